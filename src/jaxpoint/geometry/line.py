"""Rays and the lines that they lie on."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint, safe_norm

_PARALLEL = 1e-9  # sine of the angle below which two lines count as parallel


class Ray(eqx.Module):
    """A half line; the functions of this module that say "line" take its whole line.

    Fields may carry leading axes of equal shape.
    """

    origin: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m
    direction: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # unit length

    __hash__ = hash_or_hint

    @staticmethod
    def through(start: Float[AnyArray, "*batch 3"], target: Float[AnyArray, "*batch 3"]) -> Ray:
        """The ray from `start` through `target`; its direction is zero where the two coincide."""
        start = as_float(start)
        return Ray(start, normalise(as_float(target) - start))

    def at(self, distance: Float[AnyArray, "*batch"] | float) -> Float[Array, "*batch 3"]:
        """The point at a distance (m) from the origin; negative is behind it."""
        return self.origin + as_float(distance)[..., None] * self.direction


def normalise(vectors: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Vectors scaled to length 1; a zero vector stays zero."""
    vectors = as_float(vectors)
    length = safe_norm(vectors)[..., None]
    return vectors / jnp.where(length > 0, length, 1.0)


def angle_between(a: Float[AnyArray, "*batch 3"], b: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
    """Angle between two vectors, rad, 0..pi; accurate for tiny angles, gradient 0 where they are parallel."""
    a, b = as_float(a), as_float(b)
    return jnp.arctan2(safe_norm(jnp.cross(a, b)), jnp.sum(a * b, axis=-1))


def nearest_on_line(line: Ray, point: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """The foot of the perpendicular from a point onto a line."""
    return line.at(jnp.sum((as_float(point) - line.origin) * line.direction, axis=-1))


def distance_to_point(line: Ray, point: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
    """Perpendicular distance of a point from a line, m."""
    return safe_norm(jnp.cross(line.direction, as_float(point) - line.origin))


def closest_points(a: Ray, b: Ray) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
    """The point of each line that is nearest to the other, and whether the lines are parallel.

    Parallel lines have no single nearest pair: the origin of `a` and its foot on `b` are given.
    """
    gap = b.origin - a.origin
    cosine = jnp.sum(a.direction * b.direction, axis=-1)
    normal = jnp.cross(a.direction, b.direction)
    sine2 = jnp.sum(normal**2, axis=-1)
    parallel = sine2 < _PARALLEL**2
    along_a = jnp.sum(gap * a.direction, axis=-1)
    along_b = jnp.sum(gap * b.direction, axis=-1)
    distance_a = jnp.where(parallel, 0.0, (along_a - cosine * along_b) / jnp.where(parallel, 1.0, sine2))
    on_a = a.at(distance_a)
    return on_a, nearest_on_line(b, on_a), parallel


def distance_between(a: Ray, b: Ray) -> Float[Array, "*batch"]:
    """Shortest distance between two lines, m."""
    on_a, on_b, _ = closest_points(a, b)
    return safe_norm(on_a - on_b)
