"""A marker on the finger of drawn people: its tip against the truth of the drawing, and what is wrong said at once."""

import csv
import json
import re
import shutil
from dataclasses import replace

import capsules
import cv2
import numpy as np
import pytest

from jaxpoint.body.marker_tips import TipReason, marker_tips
from jaxpoint.camera.rig import CameraRig
from jaxpoint.cli import main
from jaxpoint.commands.detect_marker import _failure
from jaxpoint.config.person import MarkerSettings
from jaxpoint.detection.person import marker_watch as watching
from jaxpoint.detection.person.marker_regions import MarkerReason
from jaxpoint.detection.person.marker_watch import load_markers, save_markers
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.evidence.marker_views import MarkerViews
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.report.marker_pictures import _around

SIZE = (640, 480)
MARKER = 7  # label of the marker in the drawings
COLOURS = {1: (120, 60, 40), 2: (128, 158, 205), MARKER: (40, 190, 60)}  # blue, green, red: shirt, skin, marker
LENGTH_M = 0.04
DIRECTIONS = ([1.0, 0.2, 0.1], [0.8, -0.6, 0.0], [0.7, 0.5, -0.5], None, [0.9, 0.1, 0.4])  # None: nobody
EMPTY = 22
SETTINGS = MarkerSettings()


def rig_around(count=3):
    """Cameras on a half circle about the person, all looking at the chest."""
    angle = np.deg2rad(np.linspace(-70, 70, count) - 20)
    positions = np.stack([2.6 * np.cos(angle), 2.6 * np.sin(angle), 1.6 + 0.3 * np.arange(count)], axis=1)
    rotations = []
    for position in positions:
        forward = np.array([0.3, 0.0, 1.2]) - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotations.append(np.stack([right, np.cross(forward, right), forward]))
    rotation = np.array(rotations)
    return CameraRig.from_parameters(
        np.full((count, 2), 520.0), np.tile([320.0, 240.0], (count, 1)), np.tile([-0.1, 0.01, 0, 0, 0], (count, 1)),
        rotation, -np.einsum("cij,cj->ci", rotation, positions), np.tile(SIZE, (count, 1)),
    )  # fmt: skip


def pointing(direction):
    """A person who points, with a marker; and the marker's tip and direction."""
    along = np.array(direction) / np.linalg.norm(direction)
    person = capsules.capsule_person((0.0, 0.0), along, along)
    tip, radius = person.joints["tip"], 0.009
    cap = capsules.Capsule(tip - LENGTH_M * along, tip - radius * along, radius, radius, MARKER)
    return replace(person, capsules=(*person.capsules, cap)), tip, along


def rooms():
    rng = np.random.default_rng(3)
    coarse = rng.uniform(90, 190, (3, 8, 10, 1)) + rng.uniform(-8, 8, (3, 1, 1, 3))
    return [cv2.resize(one, SIZE, interpolation=cv2.INTER_LINEAR) for one in coarse]


