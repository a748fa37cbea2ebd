"""Calibrations in files: what is written is read, by us and as OpenCV understands it, and errors name the field."""

import json
import tomllib
from dataclasses import replace

import cv2
import jax
import numpy as np
import pytest
import tomli_w

from jaxpoint.calibration.result import ReadoutTimes, TimeOffsets
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.camera import POSE_NAMES, Camera
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.rational import Rational
from jaxpoint.errors import FileFormatError
from jaxpoint.io.calibration import read_calibration_json, write_calibration_json
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.formats.anipose_toml import read_calibration_toml, write_calibration_toml
from jaxpoint.simulate.rooms import random_room

ROOM = random_room(3, cameras=11)

PARAMETER_NAMES = (*POSE_NAMES, *Brown.parameter_names())


def assert_same_rig(first, second, atol):
    assert first.names == second.names
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=0, atol=atol)


def test_json_round_trip_is_exact(tmp_path):
    path = tmp_path / "calibration.json"
    size = len(PARAMETER_NAMES) * 11
    covariance = np.random.default_rng(0).normal(size=(size, size))
    provenance = {"seed": 3, "versions": {"jax": "0.10"}, "inputs": [], "note": "Raum ü"}
    write_calibration_json(path, ROOM.rig, unit="arbitrary", covariance=covariance, provenance=provenance)
    saved = read_calibration(path)
    assert_same_rig(saved.rig, ROOM.rig, 0)
    assert (saved.unit, saved.provenance) == ("arbitrary", provenance)
    np.testing.assert_array_equal(saved.covariance, covariance)
    assert [file.name for file in tmp_path.iterdir()] == ["calibration.json"]
    write_calibration_json(path, ROOM.rig)
    assert read_calibration(tmp_path).covariance is None  # a run's folder


@pytest.mark.parametrize(("name", "kind"), [("time_offsets", TimeOffsets), ("readout_times", ReadoutTimes)])
def test_times_are_kept_where_there_are_any(tmp_path, name, kind):
    path = tmp_path / "calibration.json"
    times = kind(np.linspace(0.0, 0.7, 11), np.full(11, 0.003))
    write_calibration_json(path, ROOM.rig, **{name: times})
    found = getattr(read_calibration_json(path), name)
    np.testing.assert_array_equal(found.frames, times.frames)
    np.testing.assert_array_equal(found.sigma, times.sigma)
    content = json.loads(path.read_text())
    content[name]["sigma"].pop()
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=rf"`\$\.{name}` has 11 frames and 10 sigmas for 11 cameras"):
        read_calibration_json(path)
    write_calibration_json(path, ROOM.rig)
    assert name not in json.loads(path.read_text())  # older readers refuse what they do not know
    assert getattr(read_calibration_json(path), name) is None


def test_json_is_what_the_readme_says(tmp_path):
    path = tmp_path / "calibration.json"
    write_calibration_json(path, ROOM.rig)
    content = json.loads(path.read_text())
    assert (content["format"], content["version"], content["unit"]) == ("jaxpoint-calibration", 1, "m")
    camera = content["cameras"][4]
    assert set(camera) == {"name", "size", "K", "distortion", "rotation", "translation"}
    projected, _ = cv2.projectPoints(
        ROOM.points[:5],
        cv2.Rodrigues(np.array(camera["rotation"]))[0],
        np.array(camera["translation"]),
        np.array(camera["K"]),
        np.array(camera["distortion"]),
    )
    np.testing.assert_allclose(projected[:, 0], np.asarray(ROOM.rig.project(ROOM.points[:5]))[:, 4], atol=1e-8)


