"""The room as a box: where pointing at nothing ends (thesis 7.3)."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import as_float
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.objects import Objects

MAX_ROOM_M = 100.0  # no room is larger: a larger one has its lengths in another unit
MARGIN_M = 0.05  # between a guessed wall and what is nearest to it
SURFACES = (
    "the wall at the lowest x",
    "the wall at the lowest y",
    "the floor",
    "the wall at the highest x",
    "the wall at the highest y",
    "the ceiling",
)


class Room(eqx.Module):
    """An upright box with walls along the axes."""

    low: Float[Array, "3"] = eqx.field(converter=as_float)  # m
    high: Float[Array, "3"] = eqx.field(converter=as_float)  # m

    @staticmethod
    def around(objects: Objects, inside: Float[np.ndarray, "N 3"] | None = None) -> Room:
        """A guess where nobody gave the room's size: as small as holds what is known.

        What hangs on walls bounds most rooms. The floor is at z = 0, as calibrations have it, or as low as anything.

        Args:
            objects: all of which lie in it.
            inside: other places in it, such as cameras and people, m.
        """
        places = np.stack(objects.bounds)
        if inside is not None:
            places = np.concatenate([places, inside])
        low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
        low[2] = min(0.0, places[:, 2].min())
        return Room(low, high)


class RoomPoint(eqx.Module):
    """Where rays end on the room's surfaces."""

    point: Float[Array, "*batch 3"]  # m
    distance: Float[Array, "*batch"]  # m
    surface: Int[Array, "*batch"]  # place in SURFACES
    inside: Bool[Array, "*batch"]  # whether the ray starts within the room; else nothing of the above is meant


def end_in_room(rays: Ray, room: Room) -> RoomPoint:
    """Where rays from within the room end on its walls, floor or ceiling."""
    return over_lines(partial(_end_in_room, room), rays)


@jit
def _end_in_room(room: Room, rays: Ray) -> RoomPoint:
    def one(ray: Ray) -> RoomPoint:
        moves = jnp.abs(ray.direction) > 1e-12
        up = ray.direction > 0
        reach = (jnp.where(up, room.high, room.low) - ray.origin) / jnp.where(moves, ray.direction, 1.0)
        axis = jnp.argmin(jnp.where(moves, reach, jnp.inf))
        inside = jnp.all((ray.origin >= room.low) & (ray.origin <= room.high))
        return RoomPoint(ray.at(reach[axis]), reach[axis], axis + 3 * up[axis], inside)

    return jax.vmap(one)(rays)
