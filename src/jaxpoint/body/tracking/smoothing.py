"""The frames of the tracker put together, person by person, and smoothed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxpoint.body.tracking.head_tracks import FrameHeads, HeadTracks, Status, Tracking
from jaxpoint.body.tracking.kalman import Filtered, State, filter_track, smooth_track
from jaxpoint.compilation import jit
from jaxpoint.config.track import TrackSettings

_LEAST = 64  # frames that a compiled program is made for at least


class HeadPath(NamedTuple):
    """What was measured of one person in L frames; the first must have two views."""

    times: Float[np.ndarray, " L"]  # s
    points: Float[np.ndarray, "L 3"]  # m
    informations: Float[np.ndarray, "L 3 3"]  # 1/m^2


def gather_tracks(
    frames: Sequence[FrameHeads],
    cameras: tuple[str, ...],
    frame_ids: Int[np.ndarray, " F"],
    times: Float[np.ndarray, " F"],
) -> Tracking:
    """What the frames measured, person by person, without places yet."""
    person_of = {track.key: track.person for heads in frames for track in heads.tracks}  # the latest is what counts
    people = np.array(sorted({person for person in person_of.values() if person}), int)
    column = {key: int(np.searchsorted(people, person)) for key, person in person_of.items() if person}
    shape = len(frames), len(people)
    heads = HeadTracks(
        frame_ids=np.asarray(frame_ids),
        times=np.asarray(times, float),
        people=people.astype(int),
        positions=np.zeros((*shape, 3)),
        sigma=np.zeros(shape),
        used=np.zeros((*shape, len(cameras)), bool),
        status=np.full(shape, int(Status.ABSENT)),
        cameras=cameras,
    )
    tracking = Tracking(
        heads,
        velocities=np.zeros((*shape, 3)),
        covariances=np.zeros((*shape, 6, 6)),
        candidates=np.full((*shape, len(cameras)), -1),
        points=np.zeros((*shape, 3)),
        informations=np.zeros((*shape, 3, 3)),
        innovations2=np.zeros(shape),
    )
    for frame, seen in enumerate(frames):
        for row, track in enumerate(seen.tracks):
            if track.key not in column:
                continue
            place = frame, column[track.key]
            if heads.measured[place]:  # by a later track of the same person, while this one was being waited for
                continue
            heads.status[place] = seen.status[row]
            heads.used[place] = seen.candidates[row] >= 0
            for name in ("candidates", "points", "informations", "innovations2"):
                getattr(tracking, name)[place] = getattr(seen, name)[row]
    return tracking


def smooth(tracking: Tracking, settings: TrackSettings) -> None:
    """Places, velocities and covariances of everybody, from the first frame measured to the last, in place."""
    heads = tracking.heads
    later = np.cumsum(heads.measured[::-1], axis=0)[::-1] > 0
    earlier = np.cumsum(heads.measured, axis=0) > 0
    heads.status[~(earlier & later)] = Status.ABSENT
    for part in tracking.parts():
        part[heads.status == Status.ABSENT] = 0
    tracking.candidates[heads.status == Status.ABSENT] = -1
    there = [np.flatnonzero(heads.present[:, person]) for person in range(len(heads.people))]
    known = [person for person, frames in enumerate(there) if len(frames)]
    paths = [
        HeadPath(heads.times[frames], tracking.points[frames, person], tracking.informations[frames, person])
        for person, frames in enumerate(there)
        if len(frames)
    ]
    for person, (filtered, states) in zip(known, smooth_paths(paths, settings)):
        frames = there[person]
        heads.positions[frames, person] = states.mean[:, :3]
        tracking.velocities[frames, person] = states.mean[:, 3:]
        tracking.covariances[frames, person] = states.covariance
        tracking.innovations2[frames, person] = filtered.distance2
        heads.sigma[frames, person] = np.sqrt(np.linalg.eigvalsh(states.covariance[:, :3, :3])[:, -1])


def smooth_paths(paths: Sequence[HeadPath], settings: TrackSettings) -> list[tuple[Filtered, State]]:
    """Filter and smoother of several people, as numpy arrays; padded, so that few programs are compiled."""
    if not paths:
        return []
    size = max(_LEAST, 1 << max(len(path.times) - 1 for path in paths).bit_length())
    rows = [np.minimum(np.arange(size), len(path.times) - 1) for path in paths]
    filling = [np.arange(size) >= len(path.times) for path in paths]
    count = 1 << (len(paths) - 1).bit_length()
    order = [min(k, len(paths) - 1) for k in range(count)]
    found = _run(
        np.stack([paths[k].times[rows[k]] for k in order]),
        np.stack([paths[k].points[rows[k]] for k in order]),
        np.stack([np.where(filling[k][:, None, None], 0.0, paths[k].informations[rows[k]]) for k in order]),
        np.float64(settings.acceleration_m_s2),
        np.float64(settings.speed_m_s),
    )
    found = jax.tree.map(np.asarray, found)
    return [jax.tree.map(lambda leaf: leaf[k, : len(path.times)], found) for k, path in enumerate(paths)]  # noqa: B023


@jit
def _run(
    times: Float[Array, "N L"],
    points: Float[Array, "N L 3"],
    informations: Float[Array, "N L 3 3"],
    acceleration: Float[Array, ""],
    speed: Float[Array, ""],
) -> tuple[Filtered, State]:
    """Filter and smoother of N tracks of L frames."""

    def one(*track: Array) -> tuple[Filtered, State]:
        filtered = filter_track(*track, acceleration, speed)
        return filtered, smooth_track(track[0], filtered)

    return jax.vmap(one)(times, points, informations)
