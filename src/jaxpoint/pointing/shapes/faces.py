"""Flat faces: parallelograms, of which rectangles have one and boxes six."""

from __future__ import annotations

from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.geometry.arrays import safe_norm
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.mass import Edges, Vectors
from jaxpoint.pointing.shapes.polygon import dot, edge_angle, flat_edges, in_frame, triple_product
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives

_PARALLEL = 1e-9  # sine of the angle below which a ray does not meet a face
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])  # in sides, around the face


class _Planes(eqx.Module):
    """What rays that meet faces have in common: of each face its unit normal and the dual base of its sides.

    The products of a point with the dual base, less those of the corner, are its fractions of the sides.
    """

    normal: Float[Array, "N 3"]
    right: Float[Array, "N 3"]  # 1/m
    down: Float[Array, "N 3"]  # 1/m
    offset: Float[Array, "N 3"]  # products of these three with the corner; m, 1, 1
    used: Bool[Array, " N"]  # whether the face has a size


class Faces(AbstractPrimitives):
    """N parallelograms. Those of a solid are met from outside only: from where their corners are in order."""

    corner: Float[Array, "N 3"]  # m, left-top
    right: Float[Array, "N 3"]  # m, from left-top to right-top
    down: Float[Array, "N 3"]  # m, from left-top to left-bottom
    solid: Bool[Array, " N"]
    planes: _Planes | None = None  # as `precompute` leaves them

    most: ClassVar[int | None] = 16

    def precompute(self) -> Faces:
        return eqx.tree_at(lambda own: own.planes, self, self._planes(), is_leaf=lambda leaf: leaf is None)

    def bounding_spheres(self) -> tuple[Array, Array]:
        middle = self.corner + (self.right + self.down) / 2
        side2, down2 = jnp.sum(self.right**2, axis=1), jnp.sum(self.down**2, axis=1)
        return middle, jnp.sqrt(side2 + down2 + 2 * jnp.abs(jnp.sum(self.right * self.down, axis=1))) / 2

    def meet(self, ray: Ray) -> tuple[Array, Array, Array]:
        distance, u, v, ahead, front = _meet_planes(self._planes(), ray)
        hit = ahead & (~self.solid | front) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        return jnp.where(hit, distance, jnp.inf), u, v

    def nearest_places(self, ray: Ray) -> Vectors:
        """Where the ray meets each face's plane, held within the face; the middle where it does not meet the plane."""
        _, u, v, ahead, _ = _meet_planes(self._planes(), ray)
        u, v = (jnp.where(ahead, jnp.clip(part, 0.02, 0.98), 0.5) for part in (u, v))
        x, y, z = (self.corner[:, i] + u * self.right[:, i] + v * self.down[:, i] - ray.origin[i] for i in range(3))
        return x, y, z

    def angles(self, ray: Ray) -> Array:
        return jax.vmap(partial(_angle_to_face, ray.direction))(self._corners(ray.origin[None]))

    def distances(self, ray: Ray) -> Array:
        return jax.vmap(partial(_distance_to_face, ray.direction))(self._corners(ray.origin[None]))

    def point_distances(self, points: Array) -> Array:
        return jax.vmap(_point_to_face)(self._corners(points))

    def silhouettes(self, origin: Array, frame: Array | None = None) -> Edges:
        corner, right, down = (in_frame(frame, v) for v in (self.corner - origin[None], self.right, self.down))
        facing = triple_product(corner, right, down)
        seen = ~self.solid | (facing > 0)
        return (*flat_edges(corner, right, down, _CORNERS), jnp.where(seen, jnp.sign(facing), 0.0))

    def shrink(self, about: Array, share: float) -> Faces:
        corner = about + share * (self.corner - about)
        return Faces(corner, share * self.right, share * self.down, self.solid)

    def outlines(self) -> Float[np.ndarray, "N L n 3"]:
        a, u, v = (np.asarray(part) for part in (self.corner, self.right, self.down))
        return np.stack([a, a + u, a + u + v, a + v], axis=1)[:, None]

    def _corners(self, origins: Float[Array, "#N 3"]) -> Float[Array, "N 4 3"]:
        """Around each face, from a place (or one for each), m."""
        a, u, v = self.corner - origins, self.right, self.down
        return jnp.stack([a, a + u, a + u + v, a + v], axis=1)

    def _planes(self) -> _Planes:
        if self.planes is not None:
            return self.planes
        corner, right, down = self.corner, self.right, self.down
        normal = jnp.cross(down, right)
        area2 = jnp.sum(normal**2, axis=1)
        used = area2 > 0
        safe = jnp.where(used, area2, 1.0)[:, None]
        parts = normal / jnp.sqrt(safe), jnp.cross(normal, down) / safe, jnp.cross(right, normal) / safe
        return _Planes(*parts, jnp.stack([jnp.sum(part * corner, axis=1) for part in parts], axis=1), used)


