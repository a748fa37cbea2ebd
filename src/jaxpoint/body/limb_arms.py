"""The arm of one person in one frame by its outlines: found over all views, measured in each, put together in 3-D."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.body.arm import ArmReason, ArmView, PointingArm
from jaxpoint.body.arm_features import arm_features
from jaxpoint.body.contradicting_views import looks_past
from jaxpoint.body.limb_association import Arm, LimbRays, agreeing_views, associate, common_point, stretch
from jaxpoint.body.limb_axis import LimbAxis
from jaxpoint.body.predicted_axis import NEAREST_M, PredictedAxis, predict_axis, rays_through, strips_axis
from jaxpoint.body.stature import ELBOW_OF_STATURE, HEAD_M, SPAN_OF_STATURE, limb_span
from jaxpoint.body.strip_pixels import stack_strips, strip_pixels
from jaxpoint.body.strips import Strip, beside_one_edge, cut_strip
from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.limb_slices import SLICES, LimbEdges, LimbEnd
from jaxpoint.evidence.person_evidence import AbstractPersonEvidence

People = Sequence[AbstractPersonEvidence | None]
"""What each view shows of one person; None where it shows nothing."""

VIEW_M = 0.04  # by which an arm may be stretched out less for each view more that supports it
SURE = 3.5  # log odds of an arm beyond which no other is looked for
LEAST = -1.0  # log odds of the least likely arm that is an answer
ROUNDS = 3  # of predicting, measuring, fitting
MIN_SLICES = 6  # of a view that counts
ONE_EDGE_SLICES = 10  # of a view in which only one of the limb's edges is seen
FORESHORTENED = np.deg2rad(15.0)  # a limb nearer to the line of sight does not show its direction (thesis 7.3)
HANGS_M = 0.3  # from the body's upright axis: a tip that is nearer does not point
BEND_M = 0.14  # from the forearm's axis to the tip of a bent hand; farther out is another limb's
SIGMA = np.deg2rad(10.0)  # of the least certain direction that is used
AGREES = 2.5  # a view's middle line lies within so many of these errors of the common axis
MOST_TIPS = 3  # candidates of a tip in one view
MOST_LIMBS = 12  # long ends of one view that are looked at
_OUTLINE_WEIGHT = 0.6
_CONVERGED = 1.2
_OTHER_START = np.deg2rad(4.0)


@dataclass(frozen=True)
class _Scene:
    """What all C cameras see of one person in one frame."""

    rig: CameraRig
    people: People
    positions: Float[np.ndarray, "C 3"]  # m, of the cameras
    focal: Float[np.ndarray, " C"]  # px
    sizes: Int[np.ndarray, "C 2"]  # px, of the images


@dataclass(frozen=True)
class _Measured:
    """An axis, the strips that were cut where it was expected, and where that was."""

    axis: LimbAxis
    strips: list[Strip | None]
    predicted: PredictedAxis

    @property
    def agreement(self) -> float:
        """Slices that count, less where they scatter."""
        return float(self.axis.slices.sum()) / (1 + float(self.axis.rms))

    @property
    def converged(self) -> bool:
        """Whether three views' slices lie on the axis: no other start can do better."""
        return bool((self.axis.slices >= MIN_SLICES).sum() >= 3 and self.axis.rms < _CONVERGED)


