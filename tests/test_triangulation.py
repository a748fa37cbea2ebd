"""Triangulation against the truth, OpenCV, scipy, Monte Carlo and finite differences."""

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from jaxpoint import triangulation
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.rational import Rational
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry.pose import Similarity
from jaxpoint.triangulation import Flag, Triangulation, triangulate

CAMERAS, FRAMES = 5, 64


def ring_of_cameras(distorted=True):
    """Five cameras around a room, 2.5 m up, looking at its middle."""
    rng = np.random.default_rng(1)
    angle = 2 * np.pi * np.arange(CAMERAS) / CAMERAS
    position = np.stack([4 * np.cos(angle), 4 * np.sin(angle), np.full(CAMERAS, 2.5)], axis=1)
    forward = np.array([0, 0, 1.0]) - position
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    lens = rng.normal(size=(CAMERAS, 5)) * [0.05, 0.01, 1e-3, 1e-3, 1e-3] - [0.2, 0, 0, 0, 0]
    return CameraRig.from_parameters(
        rng.uniform(700, 1000, (CAMERAS, 2)),
        rng.uniform(-20, 20, (CAMERAS, 2)) + np.array([640, 360]),
        lens * distorted,
        rotation,
        -np.einsum("cij,cj->ci", rotation, position),
        np.tile([1280, 720], (CAMERAS, 1)),
    )


