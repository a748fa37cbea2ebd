"""Frames that a recording repeats or skips at regular intervals, to keep up with a rate that is not its camera's.

Such a camera's frames do not lie evenly in time: its light rests for a frame, or goes twice as far, and in between it
is whole frames off. Brought to one clock by moving it fractions of a frame, half of its pixels would be wrong.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.motion import frame_step
from jaxpoint.tracks import Tracks

LEAST_PX = 4.0  # a frame, at an image width of 1280 px: a slower light shows no steps
STEADY = 0.4  # times the light's way in a frame: by no more may the ways before and after a step differ
RESTS = 0.25  # times that way: as near to nothing, or to twice it, is the way of a step
NEAR = 2  # rows that a step may lie from where a regular interval has it
SURPLUS = 3  # steps that must be seen, and this many times those that are missing
MOST_SEEN = 40  # steps between which intervals are tried
WIDE = 0.35  # part of the interval by which it may differ from what the rate says


@dataclass(frozen=True)
class Steps:
    """Where a camera repeats (or skips) a frame."""

    rows: Int[np.ndarray, " S"]  # the first row after each step
    skips: bool  # rather than repeats
    rate: float  # frames of the file to one of the camera

    def places(self, rows: int) -> Int[np.ndarray, " F"]:
        """The camera's own frame at each row, counted from the first."""
        steps = np.zeros(rows, int)
        np.add.at(steps, self.rows, 1 if self.skips else -1)
        return np.arange(rows) + np.cumsum(steps)


def regular_steps(tracks: Tracks, camera: int, usable: Bool[np.ndarray, "F C"], rate: float) -> Steps | None:
    """The steps of a camera that runs at `rate` frames to one of the others; None where its light moves evenly.

    Args:
        usable: observations that are no outliers.
    """
    slope = 1.0 / rate - 1.0  # of the camera's frames over the rows: positive where frames are skipped
    step = frame_step(tracks.series_ids)
    even = len(tracks.frame_ids) > 8 and bool((np.diff(tracks.frame_ids) == step).all())
    if not even or not 0 < abs(slope) < 0.2 or abs(slope) * tracks.frames < SURPLUS:
        return None
    ways = _ways(tracks.pixels[:, camera], usable[:, camera], LEAST_PX * tracks.image_sizes[camera, 0] / 1280.0)
    seen = np.flatnonzero(ways == (2 if slope > 0 else 0))
    plain = np.flatnonzero(ways == 1)
    if len(seen) < SURPLUS:
        return None
    rows = _regular(seen, plain, 1.0 / abs(slope), tracks.frames)
    if rows is None:
        return None
    interval = float(np.mean(np.diff(rows)))
    return Steps(rows, slope > 0, 1.0 / (1.0 + 1.0 / interval) if slope > 0 else 1.0 / (1.0 - 1.0 / interval))


def _ways(pixels: Float[np.ndarray, "F 2"], usable: Bool[np.ndarray, " F"], least: float) -> Int[np.ndarray, " F"]:
    """How many frames' way the light goes to each row from the one before: 0, 1 or 2; -1 where that cannot be told."""
    way = np.diff(pixels, axis=0)  # to rows 1 ... F - 1
    known = usable[1:] & usable[:-1]
    before, now, after = way[:-2], way[1:-1], way[2:]
    usual = (before + after) / 2.0
    speed = np.linalg.norm(usual, axis=1)
    told = known[:-2] & known[1:-1] & known[2:] & (speed >= least)
    told &= np.linalg.norm(before - after, axis=1) <= STEADY * speed
    found = np.full(len(pixels), -1)
    for times in (1, 0, 2):
        near = told & (np.linalg.norm(now - times * usual, axis=1) <= RESTS * speed)
        found[2:-1][near] = times
    return found


def _regular(seen: np.ndarray, plain: np.ndarray, interval: float, rows: int) -> Int[np.ndarray, " S"] | None:
    """Regular rows, at about this interval, at which most steps are seen and few plain ways: through two seen ones."""
    best, chosen = 0, None
    for i, j in itertools.combinations(seen[:MOST_SEEN].tolist(), 2):
        for count in range(round((j - i) / interval / (1.0 + WIDE)), round((j - i) / interval / (1.0 - WIDE)) + 1):
            length = (j - i) / max(count, 1)
            if abs(length / interval - 1.0) > WIDE:
                continue
            at = np.arange(i % length, rows - 0.5, length)
            hit = _near(seen, at)
            missed = ~hit & _all_plain(plain, at)
            score = int(hit.sum()) - int(missed.sum())
            if hit.sum() >= SURPLUS * max(1, missed.sum()) and score > best:
                best, chosen = score, np.where(hit, seen[np.abs(seen[:, None] - at).argmin(axis=0)], np.round(at))
    return None if chosen is None else np.unique(chosen[chosen > 0].astype(int))


def _near(seen: np.ndarray, at: np.ndarray) -> Bool[np.ndarray, " S"]:
    return np.asarray((np.abs(seen[:, None] - at) <= NEAR).any(axis=0))


def _all_plain(plain: np.ndarray, at: np.ndarray) -> Bool[np.ndarray, " S"]:
    """The light went evenly at all rows around: there is no step."""
    return (np.abs(plain[:, None] - at) <= NEAR).sum(axis=0) >= 2 * NEAR


def without_steps(tracks: Tracks, camera: int, steps: Steps) -> Tracks:
    """The tracks with this camera's frames at their own places in time; a repeated frame is used once."""
    places = steps.places(tracks.frames)
    first = np.append(True, np.diff(places) > 0) & (places < tracks.frames)
    pixels, visible = tracks.pixels.copy(), tracks.visible.copy()
    pixels[:, camera], visible[:, camera] = 0.0, False
    pixels[places[first], camera] = tracks.pixels[first, camera]
    visible[places[first], camera] = tracks.visible[first, camera]
    return replace(tracks, pixels=pixels, visible=visible)