def test_toml_round_trip_in_input_order(tmp_path):
    path = tmp_path / "calibration.toml"
    write_calibration_toml(path, ROOM.rig, unit="m", metadata={"error": 0.3})
    saved = read_calibration(path)
    assert_same_rig(saved.rig, ROOM.rig, 1e-12)
    assert (saved.unit, saved.provenance["error"]) == ("m", 0.3)
    content = tomllib.loads(path.read_text())
    assert list(content) == [f"cam_{i}" for i in range(11)] + ["metadata"]
    camera = content["cam_10"]
    assert list(camera) == ["name", "size", "matrix", "distortions", "rotation", "translation"]
    arguments = (camera[key] for key in ("rotation", "translation", "matrix", "distortions"))
    projected, _ = cv2.projectPoints(ROOM.points[:5], *map(np.array, arguments))
    np.testing.assert_allclose(projected[:, 0], np.asarray(ROOM.rig.project(ROOM.points[:5]))[:, 10], atol=1e-8)


def test_camera_array_of_caliscope(data_folder):
    """Its README: mean reprojection of camera 0's corners 1.055 px from its own points."""
    folder = data_folder / "caliscope_charuco4"
    saved = read_calibration(folder / "camera_array.toml")
    assert saved.rig.names == ("cam_0", "cam_1", "cam_2", "cam_3")
    np.testing.assert_allclose(np.asarray(saved.rig.cameras.focal)[0], [903.550124089999, 907.8788668762852])
    corners = np.genfromtxt(folder / "calibration/extrinsic/CHARUCO/xyz_CHARUCO.csv", delimiter=",", skip_header=1)
    places = {(int(row[0]), int(row[2])): row[3:6] for row in corners}
    seen = np.genfromtxt(folder / "calibration/extrinsic/CHARUCO/xy_CHARUCO.csv", delimiter=",", skip_header=1)
    seen = seen[(seen[:, 1] == 0) & [(int(row[0]), int(row[3])) in places for row in seen]]
    points = np.array([places[int(row[0]), int(row[3])] for row in seen])
    errors = np.linalg.norm(np.asarray(saved.rig.project(points))[:, 0] - seen[:, 4:6], axis=1)
    assert errors.mean() == pytest.approx(1.055, abs=0.005)


def test_camera_array_ignores_and_sorts(tmp_path, data_folder):
    content = tomllib.loads((data_folder / "caliscope_charuco4/camera_array.toml").read_text())
    cameras = content["cameras"]
    cameras["1"]["ignore"] = True
    rotation = np.array(cameras["3"]["rotation"])
    cameras["3"]["rotation"] = cv2.Rodrigues(rotation)[0].ravel().tolist()  # as newer caliscope writes it
    path = tmp_path / "camera_array.toml"
    path.write_text(tomli_w.dumps({"cameras": {key: cameras[key] for key in ("3", "0", "1", "2")}}))
    rig = read_calibration(path).rig
    assert rig.names == ("cam_0", "cam_2", "cam_3")
    np.testing.assert_allclose(np.asarray(rig.cameras.cam_from_world.rotation)[2], rotation, atol=1e-7)


def test_toml_of_other_programs(tmp_path):
    """Pose2Sim writes sizes as floats, four distortions and no metadata."""
    path = tmp_path / "Calib.toml"
    path.write_text(
        '[cam_01]\nname = "front"\nsize = [ 1088.0, 1920.0]\nmatrix = [[1681.2, 0.0, 533.0], [0.0, 1681.0, 948.1], '
        "[0.0, 0.0, 1.0]]\ndistortions = [-0.046, 0.13, 0.0, 0.001]\nrotation = [1.2, 0.5, -0.1]\n"
        "translation = [1.0, 2.0, 3.0]\nfisheye = false\n"
    )
    saved = read_calibration(path)
    assert saved.rig.names == ("front",)
    assert np.asarray(saved.rig.image_sizes).tolist() == [[1088, 1920]]
    assert np.asarray(saved.rig.cameras.distortion)[0].tolist() == [-0.046, 0.13, 0.0, 0.001, 0.0]


