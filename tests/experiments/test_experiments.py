"""The experiments, each at its smallest size, and that they notice what they are there to notice."""

import re
from dataclasses import replace

import numpy as np
import pytest

import influence
import random_rooms as rooms
import readout_times as readouts
import self_calibration_stages as stages
import time_offsets as offsets
import validation_lengths as lengths
from jaxpoint.calibration.result import Stage
from jaxpoint.config import CalibrateSettings, EpipolarSettings
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.simulate.rooms import random_room


@pytest.fixture(scope="module")
def easy():
    """One room of four cameras, as `calibrate` leaves it, and its row."""
    return rooms.solved_room(5, rooms.RandomRooms(cameras=4))


def row(seed: int, **changes) -> rooms.Row:
    """A room that went well, but for the changes."""
    good = rooms.Row(seed, 4, "wall", 0.7, 0.5, 0.05, "ok", 1.25, 1.0001, 3.0, 2.9, False, 40, 39, 800, 2)
    return replace(good, **changes)


def test_a_room_is_solved_as_from_the_truth(easy):
    assert easy.verdict == "ok"
    assert easy.right
    assert 0.98 < easy.ratio < 1.001
    assert 0.1 < easy.reference_mm < 30
    assert easy.outliers > 0
    assert easy.found >= 0.9 * easy.outliers
    assert easy.lost < 0.02 * easy.good
    # The noise that was drawn is the noise that is found.
    assert easy.sigma_px == pytest.approx(easy.noise_px, rel=0.1)


def test_centres_and_hand_against_a_known_transformation():
    room = random_room(5, cameras=4)
    placed = np.ones(room.tracks.frames, bool)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved, points = 2.5 * room.positions @ turn.T + 7.0, 2.5 * room.points @ turn.T + 7.0
    assert rooms.centre_error(room, moved, points, placed) == (pytest.approx(0.0, abs=1e-6), False)
    mirror = np.array([1.0, 1.0, -1.0])
    assert rooms.centre_error(room, moved * mirror, points * mirror, placed)[1]
    shift = np.array([0.01, 0.0, 0.0]) * np.array([[1.0], [-1.0], [1.0], [-1.0]])
    assert 1.0 < rooms.centre_error(room, room.positions + shift, room.points, placed)[0] <= 10.0
    # Frames without a point do not count.
    wild, placed[:40] = room.points.copy(), False
    wild[:40] = 1e6
    assert rooms.centre_error(room, room.positions, wild, placed) == (pytest.approx(0.0, abs=1e-6), False)


def test_outliers_are_counted_where_two_other_good_views_can_tell(solved_room):
    known, calibration = solved_room
    counted = rooms.outlier_figures(known.room, calibration)  # the fixture keeps everything but the outliers
    assert counted["found"] == counted["outliers"] > 0
    assert counted["lost"] == 0
    believing = replace(calibration, verdicts=np.zeros_like(calibration.verdicts))
    assert rooms.outlier_figures(known.room, believing)["found"] == 0
    testable = known.room.tracks.visible[~known.room.is_outlier.any(axis=1)].sum(axis=1)
    assert counted["good"] >= testable[testable >= 3].sum()


def test_a_wrong_rig_called_good_is_told_from_one_that_was_marked():
    table = rooms.summary(
        [
            row(0),
            row(1, ratio=1.02),
            row(2, centres_mm=9.0),
            row(3, mirrored=True),
            row(4, ratio=2.0, verdict="gate", remark="too large"),
            row(6, verdict="gate", remark="1 px is 1 px"),
            rooms.Row(5, 4, "wall", 0.7, 0.5, 0.05, "error", 0.1, remark="too few"),
        ]
    )
    assert table["rooms"] == 7
    assert table["cost_within_1_percent"] == 4
    assert table["centres_within_3_times"] == 5
    assert table["mirrored"] == table["errors"] == table["right_but_marked"] == 1
    assert table["marked_by_a_gate"] == 2
    assert table["wrong_called_good"] == 3
    assert table["outliers_found"] == pytest.approx(39 / 40)
    assert [line["seed"] for line in table["not_right"]] == [1, 2, 3, 4, 5]
    text = rooms.markdown(table)
    assert "| wrong rigs called good | 3 | 0 |" in text
    assert text.splitlines()[-1].startswith("| 5 |")