def seen_points():
    """Points of the room, where they are seen, by whom, and with 1 px of noise."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1.2, -1.2, 0.2], [1.2, 1.2, 1.8], (FRAMES, 3))
    pixels = np.asarray(RIG.project(points))
    visible = rng.random((FRAMES, CAMERAS)) < 0.7
    visible[:, :2] |= visible.sum(axis=1, keepdims=True) < 2
    return points, pixels, visible, pixels + rng.normal(size=pixels.shape)


RIG = ring_of_cameras()
POINTS, PIXELS, VISIBLE, NOISY = seen_points()


def assert_same(one: Triangulation, other: Triangulation, atol=1e-6):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, atol=atol, rtol=1e-7)


def test_exact_without_noise():
    result = triangulate(RIG, PIXELS, VISIBLE)
    np.testing.assert_allclose(result.points, POINTS, atol=1e-9)
    assert np.asarray(result.valid).all()
    assert float(result.rms.max()) < 1e-9
    np.testing.assert_allclose(result.residuals, 0, atol=1e-9)


def test_opencv_agrees_on_two_views():
    rig = ring_of_cameras(distorted=False)
    pixels = np.asarray(rig.project(POINTS))
    first, second = np.asarray(rig.matrices)[:2]
    theirs = cv2.triangulatePoints(first, second, pixels[:, 0].T, pixels[:, 1].T)
    theirs = (theirs[:3] / theirs[3]).T
    visible = np.zeros((FRAMES, CAMERAS), dtype=bool)
    visible[:, :2] = True
    linear = triangulate(rig, pixels, visible, refine_steps=0)
    np.testing.assert_allclose(linear.points, theirs, atol=1e-9)


def test_least_pixel_error_is_scipys():
    result = triangulate(RIG, NOISY, VISIBLE)
    for frame in range(6):
        used = VISIBLE[frame]
        best = least_squares(
            lambda x, frame=frame, used=used: (np.asarray(RIG.project(x)) - NOISY[frame])[used].ravel(),
            POINTS[frame],
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
        )
        np.testing.assert_allclose(result.points[frame], best.x, atol=1e-7)
        assert float(result.rms[frame]) == pytest.approx(np.sqrt(2 * best.cost / used.sum()), rel=1e-9)
    projected = np.asarray(RIG.project(result.points))
    np.testing.assert_allclose(result.residuals, np.where(VISIBLE[..., None], projected - NOISY, 0), atol=1e-9)


def empirical_over_predicted(samples, predicted):
    """Eigenvalues of the sample covariance in units of the predicted one; all 1 where they agree."""
    factor = np.linalg.inv(np.linalg.cholesky(predicted))
    return np.linalg.eigvalsh(factor @ np.cov(np.asarray(samples).T) @ factor.T)


def test_covariance_is_that_of_many_noisy_recordings():
    draws, sigma, rng = 4096, 0.8, np.random.default_rng(2)
    for frame in range(3):
        noisy = PIXELS[frame] + rng.normal(size=(draws, CAMERAS, 2)) * sigma
        visible = np.tile(VISIBLE[frame], (draws, 1))
        samples = triangulate(RIG, noisy, visible, sigma_px=sigma)
        ratios = empirical_over_predicted(samples.points, samples.covariance[0])
        np.testing.assert_allclose(ratios, 1, atol=0.1)
        offset = np.asarray(samples.points) - POINTS[frame]
        distance = np.einsum("ni,nij,nj->n", offset, np.linalg.inv(samples.covariance), offset)
        assert distance.mean() == pytest.approx(3, abs=0.2)  # chi-square of three degrees of freedom


def test_covariance_of_the_cameras_is_added():
    sigma = np.tile([1e-3] * 3 + [3e-3] * 3 + [2.0] * 4 + [2e-3, 1e-3, 2e-4, 2e-4, 1e-4], CAMERAS)
    rng = np.random.default_rng(3)
    mixing = np.eye(len(sigma)) + 0.3 * rng.normal(size=(len(sigma),) * 2) / 3
    factor = sigma[:, None] * mixing
    covariance = factor @ factor.T
    changes = rng.normal(size=(2048, len(sigma))) @ factor.T
    frame = 2

    @jax.jit
    @jax.vmap
    def with_wrong_cameras(change):
        cameras = jax.vmap(Camera.perturbed)(RIG.cameras, change.reshape(CAMERAS, 15))
        rig = eqx.tree_at(lambda rig: rig.cameras, RIG, cameras)
        return triangulate(rig, PIXELS[frame], VISIBLE[frame]).points

    samples = with_wrong_cameras(changes)
    result = triangulate(RIG, PIXELS[frame], VISIBLE[frame], sigma_px=0.5, camera_covariance=covariance)
    without = triangulate(RIG, PIXELS[frame], VISIBLE[frame], sigma_px=0.5)
    from_cameras = np.asarray(result.covariance - without.covariance)
    np.testing.assert_allclose(empirical_over_predicted(samples, from_cameras), 1, atol=0.12)


def test_covariance_of_the_cameras_holds_away_from_the_origin():
    """A camera turns about the world's origin, wherever the room is: against the derivative of the points."""
    away = Similarity(np.float64(1.0), np.eye(3), np.array([7.0, -5.0, 3.0]))
    rig, point = RIG.transformed(away), POINTS[2] + np.array([7.0, -5.0, 3.0])
    pixels = np.asarray(rig.project(point))
    sigma = np.tile([1e-3] * 3 + [3e-3] * 3 + [2.0] * 4 + [2e-3, 1e-3, 2e-4, 2e-4, 1e-4], CAMERAS)

    def moved(change):
        cameras = jax.vmap(Camera.perturbed)(rig.cameras, change.reshape(CAMERAS, 15))
        return triangulate(eqx.tree_at(lambda rig: rig.cameras, rig, cameras), pixels, VISIBLE[2]).points

    slope = np.asarray(jax.jit(jax.jacfwd(moved))(jnp.zeros(len(sigma))))
    found = triangulate(rig, pixels, VISIBLE[2], sigma_px=1e-9, camera_covariance=np.diag(sigma**2)).covariance
    np.testing.assert_allclose(found, slope * sigma**2 @ slope.T, rtol=1e-4)


def test_covariance_scales_with_the_noise():
    one, two = (triangulate(RIG, NOISY, VISIBLE, sigma_px=s) for s in (1.0, 2.0))
    np.testing.assert_allclose(two.covariance, 4 * one.covariance, rtol=1e-12)


def test_hidden_pixels_never_matter():
    wild = np.where(VISIBLE[..., None], NOISY, np.nan)
    assert_same(triangulate(RIG, wild, VISIBLE), triangulate(RIG, NOISY, VISIBLE), atol=0)
    wild = np.where(VISIBLE[..., None], NOISY, 1e12)
    assert_same(triangulate(RIG, wild, VISIBLE), triangulate(RIG, NOISY, VISIBLE), atol=0)


def test_camera_order_never_matters():
    order = [3, 0, 4, 1, 2]
    turned = triangulate(RIG.select(order), NOISY[:, order], VISIBLE[:, order])
    result = triangulate(RIG, NOISY, VISIBLE)
    result = eqx.tree_at(lambda t: t.residuals, result, result.residuals[:, jnp.array(order)])
    assert_same(turned, result)


