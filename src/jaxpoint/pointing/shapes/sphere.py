"""Spheres: lamps, balls, heads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import safe_norm
from jaxpoint.geometry.line import Ray, normalise
from jaxpoint.geometry.world_axes import World
from jaxpoint.pointing.mass import Edges, across
from jaxpoint.pointing.shapes.polygon import angles_to, dot, flat_edges, in_frame, triple_product
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives
from jaxpoint.pointing.shapes.shape import AbstractShape, Field, Rows, length, too_small, vector

_SIDES = 12  # of the polygon of equal area that stands for a sphere's outline
_TURN = 2 * np.pi * np.arange(_SIDES) / _SIDES
_CIRCLE = np.sqrt(_TURN[1] / np.sin(_TURN[1])) * np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
_RING = 2 * np.pi * np.arange(24) / 24  # of a circle as drawn: a multiple of 4, so that it reaches all extremes


@dataclass(frozen=True)
class Sphere(AbstractShape):
    """A sphere, met from outside."""

    center: Float[np.ndarray, "3"]  # m
    radius: float  # m

    name: ClassVar[str] = "sphere"
    fields: ClassVar[tuple[Field, ...]] = (vector("center"), length("radius"))

    def primitives(self) -> Rows:
        return Spheres, (np.asarray(self.center, float)[None], np.array([self.radius], float))

    def to_room(self, world: World) -> Sphere:
        return Sphere(world.to_room(self.center), self.radius)

    def fault(self) -> str | None:
        return too_small("radius", self.radius)

    @property
    def sides(self) -> tuple[float, ...]:
        """The diameter, m."""
        return (float(2 * self.radius),)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.center - self.radius, self.center + self.radius


class Spheres(AbstractPrimitives):
    """N spheres."""

    center: Float[Array, "N 3"]  # m
    radius: Float[Array, " N"]  # m

    most: ClassVar[int | None] = None

    def bounding_spheres(self) -> tuple[Array, Array]:
        return self.center, self.radius

    def meet(self, ray: Ray) -> tuple[Array, Array, Array]:
        along = dot(self.center, ray.direction) - dot(ray.direction[None], ray.origin)
        gap = self.center - ray.origin[None]
        inside = self.radius**2 - (jnp.sum(gap**2, axis=1) - along**2)
        meets = (inside > 0) & (self.radius > 0)
        distance = along - jnp.sqrt(jnp.where(meets, inside, 1.0))
        half = jnp.full(self.radius.shape, 0.5, distance.dtype)
        return jnp.where(meets & (distance > 0), distance, jnp.inf), half, half

    def angles(self, ray: Ray) -> Array:
        gap = self.center - ray.origin[None]
        far = safe_norm(gap)
        away = far > self.radius
        half = jnp.arcsin(jnp.where(away, self.radius / jnp.where(away, far, 1.0), 1.0))
        return jnp.where(away, jnp.maximum(angles_to(ray.direction, gap) - half, 0.0), 0.0)

    def distances(self, ray: Ray) -> Array:
        gap = self.center - ray.origin[None]
        along = jnp.maximum(gap @ ray.direction, 0.0)
        return jnp.maximum(safe_norm(gap - along[:, None] * ray.direction[None]) - self.radius, 0.0)

    def point_distances(self, points: Array) -> Array:
        return jnp.maximum(safe_norm(self.center - points) - self.radius, 0.0)

    def silhouettes(self, origin: Array, frame: Array | None = None) -> Edges:
        """A polygon of the area of the circle as which each is seen; none from within."""
        gaps = self.center - origin[None]
        gap2 = jnp.sum(gaps**2, axis=1)
        outside = (gap2 > self.radius**2) & (self.radius > 0)
        shrink = jnp.where(outside, 1 - self.radius**2 / jnp.where(outside, gap2, 1.0), 1.0)
        half_axes = jax.vmap(across)(normalise(gaps)) * (self.radius * jnp.sqrt(shrink))[:, None, None]
        circle = gaps * shrink[:, None], half_axes[:, 0], half_axes[:, 1]  # which lies before the middle
        middle, left, up = (in_frame(frame, v) for v in circle)
        turn = jnp.where(outside, jnp.sign(triple_product(middle, left, up)), 0.0)
        return (*flat_edges(middle, left, up, _CIRCLE), turn)

    def solid_angles(self, origin: Array) -> Array:
        gap2 = jnp.sum((self.center - origin[None]) ** 2, axis=1)
        outside = gap2 > self.radius**2
        cosine = jnp.sqrt(jnp.where(outside, 1 - self.radius**2 / jnp.where(outside, gap2, 1.0), 1.0))
        return jnp.where(outside, 2 * jnp.pi * (1 - cosine), 4 * jnp.pi)

    def shrink(self, about: Array, share: float) -> Spheres:
        return Spheres(about + share * (self.center - about), share * self.radius)

    def outlines(self) -> Float[np.ndarray, "N L n 3"]:
        """Three great circles."""
        ring = np.stack([np.cos(_RING), np.sin(_RING), 0 * _RING], axis=1)
        circles = np.stack([ring[:, order] for order in ([0, 1, 2], [0, 2, 1], [2, 0, 1])])
        center, radius = np.asarray(self.center), np.asarray(self.radius)
        return center[:, None, None] + radius[:, None, None, None] * circles[None]
