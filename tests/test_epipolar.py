"""Epipolar geometry against OpenCV, scipy and the definitions."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import gamma, gammaincc

from jaxpoint.calibration.twoview import LENS_GRID
from jaxpoint.epipolar import (
    View,
    draw_samples,
    eight_point,
    lens_table,
    lift,
    magsac_weight,
    rank_two,
    robust_fundamental,
    sampson,
    seven_point,
)

HALF_DIAGONALS = np.array([734.3, 734.3])  # px, of 1280 x 720
N, SEEN = 512, 300


def bent(straight: np.ndarray, lens: float) -> np.ndarray:
    """Distorted points of undistorted ones under the division model: r_d solves lens r_u r_d^2 - r_d + r_u = 0."""
    if lens == 0:
        return straight.copy()
    radius = np.linalg.norm(straight, axis=1)
    solved = np.array([min(abs(np.roots([lens * r, -1.0, r]))) for r in radius])
    return straight * (solved / radius)[:, None]


def two_views(seed, lenses=(0.0, 0.0), noise_px=0.0, count=SEEN):
    """Matches of random points of a room seen by two cameras, over half the diagonal, and the true F."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-1.5, -1.0, 3.0], [1.5, 1.0, 7.0], (count, 3))
    turn = cv2.Rodrigues(np.array([0.1, -0.5, 0.05]))[0]
    shift = np.array([2.2, 0.1, 0.6])
    focals = np.array([1.3, 1.0])
    moved = points @ turn.T + shift
    views = [focals[0] * points[:, :2] / points[:, 2:], focals[1] * moved[:, :2] / moved[:, 2:]]
    views = [bent(view, lens) + rng.normal(0.0, noise_px, view.shape) / 734.3 for view, lens in zip(views, lenses)]
    cross = np.cross(np.eye(3), shift)  # rows e_k x t: minus the matrix of t x .
    inverse = [np.diag([1 / f, 1 / f, 1.0]) for f in focals]
    fundamental = inverse[1] @ (-cross @ turn) @ inverse[0]
    return views, fundamental / np.linalg.norm(fundamental)


def same_up_to_scale(a, b):
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return min(np.abs(a - b).max(), np.abs(a + b).max())


def homogeneous(points):
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


@pytest.mark.parametrize("lens", [-0.5, -0.1, 0.0, 0.2])
def test_lift_undoes_the_division_model(lens):
    straight = np.random.default_rng(0).uniform(-0.7, 0.7, (50, 2))
    rays = np.asarray(lift(jnp.asarray(bent(straight, lens)), jnp.asarray(lens)))
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], straight, atol=1e-12)


def test_slopes_are_the_derivative_of_the_rays_by_the_pixel():
    points = jnp.asarray(np.random.default_rng(1).uniform(-0.7, 0.7, (10, 2)))
    view = View(points, jnp.asarray(-0.3), jnp.asarray(700.0))
    step = 0.01  # px
    for axis in range(2):
        push = np.eye(2)[axis] * step / 700.0
        change = lift(points + push[None], view.distortion) - lift(points - push[None], view.distortion)
        np.testing.assert_allclose(np.asarray(view.slopes())[:, axis], np.asarray(change) / (2 * step), atol=1e-12)


def test_eight_point_is_exact_without_noise():
    (first, second), truth = two_views(0)
    fit = np.asarray(eight_point(jnp.asarray(homogeneous(first)), jnp.asarray(homogeneous(second)), jnp.ones(SEEN)))
    theirs = cv2.findFundamentalMat(first, second, cv2.FM_8POINT)[0]
    assert same_up_to_scale(fit, truth) < 1e-9
    assert same_up_to_scale(fit, theirs) < 1e-7
    assert np.linalg.norm(fit) == pytest.approx(1.0)


