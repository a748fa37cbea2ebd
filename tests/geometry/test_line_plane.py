"""Rays, planes and rectangles against scipy's minimiser, numpy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jax.test_util import check_grads
from scipy.optimize import minimize

from jaxpoint.geometry.line import (
    Ray,
    angle_between,
    closest_points,
    distance_between,
    distance_to_point,
    nearest_on_line,
)
from jaxpoint.geometry.plane import Plane, Rect, fit_plane, intersect, intersect_rect

POINTS = arrays(np.float64, (4, 3), elements=st.floats(-10, 10, width=32))
CLOSEST = jax.jit(lambda a, b, c, d: closest_points(Ray.through(a, b), Ray.through(c, d)))
FIT = jax.jit(fit_plane)


@given(POINTS)
@settings(max_examples=25, deadline=None)
def test_closest_points_are_closest(points):
    a, b, c, d = points
    if min(np.linalg.norm(b - a), np.linalg.norm(d - c)) < 1e-3:
        return
    on_a, on_b, parallel = CLOSEST(a, b, c, d)
    found = np.linalg.norm(on_a - on_b)

    def gap(x):
        return np.sum((a + x[0] * (b - a) - c - x[1] * (d - c)) ** 2)

    best = np.sqrt(max(minimize(gap, np.zeros(2), method="BFGS").fun, 0.0))
    assert np.isfinite(found)
    if not parallel:
        assert found <= best + 1e-5
    assert float(distance_between(Ray.through(a, b), Ray.through(c, d))) == pytest.approx(found, abs=1e-9)


def test_parallel_lines():
    a, b = Ray(np.zeros(3), [1.0, 0, 0]), Ray([5.0, 3.0, 4.0], [-1.0, 0, 0])
    on_a, on_b, parallel = closest_points(a, b)
    assert bool(parallel)
    np.testing.assert_allclose(np.linalg.norm(on_a - on_b), 5.0)
    gradient = jax.grad(lambda origin: distance_between(a, Ray(origin, b.direction)))(b.origin)
    np.testing.assert_allclose(gradient, [0, 0.6, 0.8], atol=1e-12)


def test_point_and_line():
    ray = Ray.through(np.array([1.0, 1, 0]), np.array([1.0, 1, 7]))
    np.testing.assert_allclose(nearest_on_line(ray, np.array([4.0, 5, -3])), [1, 1, -3])
    assert float(distance_to_point(ray, np.array([4.0, 5, -3]))) == pytest.approx(5)
    on_line = jax.grad(lambda point: distance_to_point(ray, point))(jnp.array([1.0, 1.0, 2.0]))
    np.testing.assert_array_equal(on_line, np.zeros(3))


def test_batches_of_rays_of_one_origin():
    targets = np.random.default_rng(0).normal(size=(5, 3))
    rays = Ray.through(np.zeros((5, 3)), targets)
    np.testing.assert_allclose(rays.at(np.linalg.norm(targets, axis=1)), targets, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi - 1e-9, np.pi])
def test_angle_between(angle):
    a, b = np.array([2.0, 0, 0]), 3 * np.array([np.cos(angle), np.sin(angle), 0])
    assert float(angle_between(a, b)) == pytest.approx(angle, rel=1e-9, abs=1e-15)
    assert np.isfinite(jax.grad(angle_between)(jnp.asarray(a), b)).all()


def test_fit_plane_finds_the_plane_and_its_residual():
    rng = np.random.default_rng(1)
    normal = np.array([0.48, 0.6, 0.64])
    basis = np.linalg.svd(normal[None])[2][1:]
    flat = rng.normal(size=(200, 2)) @ basis + 2.5 * normal
    plane, residual = FIT(flat)
    assert abs(plane.normal @ normal) == pytest.approx(1, abs=1e-14)
    assert abs(float(plane.offset)) == pytest.approx(2.5)
    assert float(residual) < 1e-14
    heights = rng.normal(size=200) * 0.01
    plane, residual = FIT(flat + heights[:, None] * normal)
    centred = flat + heights[:, None] * normal
    centred = centred - centred.mean(axis=0)
    assert float(residual) == pytest.approx(np.linalg.svd(centred, compute_uv=False)[2] / np.sqrt(200), rel=1e-9)


def test_fit_plane_hides_by_weight_and_has_derivatives_for_a_square():
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0.0], [1, -1, 0.0]]) + np.array([0, 0, 3])
    wild = np.concatenate([square, [[100.0, 50, 70]]])
    plane, residual = FIT(wild, np.array([1.0, 1, 1, 1, 0]))
    assert abs(plane.normal[2]) == pytest.approx(1)
    assert float(residual) < 1e-12

    @jax.jit
    def tilt(points):
        fitted, _ = fit_plane(points)
        return fitted.normal * jnp.sign(fitted.normal[2])

    lifted = square + np.array([[0, 0, 0.1], [0, 0, -0.05], [0, 0, 0.02], [0, 0, 0]])
    for points in (square, lifted):
        check_grads(tilt, (points,), order=1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)
    assert np.isfinite(jax.jit(jax.grad(lambda p: fit_plane(p)[1]))(square)).all()


def test_plane_through_distance_and_projection():
    plane = Plane.through(np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]))
    np.testing.assert_allclose(plane.normal, [0, 0, 1])
    points = np.random.default_rng(2).normal(size=(2, 3, 3))
    np.testing.assert_allclose(plane.distance(points), points[..., 2] - 1)
    np.testing.assert_allclose(plane.project(points)[..., 2], 1.0)


@pytest.mark.parametrize(
    ("direction", "hit"), [([0, 0, 1.0], True), ([0, 0, -1.0], False), ([1.0, 0, 0], False), ([0.6, 0, 0.8], True)]
)
def test_intersect(direction, hit):
    plane = Plane([0, 0, -1.0], -2.0)
    point, forward = intersect(Ray(np.array([1.0, 1, 0]), direction), plane)
    assert bool(forward) is hit
    assert np.isfinite(point).all()
    if hit:
        assert float(plane.distance(point)) == pytest.approx(0, abs=1e-15)


CORNERS = np.array([[0.0, 0, 2], [3, 0, 2], [0, 0, 1], [3, 0, 1]])  # a picture seen from -y: LT, RT, LB, RB


def test_rect_of_measured_corners():
    rect, residual = Rect.from_corners(CORNERS)
    np.testing.assert_allclose(rect.corners, CORNERS, atol=1e-14)
    assert float(residual) < 1e-14
    np.testing.assert_allclose(rect.plane.normal, [0, -1, 0], atol=1e-15)  # to the viewer
    warped = CORNERS + np.array([[0, 0.02, 0], [0, -0.02, 0], [0, -0.02, 0], [0, 0.02, 0]])
    _, residual = Rect.from_corners(warped)
    assert float(residual) == pytest.approx(0.02, rel=1e-6)


@pytest.mark.parametrize(
    ("target", "fractions", "hit"),
    [
        ([1.5, 0, 1.5], [0.5, 0.5], True),
        ([0.3, 0, 1.8], [0.1, 0.2], True),
        ([3.3, 0, 1.5], [1.1, 0.5], False),
        ([1.5, 0, 0.8], [0.5, 1.2], False),
    ],
)
def test_intersect_rect(target, fractions, hit):
    rect, _ = Rect.from_corners(CORNERS)
    origin = np.array([1.0, -4.0, 1.0])
    point, found, inside = intersect_rect(Ray.through(origin, np.array(target)), rect)
    np.testing.assert_allclose(point, target, atol=1e-14)
    np.testing.assert_allclose(found, fractions, atol=1e-14)
    assert bool(inside) is hit
    away = Ray.through(origin, 2 * origin - np.array(target))
    assert not bool(intersect_rect(away, rect)[2])


def test_rect_of_no_area_is_never_hit():
    rect = Rect(np.zeros(3), [1.0, 0, 0], [2.0, 0, 0])
    _, fractions, inside = intersect_rect(Ray.through(np.array([0.0, -1, 0]), np.zeros(3)), rect)
    assert not bool(inside)
    assert np.isfinite(fractions).all()
