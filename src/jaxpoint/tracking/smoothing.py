"""The frames of the tracker put together, person by person, and smoothed."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.config.track import TrackSettings
from jaxpoint.tracking.kalman import State, filter_track, smooth_track
from jaxpoint.tracking.result import FrameHeads, HeadTracks, Status, Tracking

_LEAST = 64  # frames that a compiled program is made for at least




def smoothed(
    frames: Sequence[FrameHeads],
    cameras: tuple[str, ...],
    frame_ids: Int[np.ndarray, " F"],
    times: Float[np.ndarray, " F"],
    settings: TrackSettings,
) -> Tracking:
    """The confirmed tracks of a recording from what was measured in each frame, from the first to the last time."""
    person_of = {track.key: track.person for heads in frames for track in heads.tracks}  # the latest is what counts
    people = np.array(sorted({person for person in person_of.values() if person}), int)
    column = {key: int(np.searchsorted(people, person)) for key, person in person_of.items() if person}
    tracking = _gathered(frames, column, cameras, frame_ids, times, people)
    _trim(tracking)
    if len(people):
        _smooth(tracking, settings)
    return tracking


def _gathered(frames, column, cameras, frame_ids, times, people) -> Tracking:
    """What was measured, with no places yet."""
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


def _trim(tracking: Tracking) -> None:
    """Nobody is foretold after the last frame that measured him."""
    measured = tracking.heads.measured
    later = np.cumsum(measured[::-1], axis=0)[::-1] > 0
    tracking.heads.status[~later] = Status.ABSENT


def _smooth(tracking: Tracking, settings: TrackSettings) -> None:
    """Places, velocities and covariances of everybody, from the first frame to the last."""
    heads = tracking.heads
    first = np.argmax(heads.present, axis=0)
    length = heads.present.sum(axis=0)
    size = max(_LEAST, 1 << int(length.max() - 1).bit_length())
    rows = np.minimum(first + np.arange(size)[:, None], first + length - 1).T  # (N, L), the last frame repeated
    person = np.arange(len(first))[:, None]
    filling = np.arange(size) >= length[:, None]
    states = _run(
        heads.times[rows],
        tracking.points[rows, person],
        np.where(filling[..., None, None], 0.0, tracking.informations[rows, person]),
        np.float64(settings.acceleration_m_s2),
        np.float64(settings.speed_m_s),
    )
    mean, square = np.asarray(states.mean), np.asarray(states.covariance)
    for i, (begin, frames) in enumerate(zip(first, length)):
        there = slice(begin, begin + frames)
        heads.positions[there, i] = mean[i, :frames, :3]
        tracking.velocities[there, i] = mean[i, :frames, 3:]
        tracking.covariances[there, i] = square[i, :frames]
        heads.sigma[there, i] = np.sqrt(np.linalg.eigvalsh(square[i, :frames, :3, :3])[:, -1])


@jit
def _run(
    times: Float[Array, "N L"],
    points: Float[Array, "N L 3"],
    informations: Float[Array, "N L 3 3"],
    acceleration: Float[Array, ""],
    speed: Float[Array, ""],
) -> State:
    """Filter and smoother of N tracks of L frames."""

    def one(*track: Array) -> State:
        return smooth_track(track[0], filter_track(*track, acceleration, speed))

    return jax.vmap(one)(times, points, informations)