def test_a_similarity_of_the_world_moves_the_points_with_it():
    similarity = Similarity(np.float64(0.01), Rotation.from_rotvec([1.0, 0.2, -2]).as_matrix(), [5e4, -3e4, 100.0])
    moved = triangulate(RIG.transformed(similarity), NOISY, VISIBLE)
    result = triangulate(RIG, NOISY, VISIBLE)
    np.testing.assert_allclose(moved.points, similarity @ result.points, atol=1e-9)
    np.testing.assert_allclose(moved.rms, result.rms, atol=1e-6)
    turned = 1e-4 * np.asarray(similarity.rotation @ result.covariance @ similarity.rotation.T)
    np.testing.assert_allclose(moved.covariance, turned, rtol=1e-5, atol=1e-6 * abs(turned).max())


def two_cameras(baseline):
    """Two cameras side by side that look along z; no distortion."""
    return CameraRig.from_parameters(
        np.full((2, 2), 800.0),
        np.full((2, 2), 500.0),
        np.zeros((2, 5)),
        np.tile(np.eye(3), (2, 1, 1)),
        np.array([[0.0, 0, 0], [-baseline, 0, 0]]),
        np.full((2, 2), 1000),
    )


BOTH = np.ones(2, dtype=bool)


def test_a_point_between_two_cameras_has_low_parallax():
    half_turn = np.diag([-1.0, 1, -1])
    rig = two_cameras(1.0)
    poses = np.stack([np.eye(3), half_turn]), np.array([[0.0, 0, 0], [0, 0, 6]])
    rig = CameraRig.from_parameters(
        rig.cameras.focal, rig.cameras.center, np.zeros((2, 5)), *poses, rig.image_sizes, rig.names
    )
    result = triangulate(rig, rig.project(np.array([0.02, 0, 3.0])), BOTH)
    assert int(result.flags) == Flag.LOW_PARALLAX
    assert np.rad2deg(result.parallax) == pytest.approx(2 * np.rad2deg(np.arctan(0.02 / 3)), abs=1e-9)


@pytest.mark.parametrize("angle_deg", [0.5, 1.99, 2.01, 30.0])
def test_low_parallax(angle_deg):
    baseline = 2 * 5 * np.tan(np.deg2rad(angle_deg) / 2)
    point = np.array([baseline / 2, 0, 5])
    rig = two_cameras(baseline)
    result = triangulate(rig, rig.project(point), BOTH)
    assert np.rad2deg(result.parallax) == pytest.approx(angle_deg, abs=1e-6)
    assert int(result.flags) == (Flag.LOW_PARALLAX if angle_deg < 2 else 0)
    assert bool(result.valid) is (angle_deg > 2)
    np.testing.assert_allclose(result.points, point, atol=1e-8)


def test_behind():
    rig = two_cameras(1.0)
    point = np.array([0.4, 0.2, -3.0])
    result = triangulate(rig, rig.project(point), BOTH)
    assert int(result.flags) == Flag.BEHIND
    assert not bool(result.valid)
    np.testing.assert_allclose(result.points, point, atol=1e-9)


def test_parallel_rays_stay_finite():
    result = triangulate(two_cameras(1.0), np.full((2, 2), 500.0), BOTH)
    assert int(result.flags) & Flag.LOW_PARALLAX
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result))


@pytest.mark.parametrize("views", [[], [1]])
def test_few_views(views):
    visible = np.isin(np.arange(CAMERAS), views)
    result = triangulate(RIG, PIXELS[0], visible)
    assert int(result.flags) == Flag.FEW_VIEWS
    np.testing.assert_array_equal(result.points, 0)
    np.testing.assert_array_equal(result.residuals, 0)
    np.testing.assert_array_equal(result.covariance, np.where(np.eye(3, dtype=bool), np.inf, 0))


def test_a_pixel_beyond_the_lens_is_not_used():
    pixels = PIXELS[0].copy()
    pixels[2] = 30_000.0
    result = triangulate(RIG, pixels, np.ones(CAMERAS, dtype=bool))
    assert int(result.flags) == Flag.LENS_RANGE
    assert bool(result.valid)
    np.testing.assert_allclose(result.points, POINTS[0], atol=1e-9)
    np.testing.assert_array_equal(result.residuals[2], 0)
    pixels[2] = np.nan
    assert int(triangulate(RIG, pixels, np.ones(CAMERAS, dtype=bool)).flags) == Flag.LENS_RANGE


