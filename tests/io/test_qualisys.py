"""Qualisys calibrations: OpenCV as the oracle, the published floor points of a real recording, files that are wrong."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.formats.qualisys_xml import read_qualisys

ROTATION = cv2.Rodrigues(np.array([0.3, -1.1, 0.4]))[0]
POSITION_MM = (1460.0, -1909.0, 1897.0)
CAMERA = """
<camera serial="{name}" viewrotation="0">
  <fov_video bottom="1919" left="8" right="1087" top="20"/>
  <transform {rotation} x="1460" y="-1909" z="1897"/>
  <intrinsic centerPointU="34112" centerPointV="60672" focalLengthU="107520" focalLengthV="107584"
    radialDistortion1="-0.05" radialDistortion2="0.14" radialDistortion3="0.01"
    tangentalDistortion1="0.002" tangentalDistortion2="-0.003"/>
</camera>"""


def written(folder: Path, *names: str, old: str = "", new: str = "") -> Path:
    rotation = " ".join(f'r{i + 1}{j + 1}="{ROTATION[i, j]:.17g}"' for i in range(3) for j in range(3))
    cameras = "".join(CAMERA.format(name=name, rotation=rotation) for name in names)
    text = f"<calibration><cameras>{cameras}</cameras></calibration>"
    path = folder / "room.qca.txt"
    path.write_text(text.replace(old, new) if old else text)
    return path


def test_projects_like_opencv_with_the_numbers_in_the_file(tmp_path):
    rig = read_qualisys(written(tmp_path, "left", "right"))
    assert rig.names == ("left", "right")
    assert np.asarray(rig.image_sizes).tolist() == [[1080, 1900]] * 2
    saved = read_calibration(tmp_path / "room.qca.txt")
    assert (saved.unit, saved.rig.names) == ("m", ("left", "right"))
    np.testing.assert_allclose(np.asarray(rig.positions)[0], np.array(POSITION_MM) / 1000)
    matrix = np.array([[107520 / 64, 0, 34112 / 64 - 8], [0, 107584 / 64, 60672 / 64 - 20], [0, 0, 1]])
    turn = np.diag([1.0, -1.0, -1.0]) @ ROTATION
    ahead = np.array(POSITION_MM) / 1000 + turn.T @ np.array([0.3, -0.5, 4.0])
    wanted, _ = cv2.projectPoints(
        ahead[None], cv2.Rodrigues(turn)[0], -turn @ np.array(POSITION_MM) / 1000, matrix,
        np.array([-0.05, 0.14, 0.002, -0.003, 0.01]),
    )  # fmt: skip
    np.testing.assert_allclose(np.asarray(rig.project(ahead))[1], wanted[0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<calibration>", "", "is not the XML of a Qualisys calibration"),
        ("camera ", "lens ", "mismatched tag|is not the XML"),
        ("cameras>", "rooms>", "holds 0 cameras"),
        ('viewrotation="0"', 'viewrotation="90"', "view of camera 'left' is rotated by 90 degrees"),
        ('centerPointU="34112"', "", "camera 'left' has no number for centerPointU in <intrinsic>"),
        ('x="1460"', 'x="far"', "camera 'left' has no number for x in <transform>"),
        ('radialDistortion2="0.14"', 'radialDistortion2="inf"', "no number for radialDistortion2"),
    ],
)
def test_files_that_are_wrong(tmp_path, old, new, message):
    with pytest.raises(FileFormatError, match=message):
        read_qualisys(written(tmp_path, "left", old=old, new=new))


def test_published_numbers_and_floor_points(data_folder):
    rig = read_qualisys(data_folder / "pose2sim_single" / "calibration" / "Calib.qca.txt")
    np.testing.assert_allclose(np.asarray(rig.cameras.focal)[:, 0], [1681.24, 1673.73, 1681.60, 1675.23], atol=0.01)
    np.testing.assert_allclose(
        np.asarray(rig.positions) * 1000,
        [[1460, -1909, 1897], [2582, 707, 1691], [-3217, 2231, 2088], [-3759, -1416, 1882]],
        atol=1,
    )
    floor = np.array([[x, y, z] for x in (-2.0, 0.0) for y, z in ((0.3, 0.0), (0.0, 0.0), (0.0, 0.05), (-0.3, 0.0))])
    published = [(329, 974), (227, 982), (230, 965), (116, 991), (840, 1461), (719, 1503), (727, 1480), (582, 1550)]
    np.testing.assert_allclose(np.asarray(rig.project(floor))[:, 0], published, atol=0.6)
