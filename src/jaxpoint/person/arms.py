"""The pointing arm of one person at one moment: found over all views, measured in each, put together in the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.detect.arm import SLICES, Crop, Limb, Strip, cut_strip, find_limbs
from jaxpoint.person.association import Arm, LimbRays, associate, stretch
from jaxpoint.pointing.axis import SPAN_M, LimbAxis, fit_axis

HEAD_M = 0.24  # height of a head
MIN_SLICES = 6  # of a view that counts
FORESHORTENED = np.deg2rad(20.0)  # a limb nearer to the line of sight says nothing of its direction (thesis 7.3)
NEAREST_M = 0.4  # closer to a camera than this nothing is looked at
AGREES_PX = 3.0  # a view's middle line lies this near to the common axis,
AGREES_M = 0.015  # or this near at the arm's distance
MOST_LIMBS = 12  # long ends of one view that are looked at
_OUTLINE_WEIGHT = 0.6
_SETTLED_PX = 1.0
_OTHER_START = np.deg2rad(4.0)
_REACH = np.linspace(SPAN_M[0] - 0.02, SPAN_M[1] + 0.02, SLICES)  # behind the tip, m


class ArmReason(IntEnum):
    """Why a view has no say in an arm, or FOUND."""

    FOUND = 0
    NO_IMAGE = 1  # no frame of this camera at this moment
    NO_PERSON = 2  # no silhouette of the person
    NO_ARM = 3  # no two views agree on an arm
    OUTSIDE = 4  # behind the camera or outside its image
    FORESHORTENED = 5  # the arm points along the line of sight
    HIDDEN = 6  # too few slices with two edges: covered, or merged with what is behind
    DISAGREES = 7  # its middle line is not the common axis


@dataclass(frozen=True)
class ArmView:
    """The arm in one view; zeros where the reason is not FOUND."""

    reason: ArmReason
    tip: Float[np.ndarray, "2"]  # px
    strip: Strip | None
    rms_px: float  # distance of the middle line from the common axis
    angle: float  # rad, between the arm and the line of sight

    @property
    def base(self) -> Float[np.ndarray, "2"]:
        """Middle of the seen slice that is farthest from the tip, px."""
        if self.strip is None:
            return np.zeros(2)
        return self.strip.middle[np.flatnonzero(self.strip.width > 0)[-1]]


@dataclass(frozen=True)
class PointingArm:
    """An arm in the room, and what each of C views says of it."""

    tip: Float[np.ndarray, "3"]  # m
    tip_spread: float  # m, rms distance of the views' rays from the tip
    axis: LimbAxis
    views: tuple[ArmView, ...]
    stretch: float  # m, how far the tip is from the body's upright axis

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit length, towards the tip."""
        return np.asarray(self.axis.direction)

    @property
    def counted(self) -> int:
        """Number of views that have a say."""
        return sum(view.reason == ArmReason.FOUND for view in self.views)


class Strips(eqx.Module):
    """Where a promised axis lies in every view; C cameras, S places."""

    pixels: Float[Array, "C S 2"]  # px
    across: Float[Array, "C 2"]  # unit
    pixels_a_metre: Float[Array, " C"]
    angle: Float[Array, " C"]  # rad, between the axis and the line of sight
    ahead: Bool[Array, " C"]  # far enough in front of the camera