def test_batches_blocks_and_transformations_agree():
    result = triangulate(RIG, NOISY, VISIBLE)
    folded = triangulate(RIG, NOISY.reshape(4, 16, CAMERAS, 2), VISIBLE.reshape(4, 16, CAMERAS))
    assert folded.covariance.shape == (4, 16, 3, 3)
    assert_same(jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), folded), result, atol=0)
    assert_same(triangulate(RIG, NOISY[7], VISIBLE[7]), jax.tree.map(lambda leaf: leaf[7], result))
    many = triangulate(RIG, np.tile(NOISY, (20, 1, 1)), np.tile(VISIBLE, (20, 1)))
    assert_same(many, jax.tree.map(lambda leaf: np.tile(leaf, (20, *[1] * (leaf.ndim - 1))), result))
    mapped = jax.jit(jax.vmap(lambda p, v: triangulate(RIG, p, v)))(NOISY, VISIBLE)
    assert_same(mapped, result)
    empty = triangulate(RIG, NOISY[:0], VISIBLE[:0])
    assert empty.points.shape == (0, 3)
    assert empty.residuals.shape == (0, CAMERAS, 2)


def test_large_batches_are_worked_on_in_parts(monkeypatch):
    monkeypatch.setattr(triangulation, "_BLOCK", 128 * CAMERAS)
    monkeypatch.setattr(triangulation, "_PART", 512)
    pixels, visible = np.tile(NOISY, (20, 1, 1))[:1200], np.tile(VISIBLE, (20, 1))[:1200]
    result = triangulate(RIG, pixels, visible)
    assert_same(result, jax.jit(triangulate)(RIG, pixels, visible))
    assert_same(triangulate(RIG, jnp.asarray(pixels), jnp.asarray(visible)), result, atol=0)


def test_without_covariance_all_else_is_the_same():
    without = triangulate(RIG, NOISY, VISIBLE, covariance=False)
    with pytest.raises(ValueError, match="covariance=False"):
        _ = without.covariance
    result = eqx.tree_at(lambda t: t.covariance_or_none, triangulate(RIG, NOISY, VISIBLE), None)
    assert_same(without, result)


def test_other_lenses():
    plain = ring_of_cameras(distorted=False)
    other = eqx.tree_at(lambda rig: rig.cameras.lens, plain, Pinhole(plain.cameras.lens.parameters[:, :4]))
    assert_same(triangulate(other, NOISY, VISIBLE), triangulate(plain, NOISY, VISIBLE))
    brown = jnp.concatenate([RIG.cameras.lens.parameters, jnp.zeros((CAMERAS, 3))], axis=1)
    other = eqx.tree_at(lambda rig: rig.cameras.lens, RIG, Rational(brown))
    assert_same(triangulate(other, NOISY, VISIBLE), triangulate(RIG, NOISY, VISIBLE))


def test_fisheyes_that_see_behind_themselves():
    """Points all around five lenses of more than 180 degrees, most of them beside or behind some camera."""
    rng = np.random.default_rng(5)
    count = len(POINTS)
    lens = KannalaBrandt.of(
        rng.uniform(280, 320, (CAMERAS, 2)),
        rng.uniform([620, 340], [660, 380], (CAMERAS, 2)),
        rng.normal(0, [0.02, 0.004, 1e-3, 1e-4], (CAMERAS, 4)),
    )
    rig = eqx.tree_at(lambda rig: rig.cameras.lens, RIG, lens)
    points = rng.uniform([-7, -7, -1], [7, 7, 5], (count, 3))
    visible = np.asarray(rig.sees(points)) & (rng.random((count, CAMERAS)) < 0.8)
    behind = visible & (np.asarray(rig.depth(points)) < 0)
    assert behind.sum() > count / 3
    pixels = np.asarray(rig.project(points))
    known = visible.sum(axis=1) >= 2
    exact = triangulate(rig, pixels, visible)
    wide = known & (np.asarray(exact.flags) == 0)
    assert wide.sum() > 0.8 * known.sum()
    np.testing.assert_allclose(np.asarray(exact.points)[wide], points[wide], atol=1e-7)

    noisy = pixels + rng.normal(0, 0.5, pixels.shape)
    found = triangulate(rig, noisy, visible, sigma_px=0.5, refine_steps=10)
    error = (np.asarray(found.points) - points)[wide]
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(np.asarray(found.covariance)[wide]), error)
    assert 2.2 < square.mean() < 3.9  # 3 coordinates

    def weighted(moved):
        return jnp.sum(triangulate(rig, moved, visible, refine_steps=15).points[wide])

    gradient, step = jax.jit(jax.grad(weighted))(noisy), rng.normal(0, 1e-4, noisy.shape) * visible[..., None]
    numeric = (weighted(noisy + step) - weighted(noisy - step)) / 2
    np.testing.assert_allclose(jnp.sum(gradient * step), numeric, rtol=1e-4)


