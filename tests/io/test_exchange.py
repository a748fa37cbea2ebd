"""Exchange formats: what is written comes back to the same pixels; what has no place is said; nothing is guessed."""

import cv2
import jax
import numpy as np
import pytest

from jaxpoint.calibration.result import ReadoutTimes, TimeOffsets
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.rational import Rational
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io import exchange
from jaxpoint.io.exchange import read_calibration, read_lenses, write_calibration
from jaxpoint.io.formats.format_registry import FORMATS
from jaxpoint.io.rig_entries import UNSTATED, SavedCalibration

LENSES = {
    "none": (Brown, [0.0] * 5),
    "radial": (Brown, [-0.2, 0.05, 0.0, 0.0, 0.0]),
    "brown4": (Brown, [-0.2, 0.05, 0.001, -0.002, 0.0]),
    "brown5": (Brown, [-0.2, 0.05, 0.001, -0.002, 0.01]),
    "rational": (Rational, [0.3, -0.1, 0.001, -0.002, 0.02, 0.4, -0.2, 0.03]),
    "fisheye": (KannalaBrandt, [0.01, -0.02, 0.003, -0.001]),
}
ALL, BROWN4 = set(LENSES), {"none", "radial", "brown4"}
BROWN5, PLANE = BROWN4 | {"brown5"}, BROWN4 | {"brown5", "rational"}
HOLDS = {
    **dict.fromkeys(("jaxpoint", "anipose", "caliscope", "opencv", "ros", "colmap", "colmap-rig"), ALL),
    **dict.fromkeys(("pose2sim", "easymocap", "mrcal"), PLANE),
    **dict.fromkeys(("qualisys", "dlt"), BROWN5),
    **dict.fromkeys(("multicamselfcal", "strand-braid"), BROWN4),
    "kalibr": BROWN4 | {"fisheye"},
    "nerfstudio": BROWN5 | {"fisheye"},
    "vicon": {"none"},  # a radial lens by a fit, below
}
RELATIVE = {"opencv", "ros", "kalibr", "colmap-rig"}  # poses are those of a pair, or relative to the first camera
READ = [name for name, fmt in FORMATS.items() if fmt.read is not None]
SIZE = (1280, 720)
NAMES = ("door", "window", "shelf")
POINTS = np.random.default_rng(1).uniform(-1, 1, (20, 3))


def rig_of(lens="brown4", count=3, sizes=None, focal=None) -> CameraRig:
    """Cameras that look at the points from 4 m; the world's origin lies before all."""
    kind, coefficients = LENSES[lens]
    rng = np.random.default_rng(0)
    rotation = np.array([cv2.Rodrigues(vector)[0] for vector in rng.normal(0, 0.3, (3, 3))])
    focal = np.array([[900.0, 905.0], [800.0, 810.0], [700.0, 705.0]]) if focal is None else focal
    return CameraRig.from_parameters(
        focal[:count],
        np.array([[640.3, 361.0], [600.0, 350.5], [610.0, 355.0]])[:count],
        np.tile(coefficients, (count, 1)),
        rotation[:count],
        (rng.normal(0, 0.3, (3, 3)) + np.array([0, 0, 4]))[:count],
        np.tile(SIZE, (count, 1)) if sizes is None else sizes,
        NAMES[:count],
        kind,
    )


def pixels(rig, points=POINTS) -> np.ndarray:
    """(cameras, points, 2) by OpenCV."""
    found = []
    for i in range(len(rig)):
        pose = rig[i].cam_from_world
        k, bending = np.asarray(rig[i].intrinsics), np.asarray(rig[i].distortion)
        seen = points @ np.asarray(pose.rotation).T + np.asarray(pose.translation)
        if isinstance(rig.cameras.lens, KannalaBrandt):
            image = cv2.fisheye.distortPoints((seen[:, :2] / seen[:, 2:])[:, None], k, bending)
        else:
            image = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), k, bending)[0]
        found.append(image.reshape(-1, 2))
    return np.array(found)


def in_first_camera(rig, points):
    pose = rig[0].cam_from_world
    return points @ np.asarray(pose.rotation).T + np.asarray(pose.translation)


