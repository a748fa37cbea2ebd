"""`jaxpoint triangulate`: points out, proved by OpenCV, ezc3d, and the layout of others' files."""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest

from jaxpoint.calibration.result import TimeOffsets
from jaxpoint.calibration.track_points import points_of_tracks
from jaxpoint.cli import main
from jaxpoint.io.exchange import read_calibration, write_calibration
from jaxpoint.io.rig_entries import SavedCalibration
from jaxpoint.io.track_files import read_tracks, save_tracks
from jaxpoint.tracks import Tracks

MM = 1000.0


@pytest.fixture(scope="module")
def fly(data_folder, tmp_path_factory):
    """Calibration and 20 frames of keypoints of three cameras, by anipose and Lightning Pose."""
    source = data_folder / "formats/lightning_pose/eks_fly_3cam"
    folder = tmp_path_factory.mktemp("fly")
    for file in source.glob("*.csv"):
        (folder / file.name).write_text("\n".join(file.read_text().splitlines()[:23]) + "\n")
    shutil.copy(source / "calibration.toml", folder)
    return folder


def triangulate(fly, out, *flags, expected=0):
    arguments = ["triangulate", str(fly / "calibration.toml"), str(fly), "--unit", "mm", "--out", str(out), *flags]
    assert main(arguments) == expected
    return out


def points_of(table):
    """Frame, point -> m, from the table."""
    with table.open() as file:
        rows = list(csv.DictReader(file))
    return {(int(row["frame"]), row["point"]): np.array([float(row[f"{a}_m"]) for a in "xyz"]) for row in rows}


@pytest.fixture(scope="module")
def table(fly):
    return triangulate(fly, fly / "points.csv")


def test_points_are_where_opencv_has_them(fly, table):
    """Two views each, without distortion, by OpenCV's own linear method; a third moves them by about the noise."""
    rig = read_calibration(fly / "calibration.toml").rig
    tracks = read_tracks(fly, image_sizes=(1000, 1000))
    views = []
    for c in (0, 1):
        k = np.diag([*np.asarray(rig.cameras.focal)[c], 1.0])
        k[:2, 2] = np.asarray(rig.cameras.center)[c]
        pose = rig.cameras.cam_from_world
        pixels = cv2.undistortPoints(tracks.pixels[:, c].copy(), k, np.asarray(rig.cameras.distortion)[c])
        views += [(np.c_[np.asarray(pose.rotation)[c], np.asarray(pose.translation)[c]], pixels[:, 0].T)]
    homogeneous = cv2.triangulatePoints(views[0][0], views[1][0], views[0][1], views[1][1])
    known = (homogeneous[:3] / homogeneous[3]).T
    found = points_of(table)
    assert len(found) == 240
    keys = zip(tracks.frame_ids.tolist(), map(tracks.point_name, tracks.point_ids.tolist()))
    ours = MM * np.array([found[key] for key in keys])
    assert np.median(np.linalg.norm(ours - known, axis=1)) < 0.01  # mm, of a fly 2 mm long; 1.4 px are 0.004
    errors = [np.sqrt(((np.asarray(rig.project(points)) - tracks.pixels) ** 2).mean()) for points in (ours, known)]
    assert errors[0] < errors[1]


def test_c3d_is_what_ezc3d_reads(fly, table, data_folder):
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d(str(triangulate(fly, fly / "points.c3d", "--fps", "300")))
    sample = ezc3d.c3d(str(data_folder / "formats/c3d/dlc2kinematics_runway03.c3d"))
    point = file["parameters"]["POINT"]
    assert set(point) >= {"USED", "SCALE", "RATE", "FRAMES", "LABELS", "UNITS"} <= set(sample["parameters"]["POINT"])
    screen = [sample["parameters"]["POINT"][f"{axis}_SCREEN"]["value"] for axis in "XY"]
    assert [point[f"{axis}_SCREEN"]["value"] for axis in "XY"] == screen  # z up, as Vicon writes it
    assert (point["UNITS"]["value"], point["RATE"]["value"].tolist()) == (["mm"], [300.0])
    known = points_of(table)
    for p, name in enumerate(point["LABELS"]["value"]):
        for frame in (0, 19):
            np.testing.assert_allclose(file["data"]["points"][:3, p, frame], MM * known[frame, name], atol=1e-4)
    with table.open() as text:
        first = next(csv.DictReader(text))
    residual = file["data"]["meta_points"]["residuals"][0, 0, 0]
    assert residual == pytest.approx(MM * float(first["sigma_m"]), rel=0.005)  # C3D has 255 steps of it


def test_trc_has_the_layout_of_opensim(fly, table, data_folder):
    """As in Pose2Sim's files for OpenSim, which have y up."""
    lines = triangulate(fly, fly / "points.trc", "--fps", "300").read_text().splitlines()
    samples = data_folder / "formats/trc"
    sample = (samples / "pose2sim_S00_P00_T01_BalancingTrial_0-100.trc").read_text().splitlines()
    assert lines[0].split("\t")[:3] == sample[0].split("\t")[:3]
    assert lines[1] == sample[1]
    assert lines[2].split("\t") == ["300", "300", "20", "12", "mm", "300", "0", "20"]
    assert lines[3].split("\t")[:6] == ["Frame#", "Time", "L1A", "", "", "L1B"]
    assert (
        len(lines[3].split("\t"))
        == len(lines[4].split("\t"))
        == 2 + 3 * 12
        == len(sample[3].rstrip("\n").split("\t")) - 3 * 9
    )
    assert lines[5] == ""
    cells = lines[6 + 19].split("\t")
    x, y, z = MM * points_of(table)[19, "L1A"]
    assert cells[:2] == ["19", "0.0633333333"]
    np.testing.assert_allclose(np.array(cells[2:5], float), [x, z, -y], atol=1e-4)