def test_eight_point_with_noise_is_as_good_as_opencv():
    (first, second), _ = two_views(1, noise_px=0.7)
    views = [View(jnp.asarray(p), jnp.asarray(0.0), jnp.asarray(734.3)) for p in (first, second)]
    fit = eight_point(views[0].rays, views[1].rays, jnp.ones(SEEN))
    theirs = cv2.findFundamentalMat(first * 734.3, second * 734.3, cv2.FM_8POINT)[0]
    scale = np.diag([734.3, 734.3, 1.0])
    ours_px, theirs_px = (
        np.mean(np.asarray(sampson(jnp.asarray(f), *views)) ** 2) for f in (fit, scale @ theirs @ scale)
    )
    assert ours_px < 1.05 * theirs_px
    assert abs(np.linalg.det(np.asarray(fit))) < 1e-12


def test_eight_point_ignores_what_has_no_weight():
    (first, second), truth = two_views(2)
    weights = np.ones(SEEN)
    weights[::7] = 0.0
    spoilt = first.copy()
    spoilt[::7] += 3.0
    fit = eight_point(*(jnp.asarray(homogeneous(p)) for p in (spoilt, second)), jnp.asarray(weights))
    assert same_up_to_scale(np.asarray(fit), truth) < 1e-9


def test_rank_two_is_the_nearest_singular_matrix():
    matrix = np.random.default_rng(3).normal(size=(3, 3))
    nearest = np.asarray(rank_two(jnp.asarray(matrix)))
    assert abs(np.linalg.det(nearest)) < 1e-12
    assert np.linalg.norm(nearest - matrix) == pytest.approx(np.linalg.svd(matrix)[1][2])


def test_seven_point_finds_every_solution_of_opencv():
    (first, second), truth = two_views(4)
    samples = np.random.default_rng(5).permuted(np.tile(np.arange(SEEN), (40, 1)), axis=1)[:, :7]
    found = np.asarray(seven_point(*(jnp.asarray(homogeneous(p)[samples]) for p in (first, second))))
    assert found.shape == (40, 3, 3, 3)
    compared = 0
    for sample, ours in zip(samples, found):
        assert min(same_up_to_scale(f, truth) for f in ours) < 1e-6
        theirs = cv2.findFundamentalMat(first[sample], second[sample], cv2.FM_7POINT)[0]
        for other in np.zeros((0, 3, 3)) if theirs is None else theirs.reshape(-1, 3, 3):
            assert min(same_up_to_scale(f, other) for f in ours) < 1e-5
            compared += 1
        for f in ours / np.linalg.norm(ours, axis=(1, 2))[:, None, None]:
            assert abs(np.linalg.det(f)) < 1e-9
            value = (homogeneous(second[sample]) * (homogeneous(first[sample]) @ f.T)).sum(axis=1)
            assert np.abs(value).max() < 1e-9
    assert compared >= 40


def test_sampson_distance_is_that_of_opencv():
    (first, second), truth = two_views(6, noise_px=2.0)
    views = [View(jnp.asarray(p), jnp.asarray(0.0), jnp.asarray(1.0)) for p in (first, second)]
    ours = np.asarray(sampson(jnp.asarray(truth), *views))
    a, b = homogeneous(first), homogeneous(second)
    theirs = [cv2.sampsonDistance(a[i].reshape(3, 1), b[i].reshape(3, 1), truth) for i in range(SEEN)]
    np.testing.assert_allclose(ours**2, theirs, rtol=1e-9)


def test_sampson_distance_counts_distorted_pixels():
    """Moving a match by a small d px along its gradient changes the distance by d px, whatever the lens."""
    lenses = (-0.4, -0.1)
    (first, second), truth = two_views(7, lenses)
    step = 0.05 / 734.3

    def distance(moved_a, moved_b):
        parts = [View(p, jnp.asarray(lens), jnp.asarray(734.3)) for p, lens in zip((moved_a, moved_b), lenses)]
        return sampson(jnp.asarray(truth), *parts)

    slope_a, slope_b = jax.grad(lambda a, b: distance(a, b).sum(), argnums=(0, 1))(
        jnp.asarray(first), jnp.asarray(second)
    )
    length = jnp.sqrt((slope_a**2 + slope_b**2).sum(axis=1, keepdims=True))
    change = distance(first + step * slope_a / length, second + step * slope_b / length)
    np.testing.assert_allclose(np.asarray(change), 0.05, rtol=2e-2)