def target_of(name, tmp_path):
    """A file where the format writes one, else a folder."""
    fmt, rig = FORMATS[name], rig_of("none")
    files = fmt.write(SavedCalibration(rig), tmp_path / "x")
    return tmp_path / (next(iter(files)) if len(files) == 1 else "out")


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("name", READ)
def test_the_same_pixels_after_a_round_trip(tmp_path, name, lens):
    count = 2 if name in ("ros", "opencv") else 3  # those have poses of a pair
    square = np.array([[900.0, 900.0], [800.0, 800.0], [700.0, 700.0]]) if name == "vicon" else None
    rig, path = rig_of(lens, count, focal=square), target_of(name, tmp_path)
    fmt = FORMATS[name]
    if lens not in HOLDS[name] and not (name == "vicon" and lens == "radial"):
        with pytest.raises(UsageError, match=r"no place for the .* lens of camera 'door'"):
            write_calibration(rig, path, name)
        assert not list(tmp_path.iterdir())
        return
    write_calibration(rig, path, name)
    saved = read_calibration(path, size=None if fmt.holds.sizes else SIZE)  # recognised by what is in it
    points = in_first_camera(rig, POINTS) if name in RELATIVE else POINTS
    tolerance = 1.0 if (name, lens) == ("vicon", "radial") else 1e-6  # px; the note says it
    order = [saved.rig.names.index(name) for name in fmt.rename(rig.names)]  # files of a folder are read by name
    np.testing.assert_allclose(pixels(saved.rig, points)[order], pixels(rig), rtol=0, atol=tolerance)
    assert len(saved.rig) == count
    assert saved.rig.image_sizes.tolist() == [list(SIZE)] * count
    assert saved.unit == (UNSTATED if fmt.holds.unit == UNSTATED else "m")
    assert saved.posed
    assert saved.in_room == (name not in RELATIVE)  # a camera's frame has neither floor nor up
    assert bool(saved.notes) == ((name, lens) == ("vicon", "radial"))


@pytest.mark.parametrize("name", READ)
def test_what_a_format_has_no_place_for_is_said(tmp_path, name):
    rig = rig_of("none", 2)
    covariance = np.eye(rig.camera_size * 2)
    nothing = np.zeros(2), np.zeros(2)
    times = {"time_offsets": TimeOffsets(*nothing), "readout_times": ReadoutTimes(*nothing)}
    saved = SavedCalibration(rig, covariance=covariance, **times)
    fmt, said = FORMATS[name], " ".join(write_calibration(saved, tmp_path / "out", name))
    assert ("covariance" in said) == ("time offsets" in said) == ("readout times" in said) == (name != "jaxpoint")
    assert ("relative to camera 'door'" in said) == (name in RELATIVE)
    assert ("--size" in said) == (not fmt.holds.sizes)
    assert ("names the cameras" in said) == (fmt.rename(rig.names) != rig.names)


@pytest.mark.parametrize("name", [name for name in READ if not FORMATS[name].needs_poses])
def test_lenses_alone(tmp_path, name):
    """Without poses they stay lenses, and a calibration asks for poses."""
    rig, path = rig_of("brown4", 2), target_of(name, tmp_path)
    write_calibration(SavedCalibration(rig, posed=False), path, name)
    lenses = read_lenses(path)
    np.testing.assert_allclose(lenses.cameras.lens.parameters, rig.cameras.lens.parameters, rtol=1e-14)
    with pytest.raises(FileFormatError, match=r"no rotation and translation|'rotation' is missing"):
        read_calibration(path)


