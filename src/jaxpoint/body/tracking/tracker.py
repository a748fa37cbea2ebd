"""The tracker: one frame after the other as they come (`step`), or a whole recording at once (`track_heads`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from jaxpoint.body.tracking.encounters import SeenHeads, rejoin, resolve
from jaxpoint.body.tracking.head_association import Predictions, associate, near_prediction, quantile
from jaxpoint.body.tracking.head_tracks import FrameHeads, Status, Tracking, status_of
from jaxpoint.body.tracking.identity import Track, beside_others, name_tracks
from jaxpoint.body.tracking.kalman import State
from jaxpoint.body.tracking.measurement import measure, predict_all
from jaxpoint.body.tracking.rays import Rays, rays_of_frames
from jaxpoint.body.tracking.smoothing import gather_tracks, smooth
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.track import TrackSettings
from jaxpoint.errors import InsufficientDataError

_LEAST = 4  # people that a compiled program is made for at least


@dataclass(frozen=True)
class TrackerState:
    """All that the tracker remembers from one frame to the next; a new one remembers nothing."""

    time: float | None = None  # s, of the latest frame
    tracks: tuple[Track, ...] = ()
    keys: int = 0  # given to tracks so far
    people: int = 0  # ids given so far


def step(
    state: TrackerState,
    rig: CameraRig,
    pixels: Float[np.ndarray, "C K 2"],
    valid: Bool[np.ndarray, "C K"],
    time: float,
    settings: TrackSettings | None = None,
    *,
    sigma_px: Float[np.ndarray, "C K"] | None = None,
    doubtful: Bool[np.ndarray, "C K"] | None = None,
    room: Float[np.ndarray, "2 3"] | None = None,
) -> tuple[TrackerState, FrameHeads]:
    """Follow the heads through one more frame; the arguments are those of `track_heads`, of one frame.

    Raises:
        ValueError: shapes do not fit, or `time` is not after the frame before.
        InsufficientDataError: fewer than two cameras.
    """
    settings = settings or TrackSettings()
    sigma = np.full(valid.shape, settings.sigma_px) if sigma_px is None else sigma_px
    if state.time is not None and time <= state.time:
        raise ValueError(f"A frame at {time:g} s comes after one at {state.time:g} s; give them in order, each once.")
    _check(rig, pixels[None], valid[None], sigma[None], np.array([time]), 1)
    pixels, sigma = np.where(valid[..., None], pixels, 0.0), np.where(valid, sigma, 1.0)
    with jax.enable_x64(True):
        unsure = None if doubtful is None else doubtful[None]
        rays = rays_of_frames(rig, pixels[None], valid[None], sigma[None], unsure)[0]
        return _step(state, rig, rays, (pixels, sigma), float(time), settings, _bounds(settings, room))


def track_heads(
    rig: CameraRig,
    pixels: Float[np.ndarray, "F C K 2"],
    valid: Bool[np.ndarray, "F C K"],
    times: Float[np.ndarray, " F"],
    settings: TrackSettings | None = None,
    *,
    sigma_px: Float[np.ndarray, "F C K"] | None = None,
    doubtful: Bool[np.ndarray, "F C K"] | None = None,
    frame_ids: Int[np.ndarray, " F"] | None = None,
    room: Float[np.ndarray, "2 3"] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Tracking:
    """The tracks of all heads in a recording, smoothed: thesis 6.2.3 with every view instead of two.

    Args:
        rig: the cameras, C of them, in metres with the floor at z = 0.
        pixels: px, candidates of heads, K in each view at most, in any order; distorted, as the cameras saw them.
        valid: which of them there are; what stands at the others never matters.
        times: s, rising.
        settings: noise, gates, and when a track begins and ends.
        sigma_px: standard deviation of each candidate's coordinates, px; `settings.sigma_px` where not given.
        doubtful: candidates that may well be no heads: they join others, but never speak against them.
        frame_ids: numbers of the frames in the recording; 0, 1, ... if left out.
        room: lowest and highest corner of the room, m, if it is known.
        progress: called with the share of the frames done.

    Raises:
        ValueError: shapes do not fit, or the times do not rise.
        InsufficientDataError: fewer than two cameras.
    """
    settings = settings or TrackSettings()
    sigma = np.full(valid.shape, settings.sigma_px) if sigma_px is None else sigma_px
    _check(rig, pixels, valid, sigma, times, len(pixels))
    pixels, sigma = np.where(valid[..., None], pixels, 0.0), np.where(valid, sigma, 1.0)
    state, frames = TrackerState(), []
    with jax.enable_x64(True):
        bounds = _bounds(settings, room)
        seen = SeenHeads(rig, rays_of_frames(rig, pixels, valid, sigma, doubtful), pixels, sigma, bounds)
        for frame, rays in enumerate(seen.rays):
            own = pixels[frame], sigma[frame]
            state, heads = _step(state, rig, rays, own, float(times[frame]), settings, bounds)
            frames.append(heads)
            if progress:
                progress((frame + 1) / len(pixels))
        ids = np.arange(len(pixels)) if frame_ids is None else frame_ids
        tracking = gather_tracks(frames, rig.names, ids, times)
        smooth(tracking, settings)
        rejoin(tracking, settings)
        smooth(tracking, settings)
        if resolve(tracking, seen, settings):
            smooth(tracking, settings)
        return tracking.without_the_absent()


def _step(
    state: TrackerState,
    rig: CameraRig,
    rays: Rays,
    seen: tuple[Float[np.ndarray, "C K 2"], Float[np.ndarray, "C K"]],
    time: float,
    settings: TrackSettings,
    bounds: Float[np.ndarray, "2 3"],
) -> tuple[TrackerState, FrameHeads]:
    tracks = [track for track in state.tracks if not track.is_expired(time, settings)]
    tracks = _predict(tracks, 0.0 if state.time is None else time - state.time, settings)
    expected = Predictions(
        np.array([track.mean[:3] for track in tracks]).reshape(-1, 3),
        np.array([track.covariance[:3, :3] for track in tracks]).reshape(-1, 3, 3),
    )
    found = associate(rays, len(rig), expected, settings, bounds)
    born = found.candidates[found.tracks < 0]
    candidates = np.full((len(tracks), len(rig)), -1)
    candidates[found.tracks[found.tracks >= 0]] = found.candidates[found.tracks >= 0]
    candidates = np.concatenate([candidates, born])
    is_new = np.arange(len(candidates)) >= len(tracks)
    tracks += [Track.new(state.keys + i, time) for i in range(len(born))]
    points, informations, distances2, accepted, states = _measure(rig, tracks, candidates, seen, is_new, settings)
    candidates[~accepted] = -1
    views = (candidates >= 0).sum(axis=1)
    status = status_of(views)
    near = np.zeros(len(views), bool)
    near[: len(expected)] = near_prediction(rays, expected, settings).any(axis=1)
    status[near & (views == 0)] = Status.AMBIGUOUS
    mean, square = np.asarray(states.mean), np.asarray(states.covariance)
    beside = beside_others(mean[:, :3], np.array([track.person > 0 for track in tracks], bool) & (views > 0))
    after = [track.after(time, int(views[i]), bool(beside[i]), mean[i], square[i]) for i, track in enumerate(tracks)]
    heads = FrameHeads(tuple(after), status, candidates, points, informations, distances2).select(accepted | ~is_new)
    tracks, people = name_tracks(list(heads.tracks), state.people, settings)
    alive = {track.key for track in tracks}
    heads = replace(heads.select(np.array([track.key in alive for track in heads.tracks], bool)), tracks=tuple(tracks))
    return TrackerState(time, tuple(tracks), state.keys + len(born), people), heads


def _predict(tracks: list[Track], seconds: float, settings: TrackSettings) -> list[Track]:
    """The tracks where they are expected so many seconds later."""
    if not tracks:
        return []
    states = predict_all(_states(tracks), np.float64(seconds), np.float64(settings.acceleration_m_s2))
    mean, square = np.asarray(states.mean), np.asarray(states.covariance)
    return [replace(track, mean=mean[i], covariance=square[i]) for i, track in enumerate(tracks)]


def _measure(
    rig: CameraRig,
    tracks: list[Track],
    candidates: Int[np.ndarray, "T C"],
    seen: tuple[Float[np.ndarray, "C K 2"], Float[np.ndarray, "C K"]],
    is_new: Bool[np.ndarray, " T"],
    settings: TrackSettings,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, State]:
    """The fields of `Measured`: the heads triangulated from their candidates, and their tracks with that."""
    states = _states(tracks)
    size = len(states.mean)
    pixels, sigma = (_pad(part[np.arange(len(rig)), candidates], size) for part in seen)
    used, new = _pad(candidates >= 0, size), _pad(is_new, size)
    gates = np.array([quantile(settings.gate, 2), quantile(settings.gate, 3)])
    found = measure(rig, states, new, pixels, used, sigma, np.float64(settings.speed_m_s), gates)
    return tuple(jax.tree.map(lambda leaf: np.asarray(leaf)[: len(tracks)], found))


def _states(tracks: list[Track]) -> State:
    """The tracks' states, filled up so that few different numbers of them are compiled for."""
    size = max(_LEAST, 1 << max(len(tracks) - 1, 0).bit_length())
    mean, square = np.zeros((size, 6)), np.tile(np.eye(6), (size, 1, 1))
    for i, track in enumerate(tracks):
        mean[i], square[i] = track.mean, track.covariance
    return State(mean, square)


