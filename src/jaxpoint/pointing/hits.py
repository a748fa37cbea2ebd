"""Which objects lie on a ray, in order: further ones are hidden but may be meant (thesis 7.3)."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.objects import Objects, Shapes

MOST = 8


class Hits(eqx.Module):
    """Where rays meet objects, nearest first; unused places at the end are 0 and not `valid`."""

    object: Int[Array, "*batch H"]  # place in the database
    distance: Float[Array, "*batch H"]  # m, from the ray's origin
    point: Float[Array, "*batch H 3"]  # m
    fractions: Float[Array, "*batch H 2"]  # of the sides of a face: (0, 0) at left-top; else as its shape documents
    valid: Bool[Array, "*batch H"]
    count: Int[Array, "*batch"]  # of all objects met, which may be more than H


def intersect(rays: Ray, objects: Objects, most: int = MOST) -> Hits:
    """All objects that rays meet, by distance.

    A rectangle is met from both sides, solids (a box, a sphere) from outside. Distances, points and fractions have
    derivatives by the rays and the objects' places.

    Args:
        rays: any leading axes; unit directions.
        most: H, the number of objects that are reported for a ray; nearest first.
    """
    return over_lines(partial(_intersect, objects.shapes, min(most, objects.shapes.count)), rays)


@partial(jit, static_argnames="most")
def _intersect(shapes: Shapes, most: int, rays: Ray) -> Hits:
    """Of rays with one leading axis."""
    distance, u, v = jax.vmap(lambda ray: shapes.each(lambda own: own.meet(ray)))(rays)
    places, count = nearest_first(jax.lax.stop_gradient(distance), most)
    valid = jnp.arange(most)[None] < count[:, None]
    along, u, v = (
        jnp.where(valid, jnp.take_along_axis(jnp.where(jnp.isfinite(distance), part, 0.0), places, axis=1), 0.0)
        for part in (distance, u, v)
    )
    point = rays.origin[:, None] + along[..., None] * rays.direction[:, None]
    return Hits(
        jnp.where(valid, shapes.owner[places], 0),
        along,
        jnp.where(valid[..., None], point, 0.0),
        jnp.stack([u, v], axis=-1),
        valid,
        count,
    )


def nearest_first(distance: Float[Array, "G n"], most: int) -> tuple[Int[Array, "G most"], Int[Array, " G"]]:
    """Places of the smallest distances of each row, and how many are finite.

    Hits are few, so the smallest are taken out one after the other; sorting whole rows takes ten times as long. The
    last bits of a distance hold its place: one minimum finds both.
    """
    size = distance.shape[1]
    bits = max(size - 1, 1).bit_length()
    kind = jnp.int64 if distance.dtype == jnp.float64 else jnp.int32
    none = jnp.iinfo(kind).max
    finite = jnp.isfinite(distance)
    keys = jax.lax.bitcast_convert_type(jnp.where(finite, distance, 0.0), kind)
    keys = jnp.where(finite, (keys >> bits << bits) | jnp.arange(size, dtype=kind)[None], none)

    def more(state: tuple) -> Array:
        i, least, *_ = state
        return (i < most) & jnp.any(least < none)

    def take(state: tuple) -> tuple:
        i, least, keys, found = state
        found = found.at[:, i].set((least & ((1 << bits) - 1)).astype(jnp.int32))
        keys = jnp.where(keys == least[:, None], none, keys)
        return i + 1, jnp.min(keys, axis=1), keys, found

    start = (0, jnp.min(keys, axis=1), keys, jnp.zeros((len(distance), most), jnp.int32))
    found = jax.lax.while_loop(more, take, start)[3]
    return jnp.where(found < size, found, 0), jnp.sum(finite, axis=1, dtype=jnp.int32)
