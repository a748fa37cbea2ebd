"""The numbers of the report against straightforward counting and OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from jaxpoint.calibration.result import Verdict
from jaxpoint.metrics import metrics
from jaxpoint.report.figures_scene import bounds, frusta, frustum_lines
from jaxpoint.report.reading import before_alignment, lens_profile, pixel_slopes
from jaxpoint.report.summary import (
    GRID,
    RigScene,
    cell_means,
    image_coverage,
    kept_curve,
    mean_of_best,
    worst_outliers,
)


def test_kept_curve_is_the_mean_of_the_best():
    errors = np.random.default_rng(0).exponential(size=40)
    fraction, mean = kept_curve(errors)
    assert_allclose(fraction[[0, 19, 39]], [1 / 40, 0.5, 1.0])
    assert_allclose(mean[19], np.sort(errors)[:20].mean())
    assert_allclose(mean[-1], errors.mean())
    assert_allclose(mean_of_best(errors, 0.92), np.sort(errors)[:37].mean())
    assert np.isnan(mean_of_best(np.zeros(0), 0.92))


def test_coverage_counts_like_a_histogram(summary):
    counts = image_coverage(summary.pixels, summary.visible, summary.sizes)
    for camera, (width, height) in enumerate(summary.sizes):
        x, y = summary.pixels[summary.visible[:, camera], camera].T
        edges = [np.linspace(-0.5, height - 0.5, GRID[1] + 1), np.linspace(-0.5, width - 0.5, GRID[0] + 1)]
        assert_array_equal(counts[camera], np.histogram2d(y, x, edges)[0])


def test_cell_means_average_the_residuals_of_a_cell():
    pixels = np.array([[0.0, 0.0], [10.0, 10.0], [799.0, 599.0]])
    residuals = np.array([[1.0, 0.0], [0.0, 3.0], [-2.0, 1.0]])
    mean, count = cell_means(pixels, residuals, np.array([800, 600]))
    assert_allclose(mean[0, 0], [0.5, 1.5])
    assert_allclose(mean[5, 7], [-2.0, 1.0])
    assert count.sum() == 3
    assert count[0, 0] == 2


def test_figures_agree_with_the_metrics(calibration, summary):
    figures = metrics(calibration)
    assert_allclose(summary.mean_px, figures["reprojection"]["mean_px"])
    assert_allclose(summary.mean_all_px, figures["reprojection"]["mean_all_px"])
    assert summary.judged.sum() == figures["observations"]["compared"]
    assert summary.rejected.sum() == (calibration.verdicts == Verdict.REPROJECTION).sum()


def test_worst_outliers_come_first_and_are_rejected_ones(summary):
    worst = worst_outliers(summary, 5)
    errors = [summary.errors[row, camera] for camera, row in worst]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] == summary.errors[summary.rejected].max()


def test_frusta_end_in_the_corners_of_the_images(summary):
    cones = frusta(summary.scene, summary.sizes, summary.focal, summary.center)
    for c, (width, height) in enumerate(summary.sizes):
        (fx, fy), (cx, cy) = summary.focal[c], summary.center[c]
        assert np.abs([cx / fx, (width - cx) / fx]).max() < 1.2
        intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        rotation = summary.scene.world_from_cam[c].T
        pixels, _ = cv2.projectPoints(
            cones[c, 1:], cv2.Rodrigues(rotation)[0], -rotation @ summary.scene.centers[c], intrinsics, np.zeros(5)
        )
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
        clipped = min(1.0, 1.0 / np.abs((corners - [cx, cy]) / [fx, fy]).max())
        assert_allclose(pixels[:, 0], [cx, cy] + clipped * (corners - [cx, cy]), atol=1e-6)
    assert frustum_lines(cones).shape == (4, 8, 2, 3)


def test_bounds_hold_all_cameras_but_no_wild_point(summary):
    scene = replace(summary.scene, points=np.vstack([summary.scene.points, [1e6, 0, 0]]))
    low, high = bounds(scene, frusta(scene, summary.sizes, summary.focal, summary.center))
    assert (summary.scene.centers > low).all()
    assert (summary.scene.centers < high).all()
    assert high[0] < 20


def test_upright_undoes_any_turn(summary):
    turn = cv2.Rodrigues(np.array([0.4, -1.9, 0.7]))[0]
    tilted = summary.scene.moved(0.3, turn, np.array([1.0, 2.0, 3.0]), "arbitrary")
    up = tilted.upright()
    assert_allclose(np.linalg.det(up.world_from_cam), 1.0)
    # Heights are those of the room, up to scale, to the few degrees by which the simulated cameras roll and tilt.
    height = np.corrcoef(up.points[:, 2], summary.scene.points[:, 2])[0, 1]
    assert height > 0.9
    assert_allclose(up.size, 0.3 * summary.scene.size)


def test_scene_without_a_single_point_can_be_drawn(summary):
    empty = RigScene(summary.scene.centers, summary.scene.world_from_cam, np.zeros((0, 3)), "arbitrary").upright()
    low, high = bounds(empty, frusta(empty, summary.sizes, summary.focal, summary.center))
    assert (low < high).all()


def test_before_alignment_is_undone_by_the_similarity(calibration, summary):
    solved = before_alignment(summary.scene, calibration.alignment.similarity)
    assert_allclose(np.asarray(calibration.alignment.similarity @ solved.points), summary.scene.points, atol=1e-9)
    assert solved.unit == "arbitrary"


def _profile(k1, k2, focal=800.0, seen=(500.0, 300.0)):
    def distort(xy):
        r2 = (xy**2).sum(axis=-1, keepdims=True)
        return xy * (1 + k1 * r2 + k2 * r2**2)

    center, sizes = np.array([[319.5, 239.5]]), np.array([[640, 480]])
    pixels = np.array(seen).reshape(1, 1, 2)
    return lens_profile(distort, np.full((1, 2), focal), center, sizes, pixels, np.ones((1, 1), bool))


def test_lens_profile_turns_where_its_derivative_vanishes():
    lens = _profile(-0.9, 0.0)
    expected = 800.0 * np.sqrt(1 / (3 * 0.9))
    assert_allclose(lens.turning[0], expected, rtol=0.01)
    radius = lens.radius[0]
    assert_allclose(lens.displacement[0], -0.9 * (radius / 800) ** 3 * 800, atol=1e-9)


def test_lens_profile_leads_pixels_back_as_opencv_does():
    lens = _profile(-0.25, 0.06)
    assert np.isinf(lens.turning[0]) or lens.turning[0] > lens.corner[0]
    intrinsics = np.array([[800.0, 0, 319.5], [0, 800.0, 239.5], [0, 0, 1]])
    marks = np.array([[[-0.5, -0.5]], [[500.0, 300.0]]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    ideal = cv2.undistortPoints(marks, intrinsics, np.array([-0.25, 0.06, 0, 0]), criteria=criteria)
    assert_allclose([lens.corner[0], lens.farthest[0]], 800 * np.linalg.norm(ideal[:, 0], axis=1), atol=0.02)


def test_pixel_slopes_are_those_of_an_undistorted_camera(calibration):
    """Against differences of OpenCV's projection."""
    cameras = calibration.rig.cameras
    turn, shift = np.asarray(cameras.cam_from_world.rotation), np.asarray(cameras.cam_from_world.translation)
    focal, points = np.asarray(cameras.focal), np.asarray(calibration.points)[calibration.point_valid][:20]
    slopes = pixel_slopes(turn, shift, focal, points)
    for camera in range(len(focal)):
        lens = np.diag([*focal[camera], 1.0])
        vector = cv2.Rodrigues(turn[camera])[0]
        for axis in range(3):
            step = 1e-5 * np.eye(3)[axis]
            ahead, behind = (
                cv2.projectPoints(moved, vector, shift[camera], lens, None)[0][:, 0]
                for moved in (points + step, points - step)
            )
            np.testing.assert_allclose(slopes[:, camera, :, axis], (ahead - behind) / 2e-5, rtol=1e-5, atol=1e-4)