def _meet_planes(planes: _Planes, ray: Ray) -> tuple[Array, Array, Array, Array, Array]:
    """Where a ray meets planes: distance (m), fractions of the sides, whether it does so ahead, and from the front."""
    closing = dot(planes.normal, ray.direction)
    parallel = jnp.abs(closing) < _PARALLEL
    distance = (planes.offset[:, 0] - dot(planes.normal, ray.origin)) / jnp.where(parallel, 1.0, closing)
    u, v = (
        dot(dual, ray.origin) - planes.offset[:, i] + distance * dot(dual, ray.direction)
        for i, dual in ((1, planes.right), (2, planes.down))
    )
    return distance, u, v, planes.used & ~parallel & (distance > 0), closing < 0


def _angle_to_face(direction: Array, corners: Float[Array, "4 3"]) -> Float[Array, ""]:
    """The cone about the ray that opens until it meets a face meets an edge first, where the ray misses the face."""
    return jnp.where(_meets(direction, corners), 0.0, edge_angle(direction, corners))


def _meets(direction: Array, corners: Float[Array, "4 3"]) -> Bool[Array, ""]:
    """Whether the ray from 0 goes through a parallelogram: all corners turn about it the same way, and it is ahead."""
    turns = jnp.sum(jnp.cross(corners, jnp.roll(corners, -1, axis=0)) * direction[None], axis=1)
    normal = jnp.cross(corners[1] - corners[0], corners[3] - corners[0])
    facing = normal @ corners[0]
    ahead = (normal @ direction) * facing > 0
    return ahead & (jnp.all(turns > 0) | jnp.all(turns < 0))


def _distance_to_face(direction: Array, corners: Float[Array, "4 3"]) -> Float[Array, ""]:
    """From the half line from 0; the nearest points lie on an edge, or one is the origin."""
    edges = jnp.roll(corners, -1, axis=0) - corners
    a, e = corners @ direction, edges @ direction
    ae, ee = jnp.sum(corners * edges, axis=1), jnp.sum(edges**2, axis=1)
    bottom = ee - e**2
    parallel = bottom <= 1e-12 * ee
    free = jnp.clip((a * e - ae) / jnp.where(parallel, 1.0, bottom), 0.0, 1.0)
    candidates = jnp.concatenate([corners, corners + free[:, None] * edges])
    along = jnp.maximum(candidates @ direction, 0.0)
    across = safe_norm(candidates - along[:, None] * direction[None])
    return jnp.where(_meets(direction, corners), 0.0, jnp.minimum(jnp.min(across), _point_to_face(corners)))


def _point_to_face(corners: Float[Array, "4 3"]) -> Float[Array, ""]:
    """From 0."""
    edges = jnp.roll(corners, -1, axis=0) - corners
    ee = jnp.sum(edges**2, axis=1)
    s = jnp.clip(-jnp.sum(corners * edges, axis=1) / jnp.where(ee > 0, ee, 1.0), 0.0, 1.0)
    to_edges = jnp.min(safe_norm(corners + s[:, None] * edges))
    normal = jnp.cross(edges[0], edges[1])
    area2 = normal @ normal
    unit = normal / jnp.sqrt(jnp.where(area2 > 0, area2, 1.0))
    height = unit @ corners[0]
    turns = jnp.sum(jnp.cross(corners, edges) * normal[None], axis=1)  # of the foot, about which the corners go
    return jnp.where((area2 > 0) & jnp.all(turns >= 0), jnp.abs(height), to_edges)
