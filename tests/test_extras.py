"""Nothing that is extra costs a result: whatever fails after the results, they lie on disk and the exit code is 0."""

import json
import logging
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from jaxpoint.calibration.alignment import align_to_camera_centres, apply_alignment
from jaxpoint.cli import main
from jaxpoint.config import RoomConfig
from jaxpoint.errors import InsufficientDataError, MissingDependencyError
from jaxpoint.extras import extra
from jaxpoint.io.session import open_session
from jaxpoint.io.track_files import save_tracks
from jaxpoint.report.html import write_report
from jaxpoint.runs import Interrupted, read_run, save_run, write_run

SESSION = Path(str(files("jaxpoint"))) / "data" / "session"


def broken(*_, **__):
    raise IndexError("list index out of range")


def run(*arguments, capsys):
    return main([str(argument) for argument in arguments]), *capsys.readouterr()


def lines_of(text):
    return [line for line in text.splitlines() if line.startswith("Missing: ")]


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (IndexError("0"), "a fault in jaxpoint, IndexError: please report it"),
        (MemoryError(), "there was not enough memory for it"),
        (OSError(28, "No space left on device", "page"), "(No space left on device at 'page')"),
        (ModuleNotFoundError("no", name="matplotlib"), "the package 'matplotlib' is not installed"),
        (InsufficientDataError("Too little."), "(Too little)"),
    ],
)
def test_an_error_is_a_sentence_that_names_the_file_and_the_cause(error, says, caplog):
    missing = []
    with caplog.at_level(logging.INFO, "jaxpoint"), extra("report.html", missing):
        raise error
    (sentence,) = missing
    assert sentence.startswith("Missing: report.html (")
    assert says in sentence
    warned, traced = caplog.records
    assert (warned.levelname, warned.message) == ("WARNING", sentence)
    assert traced.exc_info[1] is error  # shown under -v


def test_an_interruption_is_no_error():
    with pytest.raises(KeyboardInterrupt), extra("report.html", []):
        raise KeyboardInterrupt


@pytest.fixture
def solved(monkeypatch, solved_room):
    """`calibrate` that is done at once."""
    monkeypatch.setattr("jaxpoint.calibration.selfcal.calibrate", lambda *_, **__: solved_room[1])
    return solved_room[1]


def test_calibrate_and_align_keep_the_calibration(tmp_path, solved, monkeypatch, capsys, caplog):
    monkeypatch.setattr("jaxpoint.runs.write_report", broken)
    save_tracks(tmp_path / "tracks.npz", solved.tracks)
    (tmp_path / "tape.csv").write_text(
        "\n".join(
            ["name,x_m,y_m,z_m", *(f"{n},{x},{y},{z}" for n, (x, y, z) in zip(solved.rig.names, solved.rig.positions))]
        )
    )
    for command in (
        ["calibrate", tmp_path / "tracks.npz", "--out", tmp_path / "run"],
        ["align", tmp_path / "run", "--camera-centres", tmp_path / "tape.csv", "--out", tmp_path / "room"],
    ):
        caplog.clear()
        code, out, err = run(*command, capsys=capsys)
        assert (code, err) == (0, "")
        (sentence,) = lines_of(out)
        assert "report.html" in sentence
        assert sentence in caplog.text
        assert "Report:" not in out
        assert not (command[-1] / "report.html").exists()
        assert read_run(command[-1]).calibration.rig.names == solved.rig.names
        assert (command[-1] / "calibration.toml").exists()
    code, out, _ = run(*command, "--force", "--json", capsys=capsys)
    assert (code, json.loads(out)["report"], len(json.loads(out)["missing"])) == (0, None, 1)


def test_results_are_in_place_before_the_report_is_begun(tmp_path, solved_room, monkeypatch):
    seen = []
    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: seen.extend(path.parent.iterdir()))
    write_run(tmp_path / "run", solved_room[1], RoomConfig(), command="test")
    assert {tmp_path / "run" / name for name in ("calibration.json", "result.npz", "metrics.json")} <= set(seen)


def test_interrupted_in_its_report_a_run_is_unfinished_and_the_one_before_is_kept(tmp_path, solved_room, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: path.write_text("first"))
    write_run(tmp_path / "run", solved_room[1], RoomConfig(), command="test")
    monkeypatch.setattr("jaxpoint.runs.write_report", interrupted)
    with pytest.raises(Interrupted, match=r"run\.unfinished"):
        write_run(tmp_path / "run", solved_room[1], RoomConfig(), command="test", force=True)
    assert (tmp_path / "run" / "report.html").read_text() == "first"
    assert (tmp_path / "run.unfinished" / "calibration.json").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "run.unfinished"]


