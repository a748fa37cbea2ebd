"""One gesture from pixels to the joints of its hold, and to the thesis's line; used by `scored_sessions.py`."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np

from jaxpoint.config.pointing import GestureSettings
from jaxpoint.pointing.held_joints import held_joints
from jaxpoint.pointing.holds import arm_tracks, find_holds
from session_pixels import GesturePixels
from thesis_line import thesis_line


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


def kept_gesture(pixels: GesturePixels) -> KeptGesture:
    """What is needed to answer the gesture without its pixels."""
    session, gesture = pixels.session, pixels.gesture
    with jax.enable_x64(True):
        holds = find_holds(arm_tracks(pixels.following), GestureSettings())
        thesis = _thesis(pixels)
        joints, covariance, views, span = [], [], 0, (0.0, 0.0)
        if holds:
            hold = max(holds, key=lambda hold: hold.views * len(hold.frames))
            held = held_joints(session.rig, pixels.following, [hold])
            joints, covariance = np.asarray(held.joints.flat[0]).tolist(), np.asarray(held.covariance[0]).tolist()
            views, span = hold.views, (hold.start_s, hold.end_s)
    middle = (gesture.hold_first_s + gesture.hold_last_s) / 2
    actor = next(a for a in session.present(middle) if a.person.number == gesture.person)
    return KeptGesture(
        session.seed, gesture.number, f"{session.seed}-{gesture.person}", gesture.law, gesture.hand, gesture.target,
        gesture.target_m.tolist(), actor.joints(middle)[f"{gesture.hand}_tip"].tolist(), bool(holds), views, *span,
        joints, covariance, *thesis,
    )  # fmt: skip


def _thesis(pixels: GesturePixels) -> tuple[list[float] | None, list[float] | None]:
    """Tip and direction of the thesis's line at the middle of the hold; None where two views have no region."""
    middle = pixels.held[len(pixels.held) // 2]
    regions = [pixels.forearms[middle, camera] for camera in range(len(pixels.seen))]
    known = [region for region in regions if region is not None]
    line = thesis_line(pixels.session.rig, known) if len(known) == len(regions) else None
    return (None, None) if line is None else (np.asarray(line.origin).tolist(), np.asarray(line.direction).tolist())