def test_missing_points_are_not_there(fly, tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    tracks = read_tracks(fly, image_sizes=(1000, 1000))
    hidden = tracks.visible & ~((tracks.frame_ids == 3) & (tracks.point_ids == 0))[:, None]
    part = Tracks.from_pixels(
        tracks.pixels, tracks.image_sizes, hidden, tracks.frame_ids, tracks.frame_ids / 50.0, tracks.names,
        point_ids=tracks.point_ids, point_names=tracks.point_names,
    )  # fmt: skip
    save_tracks(tmp_path / "tracks.npz", part)
    for ending in ("c3d", "trc", "csv"):
        out = tmp_path / f"points.{ending}"
        source = [str(fly / "calibration.toml"), str(tmp_path / "tracks.npz")]
        assert main(["triangulate", *source, "--unit", "mm", "--out", str(out)]) == 0
    file = ezc3d.c3d(str(tmp_path / "points.c3d"))
    assert file["parameters"]["POINT"]["RATE"]["value"][0] == pytest.approx(50.0)  # from the times
    missing = np.isnan(file["data"]["points"][0])
    assert np.argwhere(missing).tolist() == [[0, 3]]
    assert file["data"]["meta_points"]["residuals"][0, 0, 3] < 0
    assert file["header"]["points"]["first_frame"] == 0
    row = (tmp_path / "points.trc").read_text().splitlines()[6 + 3].split("\t")
    assert row[2:5] == ["", "", ""]
    assert row[5]
    assert (3, "L1A") not in points_of(tmp_path / "points.csv")


def test_a_view_that_contradicts_the_others_is_left_out(solved_room):
    calibration = solved_room[1]
    tracks = calibration.tracks
    away = np.linalg.norm(np.asarray(calibration.rig.project(calibration.points)) - tracks.pixels, axis=-1)
    clean = tracks.select_frames(np.flatnonzero((tracks.visible & (away < 2.0)).all(axis=1))[:20])
    pixels = clean.pixels.copy()
    pixels[::2, 1] += 100.0
    wrong = Tracks.from_pixels(pixels, clean.image_sizes, names=clean.names)
    found = points_of_tracks(calibration.rig, wrong, 5.0)
    assert found.valid.all()
    assert len(found.used) >= 10
    assert (found.used[::2] == [True, False, True, True]).all()
    assert found.used[1::2].all()
    assert 0.1 < found.sigma_px < 0.6  # simulated with 0.3


def test_expected_errors_are_those_that_are_made(solved_room):
    """Against the simulated truth; in the median, for two views alone do not show an outlier along their lines."""
    known, calibration = solved_room
    found = points_of_tracks(calibration.rig, calibration.tracks, 5.0)
    errors = (found.points - known.room.points)[found.valid] / found.sigmas[found.valid, None]
    assert found.valid.sum() > 60
    assert 0.8 < np.median(np.abs(errors)) / 0.6745 < 1.25


@pytest.mark.parametrize(
    ("flags", "code", "sentence"),
    [
        (("points.trc",), 2, "TRC needs the rate of the frames"),
        (("points.xyz",), 2, "ends in .csv, .c3d, .trc, not 'points.xyz'"),
        (("points.csv", "--world", "up"), 2, "There is no world 'up'"),
        (("points.csv", "--max-error-px", "0.0001"), 4, "None of 240 points"),
        (("points.csv", "--leave-out", "Cam-A", "--leave-out", "Cam-B"), 4, "is of one camera"),
    ],
)
def test_what_cannot_be_is_said(fly, tmp_path, capsys, flags, code, sentence):
    triangulate(fly, tmp_path / flags[0], *flags[1:], expected=code)
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_cameras_out_of_step_are_said(solved_room, tmp_path, capsys):
    """And a calibration's covariance, of the cameras that the tracks have, makes its points less sure."""
    calibration = solved_room[1]
    size = calibration.rig.camera_size * 4
    loose = 1e-4 * np.eye(size)
    late = TimeOffsets(np.array([0.0, 0.5, 0.0, 0.0]), np.full(4, 0.1))
    for name, covariance, offsets in (("sure", 1e-6 * loose, None), ("unsure", loose, late)):
        saved = SavedCalibration(calibration.rig, covariance=covariance, gauge="free", time_offsets=offsets)
        write_calibration(saved, tmp_path / f"{name}.json", "jaxpoint")
    save_tracks(tmp_path / "tracks.npz", calibration.tracks.select_cameras([2, 0, 1]))
    sigmas, said = {}, {}
    for name in ("sure", "unsure"):
        out = tmp_path / f"{name}.csv"
        given = [str(tmp_path / file) for file in (f"{name}.json", "tracks.npz")]
        assert main(["triangulate", *given, "--out", str(out)]) == 0
        said[name] = capsys.readouterr().out
        with out.open() as file:
            sigmas[name] = np.array([float(row["sigma_m"]) for row in csv.DictReader(file)])
    assert "found cameras out of step" in said["unsure"]
    assert "out of step" not in said["sure"]
    assert (sigmas["unsure"] > sigmas["sure"]).all()


def test_worlds_and_losses_are_said(fly, tmp_path, capsys):
    out = triangulate(fly, tmp_path / "unreal.csv", "--world", "unreal", "--json")
    said = json.loads(capsys.readouterr().out)
    assert said["world"] == "x,-y,z"
    with out.open() as file:
        row = next(csv.DictReader(file))
    known = 100 * points_of(fly / "points.csv")[0, row["point"]]
    np.testing.assert_allclose([float(row[f"{axis}_cm"]) for axis in "xyz"], known * [1, -1, 1], rtol=1e-8)
