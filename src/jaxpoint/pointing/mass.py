"""How much of a line's distribution of directions falls on a face: exact along its edges, no density at its middle.

The direction's error lies in the plane across the line, gnomonic: a place X at depth z before the tip o is
y = (X - o) across the line / z. A line whose origin errs too passes X where y is its direction's error plus its
origin's over z, so every edge is made white by the covariance at the depth where it passes nearest to the line. That is
exact where the origin is sure or the face square to the line. In white coordinates the mass of a polygon is, by the
divergence theorem, a sum over its edges (h the distance of an edge's line from 0, s the place along
it, r^2 = h^2 + s^2, S(r) the probability of an error larger than r):

    mass = 1 / 2 pi  sum of  integral of  h (1 - S(r)) / r^2  ds

The integrand is smooth. For the Gaussian, S = exp(-r^2 / 2), by Gauss-Legendre where S matters; for Student's t with
nu degrees of freedom, a whole number, S = (1 + r^2 / nu)^(-nu/2), in closed form.
"""

from __future__ import annotations

import operator
from functools import reduce
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import safe_norm
from jaxpoint.geometry.line import normalised
from jaxpoint.pointing.line import PointingLine
from jaxpoint.pointing.objects import Shapes

NEAR_M = 0.005  # what lies less far before the tip is not pointed at
_REACH = 4.0  # standard deviations, beyond which a Gaussian is nothing
_NODES = 10
_SIDES = 12  # of the polygon of equal area that stands for a sphere's outline
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
Vectors: TypeAlias = tuple[Array, ...]  # three components
_RECTANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
_TURN = 2 * np.pi * np.arange(_SIDES) / _SIDES
_CIRCLE = np.sqrt(_TURN[1] / np.sin(_TURN[1])) * np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)


