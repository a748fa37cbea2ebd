"""The Brown lens and its inverse against OpenCV, brute force and finite differences."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

from jaxpoint.camera.brown import Brown


def with_unit_focal(coefficients):
    """Whose pixels are places on the z = 1 plane."""
    coefficients = jnp.asarray(coefficients)
    return Brown.of(jnp.ones(2, coefficients.dtype), jnp.zeros(2, coefficients.dtype), coefficients)


def on_plane(xy):
    return jnp.concatenate([xy, jnp.ones_like(xy[..., :1])], axis=-1)


@jax.jit
def DISTORT(coefficients, xy):
    return with_unit_focal(coefficients).project(on_plane(xy))


@jax.jit
def UNDISTORT(coefficients, xy):
    lens = with_unit_focal(coefficients)
    (x, y, _), valid = lens.direction_of(lens.parameters, xy[..., 0], xy[..., 1])
    return jnp.stack([x, y], axis=-1), valid


@jax.jit
def MONOTONE(coefficients, xy):
    return with_unit_focal(coefficients).reaches(on_plane(xy))


LENSES = {
    "none": [0, 0, 0, 0, 0],
    "barrel": [-0.3, 0.09, 1e-3, -2e-3, -0.01],
    "pincushion": [0.4, 0.2, -1e-3, 1e-3, 0.1],
    "radial": [-0.2, 0, 0, 0, 0],
    "tangential": [0, 0, 0.02, -0.015, 0],
    "moustache": [-0.4, 0.5, 0, 0, -0.1],
}
GRID = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 9), np.linspace(-0.5, 0.5, 7)), axis=-1)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_distort_is_opencvs(lens):
    lens = np.array(lens, dtype=float)
    points = np.concatenate([GRID.reshape(-1, 2), np.ones((GRID.size // 2, 1))], axis=1)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), lens)
    np.testing.assert_allclose(DISTORT(lens, GRID), theirs.reshape(GRID.shape), atol=1e-15)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_undistort_is_opencvs(lens):
    lens = np.array(lens, dtype=float)
    distorted = np.asarray(DISTORT(lens, GRID * 0.9))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    theirs = cv2.undistortPoints(distorted.reshape(-1, 1, 2), np.eye(3), lens, None, None, None, stop)
    ours, valid = UNDISTORT(lens, distorted)
    assert np.asarray(valid).all()
    np.testing.assert_allclose(ours, theirs.reshape(GRID.shape), atol=1e-9)
    np.testing.assert_allclose(ours, GRID * 0.9, atol=1e-13)


COEFFICIENT = st.floats(-1, 1)
TANGENTIAL = st.floats(-0.01, 0.01)


def least_slope(lens, radius):
    square = np.linspace(0, radius, 2001) ** 2
    return (1 + square * (3 * lens[0] + square * (5 * lens[1] + square * 7 * lens[4]))).min()


@given(st.tuples(COEFFICIENT, COEFFICIENT, TANGENTIAL, TANGENTIAL, COEFFICIENT), st.floats(0, 1.5), st.floats(0, 6.3))
@example((0.5, 0.5, 2**-7, 0.0, -1.0), 0.875, 1.0)  # tangential distortion carries it beyond what radial reaches
@settings(max_examples=200, deadline=None)
def test_range_and_round_trip_of_any_lens(lens, radius, angle):
    lens = np.array(lens)
    place = radius * np.array([np.cos(angle), np.sin(angle)])
    slope = least_slope(lens, radius)
    assume(abs(slope) > 1e-3)
    assert bool(MONOTONE(lens, place)) == (slope > 0)
    if slope > 0.05:
        back, valid = UNDISTORT(lens, DISTORT(lens, place))
        # Tangential distortion moves the edge of the range a little; well inside, the way back is exact.
        if least_slope(lens, 1.1 * radius + 0.02) > 0.4:
            assert bool(valid)
        if bool(valid):
            np.testing.assert_allclose(back, place, atol=1e-12 / slope)


@pytest.mark.parametrize("distorted", [0.6, 0.69, 0.703, 0.72, 1.0, 5.0, 1e6, 1e12])
def test_beyond_the_fold_is_flagged_and_finite(distorted):
    lens = np.array([-0.3, 0, 0, 0, 0])  # grows up to r = 1.054, where r' = 0.7027
    place = np.array([0.6, 0.8]) * distorted
    ideal, valid = UNDISTORT(lens, place)
    assert bool(valid) is (distorted < 0.7027)
    by_lens, by_place = GRADIENT(lens, place)
    for value in (ideal, by_lens, by_place):
        assert np.isfinite(value).all()
    assert np.any(by_place) == (distorted < 0.7027)
    if not valid:
        assert np.linalg.norm(ideal) < 2


GRADIENT = jax.jit(jax.grad(lambda c, xy: jnp.sum(UNDISTORT(c, xy)[0]), argnums=(0, 1)))
IDEAL = jax.jit(lambda c, xy: UNDISTORT(c, xy)[0])


@pytest.mark.parametrize("lens", ["none", "barrel", "tangential"])
def test_derivatives(lens):
    lens = np.array(LENSES[lens], dtype=float)
    place = np.array([[0.0, 0.0], [1e-9, 0.0], [0.4, -0.3]])
    check_grads(IDEAL, (lens, place), order=1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)
    check_grads(DISTORT, (lens, place), order=1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)


def test_second_derivatives():
    lens, place = np.array(LENSES["barrel"]), np.array([0.4, -0.3])
    hessian = jax.jit(jax.hessian(lambda xy: IDEAL(lens, xy)[0]))(place)
    gradient = jax.jit(jax.grad(lambda xy: IDEAL(lens, xy)[0]))
    numeric = [(gradient(place + d) - gradient(place - d)) / 2e-5 for d in 1e-5 * np.eye(2)]
    np.testing.assert_allclose(hessian, numeric, atol=1e-8)


def test_float32_is_kept_and_flagged_alike():
    lens = np.array(LENSES["barrel"], dtype=np.float32)
    places = GRID.astype(np.float32)
    ideal, valid = UNDISTORT(lens, DISTORT(lens, places))
    assert ideal.dtype == jnp.float32
    assert np.asarray(valid).all()
    np.testing.assert_allclose(ideal, places, atol=2e-6)
    assert np.isfinite(DISTORT(lens, np.full(2, 1e9, dtype=np.float32))).all()


def test_many_at_once_are_the_same():
    """The quick way, and the safe one where some places lie beyond the fold."""
    lens = np.array(LENSES["radial"])
    places = np.asarray(DISTORT(lens, GRID.reshape(-1, 2)))
    for far in (1.0, 9.0):
        pixels = np.concatenate([places, places[:3] * far])
        wanted = np.ones(len(pixels), bool)
        own = with_unit_focal(lens)
        (x, y, _), valid = jax.jit(Brown.direction_of)(own.parameters, pixels[:, 0], pixels[:, 1], wanted)
        ideal, expected = UNDISTORT(lens, pixels)
        np.testing.assert_array_equal(valid, expected)
        np.testing.assert_allclose(np.stack([x, y], axis=1)[expected], ideal[expected], atol=1e-12)
