"""How much of a line's distribution of directions falls on a face: exact along its edges, no density at its middle.

The direction's error lies in the plane across the line, gnomonic: a place X at depth z before the tip o is
y = (X - o) across the line / z. A line whose origin errs too passes X where y is its direction's error plus its
origin's over z, so every corner is made white by the covariance of its own depth. In white coordinates the mass of a
polygon is, by the divergence theorem, a sum over its edges (h the distance of an edge's line from 0, s the place along
it, r^2 = h^2 + s^2, S(r) the probability of an error larger than r):

    mass = 1 / 2 pi  sum of  integral of  h (1 - S(r)) / r^2  ds

The integrand is smooth. For the Gaussian, S = exp(-r^2 / 2), by Gauss-Legendre where S matters; for Student's t with
an even number of degrees of freedom, S = (1 + r^2 / nu)^(-nu/2), in closed form.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import safe_norm
from jaxpoint.geometry.line import normalised
from jaxpoint.pointing.line import PointingLine
from jaxpoint.pointing.objects import Shapes, face_corners

NEAR_M = 0.05  # what lies less far before the tip is not pointed at
_REACH = 4.0  # standard deviations, beyond which a Gaussian is nothing
_NODES = 10
_SPHERE_QUADS = 5  # a sphere's outline is a polygon of 2 n + 2 corners and the same area


def across(direction: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Two unit vectors across a direction, as rows: to its left, horizontal, and up."""
    level = safe_norm(direction[:2])
    steep = level < 1e-6
    left = jnp.stack([-direction[1], direction[0], jnp.zeros_like(level)]) / jnp.where(steep, 1.0, level)
    left = jnp.where(steep, jnp.array([0.0, 1.0, 0.0], direction.dtype), left)
    return jnp.stack([left, jnp.cross(direction, left)])


def masses(
    line: PointingLine, shapes: Shapes, spread: Float[Array, "2 2"], freedom: int | None = None
) -> Float[Array, " F+S"]:
    """The share of a line's distribution that falls on each face and sphere, whatever stands before it, 0..1.

    Args:
        line: one line.
        spread: covariance of the direction on top of the line's own, to its left and up, rad^2.
        freedom: None for a Gaussian; an even number of degrees of freedom for Student's t with that scale.
    """
    origin, base = line.ray.origin, across(line.ray.direction)
    corners = jnp.moveaxis(face_corners(shapes, origin), 0, 2)
    seen = ~shapes.solid | (_facing(corners) > 0)
    if shapes.radius.shape[0]:
        quads, visible = _outlines(shapes.center - origin[None], shapes.radius)
        corners, seen = jnp.concatenate([corners, quads], axis=2), jnp.concatenate([seen, visible])
    frame = jnp.concatenate([base, line.ray.direction[None]])
    local = jnp.einsum("ij,cjf->icf", frame, corners)
    mass = jnp.where(seen, _of_quads(local, _facing(corners), _white(line, base, spread), freedom), 0.0)
    faces = shapes.corner.shape[0]
    return jnp.concatenate([mass[:faces], jnp.sum(mass[faces:].reshape(_SPHERE_QUADS, -1), axis=0)])


