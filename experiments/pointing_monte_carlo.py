"""Simulated pointings in batch: noisy pixels to points, to a line, to an object, hundreds of thousands a second.

A part of some hundred pointings shares a room, the cameras that look on and one draw of their calibration; its
gestures are used again and again with other noise of the pixels. Within a part everything is one compiled program,
batched by `vmap` or with the pointings on the last axis; parts are worked on by all cores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from common_direction import common_direction
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.cores import by_all_cores
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.angles import azimuth_elevation, turn_directions, wrap_angle
from jaxpoint.geometry.arrays import as_float
from jaxpoint.geometry.line import Ray, normalise
from jaxpoint.geometry.pose import Pose
from jaxpoint.pointing.bias.models import AbstractBiasModel, Constant
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.objects import Objects, Shapes
from jaxpoint.triangulation import triangulate
from pointing_people import Gestures

Method = Literal["endpoints", "planes"]
Line = Literal["forearm", "thesis", "finger", "eye-fingertip", "head-hand", "shoulder-hand"]
PART = 512
_FEWEST = 128  # the gestures of a part are padded to so many: few programs are compiled
CENTROID = 0.15  # of the forearm lies before the centroid of forearm and hand, from the wrist on
FINGER_RADIUS_M = 0.008  # by which the outline lies above the axis at the fingertip


class Noise(eqx.Module):
    """What goes wrong between the body and the line: standard deviations, but for the outline."""

    pixel: Float[Array, ""] = eqx.field(converter=as_float)  # px, of both coordinates of every end
    turn: Float[Array, ""] = eqx.field(converter=as_float)  # rad, of each camera about each axis
    place: Float[Array, ""] = eqx.field(converter=as_float)  # m, of each camera along each axis
    focal: Float[Array, ""] = eqx.field(converter=as_float)  # relative, of each camera
    outline: Float[Array, ""] = eqx.field(converter=as_float)  # m, by which the front end is seen above the axis
    slide: Float[Array, ""] = eqx.field(converter=as_float)  # m, by which ends move along the axis from view to view

    @staticmethod
    def of(pixel: float = 1.0, calibration: float = 1.0, outline: float = 0.0, slide: float = 0.0) -> Noise:
        """A calibration of 1 errs by 0.05 degrees, 5 mm and 0.2 % of the focal length in every camera."""
        turn, place, focal = calibration * np.array([np.deg2rad(0.05), 0.005, 0.002])
        return Noise(np.float64(pixel), turn, place, focal, np.float64(outline), np.float64(slide))


class Scored(eqx.Module):
    """How pointings end; estimated minus true, true being from the true fingertip to the target."""

    azimuth: Float[Array, "*batch"]  # rad
    elevation: Float[Array, "*batch"]  # rad, positive too high
    angle: Float[Array, "*batch"]  # rad, between both lines
    right: Int[Array, "*batch"]  # 1 where the first object met is the one meant, or none is and none was
    origin: Float[Array, "*batch 3"]  # m
    direction: Float[Array, "*batch 3"]  # unit length, corrected


class Bodies(eqx.Module):
    """What a part looks at: N gestures of one room."""

    ends: Float[Array, "N 4 3"]  # rear and front of what is seen of the line, fingertip, target; m
    meant: Int[Array, " N"]
    visible: Bool[Array, "N V"]


@dataclass(frozen=True)
class Condition:
    """How a line is seen and drawn."""

    line: Line = "forearm"
    method: Method = "planes"
    views: int | None = None  # the best so many; None: all that see the arm
    length_m: float | None = None  # of what is seen of the line, back from its front; None: as the body is
    noise: Noise | None = None

    @property
    def front_is_tip(self) -> bool:
        return self.line in ("finger", "thesis", "eye-fingertip")


@dataclass(frozen=True)
class Job:
    """A part's room, cameras and gestures."""

    cameras: Camera
    shapes: Shapes
    bodies: Bodies
    numbers: Int[np.ndarray, " n"]  # of the gestures, in all rooms


@dataclass(frozen=True)
class Sample:
    """Pointings of all gestures, each as often."""

    gesture: Int[np.ndarray, " P"]  # number in all rooms
    scored: Scored  # with a leading axis P


