"""Lenses that are known: poses are not needed, other sizes and names are said, other models are refused by name."""

import logging

import numpy as np
import pytest

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.rational import Rational
from jaxpoint.camera.rig import CameraRig
from jaxpoint.commands.inputs import intrinsics_from
from jaxpoint.config import InputSettings
from jaxpoint.errors import FileFormatError, JaxpointError, UsageError
from jaxpoint.io.exchange import read_calibration, read_lenses, write_calibration
from jaxpoint.io.formats.format_registry import FORMATS
from jaxpoint.io.lens_entries import read_coefficients
from jaxpoint.io.rig_entries import SavedCalibration
from jaxpoint.tracks import Tracks

NAMES = tuple(f"cam_{i}" for i in range(5))
FOCAL = [945.0, 881.2733924, 870.5860370, 943.2076629, 893.4524985]  # px
KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.12, 0.03, 0.001,
    -0.002]
  distortion_model: radtan
  intrinsics: [945.0, 946.0, 639.5, 359.5]
  resolution: [1280, 720]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [881.0, 881.0, 639.5, 359.5]
  resolution: [1280, 720]
"""
ROS = """image_width: 1280
image_height: 720
camera_matrix: {rows: 3, cols: 3, data: [900.0, 0.0, 640.0, 0.0, 901.0, 360.0, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.0, 0.0, 0.0]}
"""


def tracks(names=NAMES, size=(1280, 720)) -> Tracks:
    return Tracks.from_pixels(np.zeros((1, len(names), 2)), np.tile(size, (len(names), 1)), names=names)


def given(path, names=NAMES, size=(1280, 720), **more):
    return intrinsics_from(InputSettings(intrinsics=path, **more), tracks(names, size))


@pytest.mark.parametrize("name", ["full.json", "four.json", "nopose.json", "noextr.toml", "names.json", "half.json"])
def test_lenses_are_read_with_and_without_poses(data_folder, name, caplog):
    rig = given(data_folder.parent / "cases/17-known-lenses" / name)
    assert rig.names == NAMES
    np.testing.assert_allclose(rig.cameras.focal, np.tile(FOCAL, (2, 1)).T)
    np.testing.assert_allclose(rig.cameras.center, np.tile([639.5, 359.5], (5, 1)))
    np.testing.assert_allclose(rig.cameras.distortion, np.tile([-0.12, 0.03, 0, 0, 0], (5, 1)))
    assert rig.image_sizes.tolist() == [[1280, 720]] * 5
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert [("scaled by 2" in text) for text in said] == ([True] if name == "half.json" else [])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("camchain.yaml", "has the cameras cam0, but the tracks have cam_0, cam_1, .*every camera needs a lens"),
        ("opencv.yml", "has the cameras opencv, but the tracks have cam_0, .*every camera needs a lens"),
    ],
)
def test_what_is_not_known_is_refused_by_name(data_folder, name, message):
    with pytest.raises(JaxpointError, match=message):
        given(data_folder.parent / "cases/17-known-lenses" / name)


@pytest.mark.parametrize(
    ("name", "lens"), [("eight.json", Rational), ("rational.toml", Rational), ("fisheye.toml", None)]
)
def test_lenses_of_other_models(data_folder, name, lens):
    path = data_folder.parent / "cases/17-known-lenses" / name
    if lens is None:
        with pytest.raises(JaxpointError, match="has 4 coefficients"):
            given(path)
    else:
        assert type(given(path).cameras.lens) is lens


def test_kalibr_and_opencv(data_folder, tmp_path):
    folder = data_folder.parent / "cases/17-known-lenses"
    for name in ("camchain.yaml", "opencv.yml"):
        rig = given(folder / name, names=("cam0",) if name == "camchain.yaml" else ("opencv",))
        np.testing.assert_allclose(rig.cameras.focal, [[945, 945]])
        np.testing.assert_allclose(rig.cameras.distortion, [[-0.12, 0.03, 0, 0, 0]])
    (tmp_path / "chain.yaml").write_text(KALIBR)
    rig = given(tmp_path / "chain.yaml", names=("cam_1", "cam_0"))
    assert rig.cameras.focal.tolist() == [[881, 881], [945, 946]]
    assert rig.cameras.distortion.tolist() == [[0] * 5, [-0.12, 0.03, 0.001, -0.002, 0]]
    (tmp_path / "other.yaml").write_text(KALIBR.replace("radtan", "fov"))
    with pytest.raises(FileFormatError, match=r"cam0: .*cannot be read \(model 'fov'; known are radtan, .*fisheye"):
        read_lenses(tmp_path / "other.yaml")
    (tmp_path / "fish.yaml").write_text(KALIBR.replace("radtan", "equidistant").replace("none", "equidistant"))
    with pytest.raises(FileFormatError, match=r"cam1: .*distortion_coeffs"):
        read_lenses(tmp_path / "fish.yaml")


def test_a_folder_holds_one_file_a_camera(data_folder, tmp_path):
    text = (data_folder.parent / "cases/17-known-lenses/opencv.yml").read_text()
    (tmp_path / "door.yml").write_text(text)
    (tmp_path / "window.yaml").write_text(ROS)
    rig = given(tmp_path, names=("window", "door"))
    assert rig.cameras.focal.tolist() == [[900, 901], [945, 945]]
    for broken in ("a: [1, 2", "plain words", "", "camera_matrix: 3\n", text.replace("image_width: 1280", "")):
        (tmp_path / "door.yml").write_text(broken)
        with pytest.raises(FileFormatError, match=r"door.yml.* (is no file of OpenCV|image_width|must hold|matrix)"):
            read_lenses(tmp_path)


def test_names_that_differ_are_matched_by_order_only_when_asked(data_folder):
    path, names = data_folder.parent / "cases/17-known-lenses/full.json", ("a", "b", "c", "d", "e")
    with pytest.raises(UsageError, match=r"cameras cam_0, .* have a, b, c, d, e: .* give --intrinsics-by-order"):
        given(path, names)
    rig = given(path, names, intrinsics_by_order=True)
    assert rig.names == names
    np.testing.assert_allclose(rig.cameras.focal[:, 0], FOCAL)
    with pytest.raises(UsageError, match="every camera needs a lens"):
        given(path, names[:4], intrinsics_by_order=True)


def test_images_of_another_shape_are_refused(data_folder):
    path = data_folder.parent / "cases/17-known-lenses/full.json"
    with pytest.raises(UsageError, match=r"images of 1280 x 960 px, but .* for 1280 x 720: another shape, so cropped"):
        given(path, size=(1280, 960))
    rig = given(path, size=(427, 240))  # a pixel's rounding is no other shape
    np.testing.assert_allclose(rig.cameras.focal[0], [945 * 427 / 1280, 945 / 3])


def test_a_calibration_needs_poses(data_folder):
    folder = data_folder.parent / "cases/17-known-lenses"
    for name in ("nopose.json", "noextr.toml"):
        with pytest.raises(FileFormatError, match=r"'cam_0' has no rotation and translation|'rotation' is missing"):
            read_calibration(folder / name)
    with pytest.raises(FileFormatError, match=r"'cam0' has no rotation and .*\(--intrinsics\)"):
        read_calibration(folder / "camchain.yaml")


@pytest.mark.parametrize("count", [0, 1, 2, 4, 5, 8, 14])
def test_coefficients_in_opencvs_order(count):
    values = [0.1, 0.2, 0.3, 0.4, 0.5][:count] + [0.0] * (count - 5)
    lens, found = read_coefficients("", [values])
    assert lens is Brown
    np.testing.assert_array_equal(found[:count], values[:5])


@pytest.mark.parametrize("values", ["none", [[1, 2], [3, 4]], [np.nan], [0.0] * 3, [0.0] * 15])
def test_coefficients_that_are_none(values):
    with pytest.raises(FileFormatError, match=r"x: the distortion must be (4 or 5 )?finite numbers"):
        read_coefficients("x: ", values)


@pytest.mark.parametrize("name", [name for name, fmt in FORMATS.items() if fmt.read is not None])
def test_lenses_of_every_exchange_format(tmp_path, name):
    """Names as the format has them; an image size that a file does not hold is that of the tracks."""
    turns, places = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0.0, 4.0], [1.0, 0.0, 4.0]])
    sizes = np.array([[1280, 720]] * 2)
    focal, center = np.array([[900.0, 905.0], [800.0, 810.0]]), np.array([[640.0, 361.0], [600.0, 350.0]])
    rig = CameraRig.from_parameters(focal, center, np.zeros((2, 5)), turns, places, sizes, ("cam0", "cam1"))
    fmt = FORMATS[name]
    files = fmt.write(SavedCalibration(rig), tmp_path / "x")
    path = tmp_path / (next(iter(files)) if len(files) == 1 else "out")
    write_calibration(rig, path, name)
    found = given(path, names=fmt.rename(rig.names))
    np.testing.assert_allclose(found.cameras.focal, focal, rtol=1e-12)
    np.testing.assert_allclose(found.cameras.center, center, rtol=1e-12)
    assert found.image_sizes.tolist() == [[1280, 720]] * 2


def test_a_size_that_a_file_does_not_hold_is_that_of_the_tracks(tmp_path):
    text = "%YAML:1.0\n---\nnames: [a]\nK_a: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
    text += "  data: [900., 0., 640., 0., 900., 360., 0., 0., 1.]\ndist_a: !!opencv-matrix\n  rows: 1\n  cols: 4\n"
    (tmp_path / "intri.yml").write_text(f"{text}  dt: d\n  data: [0., 0., 0., 0.]\n")
    assert given(tmp_path, names=("a",)).image_sizes.tolist() == [[1280, 720]]
    with pytest.raises(UsageError, match="holds no image size of camera 'a'; give it: --size"):
        read_lenses(tmp_path)
