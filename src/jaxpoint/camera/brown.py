"""Brown's lens: radial and tangential distortion, as OpenCV and Matlab use it (Brown 1966)."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.camera.image_plane import (
    MAX_R2,
    PlaneModel,
    image_on_plane,
    in_reach,
    on_plane,
    plane_jacobian,
    solve_symmetric,
    tangential,
    undistort,
)
from jaxpoint.camera.lens import AbstractLens, Coefficient, Parameters, Slopes, Vector
from jaxpoint.geometry.arrays import as_float

WILD_R2 = 9.0  # of an adjustment on its way: beyond it the polynomial counts as constant, and cannot overflow
_HALVINGS = 40
# Where many places are undistorted at once
_QUICK_RADIAL_STEPS = 3
_QUICK_PLANE_STEPS = 2
_QUICK_LAST_STEP = 1e-5


class Brown(AbstractLens):
    """x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2) on the z = 1 plane, y' likewise.

    The coefficients are in OpenCV's order. It can be inverted as far out as the radial part still grows with r.
    """

    parameters: Float[Array, "*batch 9"] = eqx.field(converter=as_float)  # fx, fy, cx, cy (px), k1, k2, p1, p2, k3
    name: ClassVar[str] = "brown"
    coefficients: ClassVar[tuple[Coefficient, ...]] = (
        Coefficient("k1", 1.0, 0.03),
        Coefficient("k2", 1.0, 0.03),
        Coefficient("p1", 0.005, 0.002),
        Coefficient("p2", 0.005, 0.002),
        Coefficient("k3", 1.0, 0.03),
    )
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "none": (),
        "radial1": ("k1",),
        "radial2": ("k1", "k2"),
        "brown": ("k1", "k2", "p1", "p2", "k3"),
    }
    sees_sideways: ClassVar[bool] = False

    @staticmethod
    def image_of(parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
        """Pixel of a direction before the camera."""
        return image_on_plane(MODEL, parameters, direction)

    @staticmethod
    def direction_of(
        parameters: Parameters, pixel_x: Array, pixel_y: Array, wanted: Array | None = None
    ) -> tuple[tuple[Array, Array, Array], Array]:
        """The direction of a pixel, z = 1, exact to rounding where there is one."""
        fx, fy, cx, cy, *coefficients = parameters
        x, y = (pixel_x - cx) / fx, (pixel_y - cy) / fy
        coefficients = jnp.stack(coefficients)
        if wanted is None:
            u, v, valid = undistort(MODEL, coefficients, x, y)
        else:
            reach2 = jax.lax.stop_gradient(_monotone_r2(coefficients))
            safe_x, safe_y = jnp.where(wanted, x, 0.0), jnp.where(wanted, y, 0.0)
            u, v, valid = _undistort_many(coefficients, reach2, safe_x, safe_y, wanted)
        return (u, v, jnp.ones_like(u)), valid

    @staticmethod
    def in_range(parameters: Parameters, direction: Vector) -> Array:
        """Whether the radial polynomial grows all the way from the axis to this direction."""
        return in_reach(MODEL, parameters, direction)

    @classmethod
    def slopes_of(cls, parameters: Parameters, direction: Vector, xp: Any = jnp, *, wild: bool = False) -> Slopes:
        """Written out.

        What many entries share ends in a division: a compiler that recomputes cheap operations for every entry, as
        XLA does on a CPU, keeps the result of a division. That halves the time of an adjustment.
        """
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = parameters
        u, v, z = on_plane(direction, xp)
        full, farthest = u * u + v * v, WILD_R2 if wild else MAX_R2
        grows = xp.where(full < farthest, 2.0, 0.0)  # d r2 / d u = grows u
        r2 = xp.minimum(full, farthest)
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = grows * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        twice, wide_u, wide_v = 2.0 * u * v, r2 + 2.0 * u * u, r2 + 2.0 * v * v
        pixel = fx * (u * radial + p1 * twice + p2 * wide_u) + cx, fy * (v * radial + p1 * wide_v + p2 * twice) + cy
        across_u, across_v = u * v * slope + p1 * u * grows, u * v * slope + p2 * v * grows
        xx = fx * (radial + u * u * slope + 2.0 * p1 * v + p2 * u * (4.0 + grows)) / z
        xy = fx * (across_v + 2.0 * p1 * u) / z
        yx = fy * (across_u + 2.0 * p2 * v) / z
        yy = fy * (radial + v * v * slope + p1 * v * (4.0 + grows) + 2.0 * p2 * u) / z
        x2, y2 = fx * u * r2, fy * v * r2
        return Slopes(
            pixel,
            ((xx, xy, -(xx * u + xy * v)), (yx, yy, -(yx * u + yy * v))),
            (
                (x2, x2 * r2, fx * twice, fx * wide_u, x2 * r2 * r2),
                (y2, y2 * r2, fy * wide_v, fy * twice, y2 * r2 * r2),
            ),
        )


def _distort(coefficients: Parameters, x: Array, y: Array) -> tuple[Array, Array]:
    k1, k2, _, _, k3 = coefficients
    r2 = jnp.minimum(x * x + y * y, MAX_R2)
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    off_x, off_y = _tangential(coefficients, x, y)
    return x * radial + off_x, y * radial + off_y


def _tangential(coefficients: Parameters, x: Array, y: Array) -> Float[Array, "2 *batch"]:
    return tangential(coefficients[2], coefficients[3], x, y)


def _jacobian(coefficients: Parameters, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """d x'/dx, d x'/dy (= d y'/dx), d y'/dy."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return plane_jacobian(radial, k1 + r2 * (2 * k2 + r2 * 3 * k3), p1, p2, x, y)


def _radius(coefficients: Parameters, radius: Array) -> tuple[Array, Array]:
    """The distorted radius of an ideal one, and its derivative."""
    k1, k2, _, _, k3 = coefficients
    r2 = radius * radius
    return radius * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))), _slope(coefficients, r2)


