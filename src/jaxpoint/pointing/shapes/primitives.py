"""What rays meet: primitives of one sort as arrays, which all shapes of objects are made of."""

from __future__ import annotations

import abc
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.mass import NEAR_M, Edges, OutlineView, Vectors, polygon_masses
from jaxpoint.pointing.shapes.polygon import edge_angle, fan_solid_angle

_THIRDS = 64  # steps that narrow an interval to 1e-11 of its length


class AbstractPrimitives(eqx.Module):
    """N convex primitives of one sort. Every array has the leading axis N; a row of zeros is padding, never met.

    All methods but `outlines` are traced, for one ray or one line, and have derivatives by the primitives and by it.
    Nothing is raised: where the origin lies within a primitive, or behind it, values are finite and as documented.
    The methods that are not abstract hold for every convex sort; one with a closed form has its own.
    """

    most: eqx.AbstractClassVar[int | None]  # of the primitives that one line's posterior considers; None: all

    @abc.abstractmethod
    def bounding_spheres(self) -> tuple[Float[Array, "N 3"], Float[Array, " N"]]:
        """Middles and radii (m) of spheres that hold the primitives; the radius is 0 for padding only."""

    @abc.abstractmethod
    def meet(self, ray: Ray) -> tuple[Float[Array, " N"], Float[Array, " N"], Float[Array, " N"]]:
        """Distance (m) to where the ray first meets each, infinite where it does not, and two fractions, 0..1.

        The fractions are the coordinates on the surface that `Hits` reports; 1/2 where it has none.
        """

    @abc.abstractmethod
    def point_distances(self, points: Float[Array, "N 3"]) -> Float[Array, " N"]:
        """From each one's own point to it, m; 0 within."""

    @abc.abstractmethod
    def silhouettes(self, origin: Float[Array, "3"], frame: Float[Array, "3 3"] | None = None) -> Edges:
        """The outline of each as seen from a place: a polygon of as many corners for all of the sort.

        Args:
            frame: rows, the axes of the frame that the corners are in; None: those of the room.
        """

    @abc.abstractmethod
    def shrink(self, about: Float[Array, "N 3"], share: float) -> AbstractPrimitives:
        """All about points, to a share of their size."""

    @abc.abstractmethod
    def outlines(self) -> Float[np.ndarray, "N L n 3"]:
        """For drawing: L closed polygons of n corners (m) a primitive, with its extreme coordinates among them."""

    def precompute(self) -> AbstractPrimitives:
        """With what all lines share computed once, where there is such."""
        return self

    def nearest_places(self, ray: Ray) -> Vectors:
        """From the ray's origin to a place of each that lies near the ray: x, y and z (N,), m; here the middle."""
        middle, _ = self.bounding_spheres()
        x, y, z = (middle[:, i] - ray.origin[i] for i in range(3))
        return x, y, z

    def angles(self, ray: Ray) -> Float[Array, " N"]:
        """From the ray to the nearest direction of each as seen from its origin, rad, 0..pi."""
        start, _, _ = self.silhouettes(ray.origin)
        corners = jnp.stack(start, axis=-1)
        to_edges = jax.vmap(partial(edge_angle, ray.direction), in_axes=1)(corners)
        return jnp.where(jnp.isfinite(self.meet(ray)[0]), 0.0, to_edges)

    def distances(self, ray: Ray) -> Float[Array, " N"]:
        """From the half line to each, m: along it the distance is convex, so that thirds of an interval find it."""
        middle, radius = self.bounding_spheres()
        far = jnp.sqrt(jnp.sum((middle - ray.origin[None]) ** 2, axis=1)) + radius

        def near(along: Array) -> Array:
            return self.point_distances(ray.origin[None] + along[:, None] * ray.direction[None])

        def narrow(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
            a, b = (2 * ends[0] + ends[1]) / 3, (ends[0] + 2 * ends[1]) / 3
            nearer = near(a) < near(b)
            return jnp.where(nearer, ends[0], a), jnp.where(nearer, b, ends[1])

        along = jax.lax.fori_loop(0, _THIRDS, narrow, (jnp.zeros_like(far), far))[0]
        return near(jax.lax.stop_gradient(along))  # at a minimum `along` has no share in it

    def masses(self, view: OutlineView) -> Float[Array, " N"]:
        """The share of a line's distribution of directions on each, whatever stands before it, 0..1."""
        return polygon_masses(self.silhouettes(view.origin, view.frame), view)

    def solid_angles(self, origin: Float[Array, "3"]) -> Float[Array, " N"]:
        """Of each as seen from a place, sr; 0 for what looks away."""
        return fan_solid_angle(self.silhouettes(origin))

    @property
    def used(self) -> Bool[Array, " N"]:
        """Which are no padding."""
        return self.bounding_spheres()[1] > 0

    def select(self, index: Int[Array, " n"], used: Bool[Array, " n"]) -> AbstractPrimitives:
        """Some of them, and padding in the place of those that are not used."""

        def rows(leaf: Array) -> Array:
            mask = used.reshape(-1, *(1,) * (leaf.ndim - 1))
            return jnp.where(mask, leaf[index], jnp.zeros((), leaf.dtype))

        return jax.tree.map(rows, self)

    def tangent_bounds(self, origin: Float[Array, "3"], direction: Float[Array, "3"]) -> Float[Array, " N"]:
        """Less than the tangent of the angle from a ray to each, by its bounding sphere; infinite behind."""
        middle, radius = self.bounding_spheres()
        gap = tuple(middle[:, i] - origin[i] for i in range(3))
        along = gap[0] * direction[0] + gap[1] * direction[1] + gap[2] * direction[2]
        across2 = gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2 - along**2
        beside = jnp.maximum(jnp.sqrt(jnp.maximum(across2, 0.0)) - radius, 0.0)
        ahead = (along + radius > NEAR_M) & (radius > 0)
        # Where a ray passes through many of the spheres, those whose middle is nearest come first.
        order = 1e-6 * across2 / jnp.where(ahead, along + radius, 1.0) ** 2
        return jnp.where(ahead, beside / jnp.where(ahead, along + radius, 1.0) + order, jnp.inf)
