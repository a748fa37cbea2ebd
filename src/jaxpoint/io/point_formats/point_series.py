"""Named points in 3-D through the frames of a recording, and what a format of them is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.calibration.track_points import TrackPoints
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry.world_axes import WORLDS, World
from jaxpoint.tracks import NO_TARGET, Tracks

MAX_FRAMES = 10**7  # from the first frame to the last, of files with a line for each
EVEN = 1.0  # frames, by which times may differ from even ones in the mean


@dataclass(frozen=True)
class PointSeries:
    """P points in F frames, one after another without gaps."""

    names: tuple[str, ...]
    frame_ids: Int[np.ndarray, " F"]
    points: Float[np.ndarray, "F P 3"]  # m, in the axes of `world`; NaN where there is none
    sigmas_m: Float[np.ndarray, "F P"]  # standard deviation of each coordinate; NaN where there is no point
    rms_px: Float[np.ndarray, "F P"]  # reprojection error; NaN where there is no point
    cameras: Int[np.ndarray, "F P"]  # how many views each is made of
    rate_hz: float | None = None  # frames a second
    world: World = WORLDS["room"]

    @property
    def present(self) -> Bool[np.ndarray, "F P"]:
        """Where there is a point."""
        return np.all(np.isfinite(self.points), axis=-1)

    def needed_rate(self, title: str) -> float:
        """Frames a second, where a format cannot do without.

        Raises:
            UsageError: it is not known.
        """
        if self.rate_hz is None:
            raise UsageError(f"{title} needs the rate of the frames; the tracks do not say it evenly: give --fps 60.")
        return self.rate_hz

    def in_world(self, world: World) -> PointSeries:
        """The points in the axes of another world, in metres still."""
        return replace(self, points=world.from_room(self.world.to_room(self.points)), world=world)


@dataclass(frozen=True)
class PointFormat:
    """One format of points: what its files end in, what writes them, and what they have no place for."""

    suffix: str
    title: str
    content: Callable[[PointSeries], bytes]
    world: str = "room"  # whose axes it has, where nobody says
    losses: tuple[str, ...] = ()  # a sentence for each thing that it does not hold
    check: Callable[[Path], None] = lambda path: None  # what must be there before any work is done


def series_of(tracks: Tracks, found: TrackPoints, fps: float | None = None) -> PointSeries:
    """The points of tracks by name and frame.

    Args:
        tracks: what the points were made of.
        found: the points, m.
        fps: frames a second; from the times of the tracks without.

    Raises:
        InsufficientDataError: there is no point at all, or the frames are too far apart.
    """
    rows = np.flatnonzero(found.valid)
    if not len(rows):
        raise InsufficientDataError(
            f"None of {tracks.frames} points is seen by two cameras well enough; see whether calibration and tracks are"
            " of the same cameras, or raise --max-error-px."
        )
    frames = tracks.frame_ids[rows]
    first, count = int(frames.min()), int(np.ptp(frames)) + 1
    if count > MAX_FRAMES:
        raise InsufficientDataError(f"The frames go from {first} to {frames.max()}, {count:.2g} of them; count from 0.")
    keys = [_point_key(tracks, row) for row in range(tracks.frames)]
    names = {name: place for place, name in enumerate(dict.fromkeys(keys))}
    shape = count, len(names)
    where = frames - first, np.array([names[keys[row]] for row in rows])
    points, sigmas, rms = np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    cameras = np.zeros(shape, int)
    points[where], sigmas[where], rms[where] = found.points[rows], found.sigmas[rows], found.rms_px[rows]
    cameras[where] = found.used[rows].sum(axis=1)
    rate = fps if fps is not None else rate_of(tracks)
    return PointSeries(tuple(names), first + np.arange(count), points, sigmas, rms, cameras, rate)


def rate_of(tracks: Tracks) -> float | None:
    """Frames a second by the times of the tracks; None where there are none, or they do not go evenly."""
    if tracks.times is None:
        return None
    frames, first = np.unique(tracks.frame_ids, return_index=True)
    if len(frames) < 2:
        return None
    times = tracks.times[first]
    step = float(np.ptp(times)) / float(np.ptp(frames))
    if step <= 0 or np.abs(times - times[0] - step * (frames - frames[0])).mean() > EVEN * step:
        return None
    return 1.0 / step


def _point_key(tracks: Tracks, row: int) -> str:
    """What the point of a row is called."""
    if tracks.point_ids is None or tracks.target_ids is None:
        return "light"
    point, target = int(tracks.point_ids[row]), int(tracks.target_ids[row])
    return tracks.point_name(point) if target == NO_TARGET else f"{tracks.targets[target].name}_{point}"