def find_arm(
    rig: CameraRig, people: People, head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> PointingArm | None:
    """The arm with which a person points, by its features; None where no limb is like one.

    Limbs are measured in the order of their reach, until one is surely an arm that points. Computes in the precision
    that JAX is set to; `follow` sets it to float64.

    Args:
        rig: the cameras.
        people: what each view shows of the person; None where it shows nothing.
        head: centre of the head, m.
        head_px: the same in each image.
    """
    if _count_outlined(people) < 2:
        return None
    best, most = None, LEAST
    for limb in measure_limbs(rig, people, head, head_px):
        log_odds = limb.features.log_odds if limb.features is not None else LEAST
        if log_odds > most:
            best, most = limb, log_odds
        if most > SURE:
            break
    return best


def measure_limbs(
    rig: CameraRig, people: People, head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> Iterator[PointingArm]:
    """All limbs of a person that two views or more agree on and that do not hang, the farthest reaching first.

    The arguments are those of `find_arm`.
    """
    scene = _scene(rig, people)
    limbs, cameras = _limbs(scene, head, head_px)
    arms = associate(_rays_of(scene, limbs, cameras), head)
    arms.sort(key=lambda arm: -stretch(arm.tip, head) - VIEW_M * arm.support)
    for arm in arms:
        if stretch(arm.tip, head) >= HANGS_M:
            own = {cameras[member]: limbs[member].tip for member in arm.members}
            measured = _measure_arm(scene, arm, own, head)
            if measured is not None:
                yield measured


def find_arm_again(
    rig: CameraRig, people: People, head: Float[np.ndarray, "3"], other: PointingArm, moved: np.ndarray
) -> PointingArm | None:
    """The arm where that of a neighbouring frame predicts it; None where the views do not confirm it.

    Args:
        rig: the cameras.
        people: what each view shows of the person; None where it shows nothing.
        head: centre of the head, m.
        other: the arm a frame before or after.
        moved: by which the head has moved since, m.
    """
    if _count_outlined(people) < 2:
        return None
    ahead, near, tip = other.direction, np.asarray(other.axis.near), other.tip
    foot = near + ((tip - near) @ ahead) * ahead
    arm = Arm((), tip + moved, ahead, 0.0, other.tip_spread, foot + moved)
    return _measure_arm(_scene(rig, people), arm, {}, head)


def _count_outlined(people: People) -> int:
    """How many views can measure a limb."""
    return sum(person is not None and person.outlined for person in people)


def _scene(rig: CameraRig, people: People) -> _Scene:
    focal = np.asarray(rig.cameras.focal).mean(axis=1)
    return _Scene(rig, people, np.asarray(rig.positions), focal, np.asarray(rig.image_sizes))


def _limbs(
    scene: _Scene, head: Float[np.ndarray, "3"], head_px: Float[np.ndarray, "C 2"]
) -> tuple[list[LimbEnd], list[int]]:
    """Long ends of all views, and the camera of each."""
    limbs, cameras = [], []
    depth = np.asarray(scene.rig.depth(head))
    for camera, person in enumerate(scene.people):
        if person is None or depth[camera] < NEAREST_M:
            continue
        scale = float(scene.focal[camera] / depth[camera])
        found = person.limb_ends(scale, head_px[camera], HEAD_M * scale)[:MOST_LIMBS]
        limbs += found
        cameras += [camera] * len(found)
    return limbs, cameras


def _rays_of(scene: _Scene, limbs: Sequence[LimbEnd], cameras: Sequence[int]) -> LimbRays:
    """All long ends as rays; padded to one shape, so that one program does for every frame."""
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


def _measure_arm(
    scene: _Scene, arm: Arm, own: Mapping[int, np.ndarray], head: Float[np.ndarray, "3"]
) -> PointingArm | None:
    """The arm, its edges measured across the predicted axis in every view; the start with the most agreement wins.

    `own` are the tips that single views gave it, by camera.
    """
    span = limb_span(head)
    tries: list[_Measured] = []
    for start in _starts(arm):
        tries.append(_refine(scene, arm.foot, start, span, ROUNDS))
        if tries[-1].converged:
            break
    best = max(tries, key=lambda one: one.agreement)
    tip, _, _ = _common_tip(scene, best.strips, best.axis, own) or (arm.tip, arm.spread, {})
    # The span counts from the tip, which is known better now; where the wrist is bent, it lies beside the axis.
    ahead, near = np.asarray(best.axis.direction), np.asarray(best.axis.near)
    foot = near + ((tip - near) @ ahead) * ahead
    best = _refine(scene, foot, ahead, span, 2)
    views = _views(scene, best)
    strips = [strip if view.reason == ArmReason.FOUND else None for view, strip in zip(views, best.strips)]
    if sum(strip is not None for strip in strips) < 2:
        return None
    axis = _fit(scene, strips, foot, np.asarray(best.axis.direction), span)
    tip, spread, seen = _common_tip(scene, strips, axis, own) or (arm.tip, arm.spread, {})
    if not _is_limb(tip, axis):
        return None
    tips = np.asarray(scene.rig.project(tip))
    tips = np.array([seen.get(camera, pixel) for camera, pixel in enumerate(tips)])
    views = [replace(v, tip=tips[c]) if v.reason == ArmReason.FOUND else v for c, v in enumerate(views)]
    past = int(looks_past(scene.people, np.asarray(best.predicted.pixels), scene.sizes).sum())
    forearm = float(span[0]), float(span[1] * ELBOW_OF_STATURE / SPAN_OF_STATURE[1])
    features = arm_features(scene.rig, scene.people, head, axis, tip, strips, forearm, past)
    pixels = strip_pixels(strips, tips, axis, span)
    return PointingArm(tip, spread, axis, tuple(views), features.stretch, pixels, features)


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


def _refine(
    scene: _Scene,
    tip: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    span: Float[np.ndarray, "2"],
    rounds: int,
) -> _Measured:
    """Predict, measure, agree, fit; and again. Views that do not agree keep their strips, but are not used."""
    on_axis = tip
    for _ in range(rounds):
        predicted = jax.tree.map(np.asarray, predict_axis(scene.rig, on_axis, direction, span))
        edges = [_edges(person, predicted, camera) for camera, person in enumerate(scene.people)]
        strips = [_strip(own) for own in edges]
        agreed = _agreeing_views(scene, strips, predicted, on_axis, direction)
        used = strips
        if agreed is not None:
            used, direction = [strip if keep else None for strip, keep in zip(strips, agreed[0])], agreed[1]
        axis = _fit(scene, used, on_axis, direction, span)
        if agreed is not None:
            added = _strips_beside_one_edge(scene, edges, used, predicted, axis)
            if added:
                strips, used = ([added.get(c, strip) for c, strip in enumerate(own)] for own in (strips, used))
                axis = _fit(scene, used, on_axis, np.asarray(axis.direction), span)
        direction = np.asarray(axis.direction)
        on_axis = np.asarray(axis.near) + span[0] * direction
    return _Measured(axis, strips, predicted)


def _edges(person: AbstractPersonEvidence | None, predicted: PredictedAxis, camera: int) -> LimbEdges | None:
    """The limb's edges in one view; None where it cannot show them."""
    if person is None or not predicted.ahead[camera] or predicted.angle[camera] < FORESHORTENED:
        return None
    scale = float(predicted.pixels_a_metre[camera])
    return person.edges_along(np.asarray(predicted.pixels[camera]), np.asarray(predicted.across[camera]), scale)


def _strip(edges: LimbEdges | None) -> Strip | None:
    """The limb between its edges; None where too few slices have both."""
    strip = None if edges is None else cut_strip(edges)
    return strip if strip is not None and (strip.width > 0).sum() >= MIN_SLICES else None


def _strips_beside_one_edge(
    scene: _Scene,
    edges: Sequence[LimbEdges | None],
    used: Sequence[Strip | None],
    predicted: PredictedAxis,
    axis: LimbAxis,
) -> dict[int, Strip]:
    """Strips of views that are not used yet, by camera: beside one edge, with the width that the other views have."""
    width = _common_width(used, predicted)
    ends = np.asarray(scene.rig.project(np.stack([axis.near, axis.far])))
    added = {}
    for camera, own in enumerate(edges):
        if own is None or used[camera] is not None:
            continue
        within = AGREES * float(predicted.sigma_px[camera])
        strip = beside_one_edge(own, width * own.pixels_a_metre, _offsets(own, ends[:, camera]), within)
        if strip is not None and (strip.width > 0).sum() >= ONE_EDGE_SLICES:
            added[camera] = strip
    return added


def _common_width(strips: Sequence[Strip | None], predicted: PredictedAxis) -> Float[np.ndarray, " S"]:
    """Width of the limb at each slice, m: the middle of all views that have it there; between, straight on."""
    widths = np.stack(
        [strip.width / predicted.pixels_a_metre[camera] for camera, strip in enumerate(strips) if strip is not None]
    )
    some = (widths > 0).any(axis=0)
    middle = [np.median(column[column > 0]) for column in widths[:, some].T]
    return np.interp(np.arange(SLICES), np.flatnonzero(some), middle)


def _offsets(edges: LimbEdges, ends: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, " S"]:
    """Where the line through two pixels crosses each slice, px from the predicted axis."""
    along, gap = ends[1] - ends[0], edges.axis - ends[0]
    crossing = along[0] * edges.across[1] - along[1] * edges.across[0]  # small only where the line runs along a slice
    return (along[1] * gap[:, 0] - along[0] * gap[:, 1]) / (np.sign(crossing) * max(abs(crossing), 1e-6))


def _agreeing_views(
    scene: _Scene, strips: Sequence[Strip | None], predicted: PredictedAxis, tip: np.ndarray, direction: np.ndarray
) -> tuple[Bool[np.ndarray, " C"], Float[np.ndarray, "3"]] | None:
    pixels, width = stack_strips(strips)
    rays = np.asarray(rays_through(scene.rig, pixels, np.arange(len(strips))))
    return agreeing_views(scene.positions, rays, width > 0, scene.focal / predicted.sigma_px, tip, direction, AGREES)


def _fit(
    scene: _Scene, strips: Sequence[Strip | None], tip: np.ndarray, direction: np.ndarray, span: np.ndarray
) -> LimbAxis:
    pixels, width = stack_strips(strips)
    return jax.tree.map(np.asarray, strips_axis(scene.rig, pixels, width > 0, tip, direction, span))


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
    for camera, (person, strip) in enumerate(zip(scene.people, strips)):
        if person is not None and strip is not None:
            tips = person.tips_beyond(ends[0, camera], along[camera], float(scale[camera]))
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
    """What each view shows of the axis, with tips still to be found."""
    ends = np.asarray(scene.rig.project(np.stack([measured.axis.near, measured.axis.far])))
    return [_view(scene, measured, camera, ends[:, camera]) for camera in range(len(scene.people))]


def _view(scene: _Scene, measured: _Measured, camera: int, ends: Float[np.ndarray, "2 2"]) -> ArmView:
    predicted, strip = measured.predicted, measured.strips[camera]
    nothing = ArmView(ArmReason.FOUND, np.zeros(2), np.zeros(2), 0.0, float(predicted.angle[camera]))
    middle = predicted.pixels[camera].mean(axis=0)
    if not predicted.ahead[camera] or (middle < 0).any() or (middle > scene.sizes[camera] - 1).any():
        return replace(nothing, reason=ArmReason.OUTSIDE)
    if scene.people[camera] is None:
        return replace(nothing, reason=ArmReason.NO_PERSON)
    if nothing.angle < FORESHORTENED:
        return replace(nothing, reason=ArmReason.FORESHORTENED)
    if strip is None:
        return replace(nothing, reason=ArmReason.HIDDEN)
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    off = (strip.middle[strip.width > 0] - ends[0]) @ np.array([-along[1], along[0]])
    rms = float(np.sqrt(np.mean(off**2)))
    if rms > AGREES * float(predicted.sigma_px[camera]):
        return replace(nothing, reason=ArmReason.DISAGREES, rms_px=rms)
    return replace(nothing, base=strip.base, rms_px=rms)
