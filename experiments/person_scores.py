"""Scores of one simulated session: the default and the thesis's method on the same images, against the truth.

Used by `person_evaluation.py`. Images stream from the renderer to the detectors and are never kept.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import cv2
import jax
import numpy as np

from jaxpoint.config.person import PersonSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.detect.marker import MarkerModel
from jaxpoint.detect.motion import learn_threshold, motion_between
from jaxpoint.detect.person import PersonWatch
from jaxpoint.detect.silhouette import foreground, learn_background, silhouettes
from jaxpoint.detect.thesis import thesis_finger, thesis_forearm
from jaxpoint.person.arms import ArmReason, PointingArm, find_arm
from jaxpoint.person.following import follow
from jaxpoint.person.views import watch
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Part
from jaxpoint.simulate.session import SimulatedFrame, SimulatedSession, simulate_session
from marker_tip import taught

LEAD = 4  # frames before the hold: enough for a head track to be confirmed
COVERED = 0.3  # of the visible forearm and hand that a right region must hold
ARM = {
    "left": (Part.LEFT_UPPER_ARM, Part.LEFT_FOREARM, Part.LEFT_HAND, Part.LEFT_FINGER),
    "right": (Part.RIGHT_UPPER_ARM, Part.RIGHT_FOREARM, Part.RIGHT_HAND, Part.RIGHT_FINGER),
}


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


def score_session(
    settings: SimulationSettings, seed: int, person: PersonSettings | None = None, every: int = 1
) -> tuple[list[ViewScore], list[GestureScore]]:
    """Run both methods over the holds of one session, of which every so many frames are looked at."""
    person = person or PersonSettings()
    session = simulate_session(settings, seed)
    cameras = range(len(session.viewpoints))
    rooms = [learnt(session, camera, person) for camera in cameras]
    focal = np.asarray(session.rig.cameras.focal).mean(axis=1)
    views, scores = [], []
    for gesture in session.gestures:
        first = session.frame_at(gesture.hold_first_s) + 1
        held = range(first, session.frame_at(gesture.hold_last_s), every)
        moments = [*range(first - LEAD, first), *held]
        shown: dict[tuple[int, int], SimulatedFrame] = {}
        seen, spent = [], np.zeros(len(cameras))
        for camera in cameras:
            frames = [session.frame(moment, camera) for moment in moments]
            shown |= {(frame.frame, camera): frame for frame in frames}
            size = (frames[0].image.shape[1], frames[0].image.shape[0])
            watcher = PersonWatch(rooms[camera][0], rooms[camera][1], float(focal[camera]), person)
            started = time.perf_counter()
            seen.append(watch(((i, f.image) for i, f in enumerate(frames)), len(frames), size, watcher))
            spent[camera] = 1e3 * (time.perf_counter() - started) / len(frames)
        times = np.array([session.time_of(moment) for moment in moments])
        started = time.perf_counter()
        with jax.enable_x64(True):
            following = follow(session.rig, seen, times, frame_ids=np.array(moments))
        arm_ms = 1e3 * (time.perf_counter() - started) / len(moments)
        arms = _arms_of(following, session, gesture, moments)
        cap = _cap(session, gesture, [shown[moments[0], camera] for camera in cameras], person)
        for moment in held:
            for camera in cameras:
                frame, arm = shown[moment, camera], arms.get(moment)
                views.append(_view_score(session, gesture, frame, arm, rooms[camera][0], cap, person, spent))
        fewer = _with_fewer_views(session, gesture, held, moments, following, seen, shown)
        scores.append(_gesture_score(session, gesture, held, arms, following, moments, views, fewer, arm_ms))
    return views, scores


def _with_fewer_views(session, gesture, held, moments, following, seen, shown) -> tuple[float, float]:
    """Direction of the hold, degrees off, from the two and from the three best usable views alone."""
    heads = following.tracking.heads
    axes: dict[int, list[np.ndarray]] = {2: [], 3: []}
    true_axes = []
    for moment in held:
        row, truth = moments.index(moment), _joints(session, gesture, moment)
        usable = _usable(shown, gesture, moment, len(seen))
        off = np.linalg.norm(heads.positions[row] - truth["head"], axis=1)
        who = int(np.where(heads.present[row], off, np.inf).argmin()) if heads.present[row].any() else -1
        if len(usable) < 3 or who < 0 or off[who] > 0.3:
            continue
        head = heads.positions[row, who]
        pixels = np.asarray(session.rig.project(head))
        sightings = following.sightings[row, who]
        found = {}
        for count in axes:
            crops = [
                seen[c].crop(sightings[c]) if c in usable[:count] and sightings[c] >= 0 else None
                for c in range(len(seen))
            ]
            found[count] = find_arm(session.rig, crops, head, pixels)
        if found[2] is not None and found[3] is not None:
            for count in axes:
                axes[count].append(found[count].direction)
            true_axes.append(_forearm(truth, gesture.hand))
    if not true_axes:
        return np.nan, np.nan
    return _apart(axes[2], true_axes), _apart(axes[3], true_axes)


def _usable(shown, gesture, moment: int, cameras: int) -> list[int]:
    """Cameras that see enough of the forearm from the side, those that see most of it first."""
    truth = {
        camera: next(v for v in shown[moment, camera].views if v.person == gesture.person) for camera in range(cameras)
    }
    usable = [c for c, v in truth.items() if v.forearm_visible >= 0.6 and v.forearm_angle_deg > 45]
    return sorted(usable, key=lambda c: -truth[c].forearm_visible)


def _forearm(joints: dict[str, np.ndarray], hand: str) -> np.ndarray:
    axis = joints[f"{hand}_wrist"] - joints[f"{hand}_elbow"]
    return axis / np.linalg.norm(axis)


def _apart(axes: Sequence[np.ndarray], true_axes: Sequence[np.ndarray]) -> float:
    """Angle between the median directions, degrees."""
    return float(np.degrees(np.arccos(np.clip(_middle(axes) @ _middle(true_axes), -1, 1))))


def learnt(session: SimulatedSession, camera: int, person: PersonSettings):
    """Background and motion threshold of one camera, from the empty room."""
    images = [session.empty(frame, camera) for frame in range(session.settings.empty_frames)]
    counts = np.array([motion_between(a, b, person.motion).edges for a, b in pairwise(images)])
    return learn_background(images, person.background), learn_threshold(counts, person.motion)


def _arms_of(following, session, gesture, moments) -> dict[int, PointingArm]:
    """The arm of the gesture's person at each moment: of the head track nearest to the true head."""
    arms = {}
    heads = following.tracking.heads
    for row, moment in enumerate(moments):
        truth = _joints(session, gesture, moment)
        best = None
        for (at, person), arm in following.arms.items():
            if at == row and arm is not None:
                off = float(np.linalg.norm(heads.positions[row, person] - truth["head"]))
                if off < 0.3 and (best is None or off < best[0]):
                    best = off, arm
        if best is not None:
            arms[moment] = best[1]
    return arms


