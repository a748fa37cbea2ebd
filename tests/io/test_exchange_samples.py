"""Calibrations that other tools wrote, read as those tools mean them: by their baselines, points and stored errors."""

import csv
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_exchange import pixels

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.exchange import read_calibration, read_lenses
from jaxpoint.io.formats.storage_tree import parse_storage
from jaxpoint.io.rig_entries import UNSTATED


@pytest.fixture
def samples(data_folder) -> Path:
    return data_folder / "formats"


def distances(saved) -> list[float]:
    centres = np.asarray(saved.rig.positions)
    return np.linalg.norm(np.diff(centres, axis=0), axis=1).tolist()


@pytest.mark.parametrize(
    ("path", "lens", "baseline", "unit"),
    [
        ("kalibr/openvins_euroc_mav_kalibr_imucam_chain.yaml", "brown", 0.11008, "m"),
        ("kalibr/openvins_tum_vi_kalibr_imucam_chain.yaml", "kannala_brandt", 0.10109, "m"),
        ("kalibr/openvins_rs_t265_kalibr_imucam_chain.yaml", "kannala_brandt", 0.06274, "m"),
        ("kalibr/openvins_uzhfpv_indoor_kalibr_imucam_chain.yaml", "kannala_brandt", 0.07962, "m"),
        ("kalibr/d2slam_pinhole_radtan_stereo_calib_0_1_240_320.yaml", "brown", 0.1431, "m"),
        ("kalibr/d2slam_pinhole_radtan_stereo_calib_3_0_240_320.yaml", "brown", 0.1439, "m"),
        ("kalibr/4seasons/camchain.yaml", "kannala_brandt", 0.3005, "m"),
        ("ros_camera_info/ps4eye_stereo", "brown", 0.07857, "m"),
        ("ros_camera_info/zed_stereo", "brown", 0.51619, "m"),  # calibrated with a wrong square size
        ("opencv_filestorage/stereo_leozhao2", "rational", 7.974, UNSTATED),  # squares of the board
        ("opencv_filestorage/stereo_dreameer_windows", "rational", 1.713, UNSTATED),
        ("opencv_filestorage/stereo_thaytan/extrinsics.yml", "brown", 60.747, UNSTATED),  # mm
        ("colmap/kapture_t265_opencv_fisheye/cameras.txt", "kannala_brandt", 0.0640, UNSTATED),
    ],
)
def test_baselines(samples, path, lens, baseline, unit):
    saved = read_calibration(samples / path, size=(1280, 720) if "opencv" in path else None)
    assert (saved.rig.cameras.lens.name, saved.unit) == (lens, unit)
    assert distances(saved)[0] == pytest.approx(baseline, abs=6e-5 if unit == "m" else 6e-4)
    assert ("T_cam_imu differs" in " ".join(saved.notes)) == ("4seasons" in path)


def test_mrcals_pairs(samples):
    folder = samples / "mrcal/figueroa-overpass-looking-S"
    for stem, baseline in (("opencv8-{}", 2.1335), ("pinhole-narrow-yawed-{}", 2.1281)):
        sides = ("left", "right") if "pinhole" in stem else (0, 1)
        saved = read_calibration([folder / f"{stem.format(side)}.cameramodel" for side in sides])
        assert distances(saved)[0] == pytest.approx(baseline, abs=6e-5)
    with pytest.raises(FileFormatError, match=r"splined-0.*model 'LENSMODEL_SPLINED.*mrcal-convert-lensmodel"):
        read_calibration(folder)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("kalibr/d2slam_omni_4cam_fisheye_cams.yaml", "cam0: this lens cannot be read .model 'omni'"),
        ("opencv_filestorage/scanvan/out_camera_omni.xml", "this lens cannot be read .model 'omnidir', with xi"),
        ("opencv_filestorage/fisheye_stereo_sourishg/mystereocalib.yml", "add 'fisheye_model: 1' to the file"),
        ("strand_braid_xml/flydra_sample_calibration_water.xml", "look into water .refractive index 1.333"),
        ("strand_braid_xml/cal-2018-11-13-good.xml", "Basler_22005677.*only projective.*before it was aligned"),
        ("colmap/rig_config/cdgs_rig_config2.json", "'2026042001/120/ls00pri' has no lens here"),
        ("colmap/nerfprep_simple_radial", r"several formats \(colmap, nerfstudio\); name one by --from"),
    ],
)
def test_what_is_no_rig_of_ours_is_refused_by_name(samples, path, message):
    with pytest.raises(FileFormatError, match=message):
        read_calibration(samples / path, size=(1280, 720))