def _slope(coefficients: Parameters, r2: Array) -> Array:
    """Derivative of the distorted radius by the ideal radius."""
    k1, k2, _, _, k3 = coefficients
    return 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3))


def _least_slope(coefficients: Parameters, r2: Array) -> Array:
    """The smallest `_slope` between the axis and a squared radius: at an end, or where 3 k1 + 10 k2 s + 21 k3 s^2 = 0.

    Both roots are written so that none divides by a coefficient that may be 0.
    """
    k1, k2, _, _, k3 = coefficients
    a, b, c = 21 * k3, 10 * k2, 3 * k1
    discriminant = b * b - 4 * a * c
    real = discriminant > 0
    q = -(b + jnp.where(b < 0, -1.0, 1.0) * jnp.sqrt(jnp.where(real, discriminant, 1.0))) / 2
    least = jnp.minimum(1.0, _slope(coefficients, r2))
    for top, bottom in ((q, a), (c, q)):
        root = jnp.where(bottom != 0, top / jnp.where(bottom != 0, bottom, 1.0), -1.0)
        inside = real & (root > 0) & (root < r2)
        least = jnp.where(inside, jnp.minimum(least, _slope(coefficients, jnp.where(inside, root, 0.0))), least)
    return least


def _monotone_r2(coefficients: Parameters) -> Array:
    """Squared ideal radius up to which the distorted radius grows, by halving; at most `MAX_R2`."""

    def halve(_: Int[Array, ""], bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = jnp.sqrt(low * high)
        grows = _least_slope(coefficients, middle) > 0
        return jnp.where(grows, middle, low), jnp.where(grows, high, middle)

    largest = jnp.full_like(coefficients[0], MAX_R2)
    inner = jax.lax.fori_loop(0, _HALVINGS, halve, (1 / largest, largest))[0]
    return jnp.where(_least_slope(coefficients, largest) > 0, largest, inner)


MODEL = PlaneModel(_distort, _jacobian, _tangential, _radius, _monotone_r2)


def _bend(coefficients: Parameters, x: Array, y: Array) -> tuple[tuple[Array, Array], tuple[Array, Array, Array]]:
    """Distorted places of ideal places, and d x'/dx, d x'/dy (= d y'/dx), d y'/dy; as much at once as they share."""
    k1, k2, p1, p2, k3 = coefficients
    full = x * x + y * y
    r2 = jnp.minimum(full, MAX_R2)
    grows = jnp.where(full < MAX_R2, 2.0, 0.0)  # d r2 / d x = grows x
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = grows * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    return (
        (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y),
        (
            radial + slope * x * x + 2 * p1 * y + (4 + grows) * p2 * x,
            slope * x * y + 2 * p1 * x + grows * p2 * y,
            radial + slope * y * y + (4 + grows) * p1 * y + 2 * p2 * x,
        ),
    )


@jax.custom_jvp
def _undistort_many(
    coefficients: Float[Array, "5 *lens"], reach2: Float[Array, "*lens"], x: Array, y: Array, wanted: Bool[Array, "..."]
) -> tuple[Array, Array, Array]:
    """`undistort` of many places at once.

    A few plain Newton steps nearly always do, and say so; where a wanted place is left over, all take the safe way.
    """
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    a, b, c = k1 * square, k2 * square**2, k3 * square**3
    factors = [jnp.ones_like(x)]  # ideal over distorted radius; the tangential part is left to the plane
    # Steps are written with their division last: XLA on a CPU keeps its result, and computes all else anew.
    for _ in range(_QUICK_RADIAL_STEPS):
        factor, f2 = factors[-1], factors[-1] ** 2
        slope = 1 + f2 * (3 * a + f2 * (5 * b + f2 * 7 * c))
        factors.append((1 + factor * f2 * (2 * a + f2 * (4 * b + f2 * 6 * c))) / slope)
    u, v = before = x * factors[-1], y * factors[-1]
    for _ in range(_QUICK_PLANE_STEPS):
        before = u, v
        bent, (xx, xy, yy) = _bend(coefficients, u, v)
        determinant = xx * yy - xy * xy
        off_x, off_y = x - bent[0], y - bent[1]
        u = (before[0] * determinant + (yy * off_x - xy * off_y)) / determinant
        v = (before[1] * determinant + (xx * off_y - xy * off_x)) / determinant
    # The step after the last would be about as long as its square. Near the edge of the range that is not so.
    moved = jnp.abs(u - before[0]) + jnp.abs(v - before[1])
    _, (xx, xy, yy) = _bend(coefficients, u, v)
    # All steps are looked at, which also keeps XLA from writing one over the other: such loops it makes slow ones.
    sound = functools.reduce(jnp.minimum, factors) > 0
    found = sound & (moved < _QUICK_LAST_STEP) & (xx * yy - xy * xy > 0.05) & (u * u + v * v <= reach2)
    # Nothing within the range of the lens is distorted to a place farther out than this.
    edge = jnp.sqrt(reach2) * (1 + reach2 * (k1 + reach2 * (k2 + reach2 * k3)))
    edge = edge + 3 * (jnp.abs(p1) + jnp.abs(p2)) * reach2
    clear = found | (square > edge * edge) | ~wanted
    return jax.lax.cond(jnp.all(clear), lambda: (u, v, found), lambda: undistort(MODEL, coefficients, x, y))


@_undistort_many.defjvp
def _undistort_many_jvp(primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
    coefficients = primals[0]
    u, v, valid = _undistort_many(*primals)
    _, by_lens = jax.jvp(lambda c: _bend(c, u, v)[0], (coefficients,), (tangents[0],))
    jacobian = _bend(coefficients, u, v)[1]
    dx, dy = solve_symmetric(jacobian, tangents[2] - by_lens[0], tangents[3] - by_lens[1])
    no_change = np.zeros(valid.shape, dtype=jax.dtypes.float0)
    return (u, v, valid), (jnp.where(valid, dx, 0.0), jnp.where(valid, dy, 0.0), no_change)