def find_arm(
    rig: CameraRig, crops: Sequence[Crop | None], head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> PointingArm | None:
    """The arm of a person that is stretched out farthest; None where no two views agree on one.

    Args:
        rig: the cameras.
        crops: the person's pixels in each view; None where it has none.
        head: centre of the head, m.
        head_px: the same in each image.
    """
    limbs, cameras = _limbs(rig, crops, head, head_px)
    rays = _rays_of(rig, limbs, cameras)
    for arm in sorted(associate(rays, head), key=lambda arm: -stretch(arm, head)):
        measured = _measured(rig, crops, arm, limbs, cameras, head)
        if measured is not None:
            return measured
    return None


def _limbs(rig, crops, head, head_px) -> tuple[list[Limb], list[int]]:
    limbs, cameras = [], []
    depth = np.asarray(rig.depth(head))
    focal = np.asarray(rig.cameras.focal).mean(axis=1)
    for camera, crop in enumerate(crops):
        if crop is None or depth[camera] < NEAREST_M:
            continue
        scale = float(focal[camera] / depth[camera])
        found = find_limbs(crop, scale, head_px[camera], HEAD_M * scale)[:MOST_LIMBS]
        limbs += found
        cameras += [camera] * len(found)
    return limbs, cameras


def _rays_of(rig: CameraRig, limbs: Sequence[Limb], cameras: Sequence[int]) -> LimbRays:
    """All long ends as rays; padded to one shape, so that one program does for every moment."""
    most = MOST_LIMBS * len(rig)
    pixels = np.zeros((most, SLICES + 1, 2))
    place = np.zeros(most, np.int64)
    count = len(limbs)
    for i, limb in enumerate(limbs):
        pixels[i, 0], pixels[i, 1:], place[i] = limb.tip, limb.middle, cameras[i]
    directions = np.asarray(_rays(rig, pixels, place))[:count]
    positions = np.asarray(rig.positions)
    return LimbRays(
        camera=np.array(cameras, np.int64),
        origin=positions[place[:count]],
        tip=directions[:, 0],
        slices=directions[:, 1:],
        held=np.array([limb.width > 0 for limb in limbs]).reshape(count, SLICES),
        weight=np.array([1.0 if limb.from_skin else _OUTLINE_WEIGHT for limb in limbs]),
    )


@jit
def _rays(rig: CameraRig, pixels: Array, cameras: Array) -> Array:
    def one(places: Array, camera: Array) -> Array:
        own = jax.tree.map(lambda leaf: leaf[camera], rig.cameras)
        return own.ray(places).direction

    return jax.vmap(one)(pixels, cameras)


def _measured(rig, crops, arm: Arm, limbs, cameras, head) -> PointingArm | None:
    """The arm, its edges measured across the promised axis in every view; the start with the most agreement wins."""
    tries = []
    for start in _starts(arm):
        tries.append(_settled(rig, crops, arm.tip, start))
        if _settles(tries[-1][0]):
            break
    axis, strips, promised = max(tries, key=lambda one: _agreed(one[0]))
    tips = np.zeros((len(rig), 2))
    for member in arm.members:
        tips[cameras[member]] = limbs[member].tip
    own = np.asarray(rig.project(arm.tip))
    tips = np.where(tips.any(axis=1, keepdims=True), tips, own)
    views = [_view(rig, c, crop, strips[c], promised, axis, tips[c]) for c, crop in enumerate(crops)]
    kept = [view.strip if view.reason == ArmReason.FOUND else None for view in views]
    if sum(strip is not None for strip in kept) < 2:
        return None
    axis = _fit(rig, kept, arm.tip, np.asarray(axis.direction))
    return PointingArm(arm.tip, arm.spread, axis, tuple(views), stretch(arm, head))


def _starts(arm: Arm) -> list[Float[np.ndarray, "3"]]:
    """The common direction, and those of two views each that are clearly others; three at most."""
    starts = [arm.direction]
    for direction in arm.alternatives:
        if all(direction @ start < np.cos(_OTHER_START) for start in starts):
            starts.append(direction)
    return starts[:3]


def _settled(rig, crops, tip, direction) -> tuple[LimbAxis, list[Strip | None], Strips]:
    """Promise, measure, fit; three times."""
    on_axis = tip
    for _ in range(3):
        promised = jax.tree.map(np.asarray, _promise(rig, on_axis, direction))
        strips = [_strip(crop, promised, camera) for camera, crop in enumerate(crops)]
        axis = _fit(rig, strips, tip, direction)
        direction = axis.direction
        on_axis = axis.near + SPAN_M[0] * direction
    return axis, strips, promised


def _agreed(axis: LimbAxis) -> float:
    """Slices that count, less where they scatter."""
    return float(axis.slices.sum()) / (1 + float(axis.rms_px))


def _settles(axis: LimbAxis) -> bool:
    """Three views whose slices lie on the axis: no other start can do better."""
    return bool((axis.slices >= MIN_SLICES).sum() >= 3 and axis.rms_px < _SETTLED_PX)


def _strip(crop: Crop | None, promised: Strips, camera: int) -> Strip | None:
    """The limb's edges in one view; None where it cannot say anything."""
    if crop is None or not promised.ahead[camera] or promised.angle[camera] < FORESHORTENED:
        return None
    strip = cut_strip(crop, promised.pixels[camera], promised.across[camera], float(promised.pixels_a_metre[camera]))
    return strip if (strip.width > 0).sum() >= MIN_SLICES else None


def _view(rig, camera, crop, strip, promised, axis: LimbAxis, tip) -> ArmView:
    angle = float(promised.angle[camera])
    width, height = (int(n) for n in np.asarray(rig.image_sizes)[camera])
    middle = promised.pixels[camera].mean(axis=0)
    nothing = ArmView(ArmReason.FOUND, np.zeros(2), None, 0.0, angle)
    outside = (middle < 0).any() or middle[0] > width - 1 or middle[1] > height - 1
    if not promised.ahead[camera] or outside:
        return replace(nothing, reason=ArmReason.OUTSIDE)
    if crop is None:
        return replace(nothing, reason=ArmReason.NO_PERSON)
    if angle < FORESHORTENED:
        return replace(nothing, reason=ArmReason.FORESHORTENED)
    if strip is None:
        return replace(nothing, reason=ArmReason.HIDDEN)
    ends = np.asarray(rig.project(np.stack([axis.near, axis.far])))[:, camera]
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    held = strip.width > 0
    off = (strip.middle[held] - ends[0]) @ np.array([-along[1], along[0]])
    rms = float(np.sqrt(np.mean(off**2)))
    if rms > max(AGREES_PX, AGREES_M * float(promised.pixels_a_metre[camera])):
        return ArmView(ArmReason.DISAGREES, np.zeros(2), None, rms, angle)
    return ArmView(ArmReason.FOUND, tip, strip, rms, angle)


def _fit(rig: CameraRig, strips: Sequence[Strip | None], tip, direction) -> LimbAxis:
    pixels, seen = np.zeros((len(rig), SLICES, 2)), np.zeros((len(rig), SLICES), bool)
    for camera, strip in enumerate(strips):
        if strip is not None:
            pixels[camera], seen[camera] = strip.middle, strip.width > 0
    return jax.tree.map(np.asarray, _fit_axis(rig, pixels, seen, tip, direction))


@jit
def _fit_axis(rig: CameraRig, pixels: Array, seen: Array, tip: Array, direction: Array) -> LimbAxis:
    rays = jax.vmap(Camera.ray)(rig.cameras, pixels)
    return fit_axis(rays.origin[:, 0], rig.cameras.focal.mean(axis=1), rays.direction, seen, tip, direction)


@jit
def _promise(rig: CameraRig, tip: Array, direction: Array) -> Strips:
    places = tip - jnp.asarray(_REACH)[:, None] * direction[None]
    middle = places.mean(axis=0)

    def one(camera: Camera) -> tuple[Array, ...]:
        pixels = camera.project(places)
        along = pixels[-1] - pixels[0]
        along = along / jnp.maximum(jnp.hypot(along[0], along[1]), 1e-9)
        sight = middle - camera.position
        distance = jnp.sqrt(sight @ sight)
        depth = camera.depth(places)
        angle = jnp.arccos(jnp.clip(jnp.abs(sight @ direction) / distance, 0.0, 1.0))
        scale = camera.focal.mean() / jnp.maximum(depth.mean(), 1e-3)
        return pixels, jnp.stack([-along[1], along[0]]), scale, angle, depth.min() > NEAREST_M

    return Strips(*jax.vmap(one)(rig.cameras))
