"""Written calibrations as the tools themselves use them: OpenCV, image_proc, COLMAP, strand-braid, DLTdv and glTF."""

import base64
import json
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from test_exchange import POINTS, in_first_camera, pixels, rig_of

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.exchange import read_calibration, write_calibration
from jaxpoint.io.plain_yaml import parse_yaml


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_opencv_reads_what_is_written(tmp_path, suffix):
    path = tmp_path / f"stereo{suffix}"
    rig = rig_of("brown5", 2)
    write_calibration(rig, path, "opencv")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    seen = in_first_camera(rig, POINTS)
    rotation, translation = storage.getNode("R").mat(), storage.getNode("T").mat()
    right = cv2.projectPoints(
        seen, cv2.Rodrigues(rotation)[0], translation, storage.getNode("M2").mat(), storage.getNode("D2").mat()
    )[0]
    np.testing.assert_allclose(right.reshape(-1, 2), pixels(rig)[1], rtol=0, atol=1e-9)
    storage.release()
    np.testing.assert_allclose(pixels(read_calibration(path).rig, seen), pixels(rig), rtol=0, atol=1e-6)


def test_rectified_pixels_of_a_ros_pair_share_their_rows(tmp_path):
    """R and P as image_proc uses them: x' = P (R X), by OpenCV's undistortPoints."""
    rig = rig_of("brown5", 2)
    write_calibration(rig, tmp_path / "out", "ros")
    rows = []
    for i, name in enumerate(("door", "window")):
        table = parse_yaml("", (tmp_path / f"out/{name}.yaml").read_text())
        r, p = (np.reshape(table[f"{key}_matrix"]["data"], (3, -1)) for key in ("rectification", "projection"))
        k, bending = np.asarray(rig[i].intrinsics), np.asarray(rig[i].distortion)
        rectified = cv2.undistortPoints(pixels(rig)[i][:, None], k, bending, None, r, p[:, :3])
        rows.append(rectified.reshape(-1, 2))
        if i:
            depth = -p[0, 3] / (rows[0][:, 0] - rows[1][:, 0])
            left = parse_yaml("", (tmp_path / "out/door.yaml").read_text())
            turned = in_first_camera(rig, POINTS) @ np.reshape(left["rectification_matrix"]["data"], (3, 3)).T
            np.testing.assert_allclose(depth, turned[:, 2], rtol=1e-4)
    np.testing.assert_allclose(rows[0][:, 1], rows[1][:, 1], atol=1e-3)


def test_braids_own_arithmetic(tmp_path):
    """P to undistorted pixels, then its lens."""
    rig, path = rig_of("brown4"), tmp_path / "calibration.xml"
    write_calibration(rig, path, "strand-braid")
    for i, camera in enumerate(ElementTree.parse(path).getroot()):
        matrix = np.array([row.split() for row in camera.findtext("calibration_matrix").split(";")], float)
        lens = {part.tag: float(part.text) for part in camera.find("non_linear_parameters")}
        np.testing.assert_allclose(seen_through(matrix, lens), pixels(rig)[i], rtol=0, atol=1e-9)


def seen_through(matrix, lens) -> np.ndarray:
    """Pixels of the points by P, then by a lens about its own fc and cc."""
    u = np.hstack([POINTS, np.ones((len(POINTS), 1))]) @ matrix.T
    k = np.array([[lens["fc1"], 0, lens["cc1"]], [0, lens["fc2"], lens["cc2"]], [0, 0, 1]])
    ideal = np.linalg.solve(k, (u / u[:, 2:]).T).T
    bending = np.array([lens[name] for name in ("k1", "k2", "p1", "p2")] + [lens.get("k3", 0.0)])
    return cv2.projectPoints(ideal, np.zeros(3), np.zeros(3), k, bending)[0][:, 0]


