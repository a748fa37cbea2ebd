"""A whole session of drawn people, from images to tables: right once, then wrong in several ways."""

import csv
import json
import re
import shutil

import capsules
import cv2
import numpy as np
import pytest

from jaxpoint.camera.rig import CameraRig
from jaxpoint.cli import main, parse
from jaxpoint.commands.detect_person import _failure
from jaxpoint.commands.nothing_found import REMEDIES, commonest
from jaxpoint.config.person import PersonSettings, SilhouetteSettings
from jaxpoint.detection.person import session_watch as recording
from jaxpoint.detection.person.session_watch import watch_camera, watch_session
from jaxpoint.errors import FileFormatError
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.io.session import open_session

SIZE = (640, 480)
COLOURS = {1: (120, 60, 40), 2: (128, 158, 205)}  # blue, green, red: shirt and skin
POINTING = np.array([0.85, -0.5, 0.15]) / np.linalg.norm([0.85, -0.5, 0.15])
MOMENTS, EMPTY = 7, 20


def rig_around(count=3) -> CameraRig:
    """Cameras on a half circle about the person, all looking at the chest."""
    angle = np.deg2rad(np.linspace(-70, 70, count) - 20)
    positions = np.stack([2.6 * np.cos(angle), 2.6 * np.sin(angle), 1.6 + 0.3 * np.arange(count)], axis=1)
    forward = np.array([0.3, 0.0, 1.2]) - positions
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return CameraRig.from_parameters(
        np.full((count, 2), 520.0), np.tile([320.0, 240.0], (count, 1)), np.tile([-0.1, 0.01, 0, 0, 0], (count, 1)),
        rotation, -np.einsum("cij,cj->ci", rotation, positions), np.tile(SIZE, (count, 1)),
    )  # fmt: skip