def test_a_fisheye_pair_that_says_so(samples, tmp_path):
    text = (samples / "opencv_filestorage/fisheye_stereo_sourishg/mystereocalib.yml").read_text()
    (tmp_path / "pair.yml").write_text(f"{text}\nfisheye_model: 1\n")
    saved = read_calibration(tmp_path / "pair.yml", size=(960, 600))
    assert saved.rig.cameras.lens.name == "kannala_brandt"
    assert distances(saved)[0] == pytest.approx(0.10996, abs=6e-6)


@pytest.mark.parametrize(
    ("folder", "mean", "count"), [("maupertuis_simple_pinhole", 0.346, 3355), ("nerfprep_simple_radial", 1.369, 863)]
)
def test_colmaps_points_reproject_as_it_says(samples, folder, mean, count):
    """Mean error over all observations, and of each point of the first set the stored ERROR."""
    place = samples / "colmap" / folder
    saved = read_calibration(place, "colmap")
    lines = [line for line in (place / "images.txt").read_text().splitlines() if not line.startswith("#")]
    stems = {row.split()[0]: Path(row.split()[9]).stem for row in lines[::2]}
    seen = {row.split()[0]: np.reshape(points.split(), (-1, 3)) for row, points in zip(lines[::2], lines[1::2])}
    rows = [line.split() for line in (place / "points3D.txt").read_text().splitlines() if not line.startswith("#")]
    world = np.array([row[1:4] for row in rows], float)
    found = dict(zip(saved.rig.names, pixels(saved.rig, world)))
    errors = []
    for i, row in enumerate(rows):
        own = [
            np.linalg.norm(found[stems[image]][i] + 0.5 - seen[image][int(place_)][:2].astype(float))
            for image, place_ in zip(row[8::2], row[9::2])
        ]
        if folder.startswith("maupertuis"):
            assert np.mean(own) == pytest.approx(float(row[7]), abs=5e-3)
        errors += own
    assert (len(errors), np.mean(errors)) == (count, pytest.approx(mean, abs=6e-4))


def test_nerf_transforms_are_colmaps_cameras(samples):
    """instant-ngp's file of the same model: one similarity maps the centres, the lens is the same."""
    place = samples / "colmap/nerfprep_simple_radial"
    one, other = read_calibration(place, "colmap").rig, read_calibration(place, "nerfstudio").rig
    order = [other.names.index(name) for name in one.names]
    np.testing.assert_allclose(
        np.asarray(other.cameras.lens.parameters)[order], np.asarray(one.cameras.lens.parameters), rtol=1e-9, atol=1e-9
    )
    here, there = np.asarray(one.positions), np.asarray(other.positions)[order]
    ratio = np.linalg.norm(there[:, None] - there[None], axis=-1).sum()
    ratio /= np.linalg.norm(here[:, None] - here[None], axis=-1).sum()
    assert ratio == pytest.approx(0.04831, abs=5e-6)
    turns = np.asarray(one.cameras.cam_from_world.rotation)
    others = np.asarray(other.cameras.cam_from_world.rotation)[order]
    frames = np.einsum("cji,cjk->cik", others, turns)  # nerf world from COLMAP's world, the same by every camera
    np.testing.assert_allclose(frames, np.broadcast_to(frames[0], frames.shape), atol=1e-9)


def test_blenders_angle_is_a_focal_length(samples):
    path = samples / "nerf_transforms/blender_lego_test/transforms_val.json"
    with pytest.raises(UsageError, match="no image size of camera 'r_0'; give it: --size"):
        read_calibration(path)
    camera = read_calibration(path, size=(800, 800)).rig[0]
    np.testing.assert_allclose(camera.focal, 1111.111, atol=1e-3)
    np.testing.assert_allclose(camera.center, 399.5)
    # Blender's turntable: 4.03 from the origin, which is in the middle of the image
    assert np.linalg.norm(camera.position) == pytest.approx(4.031, abs=1e-3)
    np.testing.assert_allclose(camera.project(np.zeros(3)), [399.5, 399.5], atol=1e-3)
    assert camera.depth(np.zeros(3)) > 0


def test_opencvs_stored_error(samples):
    """The sample's calibration keeps its points and poses: the mean error comes out as it is stored."""
    path = samples / "opencv_filestorage/camera_calibration_sample/out_camera_data.yml"
    rig, table = read_lenses(path), parse_storage(path, path.read_text())
    shape = table["Image_points"]
    image = np.array(shape["data"], float).reshape(shape["rows"], -1, 2)
    columns, rows, square = (int(table[key]) for key in ("board_Width", "board_Height", "square_Size"))
    board = np.array([[i, j, 0] for j in range(rows) for i in range(columns)], float) * square
    poses = np.array(table["Extrinsic_Parameters"]["data"]).reshape(-1, 6)
    k, bending = np.asarray(rig[0].intrinsics), np.asarray(rig[0].distortion)
    off = [cv2.projectPoints(board, p[:3], p[3:], k, bending)[0][:, 0] - seen for p, seen in zip(poses, image)]
    rms = np.sqrt(np.mean(np.sum(np.square(off), axis=-1)))
    assert rms == pytest.approx(table["Avg_Reprojection_Error"], abs=1e-5)


