"""Which objects lie on a ray, in order: further ones are hidden but may be meant (thesis 7.3)."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.lines import over_lines
from jaxpoint.pointing.objects import Objects, Shapes

MOST = 8
_PARALLEL = 1e-9  # sine of the angle below which a ray does not meet a face


class Hits(eqx.Module):
    """Where rays meet objects, nearest first; unused places at the end are 0 and not `valid`."""

    object: Int[Array, "*batch H"]  # place in the database
    distance: Float[Array, "*batch H"]  # m, from the ray's origin
    point: Float[Array, "*batch H 3"]  # m
    fractions: Float[Array, "*batch H 2"]  # of the sides of the face: (0, 0) at left-top; of a sphere 1/2, 1/2
    valid: Bool[Array, "*batch H"]
    count: Int[Array, "*batch"]  # of all objects met, which may be more than H


def intersect(rays: Ray, objects: Objects, most: int = MOST) -> Hits:
    """All objects that rays meet, by distance.

    A rectangle is met from both sides, a box or a sphere from outside. Distances, points and fractions have derivatives
    by the rays and the objects' places.

    Args:
        rays: any leading axes; unit directions.
        most: H, of how many objects a ray is told; nearest first.
    """
    return over_lines(partial(_intersect, objects.shapes, min(most, objects.shapes.owner.shape[0])), rays)


@partial(jit, static_argnames="most")
def _intersect(shapes: Shapes, most: int, rays: Ray) -> Hits:
    """Of rays with one leading axis."""
    distance, u, v = jax.vmap(partial(meet, shapes))(rays)
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


def meet(
    shapes: Shapes, ray: Ray, planes: Planes | None = None
) -> tuple[Float[Array, " parts"], Float[Array, " parts"], Float[Array, " parts"]]:
    """Distance (m) to every face and sphere, infinite where there is no hit, and the fractions of a face's sides.

    Args:
        planes: of the shapes' faces, if they are known.
    """
    faces = _meet_faces(planes_of(shapes) if planes is None else planes, shapes.solid, ray)
    half = jnp.full(shapes.radius.shape, 0.5, faces[0].dtype)
    spheres = (_meet_spheres(shapes, ray.origin, ray.direction), half, half)
    distance, u, v = (jnp.concatenate(pair) for pair in zip(faces, spheres))
    return distance, u, v


class Planes(eqx.Module):
    """What rays that meet faces have in common: of each face its unit normal and the dual base of its sides.

    The products of a point with the dual base, less those of the corner, are its fractions of the sides.
    """

    normal: Float[Array, "F 3"]
    right: Float[Array, "F 3"]  # 1/m
    down: Float[Array, "F 3"]  # 1/m
    offset: Float[Array, "F 3"]  # products of these three with the corner; m, 1, 1
    used: Bool[Array, " F"]  # whether the face has a size


def planes_of(shapes: Shapes) -> Planes:
    """The planes of all faces."""
    corner, right, down = shapes.corner, shapes.right, shapes.down
    normal = jnp.cross(down, right)
    area2 = jnp.sum(normal**2, axis=1)
    used = area2 > 0
    safe = jnp.where(used, area2, 1.0)[:, None]
    parts = normal / jnp.sqrt(safe), jnp.cross(normal, down) / safe, jnp.cross(right, normal) / safe
    return Planes(*parts, jnp.stack([_dots(part, corner) for part in parts], axis=1), used)


def face_fractions(
    planes: Planes, ray: Ray
) -> tuple[Float[Array, " F"], Float[Array, " F"], Float[Array, " F"], Bool[Array, " F"], Bool[Array, " F"]]:
    """Where a ray meets planes: distance (m), fractions of the sides, whether it does so ahead, and from the front."""
    closing = _dot(planes.normal, ray.direction)
    parallel = jnp.abs(closing) < _PARALLEL
    distance = (planes.offset[:, 0] - _dot(planes.normal, ray.origin)) / jnp.where(parallel, 1.0, closing)
    u, v = (
        _dot(dual, ray.origin) - planes.offset[:, i] + distance * _dot(dual, ray.direction)
        for i, dual in ((1, planes.right), (2, planes.down))
    )
    return distance, u, v, planes.used & ~parallel & (distance > 0), closing < 0


def _meet_faces(planes: Planes, solid: Array, ray: Ray) -> tuple[Array, Array, Array]:
    distance, u, v, ahead, front = face_fractions(planes, ray)
    hit = ahead & (~solid | front) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    return jnp.where(hit, distance, jnp.inf), u, v


def _meet_spheres(shapes: Shapes, origin: Array, direction: Array) -> Array:
    along = _dot(shapes.center, direction) - _dot(direction[None], origin)
    gap = shapes.center - origin[None]
    inside = shapes.radius**2 - (jnp.sum(gap**2, axis=1) - along**2)
    meets = (inside > 0) & (shapes.radius > 0)
    distance = along - jnp.sqrt(jnp.where(meets, inside, 1.0))
    return jnp.where(meets & (distance > 0), distance, jnp.inf)


def _dot(rows: Array, vector: Array) -> Array:
    """Products of rows with one vector: a sum that fuses, where a matrix product would not."""
    return rows[:, 0] * vector[0] + rows[:, 1] * vector[1] + rows[:, 2] * vector[2]


def _dots(a: Array, b: Array) -> Array:
    """Products of rows with rows."""
    return jnp.sum(a * b, axis=1)


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