def solid_angles(origin: Float[Array, "3"], shapes: Shapes) -> Float[Array, " F+S"]:
    """Of each face and sphere as seen from a place, sr; 0 for faces of a box that look away.

    After van Oosterom and Strackee, The solid angle of a plane triangle, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    corners = jnp.moveaxis(face_corners(shapes, origin), 0, 2)
    a, b, c, d = corners
    angle = jnp.abs(_triangle(a, b, c) + _triangle(a, c, d))
    gap2 = jnp.sum((shapes.center - origin[None]) ** 2, axis=1)
    outside = gap2 > shapes.radius**2
    cosine = jnp.sqrt(jnp.where(outside, 1 - shapes.radius**2 / jnp.where(outside, gap2, 1.0), 1.0))
    of_spheres = jnp.where(outside, 2 * jnp.pi * (1 - cosine), 4 * jnp.pi)
    return jnp.concatenate([jnp.where(shapes.solid & (_facing(corners) <= 0), 0.0, angle), of_spheres])


def _triangle(a: Array, b: Array, c: Array) -> Array:
    """Signed solid angle of triangles from 0; vectors along the first axis."""
    u, v, w = (safe_norm(x.T) for x in (a, b, c))
    top = jnp.sum(a * jnp.cross(b, c, axis=0), axis=0)
    bottom = u * v * w + jnp.sum(a * b, axis=0) * w + jnp.sum(a * c, axis=0) * v + jnp.sum(b * c, axis=0) * u
    zero = (top == 0) & (bottom == 0)
    return 2 * jnp.arctan2(top, jnp.where(zero, 1.0, bottom))


def _facing(corners: Float[Array, "4 3 n"]) -> Float[Array, " n"]:
    """Positive where the corners of a face go around it from left to up, as seen from 0."""
    right, down = corners[1] - corners[0], corners[3] - corners[0]
    return jnp.sum(corners[0] * jnp.cross(right, down, axis=0), axis=0)


def _outlines(gaps: Float[Array, "S 3"], radius: Float[Array, " S"]) -> tuple[Array, Array]:
    """Four-cornered slices of the outlines of spheres as seen from 0, slice by slice, and whether 0 is outside."""
    gap2 = jnp.sum(gaps**2, axis=1)
    outside = (gap2 > radius**2) & (radius > 0)
    shrink = jnp.where(outside, 1 - radius**2 / jnp.where(outside, gap2, 1.0), 1.0)
    sides = 2 * _SPHERE_QUADS + 2
    turn = 2 * np.pi * np.arange(sides) / sides
    equal = np.sqrt(turn[1] / np.sin(turn[1]))  # the polygon has the circle's area
    wide, high = (
        jnp.swapaxes(jax.vmap(across)(normalised(gaps)), 0, 1) * (equal * radius * jnp.sqrt(shrink))[None, :, None]
    )
    rim = (gaps * shrink[:, None])[None] + sum(
        jnp.asarray(f(turn))[:, None, None] * side[None] for f, side in ((np.cos, wide), (np.sin, high))
    )
    slices = [jnp.stack([rim[i], rim[i + 1], rim[sides - 2 - i], rim[sides - 1 - i]]) for i in range(_SPHERE_QUADS)]
    return jnp.moveaxis(jnp.concatenate(slices, axis=1), 1, 2), jnp.tile(outside, _SPHERE_QUADS)


def _white(line: PointingLine, base: Array, spread: Array) -> tuple[Array, Array, Array]:
    """Covariance across the line as a polynomial of one over the depth: constant, linear and square part."""
    both = jnp.einsum("ij,ajbk,lk->aibl", base, line.covariance.reshape(2, 3, 2, 3), base)
    return both[1, :, 1] + spread, both[0, :, 1] + both[1, :, 0], both[0, :, 0]


def _of_quads(
    local: Float[Array, "3 4 n"],
    facing: Float[Array, " n"],
    covariance: tuple[Array, Array, Array],
    freedom: int | None,
) -> Float[Array, " n"]:
    """Masses of quadrilaterals given by left, up and depth of their corners."""
    start = local
    end = jnp.roll(local, -1, axis=1)
    (start, end), ahead = _clipped(start, end), jnp.maximum(start[2], end[2]) > NEAR_M
    p, q = _whitened(start, covariance), _whitened(end, covariance)
    edge = q - p
    length = jnp.sqrt(jnp.sum(edge**2, axis=0) + 1e-18)
    unit = edge / length[None]
    h = p[0] * unit[1] - p[1] * unit[0]
    a, b = jnp.sum(p * unit, axis=0), jnp.sum(q * unit, axis=0)
    part = _gaussian_edge(h, a, b) if freedom is None else _student_edge(h, a, b, freedom)
    turn = jnp.sign(facing)
    inside = jnp.all(~ahead | (h * turn[None] > 0), axis=0) & jnp.any(ahead, axis=0)
    outer = jnp.sum(jnp.where(ahead, part, 0.0), axis=0) * turn / (2 * jnp.pi)
    return jnp.clip(outer + jnp.where(inside, 1.0, 0.0), 0.0, 1.0)


def _clipped(start: Array, end: Array) -> tuple[Array, Array]:
    """Edges without what lies nearer than NEAR_M, or behind."""
    rise = end[2] - start[2]
    share = (NEAR_M - start[2]) / jnp.where(rise == 0, 1.0, rise)
    cut = start + jnp.clip(share, 0.0, 1.0)[None] * (end - start)
    return tuple(jnp.where(point[2] < NEAR_M, cut.at[2].set(NEAR_M), point) for point in (start, end))


def _whitened(points: Array, covariance: tuple[Array, Array, Array]) -> Array:
    """Directions in standard deviations of their own depth."""
    constant, linear, square = covariance
    near = 1 / points[2]
    xx, xy, yy = (constant[i] + near * (linear[i] + near * square[i]) for i in ((0, 0), (0, 1), (1, 1)))
    first = jax.lax.rsqrt(xx)
    mixed = xy * first
    x = points[0] * near * first
    return jnp.stack([x, (points[1] * near - mixed * x) * jax.lax.rsqrt(yy - mixed**2)])


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
    """The same for Student's t: (1 - S) / r^2 is the sum over j of nu^(j-1) / (nu + r^2)^j up to half of nu."""
    square = h**2 + freedom
    root = jnp.sqrt(square)
    integral = jnp.arctan2((b - a) * root, square + a * b) / root  # of 1 / (nu + r^2)
    at_a, at_b = 1 / (square + a**2), 1 / (square + b**2)
    flux, factor, power_a, power_b = integral, 1.0, a * at_a, b * at_b
    for j in range(1, freedom // 2):
        integral = (power_b - power_a + (2 * j - 1) * integral) / (2 * j * square)
        factor *= freedom
        flux += factor * integral
        power_a, power_b = power_a * at_a, power_b * at_b
    return h * flux - _subtended(h, a, b)


def _subtended(h: Array, a: Array, b: Array) -> Array:
    top, bottom = h * (b - a), h**2 + a * b
    return jnp.arctan2(top, jnp.where((top == 0) & (bottom == 0), 1.0, bottom))