def point(
    rooms: Sequence[Gestures],
    condition: Condition,
    draws: int,
    *,
    seed: int = 0,
    model: AbstractBiasModel | None = None,
    size: int = PART,
) -> Sample:
    """Every gesture with so many draws of the noise.

    Args:
        model: takes a bias back, see `jaxpoint.pointing.bias`; None: lines stay as they are.
        size: pointings of a part, which share one draw of the calibration.
    """
    noise = condition.noise or Noise.of()
    model = Constant(np.zeros(2)) if model is None else model
    jobs = jobs_of(rooms, condition)
    parts = [(job, start) for job in jobs for start in range(0, len(job.numbers) * draws, size)]
    keys = jax.random.split(jax.random.key(seed, impl="unsafe_rbg"), len(parts))
    how = condition.method, condition.front_is_tip, size

    def part(at: int) -> Scored:
        job, start = parts[at // size]
        count = len(job.numbers)
        return pointings(*how, job.cameras, job.shapes, job.bodies, start, count, noise, model, keys[at // size])

    scored = by_all_cores(part, len(parts) * size, size)
    number = np.concatenate([job.numbers[(start + np.arange(size)) % len(job.numbers)] for job, start in parts])
    used = np.concatenate([start + np.arange(size) < len(job.numbers) * draws for job, start in parts])
    return Sample(number[used], jax.tree.map(lambda leaf: np.asarray(leaf)[used], scored))


def jobs_of(rooms: Sequence[Gestures], condition: Condition) -> list[Job]:
    """Gestures of a room that are seen by the same cameras; with all cameras, those of a room."""
    jobs, before = [], 0
    for own in rooms:
        best = np.sort(np.argsort(-own.rank, axis=1)[:, : condition.views], axis=1)
        if condition.views is None:
            best = np.tile(np.arange(len(own.rig)), (len(own), 1))
        for cameras in np.unique(best, axis=0):
            some = np.flatnonzero((best == cameras).all(axis=1))
            jobs.append(_job(own, condition, cameras, some, before))
        before += len(own)
    return jobs


def _job(own: Gestures, condition: Condition, cameras: np.ndarray, some: np.ndarray, before: int) -> Job:
    rear, front = line_ends(own, condition)
    ends = np.stack([rear, front, own.points["tip"], own.target], axis=1)[some]
    size = 1 << max(len(some) - 1, _FEWEST - 1).bit_length()
    rows = [ends, own.meant[some], own.seen[some][:, cameras]]
    padded = [np.concatenate([row, np.repeat(row[:1], size - len(some), axis=0)]) for row in rows]
    chosen = jax.tree.map(lambda leaf: leaf[cameras], own.rig.cameras)
    return Job(chosen, own.objects.shapes, Bodies(*map(jnp.asarray, padded)), before + some)


def line_ends(own: Gestures, condition: Condition) -> tuple[Float[np.ndarray, "G 3"], Float[np.ndarray, "G 3"]]:
    """Rear and front of what is seen of each line, m."""
    at = own.points
    hand = (at["wrist"] + at["tip"]) / 2
    rear, front = {
        "forearm": (at["elbow"], at["wrist"]),
        "thesis": ((1 - CENTROID) * at["wrist"] + CENTROID * at["elbow"], at["tip"]),
        "finger": (at["knuckle"], at["tip"]),
        "eye-fingertip": (at["eye"], at["tip"]),
        "head-hand": (at["head"], hand),
        "shoulder-hand": (at["shoulder"], hand),
    }[condition.line]
    if condition.length_m is not None:
        back = rear - front
        rear = front + condition.length_m * back / np.linalg.norm(back, axis=1, keepdims=True)
    return rear, front


@partial(jit, static_argnums=(0, 1, 2))
def pointings(
    method: Method,
    front_is_tip: bool,
    size: int,
    cameras: Camera,
    shapes: Shapes,
    bodies: Bodies,
    start: Int[Array, ""],
    count: Int[Array, ""],
    noise: Noise,
    model: AbstractBiasModel,
    key: Array,
) -> Scored:
    """One part: pointings start, start + 1, ... of `count` gestures in turn. V cameras, B = size pointings."""
    which = (start + jnp.arange(size)) % count
    ends, visible = bodies.ends[which], bodies.visible[which]
    true = _rows(cameras)
    keys = jax.random.split(key, 3)
    supposed = _rows(disturbed(cameras, noise, keys[0]))
    points = seen_points(true, ends[:, : 2 if front_is_tip else 3].transpose(2, 1, 0), noise, keys[1])
    pixels = jnp.stack([project(true, points[:, end]) for end in range(points.shape[1])], axis=1)
    pixels = pixels + noise.pixel * _normal(keys[2], pixels.shape, pixels.dtype)
    triangulated = slice(None) if method == "endpoints" else slice(-1, None)
    found = _triangulated(disturbed(cameras, noise, keys[0]), pixels[:, triangulated], visible)
    if method == "endpoints":
        direction = normalise(found[1] - found[0])
    else:
        direction = plane_direction(supposed, pixels[:, :2], visible).T
    direction = turn_directions(direction, -model.turn(azimuth_elevation(direction)[:, None]))
    return _score(shapes, found[-1], direction, ends[:, 2], ends[:, 3], bodies.meant[which])


def disturbed(cameras: Camera, noise: Noise, key: Array) -> Camera:
    """The cameras as a calibration has them."""
    count = cameras.focal.shape[0]
    draw = jax.random.normal(key, (count, 7), cameras.focal.dtype)

    def one(camera: Camera, draw: Array) -> Camera:
        rotation = so3.exp(noise.turn * draw[:3]) @ camera.cam_from_world.rotation
        place = camera.position + noise.place * draw[3:6]
        focal = camera.focal * (1 + noise.focal * draw[6])
        lens = type(camera.lens).of(focal, camera.center, camera.distortion)
        return Camera(lens, Pose(rotation, -rotation @ place))

    return jax.vmap(one)(cameras, draw)


def seen_points(cameras: Camera, ends: Float[Array, "3 k B"], noise: Noise, key: Array) -> Float[Array, "3 k V B"]:
    """The body's points that every camera takes for the ends: moved along the axis, and the front one up across it."""
    rear, front = ends[:, 0, None], ends[:, 1, None]
    axis = _unit(front - rear)
    views = cameras.lens.parameters.shape[1]
    slides = noise.slide * _normal(key, (2, views, ends.shape[2]), ends.dtype)
    across = _unit(_cross(axis, front - _positions(cameras)))
    up = jnp.where(across[2] < 0, -1.0, 1.0)[None] * across
    moved = [rear + slides[0][None] * axis, front + slides[1][None] * axis + noise.outline * up]
    others = [jnp.broadcast_to(ends[:, i, None], moved[0].shape) for i in range(2, ends.shape[1])]
    return jnp.stack([*moved, *others], axis=1)


def project(cameras: Camera, points: Float[Array, "3 V B"]) -> Float[Array, "2 V B"]:
    """Pixels, every camera's of its own points."""
    r, t = cameras.cam_from_world.rotation, cameras.cam_from_world.translation
    x, y, z = points
    right, down, depth = (r[i, 0] * x + r[i, 1] * y + r[i, 2] * z + t[i] for i in range(3))
    return jnp.stack(cameras.lens.image_of(cameras.lens.parameters, (right, down, depth)))


def plane_direction(
    cameras: Camera, pixels: Float[Array, "2 2 V B"], visible: Bool[Array, "B V"]
) -> Float[Array, "3 B"]:
    """The direction, towards the front, in which the planes through rear and front of all views meet.

    Planes count by the length of what was seen: two ends that are far apart say more than two that are near.
    """
    wanted = visible.T
    both = jnp.concatenate([pixels[:, 0], pixels[:, 1]], axis=2)  # one program for both ends
    twice = jnp.concatenate([wanted, wanted], axis=1)
    (u, v, _), _ = cameras.lens.direction_of(cameras.lens.parameters, both[0], both[1], twice)
    (u0, u1), (v0, v1) = jnp.split(u, 2, axis=1), jnp.split(v, 2, axis=1)
    r = cameras.cam_from_world.rotation
    rays = [jnp.stack([u * r[0, i] + v * r[1, i] + r[2, i] for i in range(3)]) for u, v in ((u0, v0), (u1, v1))]
    normals = jnp.where(wanted[None], cameras.lens.parameters[0][None] * _cross(*rays), 0.0)
    direction = common_direction(normals)
    local = [sum(r[k, i] * direction[None, i] for i in range(3)) for k in range(3)]
    forward = (u1 - u0) * (local[0] - u0 * local[2]) + (v1 - v0) * (local[1] - v0 * local[2])
    return jnp.where(jnp.sum(jnp.where(wanted, forward, 0.0), axis=0) < 0, -1.0, 1.0)[None] * direction


def _triangulated(cameras: Camera, pixels: Float[Array, "2 k V B"], visible: Bool[Array, "B V"]) -> Array:
    """Points (k, B, 3), m."""
    _, k, views, count = pixels.shape
    rig = CameraRig(cameras, jnp.ones((views, 2), jnp.int32), tuple(f"cam_{i}" for i in range(views)))
    own = jnp.broadcast_to(visible[None], (k, count, views))
    return triangulate(rig, pixels.transpose(1, 3, 2, 0), own, covariance=False).points


def _score(shapes: Shapes, origin: Array, direction: Array, tip: Array, target: Array, meant: Array) -> Scored:
    to = target - tip
    found, true = azimuth_elevation(direction), azimuth_elevation(to)
    off = jnp.linalg.norm(jnp.cross(direction, to), axis=-1)
    hits = intersect(Ray(origin, direction), Objects(shapes, (), (), ()), most=1)
    named = jnp.where(hits.valid[:, 0], hits.object[:, 0], -1)
    return Scored(
        wrap_angle(found[:, 0] - true[:, 0]),
        found[:, 1] - true[:, 1],
        jnp.arctan2(off, jnp.sum(direction * to, axis=-1)),
        (named == meant).astype(jnp.int32),
        origin,
        direction,
    )


def _rows(cameras: Camera) -> Camera:
    """Every number of the cameras as a column (V, 1) that meets arrays (V, B)."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1)[..., None], cameras)


def _positions(cameras: Camera) -> Float[Array, "3 V 1"]:
    r, t = cameras.cam_from_world.rotation, cameras.cam_from_world.translation
    return -jnp.stack([sum(r[k, i] * t[k] for k in range(3)) for i in range(3)])


def _normal(key: Array, shape: tuple[int, ...], dtype: np.dtype) -> Array:
    """Noise needs no more digits than float32 has, which are drawn in half the time."""
    return jax.random.normal(key, shape, jnp.float32).astype(dtype)


def _cross(a: Array, b: Array) -> Array:
    """Of vectors along the first axis."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(vectors: Array) -> Array:
    return vectors * jax.lax.rsqrt(jnp.sum(vectors**2, axis=0))[None]
