"""From people's arms in a session to answers: gestures, lines, probabilities, in float64."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.body.following import Following
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.pointing import PointSettings, RoomExtent
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.pointing.answers import Answer, ObjectScene, answers
from jaxpoint.pointing.held_joints import HeldJoints, held_joints
from jaxpoint.pointing.holds import ArmTrack, Hold, arm_tracks, find_holds, hold_within
from jaxpoint.pointing.line_hypotheses import Correction, line_hypotheses
from jaxpoint.pointing.no_gesture import no_gesture
from jaxpoint.pointing.room_box import MAX_ROOM_M, Room
from jaxpoint.pointing.spoken import Interval, Word, evidence_of, pair_words


@dataclass(frozen=True)
class SessionAnswers:
    """What was pointed at in a session."""

    answers: tuple[Answer, ...]
    frames: tuple[int, ...]  # of each the place of the frame shown
    people: tuple[int, ...]  # of each the place of the person in the head tracks
    scene: ObjectScene
    notes: tuple[str, ...]


def room_of(extent: RoomExtent) -> Room | None:
    """The room that the settings give, if they do.

    Raises:
        UsageError: one corner without the other, or a box that is no room.
    """
    if extent.low is None and extent.high is None:
        return None
    if extent.low is None or extent.high is None:
        raise UsageError("Give the room's low and high corner both, three numbers each in metres, or neither.")
    for axis, low, high in zip("xyz", extent.low, extent.high):
        if not 0 < high - low <= MAX_ROOM_M:
            raise UsageError(
                f"The settings room.low and room.high go from {low:g} to {high:g} m in {axis}; high must be above low, "
                f"by {MAX_ROOM_M:.0f} m at most."
            )
    with jax.enable_x64(True):
        return Room(list(extent.low), list(extent.high))


def answer_gestures(
    rig: CameraRig,
    following: Following,
    scene: ObjectScene,
    settings: PointSettings,
    *,
    times: Sequence[Interval] | None = None,
    words: Sequence[Word] = (),
    camera_covariance: Float[np.ndarray, "D D"] | None = None,
    correction: Correction | None = None,
    notes: Sequence[str] = (),
) -> SessionAnswers:
    """Find the gestures and answer them.

    Args:
        rig: the cameras, m.
        following: the arms.
        scene: what can be pointed at.
        settings: of gestures and lines.
        times: when gestures are; they are looked for where this is None.
        words: what was said; a word such as "this" is paired with a gesture, names and tags are evidence.
        camera_covariance: of the cameras' D = p C parameters, where the calibration has it.
        correction: a bias to take off.
        notes: what is to be known of the recording, a sentence each.

    Raises:
        InsufficientDataError: there is no gesture, or everybody stands outside of the room.
    """
    heads = following.tracking.heads
    tracks = arm_tracks(following)
    holds = find_holds(tracks, settings.gesture) if times is None else _holds_in(heads.times, tracks, times, settings)
    if not holds:
        raise no_gesture(len(heads.times), following, tracks, settings.gesture)
    said = pair_words(words, [(hold.start_s, hold.end_s) for hold in holds])
    with jax.enable_x64(True):
        held = held_joints(rig, following, holds, camera_covariance)
        hypotheses = line_hypotheses(held, settings.line, settings.blend, correction)
        scene = scene if scene.room_known else replace(scene, room=_guessed_room(scene, rig, held))
        found = answers(
            holds,
            held,
            hypotheses,
            scene,
            heads.people.tolist(),
            heads.frame_ids[held.frames].tolist(),
            evidence=evidence_of(said, scene.objects) if words else None,
            words=[[word.text for word in own] for own in said],
            known_errors=camera_covariance is not None,
        )
    if all(answer.surface is None for answer in found):
        raise _outside(found, scene)
    notes = (*notes, *_notes(scene, camera_covariance is not None))
    where = tuple(int(frame) for frame in held.frames), tuple(hold.person for hold in holds)
    return SessionAnswers(tuple(found), *where, scene, notes)


def _holds_in(
    clock: Float[np.ndarray, " F"], tracks: Sequence[ArmTrack], times: Sequence[Interval], settings: PointSettings
) -> list[Hold]:
    holds = [hold_within(tracks, given.start_s, given.end_s, settings.gesture) for given in times]
    missing = [given for given, hold in zip(times, holds) if hold is None]
    if missing:
        first, last = float(clock[0]), float(clock[-1])
        when = f"Between {missing[0].start_s:.2f} and {missing[0].end_s:.2f} s"
        if missing[0].end_s < first or missing[0].start_s > last:
            raise InsufficientDataError(
                f"{when} no arm was measured, as the recording goes from {first:.2f} to {last:.2f} s; give the "
                "times on its clock."
            )
        raise InsufficientDataError(
            f"{when} no arm was measured in two views; correct the times, or leave that gesture out."
        )
    return [hold for hold in holds if hold is not None]


def _guessed_room(scene: ObjectScene, rig: CameraRig, held: HeldJoints) -> Room:
    """The objects' room, grown by cameras and people; not where they are in quite another place than the objects."""
    inside = np.concatenate([rig.positions, np.reshape(held.joints.flat, (-1, 3))])
    grown = Room.around(scene.objects, inside)
    low, high = scene.objects.bounds
    apart = np.maximum(inside.min(axis=0) - high, low - inside.max(axis=0)).max()
    return scene.room if apart > max((high - low).max(), np.ptp(inside, axis=0).max()) else grown


def _outside(found: Sequence[Answer], scene: ObjectScene) -> InsufficientDataError:
    low, high = np.asarray(scene.room.low), np.asarray(scene.room.high)
    place = ", ".join(f"{value:.2f}" for value in found[0].origin)
    room = " to ".join("(" + ", ".join(f"{value:.1f}" for value in corner) + ")" for corner in (low, high))
    who = "The gesture starts" if len(found) == 1 else f"All {len(found)} gestures start"
    return InsufficientDataError(
        f"{who} outside the room: the first fingertip lies at ({place}) m, the "
        f"room is {room}; align the calibration to the room of these objects, or correct "
        f"{'the corners of the room' if scene.room_known else 'the places of the objects, which are to be in metres'}."
    )


def _notes(scene: ObjectScene, known: bool) -> tuple[str, ...]:
    notes = []
    if not scene.room_known:
        notes.append(
            "The room's size is guessed from objects, cameras and people; [room] in a .toml of objects, or --room.low "
            "and --room.high, give it."
        )
    if not known:
        notes.append("The calibration has no covariance: its part of the lines' errors is left out.")
    return tuple(notes)