def test_magsac_weight_is_the_marginal_over_noise_levels():
    error = np.linspace(0.0, 4.0, 41)
    ours = np.asarray(magsac_weight(jnp.asarray(error), jnp.asarray(1.0)))
    upper = gamma(1.5) * gammaincc(1.5, np.append(error**2, 3.64**2) / 2.0)
    theirs = np.where(error < 3.64, (upper[:-1] - upper[-1]) / (upper[0] - upper[-1]), 0.0)
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


def contaminated(seed, share, lenses=(0.0, 0.0)):
    """Padded matches with `share` of outliers at least 30 px from their epipolar line; what is hidden is wild."""
    views, truth = two_views(seed, lenses, noise_px=0.5)
    rng = np.random.default_rng(seed + 100)
    first, second = (np.concatenate([view, rng.uniform(-1, 1, (N - SEEN, 2))]) for view in views)
    is_outlier = np.zeros(N, bool)
    is_outlier[:SEEN] = rng.random(SEEN) < share
    line = homogeneous(first) @ truth.T
    normal = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    push = rng.uniform(30.0, 150.0, (N, 1)) * rng.choice([-1.0, 1.0], (N, 1)) / 734.3
    second = np.where(is_outlier[:, None], second + push * normal, second)
    return first, second, np.arange(N) < SEEN, is_outlier, truth


OFFERED = np.array([[0.1, 0.1], [-0.2, -0.1], [-0.5, 0.0]])


def fitted(first, second, seen, method):
    draws = draw_samples(np.random.default_rng(0), seen, len(OFFERED), 128)
    return robust_fundamental(draws, first, second, seen, HALF_DIAGONALS, OFFERED, np.float64(3.0), method=method)


def test_samples_are_of_matches_that_are_seen():
    seen = np.random.default_rng(1).random(N) < 0.3
    draws = draw_samples(np.random.default_rng(0), seen, 2, 64)
    assert seen[np.asarray(draws.minimal)].all()
    assert seen[np.asarray(draws.scored)].all()


@pytest.mark.parametrize(("method", "share"), [("magsac", 0.3), ("ransac", 0.3), ("lmeds", 0.3)])
def test_robust_fundamental_finds_the_inliers(method, share):
    first, second, seen, is_outlier, truth = contaminated(8, share, tuple(OFFERED[1]))
    fit = fitted(first, second, seen, method)
    inlier = np.asarray(fit.inlier)
    assert fit.choice == 1
    assert same_up_to_scale(np.asarray(fit.fundamental), truth) < 0.02
    assert not inlier[~seen].any()
    assert not inlier[is_outlier].any()
    assert inlier[seen & ~is_outlier].mean() > 0.99
    # Neither the choice nor the fit may depend on what is not seen.
    again = fitted(np.where(seen[:, None], first, 7.0), second, seen, method)
    np.testing.assert_array_equal(again.fundamental, fit.fundamental)


def test_reweighting_cleans_a_plain_eight_point_fit():
    """The method that believes all matches at first bears few outliers only; reweighting sheds those."""
    first, second, seen, is_outlier, _ = contaminated(8, 0.02, tuple(OFFERED[1]))
    fit = fitted(first, second, seen, "8point")
    inlier = np.asarray(fit.inlier)
    assert is_outlier.sum() >= 4
    assert not inlier[is_outlier].any()
    assert inlier[seen & ~is_outlier].mean() > 0.95


@pytest.mark.parametrize("cells", [(2, 5), (6, 4)])
def test_lens_table_is_least_at_the_true_lenses(cells):
    lenses = LENS_GRID[list(cells)]
    first, second, seen, is_outlier, _ = contaminated(10, 0.1, tuple(lenses))
    weights = (seen & ~is_outlier).astype(float)
    table = np.asarray(lens_table(first, second, weights, HALF_DIAGONALS, LENS_GRID, np.float64(1.0)))
    assert np.unravel_index(table.argmin(), table.shape) == cells
