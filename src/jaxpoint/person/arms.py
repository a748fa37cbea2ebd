"""The pointing arm of one person at one moment: found over all views, measured in each, put together in the room."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.camera.rig import CameraRig
from jaxpoint.detect.arm import (
    SLICES,
    Crop,
    Edges,
    Limb,
    Strip,
    beside_one_edge,
    cut_strip,
    find_edges,
    find_limbs,
    find_tips,
)
from jaxpoint.person.association import Arm, LimbRays, agreeing_views, associate, common_point, stretch
from jaxpoint.person.promise import NEAREST_M, Promise, promise, rays_through, strips_axis
from jaxpoint.person.refuted import looks_past
from jaxpoint.person.signs import Signs, signs_of
from jaxpoint.pointing.axis import LimbAxis

HEAD_M = 0.24  # height of a head
SPAN = (0.108, 0.240)  # of the stature, behind the tip: wrist at 0.108, elbow at 0.254 (Drillis & Contini)
ELBOW = 0.254  # of the stature, from the tip to the elbow
SMALLEST_M, TALLEST_M = 1.45, 2.0  # of standing people
SEATED_M = 1.65  # stature of who is lower than that
VIEW_M = 0.04  # by which an arm may be stretched out less for each view more that promises it
SURE = 3.5  # log odds of an arm beyond which no other is looked for
LEAST = -1.0  # log odds of the least likely arm that is an answer
ROUNDS = 3  # of promising, measuring, fitting
MIN_SLICES = 6  # of a view that counts
ONE_EDGE_SLICES = 10  # of a view in which only one of the limb's edges is seen
FORESHORTENED = np.deg2rad(15.0)  # a limb nearer to the line of sight says nothing of its direction (thesis 7.3)
HANGS_M = 0.3  # from the body's upright axis: a tip that is nearer does not point
BEND_M = 0.14  # from the forearm's axis to the tip of a bent hand; farther out is another limb's
SIGMA = np.deg2rad(10.0)  # of a direction that still says something
AGREES = 2.5  # a view's middle line lies within so many of these errors of the common axis
MOST_TIPS = 3  # candidates of a tip in one view
MOST_LIMBS = 12  # long ends of one view that are looked at
_OUTLINE_WEIGHT = 0.6
_SETTLED = 1.2
_OTHER_START = np.deg2rad(4.0)


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
    signs: Signs | None = None  # of an arm that points, where it was found among a person's limbs

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit length, towards the tip."""
        return np.asarray(self.axis.direction)

    @property
    def counted(self) -> int:
        """Number of views that have a say."""
        return sum(view.reason == ArmReason.FOUND for view in self.views)


@dataclass(frozen=True)
class _Scene:
    """What all C cameras see of one person at one moment."""

    rig: CameraRig
    crops: Sequence[Crop | None]
    positions: Float[np.ndarray, "C 3"]  # m, of the cameras
    focal: Float[np.ndarray, " C"]  # px
    sizes: Int[np.ndarray, "C 2"]  # px, of the images


@dataclass(frozen=True)
class _Measured:
    """An axis, the strips that were cut where it was expected, and where that was."""

    axis: LimbAxis
    strips: list[Strip | None]
    promised: Promise

    @property
    def agreed(self) -> float:
        """Slices that count, less where they scatter."""
        return float(self.axis.slices.sum()) / (1 + float(self.axis.rms))

    @property
    def settled(self) -> bool:
        """Whether three views' slices lie on the axis: no other start can do better."""
        return bool((self.axis.slices >= MIN_SLICES).sum() >= 3 and self.axis.rms < _SETTLED)


