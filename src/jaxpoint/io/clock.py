"""Frames of several cameras on one clock, by their times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

ONE_CLASS = 0.67  # of the longest period: of such rates the middle one is the clock; of rates unlike, the slowest
STEADY = 0.5  # length of the mean direction of a camera's phases from which it keeps one phase to the clock
HALF = 0.5 - 1e-6  # of a period: what lies right between two rows belongs to neither
OFF_CLOCK = 0.25  # of a period: cameras a tenth of whose frames lie further from their rows run at another rate


@dataclass(frozen=True)
class CommonClock:
    """Which frame of every camera belongs to which tick of a common clock."""

    period: float  # from tick to tick, in the unit of the times
    ticks: Int[np.ndarray, " F"]  # those in which a camera has a frame, from 0
    index: Int[np.ndarray, "F C"]  # position in the camera's own frames; -1 where it has none within half a period
    places: tuple[
        Float[np.ndarray, " _"], ...
    ]  # ticks: when each frame of each camera was, less the camera's own phase
    other_rate: Bool[np.ndarray, " C"]  # cameras whose frames drift through the ticks


def common_clock(times: Sequence[Float[np.ndarray, " _"]]) -> CommonClock:
    """The nearest frame of every camera to each tick, at most half a period away; gaps stay gaps.

    The clock runs at the middle rate of the cameras, those left out that are faster by half or more. A camera
    that keeps one phase to the clock is matched about that phase, so that jitter does not move it from tick to tick.

    Args:
        times: of each camera's frames, rising, two or more.
    """
    periods = np.array([period_of(own) for own in times])
    alike = np.sort(periods[periods >= ONE_CLASS * periods.max()])
    period = float(alike[len(alike) // 2])
    leader = int(np.abs(periods - period).argmin())
    start = times[leader][0]
    phases = [_phase((own - start) / period) for own in times]
    ticks = [(own - start) / period - phase for own, phase in zip(times, phases)]
    kept = [_nearest(own) for own in ticks]
    rows = np.unique(np.concatenate([np.round(own[frames]) for own, frames in zip(ticks, kept)]).astype(int))
    index = np.full((len(rows), len(times)), -1)
    for camera, (own, frames) in enumerate(zip(ticks, kept)):
        index[np.searchsorted(rows, np.round(own[frames])), camera] = frames
    off = [_far(own[frames] - np.round(own[frames])) for own, frames in zip(ticks, kept)]
    return CommonClock(period, rows - rows[0], index, tuple(own - rows[0] for own in ticks), np.array(off))


def period_of(times: Float[np.ndarray, " F"]) -> float:
    """Mean time from frame to frame, frames that were dropped counted."""
    steps = np.diff(times)
    frames = np.concatenate([[0], np.cumsum(np.maximum(np.round(steps / np.median(steps)), 1))])
    return float(np.polyfit(frames, times - times[0], 1)[0])


def gaps_of(times: Float[np.ndarray, " F"]) -> int:
    """How many frames were dropped between the first and the last."""
    steps = np.diff(times)
    return int(np.maximum(np.round(steps / np.median(steps)) - 1, 0).sum())


def _phase(ticks: Float[np.ndarray, " F"]) -> float:
    """Where between the ticks a camera's frames lie, -0.5 to 0.5; 0 where they do not keep one place."""
    mean = np.exp(2j * np.pi * ticks).mean()
    return float(np.angle(mean) / (2 * np.pi)) if abs(mean) > STEADY else 0.0


def _nearest(ticks: Float[np.ndarray, " N"]) -> Int[np.ndarray, " K"]:
    """The frames that are the nearest to their tick, and within half a period of it."""
    off = np.abs(ticks - np.round(ticks))
    best: dict[int, int] = {}
    for frame in np.flatnonzero(off < HALF):
        tick = int(np.round(ticks[frame]))
        if tick not in best or off[frame] < off[best[tick]]:
            best[tick] = int(frame)
    return np.array(sorted(best.values()), dtype=int)


def _far(ahead: Float[np.ndarray, " N"]) -> bool:
    return bool(len(ahead) and np.percentile(np.abs(ahead), 90) > OFF_CLOCK)
