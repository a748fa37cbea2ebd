"""Gestures: when somebody holds a stretched arm still (thesis 7.1); the line is measured on the hold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.body.following import Following
from jaxpoint.body.stature import HEAD_M
from jaxpoint.config.pointing import GestureSettings


@dataclass(frozen=True)
class ArmTrack:
    """One person's arm in the F frames in which it was measured."""

    person: int  # place in the head tracks
    frames: Int[np.ndarray, " F"]  # rising
    times: Float[np.ndarray, " F"]  # s
    tips: Float[np.ndarray, "F 3"]  # m
    directions: Float[np.ndarray, "F 3"]  # unit
    stretch: Float[np.ndarray, " F"]  # share of the stature
    views: Int[np.ndarray, " F"]  # that are used


@dataclass(frozen=True)
class Hold:
    """Frames in which one arm is held; of those between, the measurements disagree or are missing."""

    person: int  # place in the head tracks
    frames: Int[np.ndarray, " F"]  # rising
    times: Float[np.ndarray, " F"]  # s
    views: int  # median number of views that are used

    @property
    def start_s(self) -> float:
        """First frame."""
        return float(self.times[0])

    @property
    def end_s(self) -> float:
        """Last frame."""
        return float(self.times[-1])

    @property
    def time_s(self) -> float:
        """Its middle."""
        return float(self.times[0] + self.times[-1]) / 2


def arm_tracks(following: Following) -> list[ArmTrack]:
    """The arm of everybody over time."""
    tracks = []
    heads = following.tracking.heads
    for person in range(len(heads.people)):
        found = sorted(
            ((at, arm) for (at, who), arm in following.arms.items() if who == person and arm is not None),
            key=lambda pair: pair[0],
        )
        frames = np.array([at for at, _ in found], int)
        arms = [arm for _, arm in found]
        stature = heads.positions[frames, person, 2] + HEAD_M / 2
        tracks.append(
            ArmTrack(
                person,
                frames,
                heads.times[frames],
                np.array([arm.tip for arm in arms]).reshape(-1, 3),
                np.array([arm.direction for arm in arms]).reshape(-1, 3),
                np.array([arm.stretch for arm in arms]) / np.maximum(stature, 1.0),
                np.array([arm.views_used for arm in arms], int),
            )
        )
    return tracks


def find_holds(tracks: Iterable[ArmTrack], settings: GestureSettings) -> list[Hold]:
    """All gestures of everybody, in order of time.

    A hold is a set of frames around one of them whose tips and directions are like its own, without a long gap. The
    set that most views speak for is taken first, and nothing right before or after it: single frames in which another
    limb was measured do not break a hold, and an elbow that is taken for a hand as the arm comes up is no gesture.
    """
    holds = []
    for track in tracks:
        holds += _holds(track, track.stretch >= settings.min_stretch, settings)
    return sorted(holds, key=lambda hold: hold.time_s)


def hold_within(tracks: Iterable[ArmTrack], start_s: float, end_s: float, settings: GestureSettings) -> Hold | None:
    """The hold of a given interval, of the person whom most views support; None where no arm was measured in it."""
    best, most = None, 0
    for track in tracks:
        inside = (track.times >= start_s - 1e-9) & (track.times <= end_s + 1e-9)
        members = _most_agreed(track, inside, settings)
        weight = int(track.views[members].sum())
        if weight > most:
            best, most = _hold(track, members), weight
    return best


def _holds(track: ArmTrack, free: Bool[np.ndarray, " F"], settings: GestureSettings) -> list[Hold]:
    holds = []
    free = free.copy()
    while free.any():
        members = _most_agreed(track, free, settings)
        # A frame counts for as long as until the next one, so that a hold of three frames lasts three of them.
        period = float(np.median(np.diff(track.times))) if len(track.times) > 1 else 0.0
        lasts = track.times[members[-1]] - track.times[members[0]] + period
        if len(members) >= settings.min_frames and lasts >= settings.min_hold_s:
            hold = _hold(track, members)
            holds.append(hold)
            near = settings.min_pause_s
            free &= (track.times < hold.start_s - near) | (track.times > hold.end_s + near)
        free[members] = False
    return holds


def _hold(track: ArmTrack, members: Int[np.ndarray, " M"]) -> Hold:
    views = int(np.median(track.views[members]))
    return Hold(track.person, track.frames[members], track.times[members], views)


def _most_agreed(track: ArmTrack, free: Bool[np.ndarray, " F"], settings: GestureSettings) -> Int[np.ndarray, " M"]:
    """The largest set of frames around one of them that agree with it; weighed by their views.

    Empty only where no frame is free: an arm of which no view is used still makes a set.
    """
    best, most = np.zeros(0, int), -1
    for seed in np.flatnonzero(free):
        members = _around(track, int(seed), free, settings)
        weight = int(track.views[members].sum())
        if weight > most:
            best, most = members, weight
    return best


def _around(track: ArmTrack, seed: int, free: np.ndarray, settings: GestureSettings) -> Int[np.ndarray, " M"]:
    members = [seed]
    for side in (-1, 1):
        last = seed
        place = seed + side
        while 0 <= place < len(free) and abs(track.times[place] - track.times[last]) <= settings.max_gap_s:
            if free[place] and _alike(track, seed, place, settings):
                members.append(place)
                last = place
            place += side
    return np.sort(np.array(members, int))


def _alike(track: ArmTrack, one: int, other: int, settings: GestureSettings) -> bool:
    near = np.linalg.norm(track.tips[one] - track.tips[other]) <= settings.tip_m
    return bool(near and track.directions[one] @ track.directions[other] >= np.cos(np.deg2rad(settings.direction_deg)))
