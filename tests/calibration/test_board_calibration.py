"""Calibration from boards beside OpenCV's on the same corners of real recordings."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.board_calibration import calibrate_boards, is_from_boards
from jaxpoint.calibration.board_figures import lens_sigma_map, view_fits, where_next
from jaxpoint.calibration.board_quality import assess_boards
from jaxpoint.calibration.covariance import with_board_covariance
from jaxpoint.calibration.lens_start import FlatView, lens_starts, zhang_focal
from jaxpoint.calibration.pair_poses import pair_scatter
from jaxpoint.calibration.planar_pose import flipped_pose, pose_from_rays
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.config import CalibrateSettings, LensSettings, OutlierSettings
from jaxpoint.detection.board.board_search import detect_board
from jaxpoint.detection.board.board_spec import read_board
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.board_sources import open_board_sources
from jaxpoint.targets import Target
from jaxpoint.tracks import Tracks, join_tracks


def corners_of(tracks):
    """Points of the board and pixels in each camera, view by view, as OpenCV takes them."""
    rows = tracks.rows_of_target(0, np.ones(tracks.frames, bool))
    whole = [own for own in rows if tracks.visible[own].all()]
    points = [tracks.targets[0].points.astype(np.float32)] * len(whole)
    return points, [[tracks.pixels[own, c].astype(np.float32) for own in whole] for c in range(tracks.cameras)]


def parameters(calibration, camera=0):
    """fx, fy, cx, cy and coefficients, and their standard deviations."""
    size = calibration.rig.camera_size
    sigmas = np.sqrt(np.diagonal(calibration.camera_covariance))[camera * size : (camera + 1) * size]
    return np.asarray(calibration.rig.cameras.lens.parameters)[camera], sigmas[6:]


def relative(calibration):
    """Rotation vector (rad) and translation (m) of the second camera from the first."""
    pose = calibration.rig.cameras.cam_from_world
    turn, shift = np.asarray(pose.rotation), np.asarray(pose.translation)
    return Rotation.from_matrix(turn[1] @ turn[0].T).as_rotvec(), shift[1] - turn[1] @ turn[0].T @ shift[0]


@pytest.fixture(scope="module")
def pair(data_folder):
    folder = data_folder / "opencv_chess_stereo"
    sources = open_board_sources([folder / "left*.jpg", folder / "right*.jpg"])
    return detect_board(sources, read_board("chessboard:9x6:25mm")).tracks


@pytest.fixture(scope="module")
def left(pair):
    return with_board_covariance(calibrate_boards(pair.select_cameras([0])))


@pytest.fixture(scope="module")
def both(pair):
    return with_board_covariance(calibrate_boards(pair))


def by_opencv(tracks, camera=0):
    points, pixels = corners_of(tracks)
    size = tuple(int(side) for side in tracks.image_sizes[camera])
    rms, matrix, coefficients, *_ = cv2.calibrateCamera(points, pixels[camera], size, None, None)
    return rms, np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], coefficients.ravel()[:5]])


def test_one_lens_is_that_of_opencv(pair, left):
    rms, theirs = by_opencv(pair.select_cameras([0]))
    ours, sigmas = parameters(left)
    assert left.converged
    assert type(left.rig.cameras.lens) is Brown
    assert left.kept.all()
    assert np.sqrt((left.errors**2).mean()) < rms * (1 + 1e-4)
    assert (np.abs(ours - theirs) < 0.1 * sigmas).all()
    np.testing.assert_allclose(np.asarray(left.rig.cameras.cam_from_world.rotation)[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.asarray(left.rig.cameras.cam_from_world.translation)[0], 0.0, atol=1e-9)


def test_its_covariance_is_that_of_opencv(pair, left):
    """Standard deviations of `calibrateCameraExtended`, whose unit of noise is rms over the square root of two."""
    points, pixels = corners_of(pair)
    size = tuple(int(side) for side in pair.image_sizes[0])
    theirs = cv2.calibrateCameraExtended(points, pixels[0], size, None, None)[5].ravel()[:9]
    _, sigmas = parameters(left)
    np.testing.assert_allclose(sigmas, theirs, rtol=0.12)


def test_a_pair_is_that_of_opencv(pair, both):
    points, pixels = corners_of(pair)
    size = tuple(int(side) for side in pair.image_sizes[0])
    single = [cv2.calibrateCamera(points, pixels[c], size, None, None) for c in range(2)]
    given = [part.copy() for one in single for part in one[1:3]]
    end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    rms, *lenses, turn, shift, _, _ = cv2.stereoCalibrate(points, *pixels, *given, size, flags=flags, criteria=end)
    assert np.sqrt((both.errors[both.kept] ** 2).mean()) < rms * (1 + 1e-4)
    for camera in range(2):
        matrix, coefficients = lenses[2 * camera : 2 * camera + 2]
        theirs = np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], coefficients.ravel()[:5]])
        ours, sigmas = parameters(both, camera)
        assert (np.abs(ours - theirs) < 0.2 * sigmas).all()
    found_turn, found_shift = relative(both)
    np.testing.assert_allclose(found_shift, shift.ravel(), atol=5e-6)
    np.testing.assert_allclose(found_turn, cv2.Rodrigues(turn)[0].ravel(), atol=2e-5)
    assert both.unit == "m"
    assert 1.0 < pair_scatter(both)[0].ratio < 2.0
    assert assess_boards(both).passed


def test_a_corner_that_is_wrong_and_a_view_that_is_poor_are_found_out(pair, left):
    pixels = pair.pixels[:, :1].copy()
    rng = np.random.default_rng(0)
    pixels[5] += 6.0
    shaken = np.flatnonzero(pair.frame_ids == 4)
    pixels[shaken, 0] += rng.normal(0, 0.7, (len(shaken), 2))
    spoilt = replace(pair.select_cameras([0]), pixels=pixels)
    found = with_board_covariance(calibrate_boards(spoilt))
    assert found.converged
    assert not found.kept[5, 0]
    assert [view.frame_id for view in view_fits(found) if view.poor] == [4]
    ours, sigmas = parameters(found)
    assert (np.abs(ours - parameters(left)[0]) < 2.5 * sigmas).all()
    quality = assess_boards(found)
    assert quality.passed
    assert "frame 4" in next(item for item in quality.findings if item.cause == "poor views").finding


def test_one_view_many_times_is_one_view(pair):
    """Six copies of an image fit, and their noise averages out; they tell no more than one."""
    rows = np.flatnonzero(pair.frame_ids == 1)
    rng, alone = np.random.default_rng(2), pair.select_cameras([0])
    pixels = np.concatenate([alone.pixels[rows] + rng.normal(0, 0.05, (len(rows), 1, 2)) for _ in range(6)])
    same = Tracks.from_pixels(
        pixels, alone.image_sizes, names=alone.names, frame_ids=np.repeat(np.arange(6), len(rows)),
        point_ids=np.tile(alone.point_ids[rows], 6), target=alone.targets[0],
    )  # fmt: skip
    quality = assess_boards(with_board_covariance(calibrate_boards(same)))
    assert not quality.passed
    assert "6 views of 1 different poses" in str(quality.failure)


def test_where_the_lens_is_known_worst(left):
    found = lens_sigma_map(left, 0)
    middle, corner = found[5:7, 7:9].mean(), found[-1, 0]
    assert middle < 0.1 < corner
    assert where_next(left, 0)[1] in ("lower left", "upper left")


def test_calibrate_starts_two_cameras_from_their_boards(pair, both):
    found = calibrate(pair)
    assert is_from_boards(found)
    np.testing.assert_array_equal(np.asarray(found.rig.matrices), np.asarray(both.rig.matrices))


def test_known_lenses_are_held(pair, left, both):
    known = both.rig
    settings = CalibrateSettings(lens=LensSettings(known="hold"))
    found = calibrate_boards(pair, settings, intrinsics=known)
    np.testing.assert_allclose(
        np.asarray(found.rig.cameras.lens.parameters), np.asarray(known.cameras.lens.parameters), rtol=1e-12
    )
    np.testing.assert_allclose(relative(found)[1], relative(both)[1], atol=2e-5)


def test_three_views_are_the_least(pair):
    few = pair.select_frames(np.isin(pair.frame_ids, [1, 2]))
    with pytest.raises(InsufficientDataError, match=r"Camera 'left' saw the board in 2 frames"):
        calibrate_boards(few)
    with pytest.raises(InsufficientDataError, match="0 flat targets"):
        calibrate_boards(pair.without_targets())
    with pytest.raises(UsageError, match="no lens model 'thin'"):
        calibrate_boards(pair, CalibrateSettings(lens=LensSettings(distortion="thin")))


def test_cameras_that_share_no_board_are_named(pair):
    visible = pair.visible.copy()
    early = pair.frame_ids < 7
    visible[early, 0], visible[~early, 1] = False, False
    apart = replace(pair, visible=visible, pixels=np.where(visible[..., None], pair.pixels, 0.0))
    with pytest.raises(InsufficientDataError, match=r"'right' saw the board together with the others in 0 frames"):
        calibrate_boards(apart)


@pytest.mark.parametrize("size", [1.0, 1.02])
def test_a_board_of_another_size_than_stated_is_told_by_a_second_target(pair, both, size):
    rng, other = np.random.default_rng(6), Target.chessboard(4, 3, 0.04, name="other")
    shown = []
    for turn in Rotation.from_rotvec(rng.normal(0, 0.4, (8, 3))).as_matrix():
        local = size * (other.points - other.points.mean(0)) @ turn.T + [*rng.uniform(-0.05, 0.05, 2), 0.45]
        shown.append(np.asarray(both.rig.project(local)) + rng.normal(0, 0.1, (12, 2, 2)))
    second = Tracks.from_pixels(
        np.concatenate(shown), pair.image_sizes, names=pair.names, frame_ids=np.repeat(np.arange(8), 12) + 50,
        point_ids=np.tile(np.arange(12), 8), target=other,
    )  # fmt: skip
    found = calibrate_boards(join_tracks(pair, second))
    said = [item for item in found.findings if item.cause == "target size"]
    assert bool(said) == (size != 1.0)


@pytest.mark.parametrize("most", [False, True])
def test_a_board_that_one_camera_counts_from_its_other_end_is_turned_back(pair, both, most):
    """As of a board with two even sides, which looks the same turned by 180 degrees."""
    pixels = pair.pixels.copy()
    frames = np.unique(pair.frame_ids)
    for frame in frames[:-3] if most else frames[::4]:
        rows = np.flatnonzero(pair.frame_ids == frame)
        rows = rows[np.argsort(pair.point_ids[rows])]
        pixels[rows, 1] = pair.pixels[rows[::-1], 1]
    found = calibrate_boards(replace(pair, pixels=pixels))
    assert found.kept.all()
    np.testing.assert_allclose(np.asarray(found.rig.matrices)[0], np.asarray(both.rig.matrices)[0], atol=1e-3)
    turn, shift = relative(found)
    np.testing.assert_allclose(shift, relative(both)[1], atol=1e-6)
    np.testing.assert_allclose(turn, relative(both)[0], atol=1e-6)


def test_zhang_and_the_search_find_the_focal_length_of_a_perfect_camera():
    rng = np.random.default_rng(1)
    board, size = Target.chessboard(9, 6, 0.03).points, np.array([1280.0, 720.0])
    views = []
    for turn in Rotation.from_rotvec(rng.normal(0, 0.5, (6, 3))).as_matrix():
        local = (board - board.mean(0)) @ turn.T + [*rng.uniform(-0.1, 0.1, 2), 0.6]
        views.append(FlatView(board[:, :2], 900 * local[:, :2] / local[:, 2:] + (size - 1) / 2))
    assert zhang_focal(views, (size - 1) / 2) == pytest.approx(900, rel=1e-9)
    assert not lens_starts(views, size)[0].equidistant
    assert lens_starts(views, size)[0].focal == pytest.approx(900, rel=1e-6)


def test_poses_of_planes_seen_beyond_ninety_degrees():
    board = Target.chessboard(5, 4, 0.03).points
    turn, shift = Rotation.from_rotvec([0.3, 2.0, 0.4]).as_matrix(), np.array([0.4, 0.05, -0.1])
    local = board @ turn.T + shift
    rotation, translation = pose_from_rays(board[:, :2], local / np.linalg.norm(local, axis=1, keepdims=True))
    np.testing.assert_allclose(rotation, turn, atol=1e-9)
    np.testing.assert_allclose(translation, shift, atol=1e-9)
    other, there = flipped_pose(turn, shift)
    np.testing.assert_allclose(other @ other.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(other) == pytest.approx(1.0)
    again, _ = flipped_pose(other, there)
    np.testing.assert_allclose(again, turn, atol=1e-12)


@pytest.fixture(scope="module")
def fisheyes(data_folder):
    folder = data_folder / "fisheye_stereo29"
    sources = open_board_sources([folder / "left*.jpg", folder / "right*.jpg"])
    return detect_board(sources, read_board("chessboard:9x6:24.23mm")).tracks


FISHEYE = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW | cv2.CALIB_USE_INTRINSIC_GUESS
EXACT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)


def fisheyes_by_opencv(tracks):
    """Both lenses by themselves from a guess (without one it fails), and the pair from these."""
    points, pixels = corners_of(tracks)
    points = [part.reshape(1, -1, 3).astype(float) for part in points]
    pixels = [[part.reshape(1, -1, 2).astype(float) for part in own] for own in pixels]
    width, height = (int(side) for side in tracks.image_sizes[0])
    single = []
    for own in pixels:
        guess = np.array([[300.0, 0, width / 2], [0, 300, height / 2], [0, 0, 1]])
        found = cv2.fisheye.calibrate(
            points, own, (width, height), guess, np.zeros((4, 1)), flags=FISHEYE, criteria=EXACT
        )
        single.append(found[:3])
    given = [part.copy() for one in single for part in one[1:]]
    rms, *lenses, turn, shift = cv2.fisheye.stereoCalibrate(
        points, *pixels, *given, (width, height), flags=FISHEYE, criteria=EXACT
    )[:7]
    return [_fisheye(*one[1:]) for one in single], rms, [_fisheye(*lenses[:2]), _fisheye(*lenses[2:])], turn, shift


def _fisheye(matrix, coefficients):
    return np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], coefficients.ravel()])


def test_two_fisheyes_beside_opencv_and_what_does_not_fit(fisheyes):
    """Single lenses agree. The pair's images are not of the same moments, which OpenCV's stereo takes out on lenses."""
    single, rms, pair, turn, shift = fisheyes_by_opencv(fisheyes)
    found = with_board_covariance(calibrate_boards(fisheyes))
    assert found.converged
    assert type(found.rig.cameras.lens) is KannalaBrandt
    assert np.sqrt((found.errors[found.kept] ** 2).mean()) < rms
    assert found.kept.mean() > 0.9
    for camera in range(2):
        ours, sigmas = parameters(found, camera)
        assert (np.abs(ours - pair[camera]) < 3 * sigmas).all()
    found_turn, found_shift = relative(found)
    np.testing.assert_allclose(1e3 * found_shift, 1e3 * shift.ravel(), atol=0.5)
    np.testing.assert_allclose(found_turn, cv2.Rodrigues(turn)[0].ravel(), atol=2e-3)
    assert pair_scatter(found)[0].ratio > 3
    assert any(item.cause == "boards disagree" for item in assess_boards(found).findings)
    alone = with_board_covariance(calibrate_boards(fisheyes.select_cameras([0])))
    ours, sigmas = parameters(alone)
    assert (np.abs(ours - single[0]) < sigmas).all()


def test_halves_of_a_fisheye_recording_agree_within_their_covariance(fisheyes):
    ids = np.unique(fisheyes.frame_ids)
    halves = []
    for start in range(2):
        seen = fisheyes.visible & np.isin(fisheyes.frame_ids, ids[start::2])[:, None]  # all rows: one program for all
        half = replace(fisheyes, visible=seen, pixels=np.where(seen[..., None], fisheyes.pixels, 0.0))
        halves.append(with_board_covariance(calibrate_boards(half)))
    for camera in range(2):
        (one, sigma), (other, spread) = (parameters(half, camera) for half in halves)
        assert (np.abs(one - other) < 3 * np.hypot(sigma, spread)).all()


def test_few_views_beside_opencv(data_folder):
    """Four views, hardly tilted, which tell a focal length and bending, and hardly more."""
    images = sorted((data_folder / "caliscope_chess_intrinsic").glob("cam_0_*.jpg"))
    tracks = detect_board(open_board_sources(images), read_board("chessboard:6x9:25mm")).tracks
    assert len(np.unique(tracks.frame_ids)) == 4
    points, pixels = corners_of(tracks)
    size = tuple(int(side) for side in tracks.image_sizes[0])
    flags = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    guess = np.array([[800.0, 0, (size[0] - 1) / 2], [0, 800, (size[1] - 1) / 2], [0, 0, 1]])
    rms, matrix, bends, *_ = cv2.calibrateCamera(
        points, pixels[0], size, guess, np.zeros(5), flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    lens = LensSettings(distortion="radial2", principal_point="fixed", aspect="fixed")
    settings = CalibrateSettings(lens=lens, outliers=OutlierSettings(floor_px=5.0))
    found = with_board_covariance(calibrate_boards(tracks, settings))
    ours, sigmas = parameters(found)
    assert found.kept.all()
    assert np.sqrt((found.errors**2).mean()) < rms * (1 + 1e-4)
    assert (np.abs(ours - [*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *bends.ravel()[:5]]) <= 0.5 * sigmas + 1e-6).all()
    rms, _ = by_opencv(tracks)
    found = with_board_covariance(calibrate_boards(tracks))
    assert np.sqrt((found.errors[found.kept] ** 2).mean()) < rms
    findings = {item.cause for item in assess_boards(found).findings}
    assert {"coverage", "loose focal length"} <= findings


def test_a_light_beside_a_board_takes_part(both, pair):
    """Points of no target, seen by both cameras, are placed and kept."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-0.3, -0.2, 0.5], [0.3, 0.2, 1.2], (40, 3))
    pixels = np.asarray(both.rig.project(points)) + rng.normal(0, 0.15, (40, 2, 2))
    inside = ((pixels > 0) & (pixels < pair.image_sizes - 1)).all(axis=(1, 2))
    light = Tracks.from_pixels(
        pixels[inside], pair.image_sizes, names=pair.names, frame_ids=np.flatnonzero(inside) + 100
    )
    found = calibrate_boards(join_tracks(pair, light))
    loose = found.tracks.target_ids < 0
    assert found.kept[loose].mean() > 0.95
    order = np.argsort(found.tracks.frame_ids[loose])
    np.testing.assert_allclose(found.points[loose][order], points[inside], atol=0.01)


def test_one_lens_for_a_pair_is_tested_by_its_boards(pair, both):
    settings = CalibrateSettings(lens=LensSettings(shared=("all",)))
    found = with_board_covariance(calibrate_boards(pair, settings))
    parameters_of_both = np.asarray(found.rig.cameras.lens.parameters)
    np.testing.assert_allclose(parameters_of_both[1], parameters_of_both[0], rtol=1e-12)
    named = [item for item in assess_boards(found, settings).findings if item.cause == "shared lens"]
    assert len(named) == 1  # two cameras of one kind, whose lenses differ by what its boards can tell
    assert found.errors[found.kept].mean() > both.errors[both.kept].mean()
