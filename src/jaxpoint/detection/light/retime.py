"""Where a light was at the times of a common clock, from a camera that took its frames at other times.

The nearest frame would be up to half a frame off, in a sawtooth that no constant offset mends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

NEAR = 0.02  # rows: a frame this near to a row is that of the row
MAX_GAP = 1.6  # periods of the camera: between frames further apart one was lost


@dataclass(frozen=True)
class Retimed:
    """One camera's lights at the times of the rows."""

    pixels: Float[np.ndarray, "F 2"]  # px, (0, 0) where not known
    covariance: Float[np.ndarray, "F 2 2"]  # px^2, zeros where not known
    known: Bool[np.ndarray, " F"]  # False where the light was not seen both before and after


def retime(
    rows: Int[np.ndarray, " F"],
    times: Float[np.ndarray, " N"],
    pixels: Float[np.ndarray, "N 2"],
    covariance: Float[np.ndarray, "N 2 2"],
    found: Bool[np.ndarray, " N"],
) -> Retimed:
    """Cubic interpolation between the two frames around each of F rows, where both show the light.

    Args:
        rows: times of the rows.
        times: of the camera's N frames, in the same unit, rising.
        pixels: of the light in each frame, px.
        covariance: of the pixels, px^2.
        found: whether the frame shows the light.
    """
    own, places, spread = times[found], pixels[found], covariance[found]
    if len(own) < 2:
        return Retimed(np.zeros((len(rows), 2)), np.zeros((len(rows), 2, 2)), np.zeros(len(rows), dtype=bool))
    gap = MAX_GAP * float(np.median(np.diff(times)))
    after = np.searchsorted(own, rows).clip(1, len(own) - 1)
    start, end = own[after - 1], own[after]
    at_frame = (np.abs(start - rows) < NEAR) | (np.abs(end - rows) < NEAR)
    known = at_frame | ((start <= rows) & (rows <= end) & (end - start <= gap))
    part = ((rows - start) / (end - start)).clip(0, 1)[:, None]
    slope = _slopes(own, places, gap)
    moved = _hermite(part, (end - start)[:, None], places[after - 1], places[after], slope[after - 1], slope[after])
    part = part[..., None]
    mixed = (1 - part) ** 2 * spread[after - 1] + part**2 * spread[after]
    return Retimed(np.where(known[:, None], moved, 0.0), np.where(known[:, None, None], mixed, 0.0), known)


def _slopes(times: Float[np.ndarray, " N"], places: Float[np.ndarray, "N 2"], gap: float) -> Float[np.ndarray, "N 2"]:
    """Pixels per row in each frame: of the parabola through it and its neighbours, of one side beside a gap."""
    steps = np.diff(times)[:, None]
    rise = np.diff(places, axis=0) / steps
    joined = steps <= gap
    left = np.concatenate([rise[:1], rise])
    right = np.concatenate([rise, rise[-1:]])
    left_joined = np.concatenate([[[False]], joined])
    right_joined = np.concatenate([joined, [[False]]])
    before = np.concatenate([steps[:1], steps])
    later = np.concatenate([steps, steps[-1:]])
    middle = (later * left + before * right) / (before + later)
    return np.where(left_joined & right_joined, middle, np.where(left_joined, left, right))


def _hermite(
    part: Float[np.ndarray, "F 1"],
    step: Float[np.ndarray, "F 1"],
    first: Float[np.ndarray, "F 2"],
    second: Float[np.ndarray, "F 2"],
    first_slope: Float[np.ndarray, "F 2"],
    second_slope: Float[np.ndarray, "F 2"],
) -> Float[np.ndarray, "F 2"]:
    """The cubic through two places with two slopes, at a part 0..1 of the way."""
    rest = 1 - part
    ends = rest**2 * (1 + 2 * part) * first + part**2 * (1 + 2 * rest) * second
    return ends + step * part * rest * (rest * first_slope - part * second_slope)
