"""Real recordings with published figures (the data's README.txt has them)."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.io.formats.caliscope_toml import read_camera_array
from jaxpoint.io.track_files import read_tracks
from jaxpoint.io.track_formats.caliscope_corners import read_caliscope_corners
from jaxpoint.tracks import Tracks


def all_errors(calibration):
    """Errors (px) of all observations, believed or not."""
    errors = calibration.errors[calibration.tracks.visible]
    return errors[errors > 0]


@pytest.mark.parametrize("init", ["auto", "factorisation"])
def test_strawlab2010(data_folder, init):
    """The toolbox that published these tracks ended at a mean of 0.62 px, a joint adjustment at 0.47 over all."""
    tracks = read_tracks(data_folder / "svoboda_strawlab2010")
    assert tracks.visible.sum() == 3914
    found = calibrate(tracks, CalibrateSettings(init=init))
    errors = np.sort(all_errors(found))
    assert found.converged
    assert len(errors) == 3914
    assert errors.mean() <= 0.48
    assert errors[: round(0.92 * len(errors))].mean() <= 0.35
    focal = np.asarray(found.rig.cameras.focal)
    assert ((focal > 700) & (focal < 1300)).all()  # a wrong upgrade has 270


@pytest.fixture(scope="module")
def arctic(data_folder):
    return calibrate(read_tracks(data_folder / "svoboda_arctic4", one_based=True))


def published_inliers(folder, tracks):
    """(F, C) the observations in camC.points4cal.dat, found by their pixels, which are written in both files."""
    inlier = np.zeros(tracks.visible.shape, bool)
    for camera in range(4):
        pixels = np.loadtxt(folder / f"cam{camera + 1}.points4cal.dat")[:, 4:6] - 1.0
        distance = np.abs(tracks.pixels[:, camera][:, None] - pixels[None]).max(axis=2)
        distance[~tracks.visible[:, camera]] = np.inf
        assert (distance.min(axis=0) < 1e-3).all()
        # A light at rest has several frames with one pixel; the files keep the frames' order.
        inlier[:, camera] = _in_order(distance < 1e-3)
    return inlier


def _in_order(match):
    """The frames that a list of pixels runs through in order; `match` (F, N) says which pixel a frame may be."""
    chosen, frame = np.zeros(len(match), bool), 0
    for column in match.T:
        frame += int(np.argmax(column[frame:]))
        chosen[frame] = True
        frame += 1
    return chosen


def test_arctic4_is_in_step_and_a_camera_put_a_frame_later_is_found(data_folder):
    tracks = read_tracks(data_folder / "svoboda_arctic4", one_based=True)
    pixels, visible = tracks.pixels.copy(), tracks.visible.copy()
    pixels[1:, 2], visible[1:, 2], visible[0, 2] = tracks.pixels[:-1, 2], tracks.visible[:-1, 2], False
    late = Tracks.from_pixels(pixels, tracks.image_sizes, visible)
    found = calibrate(late, CalibrateSettings(time_offsets=True))
    np.testing.assert_allclose(found.time_offsets.frames, [0.0, 0.0, 1.0, 0.0], atol=0.01)
    assert found.errors[found.kept].mean() <= 0.21


def test_arctic4_is_better_than_published(data_folder, arctic):
    """Published: 0.36 px over 1433 inliers; a joint adjustment of them reaches 0.20 to 0.22."""
    inlier = published_inliers(data_folder / "svoboda_arctic4", arctic.tracks)
    assert inlier.sum() == 1433
    assert arctic.converged
    assert arctic.kept.sum() >= 1690
    assert arctic.errors[arctic.kept].mean() <= 0.21
    assert (inlier & arctic.point_valid[:, None]).sum() >= 1430
    assert arctic.errors[inlier].mean() <= 0.23
    k1 = np.asarray(arctic.rig.cameras.distortion)[:, 0]
    assert ((k1 > -0.4) & (k1 < -0.1)).all()


NUMBERS = 14  # of a camera below: rotation vector, translation, log focal, centre, k1, k2, p1, p2, k3
PRIOR_SIGMA = np.array([0.05 * 640, 0.05 * 640, 1.0, 1.0, 0.005, 0.005, 1.0])  # as the settings have them


def projected(cameras, points):
    """Pixels of points by the formulas of the conventions, one camera (N, NUMBERS) for each point (N, 3)."""
    local = np.einsum("nij,nj->ni", Rotation.from_rotvec(cameras[:, :3]).as_matrix(), points) + cameras[:, 3:6]
    x, y = (local[:, :2] / local[:, 2:]).T
    log_focal, cx, cy, k1, k2, p1, p2, k3 = cameras[:, 6:].T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([np.exp(log_focal) * u + cx, np.exp(log_focal) * v + cy], axis=1)


def dependence(frame, camera, free, points):
    """Which residual depends on which number: pixels first, then the priors."""
    column = np.cumsum(free) - 1  # of a camera's free number
    sparsity = lil_matrix((2 * len(frame) + 4 * 7, 4 * free.sum() + 3 * points), dtype=np.int8)
    for axis in range(2):
        row = 2 * np.arange(len(frame)) + axis
        for offset in range(free.sum()):
            sparsity[row, free.sum() * camera + offset] = 1
        for offset in range(3):
            sparsity[row, 4 * free.sum() + 3 * frame + offset] = 1
    for one in range(4):
        for number in np.flatnonzero(free[7:]):
            sparsity[2 * len(frame) + 7 * one + number, free.sum() * one + column[7 + number]] = 1
    return sparsity


@pytest.mark.parametrize(("distortion", "off"), [("radial2", 0.03), ("brown", 0.0)])
def test_arctic4_is_at_the_optimum_that_scipy_finds(data_folder, distortion, off):
    """The same observations and model, started off by a few per cent.

    With p1, p2 and k3 the focal lengths lie in a valley so flat that scipy crawls: there it must stay where we ended.
    """
    tracks = read_tracks(data_folder / "svoboda_arctic4", one_based=True)
    found = calibrate(tracks, CalibrateSettings(lens=LensSettings(distortion=distortion)))
    used, loss = found.point_valid, 2.0 * found.sigma_px
    frame, camera = np.nonzero(found.kept[used])
    pixels = tracks.pixels[used][frame, camera]
    free = np.arange(NUMBERS) < (11 if distortion == "radial2" else NUMBERS)
    middle = np.append((tracks.image_sizes[0] - 1) / 2.0, np.zeros(5))
    cameras = np.zeros((4, NUMBERS))

    def residuals(numbers):
        cameras[:, free] = numbers[: 4 * free.sum()].reshape(4, -1)
        points = numbers[4 * free.sum() :].reshape(-1, 3)
        difference = projected(cameras[camera], points[frame]) - pixels
        square = (difference**2).sum(axis=1, keepdims=True) / loss**2
        robust = difference * np.sqrt(np.log1p(square) / np.maximum(square, 1e-300))
        prior = found.sigma_px * (cameras[:, 7:] - middle) / PRIOR_SIGMA
        return np.concatenate([robust.ravel(), prior.ravel()])

    cameras[:, :3] = Rotation.from_matrix(np.array(found.rig.cameras.cam_from_world.rotation)).as_rotvec()
    cameras[:, 3:6] = found.rig.cameras.cam_from_world.translation
    cameras[:, 6] = np.log(np.asarray(found.rig.cameras.focal)[:, 1])
    cameras[:, 7:9] = found.rig.cameras.center
    cameras[:, 9:] = found.rig.cameras.distortion
    ours = np.concatenate([cameras[:, free].ravel(), found.points[used].ravel()])
    cost, focal = (residuals(ours) ** 2).sum(), cameras[:, 6].copy()

    rng = np.random.default_rng(0)
    start = cameras + off * rng.normal(size=cameras.shape) * np.array([*6 * [0.3], 1, 300, 300, *5 * [2]])
    points = found.points[used] + 0.3 * off * rng.normal(size=(used.sum(), 3))
    numbers = np.concatenate([start[:, free].ravel(), points.ravel()])
    sparsity = dependence(frame, camera, free, used.sum())
    theirs = least_squares(residuals, numbers, jac_sparsity=sparsity, x_scale="jac", ftol=1e-8, max_nfev=150)
    assert cost <= 1.005 * 2 * theirs.cost
    found_by_scipy = theirs.x[: 4 * free.sum()].reshape(4, -1)[:, 6]
    np.testing.assert_allclose(found_by_scipy, focal, atol=0.02 if off else 1e-3)


@pytest.fixture(scope="module", params=[False, True], ids=["in step", "time offsets"])
def charuco(request, data_folder):
    """Corners of a moving board as if each were a light, lenses as published and held; and the published rig."""
    folder = data_folder / "caliscope_charuco4"
    board = read_caliscope_corners(folder / "calibration" / "extrinsic" / "CHARUCO" / "xy_CHARUCO.csv")
    tracks = board.without_targets()
    theirs = read_camera_array(folder / "camera_array.toml").rig
    theirs = theirs.select([theirs.names.index(name) for name in tracks.names])
    settings = CalibrateSettings(lens=LensSettings(known="hold"), time_offsets=request.param)
    return theirs, calibrate(tracks, settings, intrinsics=theirs)


def board_edges(calibration, scale):
    """Lengths (mm) of all edges of the board whose two corners were found; 4 x 3 inner corners, numbered by rows."""
    ids = zip(calibration.tracks.point_ids.tolist(), calibration.tracks.frame_ids.tolist())
    points = {i: p for i, p, ok in zip(ids, calibration.points, calibration.point_valid) if ok}
    lengths = []
    for (corner, frame), point in points.items():
        for neighbour in ([corner + 1] if corner % 3 < 2 else []) + [corner + 3]:
            other = points.get((neighbour, frame))
            if other is not None:
                lengths.append(np.linalg.norm(point - other))
    return 1000.0 * scale * np.array(lengths)


def test_the_shape_of_a_board_alone_gives_lenses_and_metres(data_folder):
    """Against what its makers' calibration, from the same images, has, once the camera that is late is in step."""
    folder = data_folder / "caliscope_charuco4"
    board = read_caliscope_corners(folder / "calibration" / "extrinsic" / "CHARUCO" / "xy_CHARUCO.csv")
    theirs = read_camera_array(folder / "camera_array.toml").rig
    theirs = theirs.select([theirs.names.index(name) for name in board.names])
    assert not assess(with_covariance(calibrate(board))).passed
    found = with_covariance(calibrate(board, CalibrateSettings(time_offsets=True)))
    assert assess(found).passed
    assert found.unit == "m"
    assert found.kept.sum() >= 0.92 * board.visible.sum()
    focal, published = (np.asarray(rig.cameras.focal)[:, 0] for rig in (found.rig, theirs))
    assert np.abs(focal / published - 1.0).max() < 0.025
    assert abs(float(umeyama(np.asarray(found.rig.positions), np.asarray(theirs.positions)).scale) - 1.0) < 0.015


def test_charuco_board_measures_what_it_is(charuco):
    """Scaled by the published camera centres alone, the squares come out at 54 mm (published: 53.8, sd 0.8)."""
    theirs, found = charuco
    scale = float(umeyama(np.asarray(found.rig.positions), np.asarray(theirs.positions)).scale)
    lengths = board_edges(found, scale)
    assert len(lengths) > 850
    assert abs(lengths.mean() - 53.8) < 0.4
    if found.time_offsets is None:
        assert np.median(np.abs(lengths - np.median(lengths))) < 0.6
    else:  # one camera is two thirds of a frame late; in step the board is what it was made, and the spread less
        assert lengths.std() < 0.75
        assert abs(lengths.mean() - 54.0) < 0.3


def test_charuco_reprojection_is_below_the_published(charuco):
    """Published: means of 1.055, 1.735, 1.497 and 1.128 px over 655, 544, 592 and 384 corners: 1.36 over all."""
    _, found = charuco
    assert all_errors(found).mean() < 1.36
    assert found.kept.sum() > 0.9 * found.tracks.visible.sum()