def test_ros_cameras_of_many_folders(samples):
    """Eight files of one name: the cameras' own names tell them apart."""
    files = sorted((samples / "ros_camera_info/tier4_8cam").glob("*/camera_info.yaml"))
    rig = read_lenses(files)
    assert rig.names == tuple(f"camera{i}" for i in range(8))
    assert rig.cameras.lens.name == "rational"


def test_caliscopes_points_lie_where_it_saw_them(samples):
    folder = samples / "caliscope/4_cam_recording_2023"
    rig = read_calibration(folder / "config.toml").rig
    with (folder / "xyz_HOLISTIC.csv").open() as file:
        world = {
            (r["sync_index"], r["point_id"]): [float(r[f"{a}_coord"]) for a in "xyz"] for r in csv.DictReader(file)
        }
    with (folder / "xy_HOLISTIC.csv").open() as file:
        seen = [
            (r["port"], r["img_loc_x"], r["img_loc_y"], (r["sync_index"], r["point_id"])) for r in csv.DictReader(file)
        ]
    for port in range(4):
        own = [(float(x), float(y), world[key]) for p, x, y, key in seen if p == str(port) and key in world]
        points = np.array([point for *_, point in own])
        off = pixels(rig, points)[port] - np.array([pixel for *pixel, _ in own])
        assert 5 < np.median(np.linalg.norm(off, axis=1)) < 17


def test_pose2sims_conversion_of_qualisys(samples):
    """The same cameras but for the distortion, which that version divided by 64."""
    folder = samples / "pose2sim/S00_Demo_Session/S00_Calibration"
    toml, xml = (read_calibration(folder / name) for name in ("Calib_qualisys.toml", "Calib.qca.txt"))
    assert (toml.unit, xml.unit) == ("m", "m")
    np.testing.assert_allclose(toml.rig.positions, xml.rig.positions, atol=1e-9)
    np.testing.assert_allclose(toml.rig.cameras.focal, xml.rig.cameras.focal, rtol=1e-12)
    np.testing.assert_allclose(toml.rig.cameras.center, xml.rig.cameras.center, rtol=1e-9)
    np.testing.assert_allclose(
        toml.rig.cameras.cam_from_world.rotation, xml.rig.cameras.cam_from_world.rotation, atol=1e-7
    )
    # The same rig from chessboards, by the same tool
    scene = read_calibration(samples / "pose2sim/Demo_2023-12/Calib_scene.toml").rig
    off = np.linalg.norm(np.asarray(scene.positions) - np.asarray(xml.rig.positions), axis=1)
    assert off.max() < 0.15
    nested = read_calibration(samples / "pose2sim/Demo_2023-08/Calib_intcheckerboard_extscene.toml").rig
    assert np.linalg.norm(np.asarray(nested.positions) - np.asarray(xml.rig.positions), axis=1).max() < 0.37


@pytest.mark.parametrize(
    ("path", "names", "lens"),
    [
        ("anipose/pyxy3d_anipose_fisheye_calibration.toml", ("A", "B", "C"), "kannala_brandt"),
        ("freemocap/uwupose_calibration.toml", ("A", "B"), "brown"),
        ("freemocap/previous_calibration.toml", ("1", "2", "3", "4", "5"), "kannala_brandt"),
        ("lightning_pose/eks_fly_3cam/calibration.toml", ("Cam-A", "Cam-B", "Cam-C"), "brown"),
    ],
)
def test_tomls_of_aniposes_family(samples, path, names, lens):
    saved = read_calibration(samples / path)
    assert (saved.rig.names, saved.rig.cameras.lens.name, saved.unit) == (names, lens, UNSTATED)


def test_easymocaps_cameras_without_poses_are_said(samples):
    saved = read_calibration(samples / "easymocap/trackmesh_gui", size=(1920, 1080))
    assert len(saved.rig) == 11
    assert "left out, because they have no pose: 1, 10, 14" in saved.notes[0]
    assert read_lenses(samples / "easymocap/easymocap_examples_calibration", size=(1920, 1080)).names[0] == "1"
    with pytest.raises(UsageError, match=r"no image size of camera '2'; give it: --size"):
        read_calibration(samples / "easymocap/anerf_6cam/extri.yml")  # finds intri.yml beside it