def find_arm(
    rig: CameraRig, crops: Sequence[Crop | None], head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> PointingArm | None:
    """The arm with which a person points, by its signs; None where no limb is like one.

    Limbs are measured in the order of their reach, until one is surely an arm that points. Computes in the precision
    that JAX is set to; `follow` sets it to float64.

    Args:
        rig: the cameras.
        crops: the person's pixels in each view; None where it has none.
        head: centre of the head, m.
        head_px: the same in each image.
    """
    best, most = None, LEAST
    for limb in measured_limbs(rig, crops, head, head_px):
        log_odds = limb.signs.log_odds if limb.signs is not None else LEAST
        if log_odds > most:
            best, most = limb, log_odds
        if most > SURE:
            break
    return best


def measured_limbs(
    rig: CameraRig, crops: Sequence[Crop | None], head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> Iterator[PointingArm]:
    """All limbs of a person that two views or more agree on and that do not hang, the farthest reaching first.

    The arguments are those of `find_arm`.
    """
    scene = _scene(rig, crops)
    limbs, cameras = _limbs(scene, head, head_px)
    arms = associate(_rays_of(scene, limbs, cameras), head)
    arms.sort(key=lambda arm: -stretch(arm.tip, head) - VIEW_M * arm.support)
    for arm in arms:
        if stretch(arm.tip, head) >= HANGS_M:
            own = {cameras[member]: limbs[member].tip for member in arm.members}
            measured = _measured(scene, arm, own, head)
            if measured is not None:
                yield measured


def find_arm_again(
    rig: CameraRig, crops: Sequence[Crop | None], head: Float[np.ndarray, "3"], other: PointingArm, moved: np.ndarray
) -> PointingArm | None:
    """The arm where that of a neighbouring moment promises it; None where the views do not bear it out.

    Args:
        rig: the cameras.
        crops: the person's pixels in each view; None where it has none.
        head: centre of the head, m.
        other: the arm a moment before or after.
        moved: by which the head has moved since, m.
    """
    ahead, near, tip = other.direction, np.asarray(other.axis.near), other.tip
    foot = near + ((tip - near) @ ahead) * ahead
    arm = Arm((), tip + moved, ahead, 0.0, other.tip_spread, foot + moved)
    return _measured(_scene(rig, crops), arm, {}, head)


def _scene(rig: CameraRig, crops: Sequence[Crop | None]) -> _Scene:
    focal = np.asarray(rig.cameras.focal).mean(axis=1)
    return _Scene(rig, crops, np.asarray(rig.positions), focal, np.asarray(rig.image_sizes))


def _limbs(
    scene: _Scene, head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> tuple[list[Limb], list[int]]:
    """Long ends of all views, and the camera of each."""
    limbs, cameras = [], []
    depth = np.asarray(scene.rig.depth(head))
    for camera, crop in enumerate(scene.crops):
        if crop is None or depth[camera] < NEAREST_M:
            continue
        scale = float(scene.focal[camera] / depth[camera])
        found = find_limbs(crop, scale, head_px[camera], HEAD_M * scale)[:MOST_LIMBS]
        limbs += found
        cameras += [camera] * len(found)
    return limbs, cameras


def _rays_of(scene: _Scene, limbs: Sequence[Limb], cameras: Sequence[int]) -> LimbRays:
    """All long ends as rays; padded to one shape, so that one program does for every moment."""
    most = MOST_LIMBS * len(scene.rig)
    pixels = np.zeros((most, SLICES + 1, 2))
    place = np.zeros(most, np.int64)
    count = len(limbs)
    for i, limb in enumerate(limbs):
        pixels[i, 0], pixels[i, 1:], place[i] = limb.tip, limb.middle, cameras[i]
    directions = np.asarray(rays_through(scene.rig, pixels, place))[:count]
    return LimbRays(
        camera=np.array(cameras, np.int64),
        origin=scene.positions[place[:count]],
        tip=directions[:, 0],
        slices=directions[:, 1:],
        held=np.array([limb.width > 0 for limb in limbs], dtype=bool).reshape(count, SLICES),
        weight=np.array([1.0 if limb.from_skin else _OUTLINE_WEIGHT for limb in limbs]),
    )


def limb_span(head: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """Between wrist and elbow, behind the tip, m: by the stature where a person stands, else of a small adult."""
    stature = head[2] + HEAD_M / 2
    return np.array(SPAN) * (min(stature, TALLEST_M) if stature > SMALLEST_M else SEATED_M)


def _measured(
    scene: _Scene, arm: Arm, own: Mapping[int, np.ndarray], head: Float[np.ndarray, "3"]
) -> PointingArm | None:
    """The arm, its edges measured across the promised axis in every view; the start with the most agreement wins.

    `own` are the tips that single views gave it, by camera.
    """
    span = limb_span(head)
    tries: list[_Measured] = []
    for start in _starts(arm):
        tries.append(_settle(scene, arm.foot, start, span, ROUNDS))
        if tries[-1].settled:
            break
    best = max(tries, key=lambda one: one.agreed)
    tip, _, _ = _common_tip(scene, best.strips, best.axis, own) or (arm.tip, arm.spread, {})
    # The span counts from the tip, which is known better now; where the wrist is bent, it lies beside the axis.
    ahead, near = np.asarray(best.axis.direction), np.asarray(best.axis.near)
    foot = near + ((tip - near) @ ahead) * ahead
    best = _settle(scene, foot, ahead, span, 2)
    views = _views(scene, best)
    kept = [view.strip if view.reason == ArmReason.FOUND else None for view in views]
    if sum(strip is not None for strip in kept) < 2:
        return None
    axis = _fit(scene, kept, foot, np.asarray(best.axis.direction), span)
    tip, spread, seen = _common_tip(scene, kept, axis, own) or (arm.tip, arm.spread, {})
    projected = np.asarray(scene.rig.project(tip))
    for camera, view in enumerate(views):
        if view.reason == ArmReason.FOUND:
            views[camera] = replace(view, tip=seen.get(camera, projected[camera]))
    if not _is_limb(tip, axis):
        return None
    past = int(looks_past(scene.crops, np.asarray(best.promised.pixels), scene.sizes).sum())
    strips = [view.strip for view in views]
    forearm = float(span[0]), float(span[1] * ELBOW / SPAN[1])
    signs = signs_of(scene.rig, scene.crops, head, axis, tip, strips, forearm, past)
    return PointingArm(tip, spread, axis, tuple(views), signs.stretch, signs)


def _is_limb(tip: Float[np.ndarray, "3"], axis: LimbAxis) -> bool:
    """Whether the axis is known at all, and the tip lies as near to it as that of a bent hand."""
    ahead, gap = np.asarray(axis.direction), tip - np.asarray(axis.near)
    beside = np.linalg.norm(gap - (gap @ ahead) * ahead)
    return bool(beside <= BEND_M and np.trace(np.asarray(axis.direction_covariance)) <= SIGMA**2)


def _starts(arm: Arm) -> list[Float[np.ndarray, "3"]]:
    """The common direction, and those of two views each that are clearly others; three at most."""
    starts = [arm.direction]
    for direction in arm.alternatives:
        if all(direction @ start < np.cos(_OTHER_START) for start in starts):
            starts.append(direction)
    return starts[:3]


def _settle(
    scene: _Scene,
    tip: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    span: Float[np.ndarray, "2"],
    rounds: int,
) -> _Measured:
    """Promise, measure, agree, fit; and again. Views that do not agree keep their strips, but have no say."""
    on_axis = tip
    for _ in range(rounds):
        promised = jax.tree.map(np.asarray, promise(scene.rig, on_axis, direction, span))
        edges = [_edges(crop, promised, camera) for camera, crop in enumerate(scene.crops)]
        strips = [_strip(own) for own in edges]
        agreed = _agreeing(scene, strips, promised, on_axis, direction)
        used = strips
        if agreed is not None:
            used, direction = [strip if keep else None for strip, keep in zip(strips, agreed[0])], agreed[1]
        axis = _fit(scene, used, on_axis, direction, span)
        if agreed is not None:
            added = _beside(scene, edges, used, promised, axis)
            if added:
                strips, used = ([added.get(c, strip) for c, strip in enumerate(own)] for own in (strips, used))
                axis = _fit(scene, used, on_axis, np.asarray(axis.direction), span)
        direction = np.asarray(axis.direction)
        on_axis = np.asarray(axis.near) + span[0] * direction
    return _Measured(axis, strips, promised)


def _edges(crop: Crop | None, promised: Promise, camera: int) -> Edges | None:
    """The limb's edges in one view; None where it cannot say anything."""
    if crop is None or not promised.ahead[camera] or promised.angle[camera] < FORESHORTENED:
        return None
    scale = float(promised.pixels_a_metre[camera])
    return find_edges(crop, np.asarray(promised.pixels[camera]), np.asarray(promised.across[camera]), scale)


def _strip(edges: Edges | None) -> Strip | None:
    """The limb between its edges; None where too few slices have both."""
    strip = None if edges is None else cut_strip(edges)
    return strip if strip is not None and (strip.width > 0).sum() >= MIN_SLICES else None


def _beside(
    scene: _Scene, edges: Sequence[Edges | None], used: Sequence[Strip | None], promised: Promise, axis: LimbAxis
) -> dict[int, Strip]:
    """Strips of views that have no say yet, by camera: beside one edge, with the width that the other views have."""
    width = _common_width(used, promised)
    ends = np.asarray(scene.rig.project(np.stack([axis.near, axis.far])))
    added = {}
    for camera, own in enumerate(edges):
        if own is None or used[camera] is not None:
            continue
        within = AGREES * float(promised.sigma_px[camera])
        strip = beside_one_edge(own, width * own.pixels_a_metre, _offsets(own, ends[:, camera]), within)
        if strip is not None and (strip.width > 0).sum() >= ONE_EDGE_SLICES:
            added[camera] = strip
    return added


def _common_width(strips: Sequence[Strip | None], promised: Promise) -> Float[np.ndarray, " S"]:
    """Width of the limb at each slice, m: the middle of all views that have it there; between, straight on."""
    widths = np.stack(
        [strip.width / promised.pixels_a_metre[camera] for camera, strip in enumerate(strips) if strip is not None]
    )
    some = (widths > 0).any(axis=0)
    middle = [np.median(column[column > 0]) for column in widths[:, some].T]
    return np.interp(np.arange(SLICES), np.flatnonzero(some), middle)


def _offsets(edges: Edges, ends: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, " S"]:
    """Where the line through two pixels crosses each slice, px from the promised axis."""
    along, gap = ends[1] - ends[0], edges.axis - ends[0]
    crossing = along[0] * edges.across[1] - along[1] * edges.across[0]  # small only where the line runs along a slice
    return (along[1] * gap[:, 0] - along[0] * gap[:, 1]) / (np.sign(crossing) * max(abs(crossing), 1e-6))


def _agreeing(
    scene: _Scene, strips: Sequence[Strip | None], promised: Promise, tip: np.ndarray, direction: np.ndarray
) -> tuple[Bool[np.ndarray, " C"], Float[np.ndarray, "3"]] | None:
    pixels, held = _stacked(strips)
    rays = np.asarray(rays_through(scene.rig, pixels, np.arange(len(strips))))
    return agreeing_views(scene.positions, rays, held, scene.focal / promised.sigma_px, tip, direction, AGREES)


def _fit(
    scene: _Scene, strips: Sequence[Strip | None], tip: np.ndarray, direction: np.ndarray, span: np.ndarray
) -> LimbAxis:
    return jax.tree.map(np.asarray, strips_axis(scene.rig, *_stacked(strips), tip, direction, span))


def _stacked(strips: Sequence[Strip | None]) -> tuple[Float[np.ndarray, "C S 2"], Bool[np.ndarray, "C S"]]:
    """Middles of all views' slices, and which there are."""
    pixels, seen = np.zeros((len(strips), SLICES, 2)), np.zeros((len(strips), SLICES), bool)
    for camera, strip in enumerate(strips):
        if strip is not None:
            pixels[camera], seen[camera] = strip.middle, strip.width > 0
    return pixels, seen


def _common_tip(
    scene: _Scene, strips: Sequence[Strip | None], axis: LimbAxis, own: Mapping[int, np.ndarray]
) -> tuple[Float[np.ndarray, "3"], float, dict[int, np.ndarray]] | None:
    """The place on which the views' candidates agree, the farthest out of those that as many views support.

    Returns:
        The place (m), the rms distance of its rays (m), and its pixel in the views that support it.
    """
    ends = np.asarray(scene.rig.project(np.stack([axis.near, axis.far])))
    along = ends[0] - ends[1]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    scale = scene.focal / np.asarray(scene.rig.depth(axis.near))
    views, pixels = [], []
    for camera, (crop, strip) in enumerate(zip(scene.crops, strips)):
        if crop is not None and strip is not None:
            tips = find_tips(crop, ends[0, camera], along[camera], float(scale[camera]))
            tips += [own[camera]] if camera in own else []
            views += [camera] * len(tips)
            pixels += tips
    if len(set(views)) < 2:
        return None
    count, most = len(views), MOST_TIPS * len(strips)
    padded, place = np.zeros((most, 1, 2)), np.zeros(most, np.int64)
    padded[:count, 0], place[:count] = pixels, views
    rays = np.asarray(rays_through(scene.rig, padded, place))[:count, 0]
    ahead, beside = np.asarray(axis.direction), (np.asarray(axis.near), BEND_M)
    found = common_point(scene.positions[views], rays, np.array(views), ahead, beside=beside)
    if found is None:
        return None
    tip, spread, members = found
    return tip, spread, {views[m]: pixels[m] for m in members}


def _views(scene: _Scene, measured: _Measured) -> list[ArmView]:
    """What each view says of the axis, with tips still to be found."""
    ends = np.asarray(scene.rig.project(np.stack([measured.axis.near, measured.axis.far])))
    return [_view(scene, measured, camera, ends[:, camera]) for camera in range(len(scene.crops))]


def _view(scene: _Scene, measured: _Measured, camera: int, ends: Float[np.ndarray, "2 2"]) -> ArmView:
    promised, strip = measured.promised, measured.strips[camera]
    nothing = ArmView(ArmReason.FOUND, np.zeros(2), None, 0.0, float(promised.angle[camera]))
    middle = promised.pixels[camera].mean(axis=0)
    if not promised.ahead[camera] or (middle < 0).any() or (middle > scene.sizes[camera] - 1).any():
        return replace(nothing, reason=ArmReason.OUTSIDE)
    if scene.crops[camera] is None:
        return replace(nothing, reason=ArmReason.NO_PERSON)
    if nothing.angle < FORESHORTENED:
        return replace(nothing, reason=ArmReason.FORESHORTENED)
    if strip is None:
        return replace(nothing, reason=ArmReason.HIDDEN)
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    off = (strip.middle[strip.width > 0] - ends[0]) @ np.array([-along[1], along[0]])
    rms = float(np.sqrt(np.mean(off**2)))
    if rms > AGREES * float(promised.sigma_px[camera]):
        return replace(nothing, reason=ArmReason.DISAGREES, rms_px=rms)
    return replace(nothing, strip=strip, rms_px=rms)
