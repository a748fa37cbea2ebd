"""Spheres: lamps, balls, heads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import AnyArray, safe_norm
from jaxpoint.geometry.line import Ray, normalised
from jaxpoint.pointing.shapes.polygon import (
    Vectors,
    View,
    across,
    angles_to,
    dot,
    flat_edges,
    polygon_masses,
    triple_product,
)
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives
from jaxpoint.pointing.shapes.shape import AbstractShape, Field, length, too_small, vector

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

    def primitives(self) -> Spheres:
        return Spheres(np.asarray(self.center, float)[None], np.array([self.radius], float))

    def fault(self) -> str | None:
        return too_small("radius", self.radius)

    def doubt(self, name: str) -> None:
        return None

    @property
    def sides(self) -> tuple[float, ...]:
        """The diameter, m."""
        return (float(2 * self.radius),)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.center - self.radius, self.center + self.radius

    @property
    def residual(self) -> float:
        return 0.0


class Spheres(AbstractPrimitives):
    """N spheres."""

    center: Float[AnyArray, "N 3"]  # m
    radius: Float[AnyArray, " N"]  # m

    most: ClassVar[int | None] = None

    def precompute(self) -> Self:
        return self

    def bounding_spheres(self) -> tuple[AnyArray, AnyArray]:
        return self.center, self.radius

    def meet(self, ray: Ray) -> tuple[Array, Array, Array]:
        along = dot(self.center, ray.direction) - dot(ray.direction[None], ray.origin)
        gap = self.center - ray.origin[None]
        inside = self.radius**2 - (jnp.sum(gap**2, axis=1) - along**2)
        meets = (inside > 0) & (self.radius > 0)
        distance = along - jnp.sqrt(jnp.where(meets, inside, 1.0))
        half = jnp.full(self.radius.shape, 0.5, distance.dtype)
        return jnp.where(meets & (distance > 0), distance, jnp.inf), half, half

    def nearest_places(self, ray: Ray) -> Vectors:
        """The middles: of what is seen of a sphere, that of its image."""
        x, y, z = (self.center[:, i] - ray.origin[i] for i in range(3))
        return x, y, z

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

    def point_distances(self, point: Array) -> Array:
        return jnp.maximum(safe_norm(self.center - point[None]) - self.radius, 0.0)

    def masses(self, view: View) -> Array:
        gaps = self.center - view.origin[None]
        gap2 = jnp.sum(gaps**2, axis=1)
        outside = (gap2 > self.radius**2) & (self.radius > 0)
        shrink = jnp.where(outside, 1 - self.radius**2 / jnp.where(outside, gap2, 1.0), 1.0)
        half_axes = jax.vmap(across)(normalised(gaps)) * (self.radius * jnp.sqrt(shrink))[:, None, None]
        circle = view.turn(gaps * shrink[:, None], half_axes[:, 0], half_axes[:, 1])  # the outline as seen
        mass = polygon_masses(*flat_edges(*circle, _CIRCLE), jnp.sign(triple_product(*circle)), view)
        return jnp.where(outside, mass, 0.0)

    def solid_angles(self, origin: Array) -> Array:
        gap2 = jnp.sum((self.center - origin[None]) ** 2, axis=1)
        outside = gap2 > self.radius**2
        cosine = jnp.sqrt(jnp.where(outside, 1 - self.radius**2 / jnp.where(outside, gap2, 1.0), 1.0))
        return jnp.where(outside, 2 * jnp.pi * (1 - cosine), 4 * jnp.pi)

    def shrink(self, about: Array, share: float) -> Self:
        return type(self)(about + share * (self.center - about), share * self.radius)

    def outlines(self) -> Float[np.ndarray, "N L n 3"]:
        """Three great circles."""
        ring = np.stack([np.cos(_RING), np.sin(_RING), 0 * _RING], axis=1)
        circles = np.stack([ring[:, order] for order in ([0, 1, 2], [0, 2, 1], [2, 0, 1])])
        center, radius = np.asarray(self.center), np.asarray(self.radius)
        return center[:, None, None] + radius[:, None, None, None] * circles[None]