@pytest.mark.parametrize("name", [name for name in READ if FORMATS[name].needs_poses])
def test_formats_of_poses_refuse_lenses_alone(tmp_path, name):
    with pytest.raises(UsageError, match="needs the poses of the cameras"):
        write_calibration(SavedCalibration(rig_of("none", 2), posed=False), tmp_path / "out", name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", READ)
def test_units(tmp_path, name):
    """Formats in mm refuse lengths of no known unit; formats in metres say that these are none."""
    path, fmt = tmp_path / "out", FORMATS[name]
    saved = SavedCalibration(rig_of("none", 2), unit="arbitrary")
    if fmt.holds.unit == "mm":
        with pytest.raises(UsageError, match=r"in millimetres, .* no known unit \('arbitrary'\)"):
            write_calibration(saved, path, name)
        return
    said = " ".join(write_calibration(saved, path, name))
    assert ("lengths in an arbitrary unit" in said) == (fmt.holds.unit != "any")


def test_ros_cameras_of_more_than_a_pair_are_lenses(tmp_path):
    said = write_calibration(rig_of("brown5"), tmp_path / "out", "ros")
    assert "no place for the poses of 3 cameras, only of a pair" in said[0]
    assert read_lenses(tmp_path / "out").names == ("door", "shelf", "window")  # by the names of the files


def test_opencv_cameras_of_more_than_a_pair_have_files_of_their_own(tmp_path):
    rig = rig_of("rational")
    write_calibration(rig, tmp_path / "out", "opencv")
    back = read_calibration(tmp_path / "out").rig
    order = [back.names.index(name) for name in rig.names]
    np.testing.assert_allclose(pixels(back)[order], pixels(rig), rtol=0, atol=1e-6)


def test_several_files_need_a_folder(tmp_path):
    for name, file in (("colmap", "cameras.txt"), ("mrcal", "rig.cameramodel")):
        with pytest.raises(UsageError, match=f"3 files here .*name a folder, not '{file}'"):
            write_calibration(rig_of("none"), tmp_path / file, name)
    assert not list(tmp_path.iterdir())


def test_what_is_ambiguous_is_named(tmp_path):
    write_calibration(rig_of("brown4"), tmp_path / "out", "colmap")
    write_calibration(rig_of("brown4"), tmp_path / "out/transforms.json", "nerfstudio")
    with pytest.raises(FileFormatError, match=r"several formats \(colmap, nerfstudio\); name one by --from"):
        read_calibration(tmp_path / "out")
    for name in ("colmap", "nerfstudio"):
        assert read_calibration(tmp_path / "out", name).rig.names == NAMES


def test_names_that_say_no_format(tmp_path):
    for path, message in (
        ("rig.toml", None),
        ("rig.yaml", r"that of several formats \(opencv, kalibr, ros\)"),
        ("rig.abc", "'rig.abc' is no format's"),
    ):
        if message is None:
            write_calibration(rig_of("none"), tmp_path / path)
            continue
        with pytest.raises(UsageError, match=message):
            write_calibration(rig_of("none"), tmp_path / path)
    with pytest.raises(UsageError, match="There is no format 'kalibre'; the formats are jaxpoint, anipose"):
        write_calibration(rig_of("none"), tmp_path / "x", "kalibre")


def test_cameras_that_would_share_a_file_are_refused(tmp_path):
    rig = rig_of("none", 2)
    rig = CameraRig(rig.cameras, rig.image_sizes, ("a/b", "a_b"))
    with pytest.raises(UsageError, match="a/b and a_b would share the name of a file"):
        write_calibration(rig, tmp_path / "out", "mrcal")


def test_nothing_half_written(tmp_path, monkeypatch):
    """A folder appears with all its files or not at all."""

    def broken(path):
        raise OSError("disk full")

    original, calls = exchange.replacing, []

    def third_fails(path):
        calls.append(path)
        return broken(path) if len(calls) == 3 else original(path)

    monkeypatch.setattr(exchange, "replacing", third_fails)
    with pytest.raises(OSError, match="disk full"):
        write_calibration(rig_of("none"), tmp_path / "out", "colmap")
    assert not (tmp_path / "out").exists()


def test_reading_keeps_float64_without_the_global_switch(tmp_path):
    rig = rig_of("brown5")
    for name in ("qualisys", "colmap"):
        path = target_of(name, tmp_path)
        write_calibration(rig, path, name)
        with jax.enable_x64(False):
            back = read_calibration(path).rig
        np.testing.assert_allclose(pixels(back), pixels(rig), rtol=0, atol=1e-6)


def test_cameras_of_another_rig_do_not_join(tmp_path):
    write_calibration(rig_of("none"), tmp_path / "out", "mrcal")
    write_calibration(rig_of("radial"), tmp_path / "out", "mrcal")  # the same cameras are replaced
    with pytest.raises(UsageError, match=r"holds shelf\.cameramodel already, which would be read as a camera too"):
        write_calibration(rig_of("none", 2), tmp_path / "out", "mrcal")


@pytest.mark.parametrize("name", READ)
def test_metres_without_a_room_are_said(tmp_path, name):
    """Where the frame becomes a camera's, reading says it; else the file or a sentence does."""
    path, saved = target_of(name, tmp_path), SavedCalibration(rig_of("none", 2), in_room=False)
    said = " ".join(write_calibration(saved, path, name))
    keeps = name in RELATIVE | {"jaxpoint", "anipose"}
    assert ("its frame is not the room's" in said) == (not keeps)
    assert read_calibration(path, size=SIZE).in_room == (not keeps)


def test_a_camera_without_a_pose_makes_lenses_of_all(tmp_path):
    write_calibration(rig_of("none"), tmp_path / "calibration.toml", "anipose")
    text = (tmp_path / "calibration.toml").read_text()
    at = text.rindex("rotation = [")
    (tmp_path / "calibration.toml").write_text(text[:at] + text[text.index("[metadata]") :])
    saved = exchange.read_cameras(tmp_path / "calibration.toml", poses=False)
    assert (saved.posed, len(saved.rig)) == (False, 3)
    assert "only lenses were taken, because camera 'shelf' has no pose" in saved.notes[0]


def test_a_named_format_in_the_folder_of_a_run(tmp_path):
    write_calibration(rig_of("none"), tmp_path / "calibration.json")
    write_calibration(rig_of("radial"), tmp_path, "colmap")
    assert read_calibration(tmp_path).rig.cameras.distortion[0, 0] == 0  # a run goes before
    assert read_calibration(tmp_path, "colmap").rig.cameras.distortion[0, 0] == -0.2