def test_many_views():
    twice = CameraRig(
        jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), RIG.cameras),
        jnp.concatenate([RIG.image_sizes] * 2),
        tuple(f"{name}_{i}" for i in range(2) for name in RIG.names),
    )
    result = triangulate(RIG, NOISY, VISIBLE)
    doubled = triangulate(twice, np.tile(NOISY, (1, 2, 1)), np.tile(VISIBLE, (1, 2)))
    np.testing.assert_allclose(doubled.points, result.points, atol=1e-9)
    np.testing.assert_allclose(doubled.covariance, result.covariance / 2, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(doubled.parallax, result.parallax, atol=1e-12)
    np.testing.assert_allclose(doubled.rms, result.rms, rtol=1e-9)


@jax.jit
@jax.value_and_grad
def slope(moving, visible, weight):
    """A weighted sum of the points, and of everything else at once, and its derivatives by pixels and cameras."""
    pixels, changes = moving
    cameras = jax.vmap(Camera.perturbed)(RIG.cameras, changes)
    rig = eqx.tree_at(lambda rig: rig.cameras, RIG, cameras)
    result = triangulate(rig, pixels, visible, refine_steps=15)
    finite = jnp.where(jnp.isfinite(result.covariance), result.covariance, 0.0)
    rest = sum(jnp.sum(part) for part in (finite, result.residuals, result.rms, result.parallax))
    return jnp.sum(weight[0] * result.points) + weight[1] * rest


NO_CHANGE = np.zeros((CAMERAS, 15))


def test_gradients_are_finite_where_nothing_is_known():
    visible = VISIBLE[:5].copy()
    visible[0], visible[1] = False, np.arange(CAMERAS) == 3
    pixels = np.where(visible[..., None], NOISY[:5], np.nan)
    pixels[2] = PIXELS[2]  # a perfect fit: rms 0
    pixels[3, 0], visible[3] = 1e5, True  # beyond the lens, and visible pixels that are NaN
    value, (by_pixels, by_cameras) = slope((pixels, NO_CHANGE), visible, (np.ones((5, 3)), 1.0))
    assert np.isfinite(value)
    assert np.isfinite(by_pixels).all()
    assert np.isfinite(by_cameras).all()
    np.testing.assert_array_equal(np.asarray(by_pixels)[~visible], 0)
    np.testing.assert_array_equal(np.asarray(by_pixels)[:2], 0)
    assert np.abs(np.asarray(by_pixels)[2:]).max(axis=(1, 2)).min() > 0


@pytest.mark.parametrize("everything", [0.0, 1.0])
def test_derivatives_by_pixels_and_cameras(everything):
    rng = np.random.default_rng(4)
    pixels = NOISY[:5] + 3 * rng.normal(size=(5, CAMERAS, 2))  # large residuals: the full Hessian matters
    visible, weight = VISIBLE[:5], (rng.normal(size=(5, 3)), everything)
    scale = np.array([1e-3] * 6 + [1.0] * 4 + [1e-3] * 5)
    direction = rng.normal(size=(5, CAMERAS, 2)), rng.normal(size=(CAMERAS, 15)) * scale
    step = 1e-3  # ten times as far the third derivatives show at 1e-5

    def at(distance):
        return slope((pixels + distance * direction[0], distance * direction[1]), visible, weight)

    numeric = (at(step)[0] - at(-step)[0]) / (2 * step)
    along = sum(float(np.sum(by * d)) for by, d in zip(at(0.0)[1], direction, strict=True))
    assert along == pytest.approx(float(numeric), rel=1e-5)


def test_float32_is_kept():
    cameras = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), RIG.cameras)
    rig = CameraRig(cameras, RIG.image_sizes, RIG.names)
    result = triangulate(rig, PIXELS.astype(np.float32), VISIBLE)
    assert result.points.dtype == result.covariance.dtype == jnp.float32
    np.testing.assert_allclose(result.points, POINTS, atol=2e-5)


@pytest.mark.usefixtures("any_shape")
def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"\(\.\.\., 5, 2\)"):
        triangulate(RIG, PIXELS[:, :4], VISIBLE)
    with pytest.raises(ValueError, match=r"\(75, 75\)"):
        triangulate(RIG, PIXELS, VISIBLE, camera_covariance=np.eye(74))
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        triangulate(RIG, PIXELS, VISIBLE)
