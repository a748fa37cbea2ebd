"""Lens distortion on the z = 1 plane of the camera."""

from __future__ import annotations

import abc
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.geometry.arrays import AnyArray, as_float, stack_last

# A ray 89.9 degrees off the axis; beyond it a polynomial in r^2 means nothing and only overflows.
_MAX_R2 = 1e6
_HALVINGS = 40
_RADIAL_STEPS = 10
_PLANE_STEPS = 6
# Where many places are undistorted at once
_QUICK_RADIAL_STEPS = 3
_QUICK_PLANE_STEPS = 2
_QUICK_LAST_STEP = 1e-5


class AbstractDistortion(eqx.Module):
    """Where the ray through (x, y) of the z = 1 plane really goes, and back.

    A model is final: it implements both functions and nothing inherits from it.
    """

    @abc.abstractmethod
    def distort(self, xy: Float[AnyArray, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Distorted place of ideal places; finite for every finite input."""

    @abc.abstractmethod
    def undistort(self, xy: Float[AnyArray, "*batch 2"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Ideal place of distorted places, and whether there is one within the model's range.

        Where there is none the place is finite but meaningless, and its derivative is 0.
        """


class NoDistortion(AbstractDistortion):
    """A perfect lens."""

    def distort(self, xy: Float[AnyArray, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """The same places."""
        return as_float(xy)

    def undistort(self, xy: Float[AnyArray, "*batch 2"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """The same places, all valid."""
        xy = as_float(xy)
        return xy, jnp.ones(xy.shape[:-1], dtype=bool)


class Brown(AbstractDistortion):
    """Radial and tangential distortion (Brown 1966), as OpenCV and Matlab use it.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), and likewise y' with p1 and p2 swapped.
    It can be inverted as far out as the radial part still grows with r; `undistort` says where it cannot.
    """

    coefficients: Float[Array, "5"] = eqx.field(converter=as_float)  # k1, k2, p1, p2, k3

    def distort(self, xy: Float[AnyArray, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Distorted place of ideal places."""
        xy = as_float(xy)
        return stack_last(*_distort(self.coefficients, xy[..., 0], xy[..., 1]))

    def undistort(self, xy: Float[AnyArray, "*batch 2"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Ideal place of distorted places by a fixed number of safeguarded Newton steps, and whether there is one.

        Exact to rounding where valid; derivatives (of all orders) come from the implicit function theorem.
        """
        target = as_float(xy)
        ideal = _undistort(self.coefficients, target)
        return ideal, _reaches(self.coefficients, ideal, target)

    def is_monotone(self, xy: Float[AnyArray, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Whether the radial polynomial grows all the way from the axis to the radius of ideal places."""
        xy = as_float(xy)
        return jnp.sum(xy**2, axis=-1) <= _monotone_r2(self.coefficients)


def _distort(coefficients: Float[Array, "5"], x: Array, y: Array) -> tuple[Array, Array]:
    k1, k2, _, _, k3 = coefficients
    r2 = jnp.minimum(x * x + y * y, _MAX_R2)
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    off_x, off_y = _tangential(coefficients, x, y)
    return x * radial + off_x, y * radial + off_y


def _tangential(coefficients: Float[Array, "5"], x: Array, y: Array) -> Float[Array, "2 *batch"]:
    """What decentred lenses add to the radial part."""
    p1, p2 = coefficients[2], coefficients[3]
    r2 = jnp.minimum(x * x + y * y, _MAX_R2)
    return jnp.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])


def _jacobian(coefficients: Float[Array, "5"], x: Array, y: Array) -> tuple[Array, Array, Array]:
    """d x'/dx, d x'/dy (= d y'/dx), d y'/dy."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    return (
        radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
        slope * x * y + 2 * p1 * x + 2 * p2 * y,
        radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
    )


def _slope(coefficients: Float[Array, "5"], r2: Array) -> Array:
    """Derivative of the distorted radius by the ideal radius."""
    k1, k2, _, _, k3 = coefficients
    return 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3))


def _least_slope(coefficients: Float[Array, "5"], r2: Array) -> Array:
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


def _monotone_r2(coefficients: Float[Array, "5"]) -> Float[Array, ""]:
    """Squared ideal radius up to which the distorted radius grows, by halving; at most `_MAX_R2`."""

    def halve(_: Int[Array, ""], bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = jnp.sqrt(low * high)
        grows = _least_slope(coefficients, middle) > 0
        return jnp.where(grows, middle, low), jnp.where(grows, high, middle)

    largest = jnp.full_like(coefficients[0], _MAX_R2)
    inner = jax.lax.fori_loop(0, _HALVINGS, halve, (1 / largest, largest))[0]
    return jnp.where(_least_slope(coefficients, largest) > 0, largest, inner)


def brown_slopes(
    coefficients: Float[Array, "5 C 1"], x: Float[Array, "C B"], y: Float[Array, "C B"]
) -> tuple[tuple[Array, Array], tuple[Array, Array, Array]]:
    """Distorted places of ideal places, one lens a row, and d x'/dx, d x'/dy (= d y'/dx), d y'/dy."""
    k1, k2, p1, p2, k3 = coefficients
    full = x * x + y * y
    r2 = jnp.minimum(full, _MAX_R2)
    grows = jnp.where(full < _MAX_R2, 2.0, 0.0)  # d r2 / d x = grows x
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


def undistort_rows(
    coefficients: Float[Array, "5 C 1"], x: Float[Array, "C B"], y: Float[Array, "C B"], wanted: Bool[Array, "C B"]
) -> tuple[Float[Array, "C B"], Float[Array, "C B"], Bool[Array, "C B"]]:
    """`Brown.undistort` of many places at once, one lens a row.

    A few plain Newton steps nearly always do, and say so; where a wanted place is left over, all take the safe way.
    """
    reach2 = jax.lax.stop_gradient(jax.vmap(_monotone_r2)(coefficients[:, :, 0].T)[:, None])
    return _undistort_rows(coefficients, reach2, x, y, wanted)


@jax.custom_jvp
def _undistort_rows(
    coefficients: Float[Array, "5 C 1"], reach2: Float[Array, "C 1"], x: Array, y: Array, wanted: Bool[Array, "C B"]
) -> tuple[Array, Array, Array]:
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
        bent, (xx, xy, yy) = brown_slopes(coefficients, u, v)
        determinant = xx * yy - xy * xy
        off_x, off_y = x - bent[0], y - bent[1]
        u = (before[0] * determinant + (yy * off_x - xy * off_y)) / determinant
        v = (before[1] * determinant + (xx * off_y - xy * off_x)) / determinant
    # The step after the last would be about as long as its square. Near the edge of the range that is not so.
    moved = jnp.abs(u - before[0]) + jnp.abs(v - before[1])
    _, (xx, xy, yy) = brown_slopes(coefficients, u, v)
    # All steps are looked at, which also keeps XLA from writing one over the other: such loops it makes slow ones.
    sound = functools.reduce(jnp.minimum, factors) > 0
    found = sound & (moved < _QUICK_LAST_STEP) & (xx * yy - xy * xy > 0.05) & (u * u + v * v <= reach2)
    # Nothing within the range of the lens is distorted to a place farther out than this.
    edge = jnp.sqrt(reach2) * (1 + reach2 * (k1 + reach2 * (k2 + reach2 * k3)))
    edge = edge + 3 * (jnp.abs(p1) + jnp.abs(p2)) * reach2
    clear = found | (square > edge * edge) | ~wanted

    def safe() -> tuple[Array, Array, Array]:
        def one(row: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
            ideal, valid = Brown(row).undistort(stack_last(x, y))
            return ideal[:, 0], ideal[:, 1], valid

        return jax.vmap(one)(coefficients[:, :, 0].T, x, y)

    return jax.lax.cond(jnp.all(clear), lambda: (u, v, found), safe)


@_undistort_rows.defjvp
def _undistort_rows_jvp(primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
    coefficients = primals[0]
    u, v, valid = _undistort_rows(*primals)
    _, by_lens = jax.jvp(lambda c: brown_slopes(c, u, v)[0], (coefficients,), (tangents[0],))
    dx, dy = _solve(brown_slopes(coefficients, u, v)[1], tangents[2] - by_lens[0], tangents[3] - by_lens[1])
    no_change = np.zeros(valid.shape, dtype=jax.dtypes.float0)
    return (u, v, valid), (jnp.where(valid, dx, 0.0), jnp.where(valid, dy, 0.0), no_change)


@jax.custom_jvp
@jax.jit
def _undistort(coefficients: Float[Array, "5"], target: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    """The ideal place: Newton on the radius within the range where it grows, then Newton on the plane."""
    aim = jnp.moveaxis(target, -1, 0)

    def radially(aim: Float[Array, "2 *batch"]) -> tuple[Array, Float[Array, "2 *batch"]]:
        distorted = jnp.sqrt(aim[0] * aim[0] + aim[1] * aim[1])
        radius = _undistort_radius(coefficients, distorted)
        shrink = radius / jnp.where(distorted > 0, distorted, 1.0)
        return radius, jnp.stack([aim[0] * shrink, aim[1] * shrink])

    # Tangential distortion can carry a place beyond all that the radial part reaches: it is taken off and tried again.
    _, start = radially(aim)
    radius, start = radially(aim - _tangential(coefficients, *start))
    # The start is nearly right already: a step far longer than tangential distortion is a wrong one.
    longest = 0.2 * (radius + 0.1)

    def step(_: Int[Array, ""], place: Float[Array, "2 *batch"]) -> Float[Array, "2 *batch"]:
        x, y = place
        gx, gy = _distort(coefficients, x, y)
        dx, dy = _solve(_jacobian(coefficients, x, y), aim[0] - gx, aim[1] - gy)
        return jnp.stack([x + jnp.clip(dx, -longest, longest), y + jnp.clip(dy, -longest, longest)])

    return jnp.moveaxis(jax.lax.fori_loop(0, _PLANE_STEPS, step, start), 0, -1)


def _undistort_radius(coefficients: Float[Array, "5"], distorted: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The ideal radius by Newton steps that fall back on halving, within the range where the radius grows."""
    k1, k2, _, _, k3 = coefficients
    reach = jnp.sqrt(_monotone_r2(coefficients))

    def bend(radius: Array) -> tuple[Array, Array]:
        r2 = radius * radius
        return radius * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))), _slope(coefficients, r2)

    def step(_: Int[Array, ""], state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        radius, low, high = state
        bent, slope = bend(radius)
        excess = bent - distorted
        low, high = jnp.where(excess <= 0, radius, low), jnp.where(excess > 0, radius, high)
        newton = radius - excess / jnp.where(slope > 0, slope, 1.0)
        return jnp.where((slope > 0) & (newton >= low) & (newton <= high), newton, (low + high) / 2), low, high

    start = jnp.minimum(distorted, reach)
    bent, slope = bend(start)
    # Where the lens magnifies much, r' grows like a power of r: one Newton step in logarithms goes almost all the way.
    above = (bent > distorted) & (slope > 0)
    power = jnp.where(above, bent / jnp.where(above, start * slope, 1.0), 0.0)
    start = start * jnp.where(above, distorted / jnp.where(above, bent, 1.0), 1.0) ** power
    bounds = jnp.zeros_like(distorted), jnp.zeros_like(distorted) + reach
    return jax.lax.fori_loop(0, _RADIAL_STEPS, step, (start, *bounds))[0]


@_undistort.defjvp
def _undistort_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    coefficients, target = primals
    ideal = _undistort(coefficients, target)
    x, y = ideal[..., 0], ideal[..., 1]
    _, (by_lens_x, by_lens_y) = jax.jvp(lambda c: _distort(c, x, y), (coefficients,), (tangents[0],))
    dx, dy = _solve(_jacobian(coefficients, x, y), tangents[1][..., 0] - by_lens_x, tangents[1][..., 1] - by_lens_y)
    valid = _reaches(coefficients, ideal, target)
    return ideal, stack_last(jnp.where(valid, dx, 0.0), jnp.where(valid, dy, 0.0))


def _reaches(
    coefficients: Float[Array, "5"], ideal: Float[Array, "*batch 2"], target: Float[Array, "*batch 2"]
) -> Bool[Array, "*batch"]:
    """Whether `ideal` lies in the range of the lens and is distorted to `target`, to rounding."""
    x, y = ideal[..., 0], ideal[..., 1]
    tx, ty = target[..., 0], target[..., 1]
    gx, gy = _distort(coefficients, x, y)
    gap = jnp.maximum(jnp.abs(gx - tx), jnp.abs(gy - ty))
    tolerance = 200 * jnp.finfo(gap.dtype).eps * (1 + jnp.abs(tx) + jnp.abs(ty))
    return (gap < tolerance) & (x * x + y * y <= _monotone_r2(coefficients))


def _solve(jacobian: tuple[Array, Array, Array], x: Array, y: Array) -> tuple[Array, Array]:
    """Solution of the symmetric 2 x 2 system; zero where it is singular or turned over."""
    xx, xy, yy = jacobian
    determinant = xx * yy - xy * xy
    regular = determinant > 1e-6
    inverse = jnp.where(regular, 1 / jnp.where(regular, determinant, 1.0), 0.0)
    return (yy * x - xy * y) * inverse, (xx * y - xy * x) * inverse