def test_rows_are_kept_and_not_run_again(tmp_path, monkeypatch, capsys):
    asked = []

    def solved(options, seeds):
        asked.append(list(seeds))
        yield from (row(seed, remark='said "no", twice') for seed in seeds)

    monkeypatch.setattr(rooms, "solved_rooms", solved)
    rooms.main(rooms.RandomRooms((0, 2), tmp_path))
    rooms.main(rooms.RandomRooms((0, 4), tmp_path))
    assert asked == [[0, 1], [2, 3]]
    assert rooms.read_rows(tmp_path / "rows.csv") == [row(seed, remark='said "no", twice') for seed in range(4)]
    assert capsys.readouterr().out.endswith((tmp_path / "summary.md").read_text())
    with pytest.raises(UsageError, match="other settings"):
        rooms.main(rooms.RandomRooms((0, 4), tmp_path, settings=CalibrateSettings(init="thesis")))


def test_workers_hand_back_errors_as_rows(tmp_path):
    refused = CalibrateSettings(epipolar=EpipolarSettings(min_shared_frames=10_000))
    options = rooms.RandomRooms((3, 5), tmp_path, workers=1, frames=120, cameras=3, settings=refused)
    rooms.main(options)
    found = rooms.read_rows(tmp_path / "rows.csv")
    assert [line.seed for line in found] == [3, 4]
    assert {line.verdict for line in found} == {"error"}
    assert "fits no other" in found[0].remark


def test_stages_of_the_published_recording(data_folder, tmp_path):
    out = tmp_path / "stages.md"
    stages.main(stages.Stages(data_folder / "svoboda_strawlab2010", out, every=4))
    lines = {cells[1].strip(): cells[2:-1] for cells in (line.split("|") for line in out.read_text().splitlines())}
    assert lines["inliers, cameras 1 and 2"][0].strip() == "523/523"
    counts = [re.findall(r"\d+", cell) for cell in lines["inliers, cameras 1 and 2"][1:]]
    assert all(0.9 * int(shared) < int(inliers) <= int(shared) < 300 for inliers, shared in counts)
    # The toolbox: 0.709 px, 0.62 px.
    first, refined, final = (
        np.array(lines[f"{what}, px"][1:], float)
        for what in ("projective error, first", "projective error, refined", "final mean")
    )
    assert (first < 1.0).all()
    assert (refined < first).all()
    assert (final < 0.62).all()


def test_lengths_in_a_room(tmp_path):
    out = tmp_path / "lengths.md"
    lengths.main(lengths.ValidationLengths((5, 6), out, cameras=4))
    header, _, cells, mean = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in out.read_text().splitlines()[:4]
    )
    found = dict(zip(header, cells))
    assert int(found["lengths"]) == 12
    for column in ("by_landmarks", "by_centres", "predicted", "true_rig"):
        assert 0.2 < float(found[column]) < 20.0, column
        assert mean[header.index(column)] == found[column]
    assert float(found["true_rig"]) < 3 * float(found["predicted"])


def test_edges_of_tables_are_level_and_seen():
    room = random_room(8, cameras=5)
    ends = lengths.seen_edges(room, np.random.default_rng(0), 12)
    size = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert ((size >= 0.5) & (size <= 2.0)).all()
    np.testing.assert_allclose(ends[:, 0, 2], ends[:, 1, 2])
    assert (room.seen(ends.reshape(-1, 3))[1].sum(axis=1) >= 3).all()


def test_a_room_that_cannot_be_calibrated_has_its_reason_in_its_row(monkeypatch):
    def refuse(tracks):
        raise InsufficientDataError("no light")

    monkeypatch.setattr(lengths, "calibrate", refuse)
    found = lengths.measured_room(5, lengths.ValidationLengths(cameras=4))
    assert found.remark == "no light"
    assert found.by_landmarks is None
    assert found.true_rig is not None