def test_vicons_cameras_look_into_the_room(samples):
    """36 cameras: the point nearest to all optical axes lies before each, and upright video cameras have y down."""
    saved = read_calibration(samples / "vicon_xcp/cameras_starling.xcp")
    assert len(saved.rig) == 36
    assert re.search(r"fitted by ours within 0\.\d+ px", saved.notes[0])
    centres, turns = np.asarray(saved.rig.positions), np.asarray(saved.rig.cameras.cam_from_world.rotation)
    across = np.eye(3) - turns[:, 2, :, None] * turns[:, 2, None, :]
    middle = np.linalg.solve(across.sum(axis=0), np.einsum("cij,cj->i", across, centres))
    assert (np.asarray(saved.rig.depth(middle)) > 0).all()
    assert (turns[:2, 1, 2] < -0.85).all()


def read_numbers(path) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", skip_header=1)


def test_dltdvs_points(samples):
    """3-D points of DLTdv through its coefficients, in its pixels (from 1, y up), are where it saw them."""
    folder = samples / "dlt/dltdv7_2018-08-17_3cam"
    saved = read_calibration(folder / "2018-08-17_wand_dltCoefs_round4.csv", size=(640, 512))
    assert re.search(r"off by up to 0\.00\d+ px", saved.notes[0])
    stem = "DLTdv7_data_2018-08-17_P03_1000TMC"
    seen, world, residuals = (read_numbers(folder / f"{stem}{part}.csv") for part in ("xypts", "xyzpts", "xyzres"))
    rows = np.isfinite(seen[:, :6]).all(axis=1) & np.isfinite(world[:, :3]).all(axis=1)
    theirs = pixels(saved.rig, world[rows, :3]) * [1, -1] + [1, 512]
    off = theirs - seen[rows, :6].reshape(-1, 3, 2).transpose(1, 0, 2)
    own = np.sqrt(np.square(off).sum(axis=(0, 2)) / 3)
    np.testing.assert_allclose(own, residuals.reshape(len(seen), -1)[rows, 0], atol=0.02)
    assert np.asarray(saved.rig.depth(world[rows, :3])).min() > 0


def test_easywands_wand(samples):
    """Lines of sight through coefficients and profile meet in a wand of 0.66 m."""
    folder = samples / "dlt/easywand5_2018-07-28_3cam"
    rig = read_calibration(folder, size=(640, 512)).rig
    wand = np.genfromtxt(folder / "wandPts_extracted.csv", delimiter=",")[-90:, :12].reshape(-1, 2, 3, 2)
    wand = wand[np.isfinite(wand).all(axis=(1, 2, 3))]
    ours = wand * [1, -1] + [-1, 512]
    ends = np.stack([meeting_points(rig, ours[:, end]) for end in (0, 1)], axis=1)
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    assert len(lengths) == 53
    assert (lengths.mean(), lengths.std()) == (pytest.approx(0.6627, abs=2e-3), pytest.approx(0.0082, abs=2e-3))


def meeting_points(rig, seen) -> np.ndarray:
    """The points nearest to lines of sight, of pixels (F, C, 2)."""
    rays = rig.rays(seen)
    origin, direction = np.asarray(rays.origin), np.asarray(rays.direction)
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    return np.linalg.solve(across.sum(axis=1), np.einsum("fcij,fcj->fi", across, origin)[..., None])[..., 0]


def test_multicamselfcals_points(samples):
    """Its points through P and its lenses, which one lens a camera follows nearly."""
    folder = samples / "multicamselfcal_flydra5"
    saved = read_calibration(folder)
    assert (saved.rig.names[0], saved.unit) == ("cam1_0", "m")
    assert "one lens was fitted to each camera's P and .rad, off by up to 0.9" in saved.notes[0]
    centres = np.loadtxt(folder / "Cst.dat") / 1000
    np.testing.assert_allclose(saved.rig.positions, centres, atol=1e-5)
    for i in range(5):
        table = np.loadtxt(folder / f"cam{i + 1}.points4cal.dat")
        off = pixels(saved.rig, table[:, :3] / 1000)[i] - table[:, 4:6]
        assert np.linalg.norm(off, axis=1).mean() < 1.0


def test_braids_cameras_before_its_alignment(data_folder):
    saved = read_calibration(data_folder / "braid_alignment/20241017_164418-unaligned.xml")
    assert "one lens was fitted to each camera's P and lens" in saved.notes[0]
    assert saved.rig.names == ("Basler-22441143", "Basler-22445994", "Basler-22454189")
    assert "3 of 3 cameras look away from where their axes meet" in saved.notes[1]  # before alignment it is mirrored
