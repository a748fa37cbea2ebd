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
from jaxpoint.detect.arm import SLICES, Crop, Limb, Strip, cut_strip, find_limbs, find_tips
from jaxpoint.person.association import Arm, LimbRays, agreeing_views, associate, common_point, stretch
from jaxpoint.pointing.axis import LimbAxis, fit_axis

HEAD_M = 0.24  # height of a head
SPAN = (0.113, 0.230)  # of the stature, behind the tip: wrist at 0.108, elbow at 0.254 (Drillis & Contini)
SMALLEST_M, TALLEST_M = 1.45, 2.0  # of standing people
SEATED_M = 1.65  # stature of who is lower than that
RIVAL_M = 0.12  # arms stretched out less far by more than this are no rivals of the farthest
ROUNDS = 3  # of promising, measuring, fitting
MIN_SLICES = 6  # of a view that counts
FORESHORTENED = np.deg2rad(15.0)  # a limb nearer to the line of sight says nothing of its direction (thesis 7.3)
NEAREST_M = 0.4  # closer to a camera than this nothing is looked at
SLICE_PX = 0.7  # error of a slice's middle: of its edges in the image,
SLICE_M = 0.003  # and of the limb, which is no perfect cone
AGREES = 2.5  # a view's middle line lies within so many of these errors of the common axis
MOST_TIPS = 3  # candidates of a tip in one view
MOST_LIMBS = 12  # long ends of one view that are looked at
_OUTLINE_WEIGHT = 0.6
_SETTLED = 1.2
_OTHER_START = np.deg2rad(4.0)
_BEYOND_M = 0.01  # slices are cut so far beyond both ends of the span


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
    sigma_px: Float[Array, " C"]  # error of a slice's middle
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
    arms = sorted(associate(rays, head), key=lambda arm: -stretch(arm, head))
    for arm in arms:
        if stretch(arm, head) < stretch(arms[0], head) - RIVAL_M:
            break  # the arm that is stretched out could not be measured; another one is no answer
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
    span = _span(head)
    tries = []
    for start in _starts(arm):
        tries.append(_settled(rig, crops, arm.tip, start, span, ROUNDS))
        if _settles(tries[-1][0]):
            break
    axis, strips, _ = max(tries, key=lambda one: _agreed(one[0]))
    own = {camera: limbs[member].tip for member in arm.members if strips[camera := cameras[member]] is not None}
    tip, _, _ = _common_tip(rig, crops, strips, axis, own) or (arm.tip, arm.spread, {})
    # The span counts from the tip, which is known better now.
    axis, strips, promised = _settled(rig, crops, tip, axis.direction, span, 2)
    views = [_view(rig, c, crop, strips[c], promised, axis) for c, crop in enumerate(crops)]
    kept = [view.strip if view.reason == ArmReason.FOUND else None for view in views]
    if sum(strip is not None for strip in kept) < 2:
        return None
    axis = _fit(rig, kept, tip, axis.direction, span)
    tip, spread, seen = _common_tip(rig, crops, kept, axis, own) or (arm.tip, arm.spread, {})
    projected = np.asarray(rig.project(tip))
    for camera, view in enumerate(views):
        if view.reason == ArmReason.FOUND:
            views[camera] = replace(view, tip=seen.get(camera, projected[camera]))
    return PointingArm(tip, spread, axis, tuple(views), stretch(arm, head))


