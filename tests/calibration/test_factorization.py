"""Projective cameras and points from masked, noise-free data, by both factorisations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration.factorization import factorise_tracks, projective_errors, refine
from jaxpoint.calibration.factors import factorise
from jaxpoint.calibration.sturm_triggs import depth_ratios, depths, fill_rank_four, thesis_factorisation
from jaxpoint.compilation import jit_once
from jaxpoint.epipolar import lift

NO_LENS = np.zeros(4)


def homography_between(first, second):
    """H (4 x 4) with second_i ~ first_i H for all cameras, in the least-squares sense, and the relative misfit."""
    rows = []
    for number, (a, b) in enumerate(zip(first, second)):
        block = np.zeros((12, 16 + len(first)))
        block[:, :16] = np.kron(a, np.eye(4))
        block[:, 16 + number] = -b.ravel()
        rows.append(block)
    _, values, vt = np.linalg.svd(np.concatenate(rows))
    return vt[-1, :16].reshape(4, 4), values[-1] / values[-2]


def test_what_is_left_out_is_left_out(pinhole):
    assert 0.3 < pinhole.kept[:300].mean() < 0.9  # there are holes, so the tests below test holes
    errors = projective_errors(pinhole.data, pinhole.projections, pinhole.points, NO_LENS)
    assert errors[pinhole.kept].max() < 1e-9  # and the truth is exact


def test_pose_factorisation_and_adjustment_are_exact_without_noise(pinhole):
    start = factorise_tracks(pinhole.data, NO_LENS, pinhole.kept, np.random.default_rng(0))
    assert start.errors[pinhole.kept].mean() < 20.0  # a regularised start, not yet exact
    exact = refine(pinhole.data, start, pinhole.kept, loss_px=10.0)
    assert exact.errors[pinhole.kept].max() < 1e-6
    np.testing.assert_allclose(exact.lenses, 0.0, atol=1e-7)
    between, misfit = homography_between(exact.cameras, pinhole.projections)
    assert misfit < 1e-6
    assert abs(np.linalg.det(between)) > 1e-9
    depth = np.einsum("cj,fj->fc", exact.cameras[:, 2], exact.points / exact.points[:, 3:])
    assert (np.sign(depth) * pinhole.kept).sum(axis=0).min() > 0


def test_random_starts_reach_one_minimum(pinhole):
    rng = np.random.default_rng(1)
    costs = [factorise_tracks(pinhole.data, NO_LENS, pinhole.kept, rng).cost for _ in range(3)]
    np.testing.assert_allclose(costs, costs[0], rtol=1e-4)


def test_the_factorisation_is_a_function_for_jit_vmap_and_grad(pinhole):
    """Of 60 frames with holes and some noise: the gauge is free, what is predicted there is not."""
    rng, frames = np.random.default_rng(7), 60
    weights = pinhole.kept[:frames] * 1.0
    points = pinhole.data.points[:frames] + 1e-3 * rng.normal(size=(frames, 4, 2))
    starts = rng.normal(size=(2, 4, 3, 4))
    starts[:, :, 2] = [0.0, 0.0, 0.0, 1.0] + 0.1 * starts[:, :, 2]
    seen, told = weights * (weights.sum(axis=1) >= 2)[:, None], rng.normal(size=points.shape)

    def predicted(points, start):
        found = factorise(points, weights, start)
        pixels = jnp.einsum("cij,fj->fci", found.cameras[..., :3], found.points) + found.cameras[None, ..., 3]
        straight = pixels[..., :2] / jnp.where(seen > 0, pixels[..., 2], 1.0)[..., None]
        return (seen[..., None] * told * straight).sum()

    values = jit_once(jax.vmap(predicted, in_axes=(None, 0)))(points, starts)
    assert values[0] == pytest.approx(float(values[1]), abs=1e-3)
    step = 1e-4 * rng.normal(size=points.shape)
    both = jit_once(jax.value_and_grad(predicted))
    (_, slope), (after, _), (before, _) = (both(points + far * step, starts[0]) for far in (0, 1, -1))
    np.testing.assert_array_equal(slope[seen == 0], 0.0)
    assert float((slope * step).sum()) == pytest.approx(float(after - before) / 2, rel=1e-3)


def test_adjustment_finds_the_lenses(pinhole):
    """The same rig behind division-model lenses, from lenses that are wrong by 0.05."""
    lenses = np.array([-0.2, -0.1, 0.0, -0.3])
    radius = np.linalg.norm(pinhole.data.points, axis=-1)
    shrink = 2.0 / (1.0 + np.sqrt(1.0 - 4.0 * lenses * radius**2))
    data = _with_points(pinhole.data, pinhole.data.points * shrink[..., None])
    start = factorise_tracks(data, lenses + 0.05, pinhole.kept, np.random.default_rng(2))
    found = refine(data, start, pinhole.kept, loss_px=10.0)
    # A weak prior draws each lens to its start, so nothing is exact here.
    assert found.errors[pinhole.kept].max() < 0.05
    np.testing.assert_allclose(found.lenses, lenses, atol=2e-3)


def _with_points(data, points):
    return type(data)(points, data.visible, data.half_diagonals, data.widths, data.pixel_aspects)


def test_depth_ratios_obey_equation_5_6(pinhole):
    rays = np.asarray(lift(jnp.asarray(pinhole.data.points), jnp.asarray(NO_LENS)))
    true = np.einsum("cj,fj->fc", pinhole.projections[:, 2], pinhole.points)
    ratios = jax.jit(depth_ratios)
    for (i, j), matrix in pinhole.geometry.fundamentals.items():
        both = pinhole.data.visible[:, i] & pinhole.data.visible[:, j]
        # `matrix` maps view i to lines of view j; eq. 5.6 wants the other way round.
        ours = np.asarray(ratios(matrix.T, rays[:, i], rays[:, j]))[both]
        scaled = ours / (true[both, i] / true[both, j])
        np.testing.assert_allclose(scaled, np.median(scaled), rtol=1e-8)


def test_chained_depths_agree_although_sightings_are_missing(pinhole):
    """Known depths are the true ones up to one factor a camera and one a frame."""
    found, known = depths(pinhole.data, pinhole.geometry, pinhole.kept)
    assert known[pinhole.kept].mean() > 0.99
    true = np.einsum("cj,fj->fc", pinhole.projections[:, 2], pinhole.points)
    assert (found[known] * true[known] != 0).all()
    ratio = np.where(known, found / true, 1.0)
    table = np.log(np.abs(ratio))
    camera, frame = np.zeros(4), np.zeros(len(table))
    for _ in range(200):  # alternating fit of the two factors
        frame = np.where(known, table - camera, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        camera = np.where(known, table - frame[:, None], 0.0).sum(axis=0) / known.sum(axis=0)
    assert np.abs(table - camera - frame[:, None])[known].max() < 1e-6


def test_fill_recovers_a_matrix_with_holes(pinhole):
    rays = np.asarray(lift(jnp.asarray(pinhole.data.points), jnp.asarray(NO_LENS)))
    true = np.einsum("cj,fj->fc", pinhole.projections[:, 2], pinhole.points)
    measured = np.where(pinhole.kept[..., None], true[..., None] * rays, 1e6)
    whole = np.flatnonzero(pinhole.kept.sum(axis=1) >= 3)
    tuples = np.random.default_rng(3).choice(whole, (1024, 4))
    motion, points = fill_rank_four(measured, pinhole.kept, tuples)
    errors = projective_errors(pinhole.data, np.asarray(motion), np.asarray(points), NO_LENS)
    assert errors[pinhole.kept].max() < 1e-6
    # What was hidden is filled in as it truly is.
    ideal = np.einsum("cij,fj->fci", pinhole.projections, pinhole.points)[:300]
    filled = np.einsum("cij,fj->fci", motion, points)[:300]
    hidden = ~pinhole.kept[:300] & pinhole.kept[:300].any(axis=1, keepdims=True)
    assert hidden.sum() > 100
    off = np.cross(filled[hidden], ideal[hidden])
    lengths = np.linalg.norm(filled[hidden], axis=1) * np.linalg.norm(ideal[hidden], axis=1)
    assert (np.linalg.norm(off, axis=1) / lengths).max() < 1e-6


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_fill_has_finite_derivatives_where_data_are_missing(pinhole, noise):
    """Without noise the four directions have equal eigenvalues; one frame is seen by nobody, one by a single camera."""
    rng, frames = np.random.default_rng(6), 40
    rays = np.asarray(lift(jnp.asarray(pinhole.data.points), jnp.asarray(NO_LENS)))[:frames]
    true = np.einsum("cj,fj->fc", pinhole.projections[:, 2], pinhole.points[:frames])
    measured = true[..., None] * rays * (1 + noise * rng.normal(size=rays.shape))
    known = pinhole.kept[:frames].copy()
    known[3], known[4] = False, [True, False, False, False]
    tuples = jnp.asarray(rng.choice(np.flatnonzero(known.sum(axis=1) >= 3), (64, 4)))
    weights = np.where((known.sum(axis=1) >= 2)[:, None, None], rng.normal(size=measured.shape), 0.0)

    def filled(measurements):
        motion, points = fill_rank_four(measurements, jnp.asarray(known), tuples)
        return (jnp.einsum("cij,fj->fci", motion, points) * weights).sum()

    value, slope = jax.jit(filled), np.asarray(jax.jit(jax.grad(filled))(measured))
    assert np.isfinite(slope).all()
    np.testing.assert_array_equal(slope[~known], 0.0)
    step = rng.normal(size=measured.shape) * np.abs(measured)
    along = (value(measured + 1e-6 * step) - value(measured - 1e-6 * step)) / 2e-6
    assert float((slope * step).sum()) == pytest.approx(float(along), rel=1e-5)


def test_the_thesis_method_is_exact_without_noise(pinhole):
    found = thesis_factorisation(pinhole.data, pinhole.geometry, pinhole.kept, np.random.default_rng(4))
    assert np.quantile(found.errors[pinhole.kept], 0.99) < 1e-4
    _, misfit = homography_between(found.cameras, pinhole.projections)
    assert misfit < 1e-6


def test_hidden_pixels_never_matter(pinhole):
    points = np.where(pinhole.kept[..., None], pinhole.data.points, np.nan)
    spoilt = _with_points(pinhole.data, points)
    fits = [
        factorise_tracks(data, NO_LENS, pinhole.kept, np.random.default_rng(5)).cost for data in (pinhole.data, spoilt)
    ]
    assert fits[0] == pytest.approx(fits[1], rel=1e-12)