def test_the_calibration_within_a_demo_is_saved_before_its_report(tmp_path, solved_room, monkeypatch):
    monkeypatch.setattr("jaxpoint.runs.write_report", broken)
    report = save_run(tmp_path / "calibration", solved_room[1], RoomConfig(), command="jaxpoint demo")
    assert read_run(tmp_path / "calibration").metrics["passed"]
    missing = []
    report(tmp_path / "calibration", missing)
    assert len(missing) == 1


def test_check_keeps_its_findings(tmp_path, solved_room, monkeypatch, capsys):
    save_tracks(tmp_path / "tracks.npz", solved_room[1].tracks)
    monkeypatch.setattr("jaxpoint.report.html.write_tracks_report", broken)
    monkeypatch.setattr("jaxpoint.report.advice.advise_on_tracks", broken)
    code, out, _ = run("check", tmp_path / "tracks.npz", "--out", tmp_path / "check", capsys=capsys)
    assert code == 0
    assert [line.split(" (")[0] for line in lines_of(out)] == ["Missing: the advice", "Missing: report.html"]
    assert "Enough for a calibration" not in out  # nobody looked
    assert json.loads((tmp_path / "check" / "check.json").read_text())["cameras"]


def test_diff_keeps_its_findings_and_its_verdict(tmp_path, solved_room, monkeypatch, capsys):
    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: path.write_text("page"))
    write_run(tmp_path / "run", solved_room[1], RoomConfig(), command="test")
    monkeypatch.setattr("jaxpoint.report.difference_page.write_difference_report", broken)
    code, out, _ = run("diff", tmp_path / "run", tmp_path / "run", "--out", tmp_path / "diff", capsys=capsys)
    assert (code, len(lines_of(out))) == (0, 1)
    assert (tmp_path / "diff" / "diff.json").exists()


def test_one_test_of_validate_keeps_what_the_others_found(tmp_path, solved_room, monkeypatch, capsys):
    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: path.write_text("page"))
    write_run(tmp_path / "run", solved_room[1], RoomConfig(), command="test")
    save_tracks(tmp_path / "again.npz", solved_room[1].tracks)

    def too_little(*_, **__):
        raise InsufficientDataError("A half is too little.")

    monkeypatch.setattr("jaxpoint.calibration.selfcal.calibrate", too_little)
    told = ["validate", tmp_path / "run", "--tracks", tmp_path / "again.npz", "--held-out", "--out", tmp_path / "kept"]
    code, out, err = run(*told, capsys=capsys)
    assert (code, err) == (4, "jaxpoint: A half is too little.\n")
    assert "another recording" in out
    assert list(json.loads((tmp_path / "kept" / "validation.json").read_text())) == ["tracks"]
    save_tracks(tmp_path / "fewer.npz", solved_room[1].tracks.select_cameras([0, 1, 2]))
    code, _, err = run("validate", tmp_path / "run", "--tracks", tmp_path / "fewer.npz", capsys=capsys)
    assert (code, "give tracks of the same cameras" in err) == (2, True)


