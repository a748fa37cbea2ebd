"""Scores of one gesture: the default and the thesis's method on the same images, against the truth; used by
`scored_sessions.py`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import jax
import numpy as np

from jaxpoint.body.arm import ArmReason, PointingArm
from jaxpoint.body.limb_arms import find_arm
from jaxpoint.body.strip_pixels import StripPixels
from jaxpoint.config.person import MarkerSettings, ThesisSettings
from jaxpoint.detection.person.marker_regions import MarkerModel
from jaxpoint.detection.person.thesis_regions import thesis_finger
from jaxpoint.simulate.mesh import PARTS_A_PERSON
from jaxpoint.simulate.simulated_session import SimulatedFrame
from jaxpoint.simulate.truth import ARM
from marker_tip import taught
from session_pixels import GesturePixels

COVERED = 0.3  # of the visible forearm and hand that a right region must hold


@dataclass(frozen=True)
class ViewScore:
    """One view of one frame of a hold. Regions are "right", "wrong" or "none"."""

    seed: int
    gesture: int
    frame: int
    camera: int
    visible: float  # share of the forearm
    angle_deg: float  # between forearm and line of sight
    finger_visible: float
    default: str
    default_reason: str
    thesis: str
    thesis_finger: str  # "no_cap" where the person wears none, or too little of it showed to teach its colour
    detect_ms: float


@dataclass(frozen=True)
class GestureScore:
    """One hold. Errors are NaN where there is no answer."""

    seed: int
    gesture: int
    person: int
    law: str
    sleeve: str
    clothes_like_skin: str
    stature_m: float
    tone: float
    usable_views: int  # median over the hold
    frames: int
    answered: int  # frames with an axis
    direction_deg: float  # of the hold's median axis against the true one
    two_views_deg: float  # direction from the two and from the three views that see most of the forearm; NaN where
    three_views_deg: float  # fewer than three are usable
    tip_m: float
    head_m: tuple[float, ...]  # of every frame
    arm_ms: float  # of all views of a frame together


def score(pixels: GesturePixels) -> tuple[list[ViewScore], GestureScore]:
    """Both methods over the hold of one gesture."""
    arms, cap = _arms_of(pixels), _cap(pixels)
    views = [
        _view_score(pixels, pixels.frames[moment, camera], arms.get(moment), cap)
        for moment in pixels.held
        for camera in range(len(pixels.seen))
    ]
    with jax.enable_x64(True):
        fewer = _with_fewer_views(pixels)
    return views, _gesture_score(pixels, arms, views, fewer)


def _with_fewer_views(pixels: GesturePixels) -> tuple[float, float]:
    """Direction of the hold, degrees off, from the two and from the three views that see most of the arm alone."""
    rig, seen, heads = pixels.session.rig, pixels.seen, pixels.following.tracking.heads
    axes: dict[int, list[np.ndarray]] = {2: [], 3: []}
    true_axes = []
    for moment in pixels.held:
        row, truth = pixels.moments.index(moment), pixels.joints(moment)
        usable = _usable(pixels, moment)
        off = np.linalg.norm(heads.positions[row] - truth["head"], axis=1)
        who = int(np.where(heads.present[row], off, np.inf).argmin()) if heads.present[row].any() else -1
        if len(usable) < 3 or who < 0 or off[who] > 0.3:
            continue
        head = heads.positions[row, who]
        head_px = np.asarray(rig.project(head))
        sightings = pixels.following.sightings[row, who]
        found = {}
        for count in axes:
            crops = [
                seen[c].person(sightings[c]) if c in usable[:count] and sightings[c] >= 0 else None
                for c in range(len(seen))
            ]
            found[count] = find_arm(rig, crops, head, head_px)
        if found[2] is not None and found[3] is not None:
            for count in axes:
                axes[count].append(found[count].direction)
            true_axes.append(_forearm(truth, pixels.gesture.hand))
    if not true_axes:
        return np.nan, np.nan
    return _apart(axes[2], true_axes), _apart(axes[3], true_axes)


def _usable(pixels: GesturePixels, moment: int) -> list[int]:
    """Cameras that see enough of the forearm from the side, those that see most of it first."""
    truth = {c: _truth(pixels, pixels.frames[moment, c]) for c in range(len(pixels.seen))}
    usable = [c for c, v in truth.items() if v.forearm_visible >= 0.6 and v.forearm_angle_deg > 45]
    return sorted(usable, key=lambda c: -truth[c].forearm_visible)


def _truth(pixels: GesturePixels, frame: SimulatedFrame):
    return next(view for view in frame.views if view.person == pixels.gesture.person)


def _forearm(joints: dict[str, np.ndarray], hand: str) -> np.ndarray:
    axis = joints[f"{hand}_wrist"] - joints[f"{hand}_elbow"]
    return axis / np.linalg.norm(axis)


def _apart(axes: Sequence[np.ndarray], true_axes: Sequence[np.ndarray]) -> float:
    """Angle between the median directions, degrees."""
    return float(np.degrees(np.arccos(np.clip(_middle(axes) @ _middle(true_axes), -1, 1))))


def _arms_of(pixels: GesturePixels) -> dict[int, PointingArm]:
    """The arm of the gesture's person at each moment: of the head track nearest to the true head."""
    arms = {}
    following = pixels.following
    heads = following.tracking.heads
    for row, moment in enumerate(pixels.moments):
        truth = pixels.joints(moment)
        best = None
        for (at, person), arm in following.arms.items():
            if at == row and arm is not None:
                off = float(np.linalg.norm(heads.positions[row, person] - truth["head"]))
                if off < 0.3 and (best is None or off < best[0]):
                    best = off, arm
        if best is not None:
            arms[moment] = best[1]
    return arms