def test_dlts_own_arithmetic(tmp_path):
    """Coefficients and profile in its own pixels: from 1, with y upwards."""
    rig = rig_of("brown5")
    write_calibration(rig, tmp_path / "out", "dlt")
    columns = np.genfromtxt(tmp_path / "out/dltCoefs.csv", delimiter=",").T
    profile = np.genfromtxt(tmp_path / "out/cameras_profile.txt")
    for i, (column, line) in enumerate(zip(columns, profile)):
        _, focal, _, height, cx, cy, aspect, *bending = line
        lens = dict(zip(("k1", "k2", "p1", "p2", "k3"), bending))
        lens |= {"fc1": focal, "fc2": focal * aspect, "cc1": cx, "cc2": cy}
        found = seen_through(np.append(column, 1.0).reshape(3, 4), lens)
        np.testing.assert_allclose(found * [1, -1] + [-1, height], pixels(rig)[i], rtol=0, atol=1e-9)


# What pycolmap 4.2.1 says of the direction (0.3, -0.2, 1), in pixels from the corner.
COLMAP = [
    ("SIMPLE_PINHOLE", [700, 400.5, 300.5], [610.5, 160.5]),
    ("PINHOLE", [700, 710, 400.5, 300.5], [610.5, 158.5]),
    ("SIMPLE_RADIAL", [700, 400.5, 300.5, -0.1], [607.77, 162.32]),
    ("RADIAL", [700, 400.5, 300.5, -0.1, 0.02], [607.84098, 162.27268]),
    ("OPENCV", [700, 710, 400.5, 300.5, -0.1, 0.02, 0.001, -0.002], [607.32298, 160.617504]),
    (
        "FULL_OPENCV",
        [700, 710, 400.5, 300.5, -0.1, 0.02, 0.001, -0.002, 0.003, 0.01, 0.02, 0.03],
        [606.9716723374075, 160.85505489565773],
    ),
    (
        "OPENCV_FISHEYE",
        [700, 710, 400.5, 300.5, -0.1, 0.02, 0.003, -0.004],
        [599.6950617219318, 165.8061963594556],
    ),
    ("SIMPLE_RADIAL_FISHEYE", [700, 400.5, 300.5, -0.1], [599.6363859210435, 167.74240938597094]),
    ("RADIAL_FISHEYE", [700, 400.5, 300.5, -0.1, 0.02], [599.6941892197424, 167.7038738535051]),
]


@pytest.mark.parametrize(("model", "parameters", "pixel"), COLMAP)
def test_colmaps_models_by_its_own_arithmetic(tmp_path, model, parameters, pixel):
    words = " ".join(map(str, parameters))
    (tmp_path / "cameras.txt").write_text(f"# a comment\n7 {model} 800 600 {words}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 7 some name.png\n\n")
    saved = read_calibration(tmp_path)
    assert saved.rig.names == ("some name",)
    found = pixels(saved.rig, np.array([[0.3, -0.2, 1.0]]))[0, 0]
    np.testing.assert_allclose(found, np.array(pixel) - 0.5, rtol=0, atol=1e-9)


def test_gltf_holds_cameras_where_they_are(tmp_path):
    """By glTF's own rules: node transforms, cameras along -z, y up; the corners of an image project to it."""
    rig, path = rig_of("none"), tmp_path / "rig.gltf"
    said = write_calibration(rig, path)
    assert any("lenses, principal points" in sentence for sentence in said)
    content = json.loads(path.read_text())
    data = np.frombuffer(base64.b64decode(content["buffers"][0]["uri"].split(",")[1]), np.uint8)
    view = content["bufferViews"][0]
    corners = data[view["byteOffset"] :][: view["byteLength"]].view("<f4").reshape(3, 5, 3).astype(float)
    for i, node in enumerate(content["nodes"][:3]):
        x, y, z, w = node["rotation"]
        angle = 2 * np.arctan2(np.linalg.norm([x, y, z]), w)
        turned = cv2.Rodrigues(np.array([x, y, z]) / np.linalg.norm([x, y, z]) * angle)[0]
        world = corners[i, 1:] @ turned.T + node["translation"]
        np.testing.assert_allclose(node["translation"], rig.positions[i], atol=1e-12)
        edges = [[-0.5, -0.5], [1279.5, -0.5], [1279.5, 719.5], [-0.5, 719.5]]
        np.testing.assert_allclose(pixels(rig, world)[i], edges, atol=1e-3)
    with pytest.raises(FileFormatError, match="holds no calibration of a known format"):
        read_calibration(path)
    with pytest.raises(UsageError, match="only written, not read"):
        read_calibration(path, "gltf")
