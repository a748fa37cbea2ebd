"""The objects nearest to a ray, by angle or distance: the answer to pointing at nothing (thesis 7.3)."""

from __future__ import annotations

from functools import partial
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.objects import Objects, Shapes

CLOSEST = 3  # of the thesis
Measure = Literal["angle", "distance"]


class Nearest(eqx.Module):
    """The N objects nearest to each ray, nearest first; entries without an object are 0 and not `valid`."""

    object: Int[Array, "*batch N"]  # index in the database
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
    """The objects nearest to points in the room (where a ray ends on a wall, say), by distance, m."""
    ask = partial(_nearest_to_points, objects.shapes, len(objects), min(most, len(objects)))
    return over_lines(ask, as_float(points))


@partial(jit, static_argnums=(1, 2, 3))
def _nearest_to_rays(shapes: Shapes, count: int, most: int, measure: Measure, rays: Ray) -> Nearest:
    def one(ray: Ray) -> Nearest:
        angle = shapes.each(lambda own: own.angles(ray))
        values = angle if measure == "angle" else shapes.each(lambda own: own.distances(ray))
        return _least(values, angle < jnp.pi / 2, shapes, count, most)

    return jax.vmap(one)(rays)


@partial(jit, static_argnums=(1, 2))
def _nearest_to_points(shapes: Shapes, count: int, most: int, points: Array) -> Nearest:
    def one(point: Array) -> Nearest:
        values = shapes.each(lambda own: own.point_distances(jnp.broadcast_to(point, (own.used.shape[0], 3))))
        return _least(values, jnp.bool_(True), shapes, count, most)

    return jax.vmap(one)(points)


def _least(values: Array, ahead: Array, shapes: Shapes, count: int, most: int) -> Nearest:
    """The objects with the smallest values of all their primitives."""
    used = shapes.each(lambda own: own.used)
    best = jax.ops.segment_min(jnp.where(used & ahead, values, jnp.inf), shapes.owner, count)
    order = jnp.argsort(jax.lax.stop_gradient(best))[:most]
    valid = jnp.isfinite(best[order])
    return Nearest(jnp.where(valid, order, 0).astype(jnp.int32), jnp.where(valid, best[order], 0.0), valid)