def written(path, image, rng):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.clip(image + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The folder, and the labels of every image by (frame, camera)."""
    folder, rng, rig = tmp_path_factory.mktemp("marked"), np.random.default_rng(4), rig_around()
    labels = {}
    for camera, room in enumerate(rooms()):
        for k in range(EMPTY):
            written(folder / "empty" / f"cam_{camera}" / f"{k:03d}.png", room, rng)
        for frame, direction in enumerate(DIRECTIONS):
            image = room.copy()
            if direction is not None:
                own = capsules.draw(pointing(direction)[0], rig, camera).labels
                labels[frame, camera] = own
                for label, colour in COLOURS.items():
                    image[own == label] = colour
            written(folder / "videos" / f"cam_{camera}" / f"{10 + frame}.png", image, rng)
    write_calibration_json(folder / "calibration.json", rig)
    return folder, labels


@pytest.fixture(scope="module")
def samples(session, tmp_path_factory):
    """Clicks into the marker in the images of the first frame."""
    path = tmp_path_factory.mktemp("clicks") / "samples.csv"
    lines = ["camera,frame,x,y,radius_px"]
    for (frame, camera), own in session[1].items():
        if frame == 0 and (own == MARKER).any():
            y, x = np.argwhere(own == MARKER).mean(axis=0)
            lines.append(f"cam_{camera},10,{x:.0f},{y:.0f},{1.5 if camera else ''}")
    path.write_text("\n".join(lines))
    return path


def command(session, samples, out, *more):
    cache = ["--cache", str(out.parent / "cache"), "--workers", "1"]
    return ["detect", "marker", str(session), "--samples", str(samples), "--out", str(out), *cache, *more]


def rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_tip_is_found_in_the_room_and_every_line_has_its_reason(session, samples, tmp_path, capsys, monkeypatch):
    folder, labels = session
    assert main(command(folder, samples, tmp_path / "run", "--json")) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["in_room"] == {"tips": 4, "reasons": {"no_view": 1}}
    for row, direction in zip(rows(tmp_path / "run/markers.csv"), DIRECTIONS, strict=True):
        if direction is None:
            assert (row["reason"], row["tip_x_m"]) == ("no_view", "")
            continue
        _, tip, along = pointing(direction)
        assert row["reason"] == "found"
        assert np.linalg.norm(tip - [float(row[f"tip_{axis}_m"]) for axis in "xyz"]) < 0.008
        turned = np.arccos(along @ [float(row[f"direction_{axis}"]) for axis in "xyz"])
        assert np.degrees(turned) < max(8.0, 3 * float(row["sigma_deg"]))
    lines = rows(tmp_path / "run/detections.csv")
    assert len(lines) == 3 * len(DIRECTIONS)
    for line in lines:
        own = labels.get((int(line["frame"]) - 10, int(line["camera"][-1])))
        if own is None:
            assert line["reason"] == "nobody"
        elif line["reason"] == "found":
            places = np.argwhere(own == MARKER)[:, ::-1]
            assert np.hypot(*(places - [float(line["tip_x"]), float(line["tip_y"])]).T).min() < 1.5
        else:
            assert (own == MARKER).sum() < 12
    page = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    assert "Frames without a tip in the room: 1 no view." in page
    assert page.count("<svg") == 3
    assert page.count("<img") == 4
    # What was kept is used: the videos are not looked through again.
    monkeypatch.setattr(watching, "look_for_marker", None)
    assert main(command(folder, samples, tmp_path / "again")) == 0
    assert (tmp_path / "again/markers.csv").read_bytes() == (tmp_path / "run/markers.csv").read_bytes()


def test_without_a_calibration_each_view_is_looked_at_alone(session, samples, tmp_path, capsys):
    folder = tmp_path / "alone"
    for name in ("videos", "empty"):
        shutil.copytree(session[0] / name / "cam_1", folder / name / "cam_1")
    clicks = [line for line in samples.read_text().splitlines() if "cam_1" in line or "camera" in line]
    (tmp_path / "few.csv").write_text("\n".join([clicks[0], f"{clicks[1].rsplit(',', 1)[0]},2.6"]))
    assert main(command(folder, tmp_path / "few.csv", tmp_path / "run")) == 0
    assert "No tips in the room: these need a calibration" in capsys.readouterr().out
    assert not (tmp_path / "run/markers.csv").exists()
    assert "<img" in (tmp_path / "run/report.html").read_text(encoding="utf-8")
    assert [row["counts"] for row in rows(tmp_path / "run/detections.csv")] == [""] * len(DIRECTIONS)


@pytest.mark.parametrize(
    ("clicks", "code", "message"),
    [
        ("cam_0,10,900,50,2", 7, r"\(900, 50\) lies outside the image of camera 'cam_0', which has 640 x 480"),
        ("cam_0,3,50,50,2", 7, "camera 'cam_0' has no image of frame 3; the session's frames go from 10 to 14"),
        ("cam_9,10,50,50,2", 7, "there is no camera 'cam_9'"),
        ("cam_0,10,50,50,-1", 7, "'radius_px' is -1"),
        ("cam_0,10,50,50,1e9", 7, "a disc of 1e\\+09 px radius is larger than the image of camera 'cam_0'"),
        ("cam_0,10,50,50,1", 4, "at least 20 pixels, and 5 were picked"),
        ("cam_0,10,20,20,5", 4, "median saturation of"),
    ],
)
def test_samples_that_teach_nothing_are_refused(session, tmp_path, capsys, clicks, code, message):
    (tmp_path / "samples.csv").write_text(f"camera,frame,x,y,radius_px\n{clicks}\n")
    assert main(command(session[0], tmp_path / "samples.csv", tmp_path / "run")) == code
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert re.search(message, said)
    assert not (tmp_path / "run").exists()


def test_grey_videos_are_refused(session, samples, tmp_path, capsys):
    folder = tmp_path / "grey"
    shutil.copytree(session[0], folder)
    for path in (folder / "videos").rglob("*.png"):
        cv2.imwrite(str(path), cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2GRAY))
    assert main(command(folder, samples, tmp_path / "run")) == 4
    assert "has no colour in frame" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_marker_that_views_show_and_the_room_does_not_is_a_failure():
    cameras = [{"found": count, "frames": 9, "reasons": {"no_colour": 9 - count}} for count in (3, 0)]
    figures = {"moments": 9, "cameras": cameras, "in_room": {"tips": 0, "reasons": {"one_view": 3, "no_view": 6}}}
    assert "in any of 9 frames (3 one_view, 6 no_view), though 1 of 2 cameras show it in 3 images" in str(
        _failure(figures)
    )
    assert _failure({**figures, "in_room": {"tips": 1, "reasons": {}}}) is None
    assert _failure({**figures, "in_room": None}) is None
    assert "'no_colour' (9 of 9). Pick more" in str(_failure({**figures, "cameras": [{**cameras[1]}]}))


def seen(rig, tip, along, length=LENGTH_M, person=(0.0, 0.0, 1.1), cameras=None, flipped=()):
    """One frame of exact markers, as `cameras` see them; in those of `flipped` the far end is taken for the base."""
    points = np.array([tip, tip - length * along, tip - length / 2 * along, person])
    pixels = np.asarray(rig.project(points))
    found = []
    for camera in range(len(rig)):
        count = int(cameras is None or camera in cameras)
        own = pixels[:, camera][:, None][:, :count]
        ends = (own[1], own[0]) if camera in flipped else (own[0], own[1])
        frame, marker = np.full(1, FrameReason.PERSON), np.full(1, MarkerReason.FOUND if count else 2)
        found.append(MarkerViews(frame, marker, np.zeros(count, int), np.full(count, 30), own[2], *ends, own[3]))
    return found


def test_exact_ends_give_the_exact_marker_whichever_end_a_view_took_for_the_tip():
    rig, (_, tip, along) = rig_around(), pointing([0.9, 0.3, 0.2])
    for flipped in ((), (1,), (0, 2)):
        found = marker_tips(rig, seen(rig, tip, along, 0.06, flipped=flipped), SETTINGS)[0]
        assert (found.reason, found.flipped) == (TipReason.FOUND, flipped)
        np.testing.assert_allclose(found.tip, tip, atol=1e-6)
        np.testing.assert_allclose(found.base, tip - 0.06 * along, atol=1e-6)
        np.testing.assert_allclose(found.direction, along, atol=1e-5)


def test_a_marker_is_not_found_for_one_reason():
    rig, (_, tip, along) = rig_around(), pointing([0.9, 0.3, 0.2])

    def reason(**changes):
        return marker_tips(rig, seen(rig, tip, along, **changes), SETTINGS)[0].reason

    assert reason(cameras=()) == TipReason.NO_VIEW
    assert reason(cameras=(1,)) == TipReason.ONE_VIEW
    assert reason(length=0.3) == TipReason.TOO_LONG
    apart = [
        *seen(rig, tip, along)[:1],
        *seen(rig, tip + 0.2, along)[1:2],
        *seen(rig, tip, along, cameras=())[2:],
    ]
    assert marker_tips(rig, apart, SETTINGS)[0].reason == TipReason.DISAGREE


def test_a_marker_in_the_plane_of_its_two_views_has_a_tip_and_no_direction():
    rig, (_, tip, _) = rig_around(), pointing([0.9, 0.3, 0.2])
    first, second = np.asarray(rig.positions)[:2]
    along = (first - tip) / np.linalg.norm(first - tip) - 2.0 * (second - tip) / np.linalg.norm(second - tip)
    along /= np.linalg.norm(along)
    found = marker_tips(rig, seen(rig, tip, along, cameras=(0, 1)), SETTINGS)[0]
    assert found.reason == TipReason.NO_AXIS
    np.testing.assert_allclose(found.tip, tip, atol=1e-6)


def test_what_is_kept_is_read_back_and_another_version_is_not(tmp_path):
    rig, (_, tip, along) = rig_around(), pointing([0.9, 0.3, 0.2])
    own = replace(seen(rig, tip, along)[0], notes=("One note.",))
    save_markers(tmp_path / "kept.npz", own)
    back = load_markers(tmp_path / "kept.npz")
    for name in ("reasons", "markers", "frame", "area", "centroid", "tip", "base", "person"):
        np.testing.assert_array_equal(getattr(back, name), getattr(own, name))
    assert back.notes == own.notes
    (tmp_path / "kept.npz").write_bytes(b"no longer")
    with pytest.raises(watching.FileFormatError, match="delete it"):
        load_markers(tmp_path / "kept.npz")


@pytest.mark.parametrize("middle", [(320.0, 200.0), (3.0, 2.0), (638.0, 479.0)])
def test_the_part_around_a_marker_is_cut_where_its_corner_says(middle):
    image = np.stack([*np.mgrid[:480, :640], np.zeros((480, 640))], axis=-1).astype(np.uint16)
    part, corner = _around(image, np.array(middle))
    np.testing.assert_array_equal(part[0, 0, 1::-1], corner)
    x, y = np.array(middle, int) - corner
    np.testing.assert_array_equal(part[y, x, 1::-1], np.array(middle, int))
