"""Lenses that are described on the z = 1 plane: where a ray crosses it, and how their distortion is inverted there.

The inverse is a fixed number of safeguarded Newton steps, on the radius first, then on the plane; derivatives of all
orders come from the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.camera.lens import COMMON, Parameters, Vector
from jaxpoint.geometry.arrays import stack_last

# A ray 89.9 degrees off the axis; beyond it a polynomial in r^2 means nothing and only overflows.
MAX_R2 = 1e6
_RADIAL_STEPS = 10
_PLANE_STEPS = 6


class PlaneModel(NamedTuple):
    """Distortion of places on the z = 1 plane: a radial part, which grows up to a reach, and a small tangential one.

    All take the coefficients (k, ...) first.
    """

    distort: Callable[..., tuple[Array, Array]]  # x, y -> x', y'
    jacobian: Callable[..., tuple[Array, Array, Array]]  # x, y -> d x'/dx, d x'/dy (= d y'/dx), d y'/dy
    tangential: Callable[..., Array]  # x, y -> what is added to the radial part, (2, ...)
    radius: Callable[..., tuple[Array, Array]]  # r -> r', d r'/dr
    reach2: Callable[..., Array]  # squared radius up to which r' grows


def on_plane(direction: Vector, xp: Any = jnp) -> Vector:
    """Where a direction crosses the z = 1 plane, and its z, never 0."""
    x, y, z = direction
    tiny = xp.finfo(xp.asarray(z).dtype).eps
    z = xp.where(xp.abs(z) < tiny, tiny, z)
    return x / z, y / z, z


def image_on_plane(model: PlaneModel, parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
    """Pixel of a direction before the camera."""
    fx, fy, cx, cy, *coefficients = parameters
    u, v, _ = on_plane(direction)
    bent_u, bent_v = model.distort(coefficients, u, v)
    return fx * bent_u + cx, fy * bent_v + cy


def tangential(p1: Array, p2: Array, x: Array, y: Array) -> Float[Array, "2 *batch"]:
    """What decentred lenses add to the radial part."""
    r2 = jnp.minimum(x * x + y * y, MAX_R2)
    return jnp.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])


def plane_jacobian(
    radial: Array, by_square: Array, p1: Array, p2: Array, x: Array, y: Array
) -> tuple[Array, Array, Array]:
    """d x'/dx, d x'/dy (= d y'/dx), d y'/dy, from the radial factor and its derivative by r^2."""
    slope = 2 * by_square
    return (
        radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
        slope * x * y + 2 * p1 * x + 2 * p2 * y,
        radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
    )


def undistort(
    model: PlaneModel, coefficients: Float[Array, "k ..."], x: Array, y: Array
) -> tuple[Array, Array, Bool[Array, "..."]]:
    """The ideal place of distorted ones, and whether there is one within the reach of the radial part."""
    target = stack_last(x, y)
    ideal = _undistort(model, coefficients, target)
    return ideal[..., 0], ideal[..., 1], _found(model, coefficients, ideal, target)


def in_reach(model: PlaneModel, parameters: Parameters, direction: Vector) -> Array:
    """Whether directions point forward and cross the plane where the radial part grows all the way."""
    coefficients = jnp.stack([jnp.asarray(value) for value in parameters[COMMON:]])
    u, v, _ = on_plane(direction)
    return (direction[2] > 0) & (u * u + v * v <= model.reach2(coefficients))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
@partial(jax.jit, static_argnums=0)
def _undistort(
    model: PlaneModel, coefficients: Float[Array, "k ..."], target: Float[Array, "*batch 2"]
) -> Float[Array, "*batch 2"]:
    """Newton on the radius within the range where it grows, then Newton on the plane."""
    aim = jnp.moveaxis(target, -1, 0)

    def radially(aim: Float[Array, "2 *batch"]) -> tuple[Array, Float[Array, "2 *batch"]]:
        distorted = jnp.sqrt(aim[0] * aim[0] + aim[1] * aim[1])
        radius = _undistort_radius(model, coefficients, distorted)
        shrink = radius / jnp.where(distorted > 0, distorted, 1.0)
        return radius, jnp.stack([aim[0] * shrink, aim[1] * shrink])

    # Tangential distortion can carry a place beyond all that the radial part reaches: it is taken off and tried again.
    _, start = radially(aim)
    radius, start = radially(aim - model.tangential(coefficients, *start))
    # The start is nearly right already: a step far longer than tangential distortion is a wrong one.
    longest = 0.2 * (radius + 0.1)

    def step(_: Int[Array, ""], place: Float[Array, "2 *batch"]) -> Float[Array, "2 *batch"]:
        x, y = place
        gx, gy = model.distort(coefficients, x, y)
        dx, dy = solve_symmetric(model.jacobian(coefficients, x, y), aim[0] - gx, aim[1] - gy)
        return jnp.stack([x + jnp.clip(dx, -longest, longest), y + jnp.clip(dy, -longest, longest)])

    return jnp.moveaxis(jax.lax.fori_loop(0, _PLANE_STEPS, step, start), 0, -1)


def _undistort_radius(
    model: PlaneModel, coefficients: Float[Array, "k ..."], distorted: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """The ideal radius by Newton steps that fall back on halving, within the range where the radius grows."""
    reach = jnp.sqrt(model.reach2(coefficients))

    def step(_: Int[Array, ""], state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        radius, low, high = state
        bent, slope = model.radius(coefficients, radius)
        excess = bent - distorted
        low, high = jnp.where(excess <= 0, radius, low), jnp.where(excess > 0, radius, high)
        newton = radius - excess / jnp.where(slope > 0, slope, 1.0)
        return jnp.where((slope > 0) & (newton >= low) & (newton <= high), newton, (low + high) / 2), low, high

    start = jnp.minimum(distorted, reach)
    bent, slope = model.radius(coefficients, start)
    # Where the lens magnifies much, r' grows like a power of r: one Newton step in logarithms goes almost all the way.
    above = (bent > distorted) & (slope > 0)
    power = jnp.where(above, bent / jnp.where(above, start * slope, 1.0), 0.0)
    start = start * jnp.where(above, distorted / jnp.where(above, bent, 1.0), 1.0) ** power
    bounds = jnp.zeros_like(start), jnp.zeros_like(start) + reach
    return jax.lax.fori_loop(0, _RADIAL_STEPS, step, (start, *bounds))[0]


@_undistort.defjvp
def _undistort_jvp(
    model: PlaneModel, primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    coefficients, target = primals
    ideal = _undistort(model, coefficients, target)
    x, y = ideal[..., 0], ideal[..., 1]
    _, (by_lens_x, by_lens_y) = jax.jvp(lambda c: model.distort(c, x, y), (coefficients,), (tangents[0],))
    jacobian = model.jacobian(coefficients, x, y)
    dx, dy = solve_symmetric(jacobian, tangents[1][..., 0] - by_lens_x, tangents[1][..., 1] - by_lens_y)
    valid = _found(model, coefficients, ideal, target)
    return ideal, stack_last(jnp.where(valid, dx, 0.0), jnp.where(valid, dy, 0.0))


def _found(
    model: PlaneModel,
    coefficients: Float[Array, "k ..."],
    ideal: Float[Array, "*batch 2"],
    target: Float[Array, "*batch 2"],
) -> Bool[Array, "*batch"]:
    """Whether `ideal` lies in the range of the lens and is distorted to `target`, to rounding."""
    x, y = ideal[..., 0], ideal[..., 1]
    tx, ty = target[..., 0], target[..., 1]
    gx, gy = model.distort(coefficients, x, y)
    gap = jnp.maximum(jnp.abs(gx - tx), jnp.abs(gy - ty))
    tolerance = 200 * jnp.finfo(gap.dtype).eps * (1 + jnp.abs(tx) + jnp.abs(ty))
    return (gap < tolerance) & (x * x + y * y <= model.reach2(coefficients))


def solve_symmetric(jacobian: tuple[Array, Array, Array], x: Array, y: Array) -> tuple[Array, Array]:
    """Solution of the symmetric 2 x 2 system; zero where it is singular or turned over."""
    xx, xy, yy = jacobian
    determinant = xx * yy - xy * xy
    regular = determinant > 1e-6
    inverse = jnp.where(regular, 1 / jnp.where(regular, determinant, 1.0), 0.0)
    return (yy * x - xy * y) * inverse, (xx * y - xy * x) * inverse
