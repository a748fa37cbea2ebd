"""One simulated session from pixels to the joints of its gestures, and to the thesis's lines; used by
`pointing_evaluation.py`. Images stream from the renderer to the detectors and are never kept."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import cv2
import jax
import numpy as np

from jaxpoint.answer.holds import arm_tracks, find_holds
from jaxpoint.answer.lines import held_joints
from jaxpoint.answer.thesis import thesis_line
from jaxpoint.config.person import PersonSettings
from jaxpoint.config.point import GestureSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.detect.person import PersonWatch
from jaxpoint.detect.silhouette import foreground, silhouettes
from jaxpoint.detect.thesis import thesis_forearm
from jaxpoint.person.following import follow
from jaxpoint.person.views import watch
from jaxpoint.simulate.session import SimulatedSession, simulate_session
from person_scores import learnt

LEAD = 4  # frames before the hold: enough for a head track to be confirmed
SPARE = 2  # frames between those that are looked at during the hold


@dataclass(frozen=True)
class KeptGesture:
    """What one gesture's pixels gave, and the truth. Lengths in m."""

    seed: int
    gesture: int
    person: str  # of all sessions
    law: str
    hand: str
    target: str
    target_m: list[float]
    true_tip_m: list[float]
    found: bool
    views: int
    start_s: float
    end_s: float
    joints: list[float]  # `Joints.flat`
    covariance: list[list[float]]
    thesis_tip_m: list[float] | None
    thesis_direction: list[float] | None


def kept_session(settings: SimulationSettings, seed: int) -> dict:
    """All gestures of a session, and the objects of its room."""
    session = simulate_session(settings, seed)
    person = PersonSettings()
    rooms = [learnt(session, camera, person) for camera in range(len(session.viewpoints))]
    with jax.enable_x64(True):
        gestures = [asdict(_gesture(session, gesture, rooms, person)) for gesture in session.gestures]
    things = [{"name": t.name, "kind": t.kind, "corners": t.corners.tolist()} for t in session.objects]
    return {"seed": seed, "gestures": gestures, "objects": things, "room": session.scene.size.tolist()}


def _gesture(session: SimulatedSession, gesture, rooms, person: PersonSettings) -> KeptGesture:
    first = session.frame_at(gesture.hold_first_s) + 1
    moments = [*range(first - LEAD, first), *range(first, session.frame_at(gesture.hold_last_s), SPARE)]
    focal = np.asarray(session.rig.cameras.focal).mean(axis=1)
    seen, shown = [], []
    for camera, (room, threshold) in enumerate(rooms):
        images = [session.frame(moment, camera).image for moment in moments]
        size = (images[0].shape[1], images[0].shape[0])
        watcher = PersonWatch(room, threshold, float(focal[camera]), person)
        seen.append(watch(enumerate(images), len(images), size, watcher))
        shown.append(images[LEAD + (len(images) - LEAD) // 2])
    times = np.array([session.time_of(moment) for moment in moments])
    following = follow(session.rig, seen, times, frame_ids=np.array(moments))
    holds = find_holds(arm_tracks(following, times), GestureSettings())
    middle = (gesture.hold_first_s + gesture.hold_last_s) / 2
    actor = next(a for a in session.present(middle) if a.person.number == gesture.person)
    thesis = _thesis(session, shown, rooms, person)
    joints, covariance, views, span = [], [], 0, (0.0, 0.0)
    if holds:
        hold = max(holds, key=lambda hold: hold.views * len(hold.moments))
        held = held_joints(session.rig, following, [hold])
        joints, covariance = np.asarray(held.joints.flat[0]).tolist(), np.asarray(held.covariance[0]).tolist()
        views, span = hold.views, (hold.start_s, hold.end_s)
    return KeptGesture(
        session.seed, gesture.number, f"{session.seed}-{gesture.person}", gesture.law, gesture.hand, gesture.target,
        gesture.target_m.tolist(), actor.joints(middle)[f"{gesture.hand}_tip"].tolist(), bool(holds), views, *span,
        joints, covariance, *thesis,
    )  # fmt: skip


def _thesis(session: SimulatedSession, images, rooms, person: PersonSettings):
    """Tip and direction of the thesis's line at the middle of the hold; None where two views have no region."""
    regions = []
    for image, (room, _) in zip(images, rooms):
        found = silhouettes(foreground(image, room, person.background), person.silhouette)
        if not found:
            return None, None
        regions.append(thesis_forearm(image, found[0], person.thesis))
    line = thesis_line(session.rig, regions)
    return (None, None) if line is None else (np.asarray(line.origin).tolist(), np.asarray(line.direction).tolist())


def quiet() -> None:
    """One core for OpenCV: sessions run side by side."""
    cv2.setNumThreads(1)
