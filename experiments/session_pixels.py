"""The pixels of a simulated session, gesture by gesture: rendered once and looked through once, for every score.

Used by `scored_sessions.py`. Images live as long as their gesture and are never kept.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.body.following import Following, follow
from jaxpoint.config.person import PersonSettings, ThesisSettings
from jaxpoint.detection.person.frame_motion import learn_threshold, motion_between
from jaxpoint.detection.person.silhouette import RoomBackground, Silhouette, foreground, learn_background, silhouettes
from jaxpoint.detection.person.silhouette_views import AbstractCameraEvidence, watch
from jaxpoint.detection.person.thesis_regions import ThesisRegion, thesis_forearm
from jaxpoint.detection.person.watcher import PersonWatch
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.simulated_session import SimulatedFrame, SimulatedSession

LEAD = 4  # frames before the hold: enough for a head track to be confirmed
View = tuple[int, int]  # moment and camera


@dataclass(frozen=True)
class EmptyRoom:
    """What one camera learnt of the room before anybody came."""

    background: RoomBackground
    motion_threshold: float


@dataclass(frozen=True)
class GesturePixels:
    """One gesture in C cameras at F moments: LEAD before the hold, then every so many of it."""

    session: SimulatedSession
    gesture: Gesture
    person: PersonSettings
    moments: list[int]
    held: range  # those of the hold
    frames: dict[View, SimulatedFrame]
    seen: list[AbstractCameraEvidence]  # of each camera
    following: Following
    largest: dict[View, Silhouette | None]  # the thesis's person, of the hold alone
    forearms: dict[View, ThesisRegion | None]  # and the pointing region that it finds there
    watch_ms: Float[np.ndarray, " C"]  # a frame
    arm_ms: float  # of all views of a frame together

    @property
    def times(self) -> Float[np.ndarray, " F"]:
        """Seconds of the moments."""
        return np.array([self.session.time_of(moment) for moment in self.moments])

    def joints(self, moment: int) -> dict[str, Float[np.ndarray, "3"]]:
        """The truth of who points, m."""
        time_s = self.session.time_of(moment)
        actor = next(a for a in self.session.present(time_s) if a.person.number == self.gesture.person)
        return actor.joints(time_s)


def gestures_of(session: SimulatedSession, person: PersonSettings, every: int) -> Iterator[GesturePixels]:
    """All gestures of a session, of whose holds every so many frames are looked at."""
    rooms = [learnt(session, camera, person) for camera in range(len(session.viewpoints))]
    for gesture in session.gestures:
        yield _gesture(session, gesture, rooms, person, every)


def learnt(session: SimulatedSession, camera: int, person: PersonSettings) -> EmptyRoom:
    """Background and motion threshold of one camera, from the empty room."""
    images = [session.empty(frame, camera) for frame in range(session.settings.empty_frames)]
    counts = np.array([motion_between(a, b, person.motion).edges for a, b in pairwise(images)])
    return EmptyRoom(learn_background(images, person.background), learn_threshold(counts, person.motion))


def _gesture(
    session: SimulatedSession, gesture: Gesture, rooms: list[EmptyRoom], person: PersonSettings, every: int
) -> GesturePixels:
    first = session.frame_at(gesture.hold_first_s) + 1
    held = range(first, session.frame_at(gesture.hold_last_s), every)
    moments = [*range(first - LEAD, first), *held]
    # All cameras of a moment together: people are posed and lit once for all.
    frames = {(frame.frame, frame.camera): frame for frame in session.frames(moments)}
    seen, watch_ms = _watched(session, moments, frames, rooms, person)
    times = np.array([session.time_of(moment) for moment in moments])
    started = time.perf_counter()
    with jax.enable_x64(True):
        following = follow(session.rig, seen, times, frame_ids=np.array(moments))
    arm_ms = 1e3 * (time.perf_counter() - started) / len(moments)
    largest, forearms = {}, {}
    for moment in held:
        for camera, room in enumerate(rooms):
            image = frames[moment, camera].image
            found = silhouettes(foreground(image, room.background, person.background), person.silhouette)
            largest[moment, camera] = found[0] if found else None
            forearms[moment, camera] = thesis_forearm(image, found[0], ThesisSettings()) if found else None
    return GesturePixels(
        session, gesture, person, moments, held, frames, seen, following, largest, forearms, watch_ms, arm_ms
    )


def _watched(
    session: SimulatedSession,
    moments: list[int],
    frames: dict[View, SimulatedFrame],
    rooms: list[EmptyRoom],
    person: PersonSettings,
) -> tuple[list[AbstractCameraEvidence], Float[np.ndarray, " C"]]:
    """What every camera saw, and its milliseconds a frame."""
    focal = np.asarray(session.rig.cameras.focal).mean(axis=1)
    seen, spent = [], np.zeros(len(rooms))
    for camera, room in enumerate(rooms):
        watcher = PersonWatch(room.background, room.motion_threshold, float(focal[camera]), person)
        images = ((i, frames[moment, camera].image) for i, moment in enumerate(moments))
        started = time.perf_counter()
        seen.append(watch(images, len(moments), session.viewpoints[camera].size, watcher))
        spent[camera] = 1e3 * (time.perf_counter() - started) / len(moments)
    return seen, spent