def broken(content, path, value):
    """The content with one field changed, or removed where the value is None."""
    *parents, last = path
    place = content
    for key in parents:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["version"], 2, "has version 2; this jaxpoint reads 1"),
        (["version"], None, "has version None"),
        (["format"], "colmap", "'format' is not 'jaxpoint-calibration'"),
        (["unit"], "mm", r"unit 'mm' at `\$\.unit`"),
        (["extra"], 1, "unknown field `extra`"),
        (["cameras", 1, "K"], None, r"missing required field `K` - at `\$\.cameras\[1\]`"),
        (["cameras", 1, "size"], [1.5, 2], r"`\$\.cameras\[1\]\.size\[0\]`"),
        (["cameras", 1, "distortion"], [0.1], r"`\$\.cameras\[1\]\.distortion` must be .* five numbers"),
        (["cameras", 1, "translation"], [0, 0, "x"], r"Expected `float`, got `str` - at `\$\.cameras\[1\]\.transl"),
        (["cameras", 1, "rotation", 0], [2, 0, 0], r"at `\$\.cameras\[1\]`, the rotation is none"),
        (["cameras", 1, "K", 0], [1, 2, 3], r"at `\$\.cameras\[1\]`, K must be"),
        (["cameras", 1, "size"], [0, 480], r"at `\$\.cameras\[1\]`, size \[0, 480\] must be positive"),
        (["cameras", 1, "name"], "cam_0", "with different names"),
        (["cameras"], [], "one or more with different names"),
        (["covariance"], {"parameters": ["fx"], "matrix": [[1.0]]}, r"`\$\.covariance\.parameters` must be rotation_x"),
        (["covariance"], {"parameters": list(PARAMETER_NAMES), "matrix": [[1.0]]}, "must be 165 x 165 for 11"),
    ],
)
def test_wrong_json_names_the_field(tmp_path, path, value, message):
    file = tmp_path / "calibration.json"
    write_calibration_json(file, ROOM.rig)
    file.write_text(json.dumps(broken(json.loads(file.read_text()), path, value)))
    with pytest.raises(FileFormatError, match=message):
        read_calibration_json(file)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["cam_1", "matrix"], None, r"\[cam_1\]: 'matrix' is missing"),
        (["cam_1", "size"], [640.5, 480], r"\[cam_1\]: size \[640\.5, 480\] must be whole pixels"),
        (["cam_1", "rotation"], [0.1, 0.2], r"\[cam_1\]: rotation has shape \(2,\)"),
        (["cam_1", "translation"], "far", r"\[cam_1\]: 'translation' must hold numbers"),
        (["cam_1", "translation"], [0.0, 0.0, float("inf")], r"\[cam_1\]: 'translation' must be .* finite"),
        (["cam_1", "distortions"], [0.0] * 7, r"\[cam_1\]: the distortion must be 4 or 5 finite numbers"),
        (["cam_1", "distortions"], [0.1] * 12, r"\[cam_1\]: the lens has 12 coefficients, with a thin prism"),
        (["cam_1", "fisheye"], True, r"\[cam_1\]: a kannala_brandt lens has 4 coefficients \(k1, .*\), not 5"),
    ],
)
def test_wrong_toml_names_the_section(tmp_path, path, value, message):
    file = tmp_path / "calibration.toml"
    write_calibration_toml(file, ROOM.rig)
    file.write_text(tomli_w.dumps(broken(tomllib.loads(file.read_text()), path, value)))
    with pytest.raises(FileFormatError, match=message):
        read_calibration_toml(file)