def across(direction: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Two unit vectors across a direction, as rows: to its left, horizontal, and up."""
    level = safe_norm(direction[:2])
    steep = level < 1e-6
    left = jnp.stack([-direction[1], direction[0], jnp.zeros_like(level)]) / jnp.where(steep, 1.0, level)
    left = jnp.where(steep, jnp.array([0.0, 1.0, 0.0], direction.dtype), left)
    return jnp.stack([left, jnp.cross(direction, left)])


def masses(
    line: PointingLine, shapes: Shapes, spread: Float[Array, "2 2"], freedom: int | None = None
) -> Float[Array, " parts"]:
    """The share of a line's distribution that falls on each face and sphere, whatever stands before it, 0..1.

    Args:
        line: one line.
        spread: covariance of the direction on top of the line's own, to its left and up, rad^2.
        freedom: None for a Gaussian; degrees of freedom (1, 2, 3, ...) for Student's t with that scale.
    """
    base = across(line.ray.direction)
    frame = jnp.concatenate([base, line.ray.direction[None]])
    white = _white(line, base, spread)
    faces = _turned(frame, shapes.corner - line.ray.origin[None], shapes.right, shapes.down)
    mass = _of_quads(faces, _RECTANGLE, white, freedom)
    mass = jnp.where(~shapes.solid | (_facing(*faces) > 0), mass, 0.0)
    if not shapes.radius.shape[0]:
        return mass
    gaps = shapes.center - line.ray.origin[None]
    center, wide, high, outside = _outlines(gaps, shapes.radius)
    outlines = _of_quads(_turned(frame, center, wide, high), _CIRCLE, white, freedom)
    return jnp.concatenate([mass, jnp.where(outside, outlines, 0.0)])


def solid_angles(origin: Float[Array, "3"], shapes: Shapes) -> Float[Array, " parts"]:
    """Of each face and sphere as seen from a place, sr; 0 for faces of a box that look away.

    After van Oosterom and Strackee, The solid angle of a plane triangle, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    a, u, v = _turned(jnp.eye(3, dtype=origin.dtype), shapes.corner - origin[None], shapes.right, shapes.down)
    b, c, d = _plus(a, u), _plus(_plus(a, u), v), _plus(a, v)
    facing = _facing(a, u, v)  # both triangles' triple product
    angle = 2 * (_half_angle(facing, a, b, c) + _half_angle(facing, a, c, d))
    angle = jnp.where(shapes.solid & (facing <= 0), 0.0, jnp.abs(angle))
    if not shapes.radius.shape[0]:
        return angle
    gap2 = jnp.sum((shapes.center - origin[None]) ** 2, axis=1)
    outside = gap2 > shapes.radius**2
    cosine = jnp.sqrt(jnp.where(outside, 1 - shapes.radius**2 / jnp.where(outside, gap2, 1.0), 1.0))
    return jnp.concatenate([angle, jnp.where(outside, 2 * jnp.pi * (1 - cosine), 4 * jnp.pi)])


def _turned(frame: Array, *vectors: Array) -> tuple[Vectors, ...]:
    """Rows in another frame, each as its three components: sums of few terms fuse, where products and stacks do not."""
    return tuple(tuple(axis[0] * v[:, 0] + axis[1] * v[:, 1] + axis[2] * v[:, 2] for axis in frame) for v in vectors)


def _plus(a: Vectors, b: Vectors) -> Vectors:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _inner(a: Vectors, b: Vectors) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _facing(corner: Vectors, right: Vectors, down: Vectors) -> Array:
    """Positive where a face's corners go around it from left to up, as seen from 0; of a box: from outside."""
    return (
        corner[0] * (right[1] * down[2] - right[2] * down[1])
        + corner[1] * (right[2] * down[0] - right[0] * down[2])
        + corner[2] * (right[0] * down[1] - right[1] * down[0])
    )


def _half_angle(top: Array, a: Vectors, b: Vectors, c: Vectors) -> Array:
    """Half the signed solid angle of triangles from 0."""
    u, v, w = (jnp.sqrt(_inner(x, x) + 1e-18) for x in (a, b, c))
    bottom = u * v * w + _inner(a, b) * w + _inner(a, c) * v + _inner(b, c) * u
    return angle(top, bottom)


def _outlines(gaps: Float[Array, "S 3"], radius: Float[Array, " S"]) -> tuple[Array, Array, Array, Array]:
    """Middles and half axes of the outlines of spheres as seen from 0, m, and whether 0 is outside."""
    gap2 = jnp.sum(gaps**2, axis=1)
    outside = (gap2 > radius**2) & (radius > 0)
    shrink = jnp.where(outside, 1 - radius**2 / jnp.where(outside, gap2, 1.0), 1.0)
    wide, high = jnp.swapaxes(jax.vmap(across)(normalised(gaps)), 0, 1) * (radius * jnp.sqrt(shrink))[None, :, None]
    return gaps * shrink[:, None], wide, high, outside


def _white(line: PointingLine, base: Array, spread: Array) -> tuple[Array, Array, Array]:
    """Covariance across the line as a polynomial of one over the depth: constant, linear and square part."""
    both = jnp.einsum("ij,ajbk,lk->aibl", base, line.covariance.reshape(2, 3, 2, 3), base)
    return both[1, :, 1] + spread, both[0, :, 1] + both[1, :, 0], both[0, :, 0]


def _of_quads(
    quads: tuple[Vectors, ...], rim: np.ndarray, covariance: tuple[Array, Array, Array], freedom: int | None
) -> Float[Array, " n"]:
    """Masses of polygons whose corners are corner + rim[i, 0] right + rim[i, 1] down, each left, up and in depth."""
    corner, right, down = quads
    start, end = (
        tuple(
            a[None] + jnp.asarray(at[:, :1]) * u[None] + jnp.asarray(at[:, 1:]) * v[None]
            for a, u, v in zip(corner, right, down)
        )
        for at in (rim, np.roll(rim, -1, axis=0))
    )
    turn = jnp.sign(_facing(corner, right, down))
    part, left = _of_edge(start, end, covariance, freedom)
    ahead = jnp.maximum(start[2], end[2]) > NEAR_M
    within = ~ahead | (left * turn[None] > 0)
    part = jnp.where(ahead, part, 0.0)
    # Sums that are written out fuse and vectorise, over an axis they do not.
    outer = reduce(operator.add, (part[i] for i in range(len(rim)))) * turn / (2 * jnp.pi)
    inside = reduce(operator.and_, (within[i] for i in range(len(rim))))
    seen = reduce(operator.or_, (ahead[i] for i in range(len(rim))))
    return jnp.clip(outer + jnp.where(inside & seen & (turn != 0), 1.0, 0.0), 0.0, 1.0)


def _of_edge(
    start: Vectors, end: Vectors, covariance: tuple[Array, Array, Array], freedom: int | None
) -> tuple[Array, Array]:
    """What edges add to masses, and the distance at which they pass 0, positive with 0 to their left."""
    (p, near_p), (q, near_q) = _projected(_clipped(start, end)), _projected(_clipped(end, start))
    edge = q[0] - p[0], q[1] - p[1]
    length2 = edge[0] ** 2 + edge[1] ** 2
    nearest = jnp.clip(-(p[0] * edge[0] + p[1] * edge[1]) / jnp.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    near = near_p + nearest * (near_q - near_p)  # of a straight line in the image one over the depth is linear
    p, q = _whitened(near, covariance, p, q)
    edge = q[0] - p[0], q[1] - p[1]
    shorten = jax.lax.rsqrt(edge[0] ** 2 + edge[1] ** 2 + 1e-24)
    unit = edge[0] * shorten, edge[1] * shorten
    h = p[0] * unit[1] - p[1] * unit[0]
    a, b = p[0] * unit[0] + p[1] * unit[1], q[0] * unit[0] + q[1] * unit[1]
    return _gaussian_edge(h, a, b) if freedom is None else _student_edge(h, a, b, freedom), h


def _clipped(point: Vectors, other: Vectors) -> Vectors:
    """A corner moved along its edge to where that comes to lie ahead."""
    rise = other[2] - point[2]
    share = jnp.clip((NEAR_M - point[2]) / jnp.where(rise == 0, 1.0, rise), 0.0, 1.0)
    share = jnp.where(point[2] < NEAR_M, share, 0.0)
    left, up, depth = (x + share * (y - x) for x, y in zip(point, other))
    return left, up, jnp.maximum(depth, NEAR_M)


def _projected(point: Vectors) -> tuple[tuple[Array, Array], Array]:
    """Tangents to the left and up, and one over the depth, 1/m."""
    near = 1 / point[2]
    return (point[0] * near, point[1] * near), near


def _whitened(
    near: Array, covariance: tuple[Array, Array, Array], *points: tuple[Array, Array]
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
