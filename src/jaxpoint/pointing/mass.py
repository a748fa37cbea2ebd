"""How much of a line's distribution of directions falls on a polygon: exact along its edges, no density at its middle.

The direction's error lies in the plane across the line, gnomonic: a place X at depth z before the tip o is
y = (X - o) across the line / z. A line whose origin errs too passes X where y is its direction's error plus its
origin's over z, so every edge is whitened by the covariance at the depth where it passes nearest to the line. That is
exact where the origin is sure or the polygon square to the line. In whitened coordinates the mass of a polygon is, by
the divergence theorem, a sum over its edges (h the distance of an edge's line from 0, s the place along
it, r^2 = h^2 + s^2, S(r) the probability of an error larger than r):

    mass = 1 / 2 pi  sum of  integral of  h (1 - S(r)) / r^2  ds

The integrand is smooth. For the Gaussian, S = exp(-r^2 / 2), by Gauss-Legendre where S matters; for Student's t with
nu degrees of freedom, a whole number, S = (1 + r^2 / nu)^(-nu/2), in closed form.
"""

from __future__ import annotations

import operator
from functools import reduce
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import safe_norm
from jaxpoint.pointing.pointing_line import PointingLine

NEAR_M = 0.005  # nothing nearer before the tip is pointed at
_REACH = 4.0  # standard deviations, beyond which a Gaussian has no mass
_NODES = 10
_ARCTAN = (
    0.0028662257,
    -0.0161657367,
    0.0429096138,
    -0.0752896400,
    0.1065626393,
    -0.1420889944,
    0.1999355085,
    -0.3333314528,
    1.0,
)
Vectors: TypeAlias = tuple[Array, Array, Array]  # rows, by component: sums of few terms fuse
# Of N polygons, convex as seen from 0, the starts and ends of their n edges (n, N), and how they turn (N,): 1 where the
# corners go from left to up around the polygon, -1 the other way, 0 where it is not seen.
Edges: TypeAlias = tuple[Vectors, Vectors, Array]