def test_a_quality_gate_is_no_success(monkeypatch, easy, solved_room):
    bad = replace(
        solved_room[1],
        converged=False,
        stages=(
            Stage("First solution", {"candidates": [{"robust_cost_px2": 1.0}], "chosen": "thesis"}),
            Stage("Adjustment", {"robust_cost_px2": 1e6, "rounds": 20}),
        ),
    )
    room = solved_room[0].room
    monkeypatch.setattr(rooms, "random_room", lambda seed, **_: room)
    monkeypatch.setattr(rooms, "calibrate", lambda tracks, settings: bad)
    found = rooms.solved_room(0, rooms.RandomRooms())
    assert (found.verdict, found.right, found.start) == ("gate", False, "thesis")
    assert "did not converge" in found.remark
    assert found.ratio > 1


def test_influence_is_what_solving_again_shows(free_room, tmp_path):
    known, calibration = free_room
    question = influence.pointing_question(known, calibration, 1)
    solve = influence.solver_of(question)
    solved = solve(question.measured)
    rows = influence.ranked(question, solved.slopes)
    believed = int(np.asarray(question.measured.weights).sum())
    assert {kind: len(some) for kind, some in rows.items()} == {
        "light": believed - lonely(question.measured.weights),
        "clicks": int(known.clicks.visible[:8].sum()),
        "landmarks": 8,
        "pixels": int(np.asarray(question.chain.visible).sum()),
    }
    for kind, some in rows.items():
        assert [row.degrees for row in some] == sorted((row.degrees for row in some), reverse=True)
        row = some[0] = influence.checked(question, solve, np.asarray(solved.value), some[0])
        assert row.nearby == pytest.approx(row.degrees, rel=0.05), kind
        assert (row.left_out is None) == (kind != "light")
    drawn = influence.picture(question, solved.rig, rows, 1)
    drawn.savefig(tmp_path / "influence.png")
    (arm,) = (line for line in drawn.axes[0].lines if line.get_label() == "arm")
    assert np.linalg.norm(np.diff(np.asarray(arm.get_xydata()), axis=0)) < 1.1 * influence.ARM_M
    text = influence.markdown(question, rows, influence.budget(question, solved.slopes), 1)
    assert f"the {rows['landmarks'][0].name} (" in text
    assert text.count("\n|") == 6


def lonely(weights) -> int:
    """Pixels of frames in which no other camera is believed: they say nothing."""
    views = np.asarray(weights).sum(axis=1)
    return int(views[views == 1].sum())


def test_readout_times_are_counted_against_their_targets():
    usual, plain = readouts.Solved((), (), 0.40, 2.0), readouts.Solved((), (), 1.20, 10.0)
    good, bad = readouts.Solved((0.01, 0.04), (0.5, -2.5), 0.40, 3.0), readouts.Solved((0.06,), (3.5,), 0.44, 2.0)
    rows = [readouts.Row(0, 4, usual, plain, good, bad, 0, 2), readouts.Row(1, 5, usual, None, None, None, 1, 2)]
    text = readouts.markdown(rows)
    assert "In step: 1 of 2 rooms; mean error over that of global shutters: median 1.000" in text
    assert "camera centres: median 1.50." in text
    assert "all in 1 rooms, 100% of 2 cameras (median 2.5%)" in text
    assert "within 3 predicted standard deviations: 0% of 1" in text
    assert "Warnings of 4: 4 with rolling shutters, 1 with global ones." in text


def test_time_offsets_are_counted_against_their_targets():
    good = offsets.Row(0, 4, 0.8, "ok", 9.0, 0.01, (0.5, -2.5), 0.40, 0.40, 3.0, 2.0)
    rows = [good, replace(good, worst_frames=0.06, mean_px=0.5), replace(good, verdict="gate", worst_frames=0.2)]
    text = offsets.markdown([*rows, offsets.Row(3, 4, 0.4, "too little", 1.0)])
    assert "All offsets within 0.05 frame: 1 of 4 rooms." in text
    assert "Mean error at most 1.05 times that in step: 2 of 4 rooms." in text
    assert "Error of the camera centres over that in step: median 1.50." in text
    assert "Offsets within 2 predicted standard deviations: 50% of 6." in text
    assert "Wrong offsets that no gate marked: 1 rooms." in text
    tracks = random_room(5, cameras=3).tracks
    later = offsets.a_frame_later(tracks, 1)
    np.testing.assert_array_equal(later.visible[1:, 1], tracks.visible[:-1, 1])
    np.testing.assert_array_equal(later.pixels[1:, 1], tracks.pixels[:-1, 1])
    assert not later.visible[0, 1]