def _cap(pixels: GesturePixels) -> MarkerModel | None:
    """The colour of the cap, learnt before the hold from clicks as a user would make them, with the thesis's gates."""
    if _who(pixels).cap is None:
        return None
    frames = [pixels.frames[pixels.moments[0], camera] for camera in range(len(pixels.seen))]
    return taught(frames, pixels.gesture, MarkerSettings(gates="fixed"))


def _who(pixels: GesturePixels):
    return next(a.person for a in pixels.session.play.actors if a.person.number == pixels.gesture.person)


def _view_score(
    pixels: GesturePixels, frame: SimulatedFrame, arm: PointingArm | None, cap: MarkerModel | None
) -> ViewScore:
    gesture, truth, labels = pixels.gesture, _truth(pixels, frame), frame.labels
    parts = np.array(ARM[gesture.hand]) + PARTS_A_PERSON * gesture.person
    own = None if arm is None else arm.views[frame.camera]
    region = None
    if arm is not None and own is not None and own.reason == ArmReason.FOUND:
        assert isinstance(arm.pixels, StripPixels)
        region = _polygon(arm.pixels.strip(frame.camera), own.tip, labels.shape)
    person, found = pixels.largest[frame.frame, frame.camera], pixels.forearms[frame.frame, frame.camera]
    forearm = None if found is None else _mask_of(found, labels.shape)
    finger = None
    if person is not None and cap is not None:
        finger = _mask_of(thesis_finger(frame.image, person, cap, ThesisSettings()), labels.shape)
    return ViewScore(
        pixels.session.seed, gesture.number, frame.frame, frame.camera, truth.forearm_visible, truth.forearm_angle_deg,
        truth.finger_visible, _judged(region, labels, parts), "no_arm" if own is None else own.reason.name.lower(),
        _judged(forearm, labels, parts), "no_cap" if cap is None else _judged_finger(finger, labels, parts[2:]),
        float(pixels.watch_ms[frame.camera]),
    )  # fmt: skip


def _judged(region: np.ndarray | None, labels: np.ndarray, parts: np.ndarray) -> str:
    """Right where most of the region is the arm, and it holds enough of the visible forearm and hand."""
    if region is None or not region.any():
        return "none"
    arm, forearm = np.isin(labels, parts), np.isin(labels, parts[1:])
    held = (region & forearm).sum() >= COVERED * max(1, forearm.sum())
    return "right" if 2 * (region & arm).sum() >= region.sum() and held else "wrong"


def _judged_finger(region: np.ndarray | None, labels: np.ndarray, parts: np.ndarray) -> str:
    """Right where most of the region is the hand that points."""
    if region is None or not region.any():
        return "none"
    return "right" if 2 * (region & np.isin(labels, parts)).sum() >= region.sum() else "wrong"


def _polygon(strip, tip, shape) -> np.ndarray:
    """The pixels between a strip's edges, from its base on to the tip, where it narrows to a third."""
    held = strip.width > 0
    middle, width = strip.middle[held], strip.width[held]
    middle, width = np.concatenate([[tip], middle]), np.concatenate([[width[0] / 3], width])
    along = middle[-1] - middle[0]
    along /= max(np.hypot(*along), 1e-9)
    side = np.array([-along[1], along[0]])
    edges = np.concatenate([middle + width[:, None] / 2 * side, (middle - width[:, None] / 2 * side)[::-1]])
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.round(edges).astype(np.int32)], 1)
    return mask > 0


def _mask_of(region, shape) -> np.ndarray | None:
    """A thesis region as a mask of the whole image; None where nothing was found."""
    if region.mask is None or not region.mask.size:
        return None
    x, y, width, height = region.region.box
    mask = np.zeros(shape, bool)
    mask[y : y + height, x : x + width] = region.mask
    return mask


def _gesture_score(
    pixels: GesturePixels, arms: dict[int, PointingArm], views: list[ViewScore], fewer: tuple[float, float]
) -> GestureScore:
    gesture, who = pixels.gesture, _who(pixels)
    usable = [sum(v.visible >= 0.6 and v.angle_deg > 45 for v in views if v.frame == m) for m in pixels.held]
    axes, true_axes, tips, heads = [], [], [], []
    tracked = pixels.following.tracking.heads
    for moment in pixels.held:
        truth = pixels.joints(moment)
        row = pixels.moments.index(moment)
        places = tracked.positions[row][tracked.present[row]]
        if len(places):
            heads.append(float(np.linalg.norm(places - truth["head"], axis=1).min()))
        if moment in arms:
            axes.append(arms[moment].direction)
            true_axes.append(_forearm(truth, gesture.hand))
            tips.append(float(np.linalg.norm(arms[moment].tip - truth[f"{gesture.hand}_tip"])))
    direction = _apart(axes, true_axes) if axes else np.nan
    return GestureScore(
        pixels.session.seed, gesture.number, gesture.person, gesture.law, who.sleeve, who.clothes_like_skin,
        who.stature_m, who.tone, int(np.median(usable)), len(pixels.held), len(axes), direction, fewer[0], fewer[1],
        float(np.median(tips)) if tips else np.nan, tuple(heads), pixels.arm_ms,
    )  # fmt: skip


def _middle(directions: Sequence[np.ndarray]) -> np.ndarray:
    """Median direction of a hold."""
    middle = np.median(np.array(directions), axis=0)
    return middle / np.linalg.norm(middle)