def across(direction: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Two unit vectors across a direction, as rows: to its left, horizontal, and up."""
    level = safe_norm(direction[:2])
    steep = level < 1e-6
    left = jnp.stack([-direction[1], direction[0], jnp.zeros_like(level)]) / jnp.where(steep, 1.0, level)
    left = jnp.where(steep, jnp.array([0.0, 1.0, 0.0], direction.dtype), left)
    return jnp.stack([left, jnp.cross(direction, left)])


class OutlineView(eqx.Module):
    """The distribution of one line's direction, as masses take it: a density in the plane across the line."""

    origin: Float[Array, "3"]  # m
    frame: Float[Array, "3 3"]  # rows: to the left of the line, up, and along it
    covariance: tuple[Float[Array, "2 2"], ...]  # of left and up: constant, linear, square part in 1 / depth
    freedom: int | None = eqx.field(static=True)  # of Student's t; None: Gaussian

    @staticmethod
    def of(line: PointingLine, spread: Float[Array, "2 2"], freedom: int | None = None) -> OutlineView:
        """Of one line.

        Args:
            spread: covariance of the direction on top of the line's own, to its left and up, rad^2.
            freedom: None for a Gaussian; degrees of freedom (1, 2, 3, ...) of Student's t with that scale.
        """
        base = across(line.ray.direction)
        both = jnp.einsum("ij,ajbk,lk->aibl", base, line.covariance.reshape(2, 3, 2, 3), base)
        covariance = both[1, :, 1] + spread, both[0, :, 1] + both[1, :, 0], both[0, :, 0]
        return OutlineView(line.ray.origin, jnp.concatenate([base, line.ray.direction[None]]), covariance, freedom)


def polygon_masses(edges: Edges, view: OutlineView) -> Float[Array, " N"]:
    """Masses of N polygons in the line's frame, m from its origin."""
    start, end, turn = edges
    part, left = _of_edge(start, end, view.covariance, view.freedom)
    ahead = jnp.maximum(start[2], end[2]) > NEAR_M
    within = ~ahead | (left * turn[None] > 0)
    part = jnp.where(ahead, part, 0.0)
    # Sums that are written out fuse and vectorise, over an axis they do not.
    each = range(len(part))
    outer = reduce(operator.add, (part[i] for i in each)) * turn / (2 * jnp.pi)
    inside = reduce(operator.and_, (within[i] for i in each))
    seen = reduce(operator.or_, (ahead[i] for i in each))
    return jnp.clip(outer + jnp.where(inside & seen & (turn != 0), 1.0, 0.0), 0.0, 1.0)


def _of_edge(start: Vectors, end: Vectors, covariance: tuple[Array, ...], freedom: int | None) -> tuple[Array, Array]:
    """What edges add to masses, and the distance at which they pass 0, positive with 0 to their left."""
    (p, near_p), (q, near_q) = _project(_clip(start, end)), _project(_clip(end, start))
    edge = q[0] - p[0], q[1] - p[1]
    length2 = edge[0] ** 2 + edge[1] ** 2
    nearest = jnp.clip(-(p[0] * edge[0] + p[1] * edge[1]) / jnp.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    near = near_p + nearest * (near_q - near_p)  # of a straight line in the image one over the depth is linear
    p, q = _whiten(near, covariance, p, q)
    edge = q[0] - p[0], q[1] - p[1]
    shorten = jax.lax.rsqrt(edge[0] ** 2 + edge[1] ** 2 + 1e-24)
    unit = edge[0] * shorten, edge[1] * shorten
    h = p[0] * unit[1] - p[1] * unit[0]
    a, b = p[0] * unit[0] + p[1] * unit[1], q[0] * unit[0] + q[1] * unit[1]
    return _gaussian_edge(h, a, b) if freedom is None else _student_edge(h, a, b, freedom), h


def _clip(point: Vectors, other: Vectors) -> Vectors:
    """A corner moved along its edge to where that comes to lie ahead."""
    rise = other[2] - point[2]
    share = jnp.clip((NEAR_M - point[2]) / jnp.where(rise == 0, 1.0, rise), 0.0, 1.0)
    share = jnp.where(point[2] < NEAR_M, share, 0.0)
    left, up, depth = (x + share * (y - x) for x, y in zip(point, other))
    return left, up, jnp.maximum(depth, NEAR_M)


def _project(point: Vectors) -> tuple[tuple[Array, Array], Array]:
    """Tangents to the left and up, and one over the depth, 1/m."""
    near = 1 / point[2]
    return (point[0] * near, point[1] * near), near


def _whiten(
    near: Array, covariance: tuple[Array, ...], *points: tuple[Array, Array]
) -> tuple[tuple[Array, Array], ...]:
    """Tangents in standard deviations, of what lies at one over the depth."""
    constant, linear, square = covariance
    xx, xy, yy = (constant[i] + near * (linear[i] + near * square[i]) for i in ((0, 0), (0, 1), (1, 1)))
    first = jax.lax.rsqrt(xx)
    mixed = xy * first
    second = jax.lax.rsqrt(yy - mixed**2)
    return tuple((x * first, (y - mixed * (x * first)) * second) for x, y in points)


def _gaussian_edge(h: Array, a: Array, b: Array) -> Array:
    """Flux through edges less the angles under which they are seen, where the Gaussian is something."""
    a, b = jnp.clip(a, -_REACH, _REACH), jnp.clip(b, -_REACH, _REACH)
    middle, half = (a + b) / 2, (b - a) / 2
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    flux = jnp.zeros_like(h)
    for node, weight in zip(nodes, weights):
        r2 = h**2 + (middle + node * half) ** 2 + 1e-9
        flux += weight * (1 - jnp.exp(-r2 / 2)) / r2
    return h * half * flux - _subtended(h, a, b)


def _student_edge(h: Array, a: Array, b: Array, freedom: int) -> Array:
    """The same for Student's t, by the integral over each term of (1 - S) / r^2.

    With q = nu / (nu + r^2), S = q^(nu/2). Of an even nu (1 - S) / r^2 is the sum over j of nu^(j-1) / (nu + r^2)^j up
    to half of nu; of an odd one it is (1 - sqrt q) / r^2 and sqrt q times that sum up to half of nu - 1. The first term
    of the odd ones and what is subtended are the angle under which the edge of a gnomonic image is seen.
    """
    square = h**2 + freedom
    at_a, at_b = 1 / (square + a**2), 1 / (square + b**2)
    if freedom % 2:
        power_a, power_b = a * jnp.sqrt(freedom * at_a), b * jnp.sqrt(freedom * at_b)
        flux, term, factor, outer = jnp.zeros_like(h), 0.0, 1 / freedom, _subtended(h, power_a, power_b)
    else:
        root = jnp.sqrt(square)
        power_a, power_b = a * at_a, b * at_b
        flux = term = angle((b - a) * root, square + a * b) / root  # of 1 / (nu + r^2)
        factor, outer = 1.0, _subtended(h, a, b)
    for power in range(2 - freedom % 2, freedom - 1, 2):  # twice that of 1 / (nu + r^2)
        term = (power_b - power_a + (power - 1) * term) / (power * square)
        factor *= freedom
        flux += factor * term
        power_a, power_b = power_a * at_a, power_b * at_b
    return h * flux - outer


def _subtended(h: Array, a: Array, b: Array) -> Array:
    """The angle under which edges are seen from 0, rad, positive with 0 to their left."""
    return angle(h * (b - a), h**2 + a * b)


@jax.custom_jvp
def angle(top: Array, bottom: Array) -> Array:
    """`arctan2` to 1e-8 rad, 0 where both are 0: XLA's own takes most of the time that a mass takes.

    The polynomial is 4.4.49 of Abramowitz and Stegun, Handbook of Mathematical Functions. The derivative is in closed
    form: it is quick to compile, and of the transpose of what stands below XLA makes wrong numbers (jaxlib 0.10, CPU,
    its default options).
    """
    x, y = jnp.abs(bottom), jnp.abs(top)
    high = jnp.maximum(x, y)
    ratio = jnp.minimum(x, y) / jnp.where(high > 0, high, 1.0)
    square = ratio**2
    series = jnp.zeros_like(ratio)
    for coefficient in _ARCTAN:
        series = series * square + coefficient
    angle = ratio * series
    angle = jnp.where(y > x, np.pi / 2 - angle, angle)
    angle = jnp.where(bottom < 0, np.pi - angle, angle)
    return jnp.where(top < 0, -angle, angle)


@angle.defjvp
def _angle_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (top, bottom), (top_change, bottom_change) = primals, tangents
    square = top**2 + bottom**2
    away = square > 0
    inverse = jnp.where(away, 1 / jnp.where(away, square, 1.0), 0.0)
    return angle(top, bottom), (bottom * inverse) * top_change - (top * inverse) * bottom_change