def _span(head: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """Between wrist and elbow, behind the tip, m: by the stature where a person stands, else of a small adult."""
    stature = head[2] + HEAD_M / 2
    return np.array(SPAN) * (min(stature, TALLEST_M) if stature > SMALLEST_M else SEATED_M)


def _tips(rig: CameraRig, crop: Crop, axis: LimbAxis, camera: int) -> list[Float[np.ndarray, "2"]]:
    """Candidates of the tip in one view, beyond the measured forearm."""
    ends = np.asarray(rig.project(np.stack([axis.near, axis.far])))[:, camera]
    along = ends[0] - ends[1]
    scale = float(np.asarray(rig.cameras.focal)[camera].mean() / np.asarray(rig.depth(axis.near))[camera])
    return find_tips(crop, ends[0], along / max(float(np.hypot(*along)), 1e-9), scale)


def _common_tip(rig, crops, strips, axis: LimbAxis, own) -> tuple[np.ndarray, float, dict[int, np.ndarray]] | None:
    """The place on which the views' candidates agree, the farthest out of those that as many views support."""
    views, pixels = [], []
    for camera, strip in enumerate(strips):
        if strip is not None:
            tips = _tips(rig, crops[camera], axis, camera) + ([own[camera]] if camera in own else [])
            views += [camera] * len(tips)
            pixels += tips
    if len(set(views)) < 2:
        return None
    padded, place = np.zeros((MOST_TIPS * len(rig), 1, 2)), np.zeros(MOST_TIPS * len(rig), np.int64)
    padded[: len(views), 0], place[: len(views)] = pixels, views
    rays = np.asarray(_rays(rig, padded, place))[: len(views), 0]
    found = common_point(np.asarray(rig.positions)[views], rays, np.array(views), axis.direction)
    if found is None:
        return None
    tip, spread, members = found
    return tip, spread, {views[m]: pixels[m] for m in members}


def _starts(arm: Arm) -> list[Float[np.ndarray, "3"]]:
    """The common direction, and those of two views each that are clearly others; three at most."""
    starts = [arm.direction]
    for direction in arm.alternatives:
        if all(direction @ start < np.cos(_OTHER_START) for start in starts):
            starts.append(direction)
    return starts[:3]


def _settled(rig, crops, tip, direction, span, rounds: int) -> tuple[LimbAxis, list[Strip | None], Strips]:
    """Promise, measure, agree, fit; and again. Views that do not agree keep their strips, but have no say."""
    on_axis = tip
    for _ in range(rounds):
        promised = jax.tree.map(np.asarray, _promise(rig, on_axis, direction, span))
        strips = [_strip(crop, promised, camera) for camera, crop in enumerate(crops)]
        agreed = _agreeing(rig, strips, promised, tip, direction)
        used = strips
        if agreed is not None:
            used, direction = [strip if keep else None for strip, keep in zip(strips, agreed[0])], agreed[1]
        axis = _fit(rig, used, tip, direction, span)
        direction = axis.direction
        on_axis = axis.near + span[0] * direction
    return axis, strips, promised


def _agreeing(rig: CameraRig, strips, promised: Strips, tip, direction):
    pixels, held = _stacked(rig, strips)
    rays = np.asarray(_rays(rig, pixels, np.arange(len(rig))))
    focal = np.asarray(rig.cameras.focal).mean(axis=1)
    return agreeing_views(
        np.asarray(rig.positions), rays, held, focal / promised.sigma_px, tip, np.asarray(direction), AGREES
    )


def _agreed(axis: LimbAxis) -> float:
    """Slices that count, less where they scatter."""
    return float(axis.slices.sum()) / (1 + float(axis.rms))


def _settles(axis: LimbAxis) -> bool:
    """Three views whose slices lie on the axis: no other start can do better."""
    return bool((axis.slices >= MIN_SLICES).sum() >= 3 and axis.rms < _SETTLED)


def _strip(crop: Crop | None, promised: Strips, camera: int) -> Strip | None:
    """The limb's edges in one view; None where it cannot say anything."""
    if crop is None or not promised.ahead[camera] or promised.angle[camera] < FORESHORTENED:
        return None
    strip = cut_strip(crop, promised.pixels[camera], promised.across[camera], float(promised.pixels_a_metre[camera]))
    return strip if (strip.width > 0).sum() >= MIN_SLICES else None


def _view(rig, camera, crop, strip, promised, axis: LimbAxis) -> ArmView:
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
    if rms > AGREES * float(promised.sigma_px[camera]):
        return ArmView(ArmReason.DISAGREES, np.zeros(2), None, rms, angle)
    return ArmView(ArmReason.FOUND, np.zeros(2), strip, rms, angle)


def _fit(rig: CameraRig, strips: Sequence[Strip | None], tip, direction, span) -> LimbAxis:
    pixels, seen = _stacked(rig, strips)
    return jax.tree.map(np.asarray, _fit_axis(rig, pixels, seen, tip, direction, span))


def _stacked(rig, strips) -> tuple[Float[np.ndarray, "C S 2"], Bool[np.ndarray, "C S"]]:
    """Middles of all views' slices, and which there are."""
    pixels, seen = np.zeros((len(rig), SLICES, 2)), np.zeros((len(rig), SLICES), bool)
    for camera, strip in enumerate(strips):
        if strip is not None:
            pixels[camera], seen[camera] = strip.middle, strip.width > 0
    return pixels, seen


@jit
def _fit_axis(rig: CameraRig, pixels: Array, seen: Array, tip: Array, direction: Array, span: Array) -> LimbAxis:
    rays = jax.vmap(Camera.ray)(rig.cameras, pixels)
    middle = tip - span.mean() * direction

    def sigma(camera: Camera) -> Array:
        return _sigma(*_scale_and_angle(camera, middle, direction))

    return fit_axis(
        rays.origin[:, 0],
        rig.cameras.focal.mean(axis=1),
        rays.direction,
        seen,
        tip,
        direction,
        jax.vmap(sigma)(rig.cameras),
        span,
    )


def _scale_and_angle(camera: Camera, middle: Array, direction: Array) -> tuple[Array, Array]:
    """Pixels a metre at a place, and the angle between a direction and the line of sight to it."""
    sight = middle - camera.position
    cosine = jnp.abs(sight @ direction) / jnp.sqrt(sight @ sight)
    return camera.focal.mean() / jnp.maximum(camera.depth(middle), NEAREST_M), jnp.arccos(jnp.clip(cosine, 0.0, 1.0))


def _sigma(pixels_a_metre: Array, angle: Array) -> Array:
    """Error of a slice's middle, px: seen along the limb, a slice mixes many of its sections."""
    return jnp.hypot(SLICE_PX, SLICE_M * pixels_a_metre / jnp.maximum(jnp.sin(angle), 0.1))


@jit
def _promise(rig: CameraRig, tip: Array, direction: Array, span: Array) -> Strips:
    reach = jnp.linspace(span[0] - _BEYOND_M, span[1] + _BEYOND_M, SLICES)
    places = tip - reach[:, None] * direction[None]
    middle = places.mean(axis=0)

    def one(camera: Camera) -> tuple[Array, ...]:
        pixels = camera.project(places)
        along = pixels[-1] - pixels[0]
        along = along / jnp.maximum(jnp.hypot(along[0], along[1]), 1e-9)
        scale, angle = _scale_and_angle(camera, middle, direction)
        ahead = camera.depth(places).min() > NEAREST_M
        return pixels, jnp.stack([-along[1], along[0]]), scale, _sigma(scale, angle), angle, ahead

    return Strips(*jax.vmap(one)(rig.cameras))
