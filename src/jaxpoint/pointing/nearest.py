"""The objects nearest to a ray, by angle or distance: the answer to pointing at nothing (thesis 7.3)."""

from __future__ import annotations

from functools import partial
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float, safe_norm
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.lines import over_lines
from jaxpoint.pointing.objects import Objects, Shapes, face_corners

CLOSEST = 3  # of the thesis
Measure = Literal["angle", "distance"]


class Nearest(eqx.Module):
    """The N objects nearest to each ray, nearest first; places without an object are 0 and not `valid`."""

    object: Int[Array, "*batch N"]  # place in the database
    measure: Float[Array, "*batch N"]  # rad or m
    valid: Bool[Array, "*batch N"]


def nearest(rays: Ray, objects: Objects, measure: Measure = "angle", most: int = CLOSEST) -> Nearest:
    """The objects nearest to rays; 0 where a ray meets one. What lies wholly behind the origin is no candidate.

    Args:
        rays: any leading axes; unit directions.
        measure: `angle` at the origin, from the ray to the object's nearest point (rad), or `distance`, across the
            half line (m).
        most: N.

    Raises:
        ValueError: another measure.
    """
    if measure not in get_args(Measure):
        raise ValueError(f"There is no measure '{measure}'; choose among {', '.join(get_args(Measure))}.")
    ask = partial(_nearest_to_rays, objects.shapes, len(objects), min(most, len(objects)), measure)
    return over_lines(ask, rays)


def nearest_to_points(points: Float[AnyArray, "*batch 3"], objects: Objects, most: int = CLOSEST) -> Nearest:
    """The objects nearest to places in the room (where a ray ends on a wall, say), by distance, m."""
    ask = partial(_nearest_to_points, objects.shapes, len(objects), min(most, len(objects)))
    return over_lines(ask, as_float(points))


def angles(ray: Ray, shapes: Shapes) -> Float[Array, " parts"]:
    """From a ray to the nearest direction of each face and sphere as seen from its origin, rad, 0..pi."""
    corners = face_corners(shapes, ray.origin)
    of_faces = jax.vmap(partial(_angle_to_face, ray.direction))(corners)
    gap = shapes.center - ray.origin[None]
    far = safe_norm(gap)
    away = far > shapes.radius
    half = jnp.arcsin(jnp.where(away, shapes.radius / jnp.where(away, far, 1.0), 1.0))
    to_center = _angle(ray.direction, gap)
    return jnp.concatenate([of_faces, jnp.where(away, jnp.maximum(to_center - half, 0.0), 0.0)])


def distances(ray: Ray, shapes: Shapes) -> Float[Array, " parts"]:
    """From a half line to each face and sphere, m."""
    corners = face_corners(shapes, ray.origin)
    of_faces = jax.vmap(partial(_distance_to_face, ray.direction))(corners)
    gap = shapes.center - ray.origin[None]
    along = jnp.maximum(gap @ ray.direction, 0.0)
    across = safe_norm(gap - along[:, None] * ray.direction[None])
    return jnp.concatenate([of_faces, jnp.maximum(across - shapes.radius, 0.0)])


def point_distances(point: Float[Array, "3"], shapes: Shapes) -> Float[Array, " parts"]:
    """From a point to each face and sphere, m."""
    of_faces = jax.vmap(_point_to_face)(face_corners(shapes, point))
    return jnp.concatenate([of_faces, jnp.maximum(safe_norm(shapes.center - point[None]) - shapes.radius, 0.0)])


@partial(jit, static_argnums=(1, 2, 3))
def _nearest_to_rays(shapes: Shapes, count: int, most: int, measure: Measure, rays: Ray) -> Nearest:
    def one(ray: Ray) -> Nearest:
        angle = angles(ray, shapes)
        values = angle if measure == "angle" else distances(ray, shapes)
        return _least(values, angle < jnp.pi / 2, shapes, count, most)

    return jax.vmap(one)(rays)


@partial(jit, static_argnums=(1, 2))
def _nearest_to_points(shapes: Shapes, count: int, most: int, points: Array) -> Nearest:
    return jax.vmap(lambda p: _least(point_distances(p, shapes), jnp.bool_(True), shapes, count, most))(points)


def _least(values: Array, ahead: Array, shapes: Shapes, count: int, most: int) -> Nearest:
    """The objects with the smallest values of all their parts."""
    used = jnp.concatenate([jnp.any(shapes.right != 0, axis=1), shapes.radius > 0])
    best = jax.ops.segment_min(jnp.where(used & ahead, values, jnp.inf), shapes.owner, count)
    order = jnp.argsort(jax.lax.stop_gradient(best))[:most]
    valid = jnp.isfinite(best[order])
    return Nearest(jnp.where(valid, order, 0).astype(jnp.int32), jnp.where(valid, best[order], 0.0), valid)


def _angle(direction: Array, gaps: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Between one direction and others of any length; accurate for tiny angles."""
    across = safe_norm(jnp.cross(jnp.broadcast_to(direction, gaps.shape), gaps))
    along = gaps @ direction
    return jnp.arctan2(across, jnp.where((across == 0) & (along == 0), 1.0, along))


def _angle_to_face(direction: Array, corners: Float[Array, "4 3"]) -> Float[Array, ""]:
    """The cone about the ray that opens until it meets a face meets an edge first, where the ray misses the face.

    Along an edge A + s E the cosine has one extremum, where the derivative of (a + s e) / |A + s E| vanishes.
    """
    edges = jnp.roll(corners, -1, axis=0) - corners
    a, e = corners @ direction, edges @ direction
    aa, ae, ee = (jnp.sum(x * y, axis=1) for x, y in ((corners, corners), (corners, edges), (edges, edges)))
    bottom = e * ae - a * ee
    s = jnp.clip((a * ae - e * aa) / jnp.where(bottom == 0, 1.0, bottom), 0.0, 1.0)
    candidates = jnp.concatenate([corners, corners + s[:, None] * edges])
    return jnp.where(_meets(direction, corners), 0.0, jnp.min(_angle(direction, candidates)))


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