def written(path, image, rng):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.clip(image + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Somebody who points and sways by a centimetre."""
    folder, rng, rig = tmp_path_factory.mktemp("drawn"), np.random.default_rng(4), rig_around()
    for camera in range(len(rig)):
        room = rng.uniform(90, 190, (8, 10, 1)) + rng.uniform(-8, 8, 3)
        room = cv2.resize(room, SIZE, interpolation=cv2.INTER_LINEAR)
        for k in range(EMPTY):
            written(folder / "empty" / f"cam_{camera}" / f"{k:03d}.png", room, rng)
        for frame in range(MOMENTS):
            image = room.copy()
            person = capsules.capsule_person((0.01 * (frame % 2), 0.0), POINTING, POINTING)
            own = capsules.draw(person, rig, camera).labels
            for label, colour in COLOURS.items():
                image[own == label] = colour
            written(folder / "videos" / f"cam_{camera}" / f"{10 + frame}.png", image, rng)
    write_calibration_json(folder / "calibration.json", rig)
    lines = [f"{10 + frame},cam_{camera},{frame},{0.08 * frame:.2f}" for frame in range(MOMENTS) for camera in range(3)]
    (folder / "timestamps.csv").write_text("\n".join(["sync_index,cam_id,frame_index,frame_time", *lines]))
    return folder


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("kept")


def rows(path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def run(session, out, cache, *more) -> int:
    return main(["detect", "person", str(session), "--out", str(out), "--cache", str(cache), "--workers", "1", *more])


def test_a_session_becomes_tables(session, cache, tmp_path):
    assert run(session, tmp_path / "run", cache) == 0
    seen = rows(tmp_path / "run" / "detections.csv")
    assert len(seen) == 3 * MOMENTS
    assert {row["reason"] for row in seen} == {"person"}
    assert {row["frame"] for row in seen} == {str(10 + frame) for frame in range(MOMENTS)}
    arms = rows(tmp_path / "run" / "arms.csv")
    found = [row for row in arms if row["reason"] == "found"]
    assert len(found) >= MOMENTS - 2
    directions = np.array([[float(row[f"direction_{axis}"]) for axis in "xyz"] for row in found])
    tips = np.array([[float(row[f"tip_{axis}_m"]) for axis in "xyz"] for row in found])
    truth = capsules.capsule_person((0.005, 0.0), POINTING, POINTING).joints["tip"]
    assert np.degrees(np.arccos(np.median(directions @ POINTING))) < 2.0
    assert np.median(np.linalg.norm(tips - truth, axis=1)) < 0.02
    told = [row for row in seen if row["arm_reason"] == "found"]
    assert all(row["tip_x"] and row["base_x"] for row in told)
    assert all(not row["tip_x"] for row in seen if row["arm_reason"] != "found")
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["moments"] == MOMENTS


def test_what_was_kept_is_the_same_and_another_setting_is_looked_at_anew(session, cache, monkeypatch):
    opened = open_session(session)
    first = watch_session(opened, PersonSettings(), cache=cache, workers=1)

    def refuse(*_, **__):
        raise AssertionError("the videos were looked at")

    monkeypatch.setattr(recording, "watch", refuse)
    again = watch_session(opened, PersonSettings(), cache=cache, workers=1)
    for one, other in zip(first, again):
        np.testing.assert_array_equal(one.head, other.head)
        assert one.packed == other.packed
    with pytest.raises(AssertionError, match="looked at"):
        watch_session(opened, PersonSettings(silhouette=SilhouetteSettings(people=2)), cache=cache, workers=1)


def test_a_kept_file_that_is_cut_off_is_made_anew(session, cache, tmp_path):
    opened = open_session(session)
    first = watch_session(opened, PersonSettings(), cache=cache, workers=1)
    kept = recording.camera_job(opened, 0, PersonSettings(), tmp_path).kept
    shutil.copytree(cache, tmp_path, dirs_exist_ok=True)
    kept.write_bytes(kept.read_bytes()[: kept.stat().st_size // 2])
    again = watch_session(opened, PersonSettings(), cache=tmp_path, workers=1)
    assert first[0].packed == again[0].packed


def test_without_a_calibration_every_view_stands_alone(session, cache, tmp_path, capsys):
    bare = tmp_path / "bare"
    shutil.copytree(session, bare)
    for name in ("calibration.json", "timestamps.csv"):
        (bare / name).unlink()
    for camera in ("cam_1", "cam_2"):
        shutil.rmtree(bare / "videos" / camera)
    assert run(bare, tmp_path / "run", cache) == 0
    assert not (tmp_path / "run" / "arms.csv").exists()
    assert "calibration" in capsys.readouterr().out
    assert all(not row["person"] for row in rows(tmp_path / "run" / "detections.csv"))


def test_nobody_is_an_error_and_the_table_says_why(session, cache, tmp_path, capsys):
    bare = tmp_path / "nobody"
    shutil.copytree(session, bare)
    shutil.rmtree(bare / "videos")
    shutil.copytree(bare / "empty" / "cam_0", bare / "videos" / "cam_0")
    (bare / "timestamps.csv").unlink()
    assert run(bare, tmp_path / "run", cache) == 4
    said = capsys.readouterr().err
    assert "Nobody was found" in said
    assert "A lower --background.threshold" in said
    assert {row["reason"] for row in rows(tmp_path / "run" / "detections.csv")} <= {"nobody", "idle"}


@pytest.mark.parametrize(
    ("reasons", "remedy"),
    [
        ({"too_dark": 5, "nobody": 2}, "'too_dark' (5 of 7). Record in more light"),
        ({"blown_out": 7}, "less light"),
        ({"no_image": 7}, "timestamps.csv"),
        ({"without_colour": 4, "idle": 3}, "in one mode of the cameras"),
    ],
)
def test_the_remedy_is_that_of_the_commonest_reason(reasons, remedy):
    assert set(REMEDIES) == {reason.name.lower() for reason in FrameReason if reason != FrameReason.PERSON}
    assert remedy in commonest([{"frames": 4, "reasons": reasons}, {"frames": 3, "reasons": {}}])


def figures_of(heads, people=(), followed=True):
    """Of two cameras in which somebody was seen."""
    cameras = [{"with_person": 5, "heads": count, "reasons": {}} for count in heads]
    return {"moments": 5, "cameras": cameras, "people": list(people), "followed": followed}


def test_heads_that_nobody_could_be_followed_by_are_a_failure():
    command = parse(["detect", "person", "session"])
    failed = _failure(command, figures_of([5, 4]))
    assert failed is not None
    assert failed.exit_code == 4
    assert "9 heads were seen by 2 of 2 cameras, and two must agree on one in 3 of 5 frames" in str(failed)
    alone = str(_failure(command, figures_of([0, 5])))
    assert "5 heads were seen by 1 of 2 cameras" in alone
    assert "turn the views so that they overlap" in alone
    assert "--head.farthest-m (6) away" in str(_failure(command, figures_of([0, 0])))
    assert _failure(command, figures_of([5, 5], people=[{"person": 1}])) is None
    assert _failure(command, figures_of([5, 5], followed=False)) is None


def test_landmarks_without_anybody_are_told_by_their_confidence():
    command = parse(["detect", "person", "session", "--landmarks", "landmarks.csv", "--min-confidence", "0.95"])
    nobody = {"moments": 5, "cameras": [{"with_person": 0, "heads": 0, "frames": 5, "reasons": {"nobody": 5}}]}
    assert "lower --min-confidence, which is 0.95" in str(_failure(command, nobody))


def images_of(folder):
    return sorted(folder.glob("*.png"))


def test_grey_videos_are_told_and_left_out_beside_an_empty_room_in_colour(session, tmp_path):
    folder = tmp_path / "grey"
    for part, count in (("videos", 2), ("empty", 12)):
        (folder / part / "cam_0").mkdir(parents=True)
        for path in images_of(session / part / "cam_0")[:count]:
            shutil.copy(path, folder / part / "cam_0")
    for path in images_of(folder / "videos/cam_0"):
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    (views,) = watch_session(open_session(folder), PersonSettings(), workers=1)
    assert set(views.reasons) == {FrameReason.WITHOUT_COLOUR}
    assert "'cam_0': 2 of 2 images have no colour and the empty room has" in views.notes[-1]
    for path in images_of(folder / "empty/cam_0"):
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    (views,) = watch_session(open_session(folder), PersonSettings(), workers=1)
    assert set(views.reasons) == {FrameReason.PERSON}
    assert "'cam_0': 2 of 2 images have no colour, so that skin cannot be recognised" in views.notes[-1]


def test_an_empty_room_that_does_not_fit_names_its_camera(session, tmp_path, capsys):
    folder = tmp_path / "short"
    for part in ("videos", "empty"):
        shutil.copytree(session / part / "cam_1", folder / part / "cam_1")
    for path in images_of(folder / "empty/cam_1"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), (320, 240)))
    assert run(folder, tmp_path / "run", tmp_path / "cache") == 7
    assert re.search("camera 'cam_1' .* with 320 x 240 px and its video with 640 x 480;", capsys.readouterr().err)
    for path in images_of(folder / "empty/cam_1")[3:]:
        path.unlink()
    for path in images_of(folder / "empty/cam_1"):
        shutil.copy(images_of(session / "empty/cam_1")[0], path)
    assert run(folder, tmp_path / "run", tmp_path / "cache") == 4
    assert "Camera 'cam_1': A background is learnt from at least 10 images" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_wrong_input_is_told_in_a_sentence_and_leaves_nothing(session, cache, tmp_path, capsys):
    assert run(tmp_path / "missing", tmp_path / "run", cache) == 7
    assert "check the path" in capsys.readouterr().err
    other = tmp_path / "other"
    shutil.copytree(session / "videos", other / "videos")
    write_calibration_json(other / "calibration.json", rig_around(2))
    assert run(other, tmp_path / "run", cache) == 2
    assert "no camera 'cam_2'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_one_image_that_is_cut_off_costs_one_frame(session, cache, tmp_path):
    torn = tmp_path / "torn"
    shutil.copytree(session, torn)
    (torn / "videos" / "cam_1" / f"{10 + 3}.png").write_bytes(b"")
    assert run(torn, tmp_path / "run", cache) == 0
    lacking = [row for row in rows(tmp_path / "run" / "detections.csv") if row["reason"] == "no_image"]
    assert [(row["frame"], row["camera"]) for row in lacking] == [("13", "cam_1")]
    notes = json.loads((tmp_path / "run" / "metrics.json").read_text())["notes"]
    assert any("lacks 1 image" in note and "13.png' (0 bytes)" in note for note in notes)


def test_all_that_was_read_is_on_record(session):
    read = [str(path.relative_to(session)) for path in open_session(session).files]
    assert read[3:5] == ["timestamps.csv", "calibration.json"]
    assert sorted(read[:3] + read[5:]) == [f"{kind}/cam_{k}" for kind in ("empty", "videos") for k in range(3)]


def test_names_of_cameras_are_one_to_one(session, tmp_path):
    twice = tmp_path / "twice"
    shutil.copytree(session, twice)
    (twice / "empty" / "cam_1").rename(twice / "empty" / "door")
    assert any("'door', which is no camera here" in note for note in open_session(twice).notes)
    (twice / "videos" / "cam_1.mp4").write_bytes(b"")
    with pytest.raises(FileFormatError, match="both of camera 'cam_1'; keep one"):
        open_session(twice)


def test_interruption_says_where_finished_cameras_are_kept(session, tmp_path, monkeypatch, capsys):
    looked_at = []

    def work(job, advance):
        looked_at.append(job.name)
        if len(looked_at) == 2:
            raise KeyboardInterrupt
        return watch_camera(job, advance)

    monkeypatch.setattr(recording, "watch_camera", work)
    assert run(session, tmp_path / "run", tmp_path / "kept") == 130
    assert f"interrupted; 1 of 3 cameras were done and are kept in {tmp_path / 'kept'}" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