def test_detect_led_keeps_the_tracks_and_no_page_of_another_detection(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:60, :80]
    for camera in ("a", "b"):
        (tmp_path / camera).mkdir()
        for frame in range(30):
            u, v = rng.uniform(15, 45, 2)
            light = 200 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 1.4**2))
            image = np.clip(10 + light + rng.normal(0, 1.5, light.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(str(tmp_path / camera / f"{frame:03d}.png"), image)
    monkeypatch.setattr("jaxpoint.report.html.write_detection_section", broken)
    (tmp_path / "tracks.html").write_text("of yesterday")
    options = ["--min-frames", 20, "--workers", 1, "--out", tmp_path / "tracks.npz"]
    code, out, _ = run("detect", "led", tmp_path / "a", tmp_path / "b", *options, capsys=capsys)
    assert (code, len(lines_of(out))) == (0, 1)
    assert "tracks.html" in lines_of(out)[0]
    assert "Pictures:" not in out
    assert (tmp_path / "tracks.npz").exists()
    assert not (tmp_path / "tracks.html").exists()


def test_simulate_keeps_the_session(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("jaxpoint.simulate.simulated_session.simulate_session", lambda *_: SIMULATED)
    monkeypatch.setattr(
        "jaxpoint.simulate.session_folder.write_session", lambda folder, *_, **__: (folder / "x").touch()
    )
    monkeypatch.setattr("jaxpoint.simulate.session_folder.write_preview", broken)
    code, out, _ = run("simulate", "--out", tmp_path / "session", capsys=capsys)
    assert (code, len(lines_of(out))) == (0, 1)
    assert "Preview:" not in out
    assert sorted(path.name for path in (tmp_path / "session").iterdir()) == ["provenance.json", "x"]


SIMULATED = SimpleNamespace(
    seed=0,
    gestures=(),
    objects=(),
    viewpoints=(),
    clocks=SimpleNamespace(moments=3, present=np.ones((3, 1), bool)),
    rig=SimpleNamespace(names=("cam_0",)),
    play=SimpleNamespace(duration_s=1.0),
)
"""As much of a session as the outcome tells."""


@pytest.fixture(scope="module")
def landmarks(tmp_path_factory):
    """What an estimator could say of the first gesture of the embedded session."""
    session = open_session(SESSION)
    names = {"head": "head", "right_elbow": "right_elbow", "right_wrist": "right_wrist", "right_tip": "right_index"}
    lines = ["frame,camera,name,x,y,confidence"]
    for row in (SESSION / "truth" / "joints.csv").read_text().splitlines()[1:]:
        frame, _, joint, *place = row.split(",")
        if joint not in names or not 8 <= int(frame) < 22:
            continue
        pixels = np.asarray(session.rig.project(np.array(place, float)))
        for camera, (x, y) in enumerate(pixels):
            width, height = session.sizes[camera]
            if 0 <= x < width and 0 <= y < height:
                lines.append(f"{frame},{session.names[camera]},{names[joint]},{x:.2f},{y:.2f},0.9")
    path = tmp_path_factory.mktemp("poses") / "landmarks.csv"
    path.write_text("\n".join(lines))
    return path


def test_point_keeps_the_answers(landmarks, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("jaxpoint.report.gesture_pictures.pointing_sheet", broken)
    monkeypatch.setattr("jaxpoint.report.pointing_page.write_pointing_report", broken)
    monkeypatch.setattr("jaxpoint.report.answer_text.check_speaker", lambda: None)

    def mute(_):
        raise MissingDependencyError("There is no voice.")

    monkeypatch.setattr("jaxpoint.report.answer_text.speak", mute)
    given = ["point", SESSION, "--landmarks", landmarks, "--speak", "--out", tmp_path / "answers"]
    code, out, _ = run(*given, capsys=capsys)
    assert code == 0
    missing = [line.split(" (")[0] for line in lines_of(out)]
    assert missing == ["Missing: the picture of gesture 1", "Missing: report.html", "Missing: the voice"]
    kept = sorted(path.name for path in (tmp_path / "answers").iterdir())
    assert kept == ["config.toml", "gestures.csv", "gestures.json", "metrics.json", "provenance.json"]


def test_a_gesture_without_any_image_is_shown_without_a_picture(landmarks, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "jaxpoint.report.gesture_pictures.images_of",
        lambda session, frames: [[None] * len(frames)] * len(session.names),
    )
    code, out, _ = run("point", SESSION, "--landmarks", landmarks, "--out", tmp_path / "answers", capsys=capsys)
    assert (code, lines_of(out)) == (0, [])
    assert (tmp_path / "answers" / "report.html").exists()


def test_detect_person_keeps_the_tables(landmarks, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("jaxpoint.report.people_pictures.sheets", broken)
    monkeypatch.setattr("jaxpoint.report.people_page.write_people_report", broken)
    given = ["detect", "person", SESSION, "--landmarks", landmarks, "--out", tmp_path / "people"]
    code, out, _ = run(*given, capsys=capsys)
    assert (code, len(lines_of(out))) == (0, 2)
    assert (tmp_path / "people" / "arms.csv").exists()
    assert (tmp_path / "people" / "heads.csv").exists()


def test_a_report_is_written_whatever_is_empty(tmp_path, free_room):
    """A camera that kept nothing, no point at all, no residual; and a box of the light that no camera sees most of."""
    truth = free_room[1]
    nothing = np.zeros_like(truth.point_valid)
    blind = truth.tracks.visible & (np.arange(truth.tracks.cameras) != 2)
    cases = {
        "blind": replace(
            truth, tracks=replace(truth.tracks, visible=blind), verdicts=np.where(blind, truth.verdicts, 0)
        ),
        "no point": replace(truth, point_valid=nothing),
        "exact": replace(truth, residuals=np.zeros_like(truth.residuals)),
    }
    for name, calibration in cases.items():
        write_report(tmp_path / f"{name}.html", calibration)
    aligned = apply_alignment(truth, align_to_camera_centres(truth.rig.positions, np.asarray(truth.rig.positions)))
    write_report(tmp_path / "aligned.html", replace(aligned, point_valid=nothing))