def _pad(values: Shaped[np.ndarray, "T ..."], size: int) -> Shaped[np.ndarray, "size ..."]:
    """With zeros at the end."""
    return np.pad(values, ((0, size - len(values)), *[(0, 0)] * (values.ndim - 1)))


def _bounds(settings: TrackSettings, room: Float[np.ndarray, "2 3"] | None) -> Float[np.ndarray, "2 3"]:
    """Lowest and highest coordinates of a head, m."""
    bounds = np.array([[-np.inf] * 3, [np.inf] * 3]) if room is None else np.array(room, float)
    bounds[0, 2] = max(bounds[0, 2], settings.height_m[0])
    bounds[1, 2] = min(bounds[1, 2], settings.height_m[1])
    return bounds


def _check(rig: CameraRig, pixels, valid, sigma_px, times, frames: int) -> None:
    """Raise where the arguments do not fit each other."""
    cameras = len(rig)
    if cameras < 2:
        raise InsufficientDataError("One camera gives no place in space; the head track needs two or more.")
    shape = valid.shape
    fits = len(shape) == 3 and shape[0] == frames and shape[1] == cameras
    if not fits or pixels.shape != (*shape, 2) or sigma_px.shape != shape or times.shape != (frames,):
        raise ValueError(
            f"{cameras} cameras and {frames} frames need pixels (F, {cameras}, K, 2), valid and sigma_px "
            f"(F, {cameras}, K) and times (F,), not {pixels.shape}, {shape}, {sigma_px.shape} and {times.shape}."
        )
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise ValueError(
            f"Times must rise, but frame {late[0] + 1} is at {times[late[0] + 1]:g} s, after one at "
            f"{times[late[0]]:g} s; sort the frames and drop doubled ones."
        )