def _joints(session, gesture, moment) -> dict[str, np.ndarray]:
    time_s = session.time_of(moment)
    actor = next(a for a in session.present(time_s) if a.person.number == gesture.person)
    return actor.joints(time_s)


def _cap(session, gesture, frames, person: PersonSettings) -> MarkerModel | None:
    """The colour of the cap, learnt before the hold from clicks as a user would make them, with the thesis's gates."""
    who = next(a.person for a in session.play.actors if a.person.number == gesture.person)
    if who.cap is None:
        return None
    return taught(frames, gesture, replace(person, marker=replace(person.marker, gates="fixed")))


def _view_score(session, gesture, frame, arm, room, cap, person, spent) -> ViewScore:
    truth = next(v for v in frame.views if v.person == gesture.person)
    parts = np.array(ARM[gesture.hand]) + PARTS_A_PERSON * gesture.person
    labels = frame.labels
    own = None if arm is None else arm.views[frame.camera]
    region = None
    if own is not None and own.reason == ArmReason.FOUND:
        region = _polygon(own.strip, own.tip, labels.shape)
    found = silhouettes(foreground(frame.image, room, person.background), person.silhouette)
    forearm = finger = None
    if found:
        forearm = _mask_of(thesis_forearm(frame.image, found[0], person.thesis), labels.shape)
        if cap is not None:
            finger = _mask_of(thesis_finger(frame.image, found[0], cap, person.thesis), labels.shape)
    return ViewScore(
        session.seed, gesture.number, frame.frame, frame.camera, truth.forearm_visible, truth.forearm_angle_deg,
        truth.finger_visible, _judged(region, labels, parts), "no_arm" if own is None else own.reason.name.lower(),
        _judged(forearm, labels, parts), "no_cap" if cap is None else _judged_finger(finger, labels, parts[2:]),
        float(spent[frame.camera]),
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


def _gesture_score(session, gesture, held, arms, following, moments, views, fewer, arm_ms) -> GestureScore:
    who = next(a.person for a in session.play.actors if a.person.number == gesture.person)
    own = [v for v in views if v.gesture == gesture.number and v.seed == session.seed]
    usable = [sum(v.visible >= 0.6 and v.angle_deg > 45 for v in own if v.frame == moment) for moment in held]
    axes, true_axes, tips, heads = [], [], [], []
    tracked = following.tracking.heads
    for moment in held:
        truth = _joints(session, gesture, moment)
        row = moments.index(moment)
        places = tracked.positions[row][tracked.present[row]]
        if len(places):
            heads.append(float(np.linalg.norm(places - truth["head"], axis=1).min()))
        if moment in arms:
            axes.append(arms[moment].direction)
            true_axes.append(_forearm(truth, gesture.hand))
            tips.append(float(np.linalg.norm(arms[moment].tip - truth[f"{gesture.hand}_tip"])))
    direction = _apart(axes, true_axes) if axes else np.nan
    return GestureScore(
        session.seed, gesture.number, gesture.person, gesture.law, who.sleeve, who.clothes_like_skin, who.stature_m,
        who.tone, int(np.median(usable)), len(held), len(axes), direction, fewer[0], fewer[1],
        float(np.median(tips)) if tips else np.nan, tuple(heads), arm_ms,
    )  # fmt: skip


def _middle(directions: Sequence[np.ndarray]) -> np.ndarray:
    """Median direction of a hold."""
    middle = np.median(np.array(directions), axis=0)
    return middle / np.linalg.norm(middle)


def as_rows(scores: Sequence[ViewScore] | Sequence[GestureScore]) -> list[dict]:
    """For JSON."""
    return [asdict(score) for score in scores]