def test_what_is_no_calibration(tmp_path):
    for name, text, message in (
        ("a.json", '{"format": "jaxpoint-calibration", ', "truncated; copy it again"),
        ("b.json", "[]", "holds no calibration of a known format; name it by --from NAME"),
        ("c.toml", "[cam_0]\ndistortions = 1\n= 1", "it is not TOML"),
        ("d.toml", "[metadata]\n", "holds no calibration of a known format"),
        ("e.toml", "[cameras.0]\n[cameras]\n", r"\[cameras.0\]: 'distortions' is missing"),
        ("f.yaml", "", "holds no calibration of a known format"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(FileFormatError, match=message):
            read_calibration(tmp_path / name)
    for text, message in (("= 1", "it is not TOML"), ("[metadata]\n", "holds no camera")):
        (tmp_path / "g.toml").write_text(text)
        with pytest.raises(FileFormatError, match=message):
            read_calibration(tmp_path / "g.toml", "anipose")
    with pytest.raises(FileFormatError, match=r"is no camera_array\.toml"):
        read_calibration(tmp_path / "g.toml", "caliscope")
    with pytest.raises(FileFormatError, match="There is no file"):
        read_calibration(tmp_path / "nothing.json")


def test_nothing_is_written_that_is_not_finite(tmp_path):
    rig = jax.tree.map(lambda leaf: leaf * np.nan if leaf.ndim == 3 else leaf, ROOM.rig)
    for write, name in ((write_calibration_json, "a.json"), (write_calibration_toml, "a.toml")):
        with pytest.raises(ValueError, match="rotation of the rig is not finite"):
            write(tmp_path / name, rig)
    with pytest.raises(ValueError, match=r"covariance is \(3, 3\); 11 cameras need \(165, 165\)"):
        write_calibration_json(tmp_path / "a.json", ROOM.rig, covariance=np.eye(3))
    assert not list(tmp_path.iterdir())


def test_reading_keeps_float64_without_the_global_switch(tmp_path):
    write_calibration_json(tmp_path / "calibration.json", ROOM.rig)
    with jax.enable_x64(False):
        rig = read_calibration(tmp_path).rig
    assert_same_rig(rig, ROOM.rig, 0)


@pytest.mark.parametrize("lens", [Brown, Rational, KannalaBrandt])
def test_lenses_of_all_models_are_kept(tmp_path, lens):
    plain = ROOM.rig.cameras
    distortion = 0.01 * np.arange(1.0, 1.0 + 11 * len(lens.coefficients)).reshape(11, -1)
    rig = replace(ROOM.rig, cameras=Camera(lens.of(plain.focal, plain.center, distortion), plain.cam_from_world))
    size = rig.camera_size * 11
    write_calibration_json(tmp_path / "calibration.json", rig, covariance=np.eye(size), gauge="free")
    write_calibration_toml(tmp_path / "calibration.toml", rig)
    for name in ("calibration.json", "calibration.toml"):
        saved = read_calibration(tmp_path / name)
        assert type(saved.rig.cameras.lens) is lens
        np.testing.assert_allclose(saved.rig.cameras.lens.parameters, rig.cameras.lens.parameters, rtol=1e-15)
    assert read_calibration(tmp_path / "calibration.json").covariance.shape == (size, size)


def test_models_that_differ_become_one_where_one_has_both(tmp_path):
    file = tmp_path / "calibration.toml"
    write_calibration_toml(file, ROOM.rig)
    content = tomllib.loads(file.read_text())
    content["cam_1"]["distortions"] = [0.1, 0.02, 0.0, 0.0, 0.01, 0.3, 0.04, 0.02]
    file.write_text(tomli_w.dumps(content))
    rig = read_calibration(file).rig
    assert type(rig.cameras.lens) is Rational
    np.testing.assert_allclose(rig.project(ROOM.points[:20])[:, 0], ROOM.rig.project(ROOM.points[:20])[:, 0], atol=1e-9)
    content["cam_1"] |= {"fisheye": True, "distortions": [0.1, 0.0, 0.0, 0.0]}
    file.write_text(tomli_w.dumps(content))
    content["cam_0"]["distortions"] = [0.1, 0.02, 0.0, 0.0, 0.01, 0.3, 0.04, 0.02]
    file.write_text(tomli_w.dumps(content))
    mixed = read_calibration(file).rig
    assert mixed.lens_models[:3] == (Rational, KannalaBrandt, Brown)
    np.testing.assert_allclose(mixed[2].project(ROOM.points[:20]), ROOM.rig[2].project(ROOM.points[:20]), atol=1e-9)
    write_calibration_json(tmp_path / "mixed.json", mixed)
    again = read_calibration(tmp_path / "mixed.json").rig
    assert again.lens_models == mixed.lens_models
    np.testing.assert_allclose(again.project(ROOM.points[:20]), mixed.project(ROOM.points[:20]), atol=1e-9)
