"""What a fixed camera sees without the light: a level and a deviation for every pixel."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

DEVIATION_FLOOR = 1.0  # grey levels: 8-bit images cannot show less
MAD_TO_SIGMA = 1.4826  # of a normal distribution


@dataclass(frozen=True)
class Background:
    """Level and standard deviation of one channel, grey levels."""

    level: Float32[np.ndarray, "H W"]
    deviation: Float32[np.ndarray, "H W"]  # at least 1


def mean_background(frames: Iterable[UInt8[np.ndarray, "H W"]]) -> Background:
    """Mean and standard deviation over all frames in one pass (Welford); thesis 5.3.1.

    The light itself inflates the deviation where it went slowly, which is why the median is the default.

    Raises:
        ValueError: no frames.
    """
    iterator = iter(frames)
    first = next(iterator, None)
    if first is None:
        raise ValueError("A background needs at least one frame.")
    count, mean = 1, first.astype(np.float32)
    squares = np.zeros_like(mean)
    for count, frame in enumerate(iterator, start=2):
        delta = frame - mean
        mean += delta / np.float32(count)
        squares += delta * (frame - mean)
    return Background(mean, np.maximum(np.sqrt(squares / np.float32(count)), np.float32(DEVIATION_FLOOR)))


def median_background(frames: UInt8[np.ndarray, "N H W"]) -> Background:
    """Median and scaled median absolute deviation over N frames spread over the recording.

    Raises:
        ValueError: no frames.
    """
    if not len(frames):
        raise ValueError("A background needs at least one frame.")
    level = np.empty(frames.shape[1:], dtype=np.float32)
    deviation = np.empty_like(level)
    for row in range(frames.shape[1]):  # a row at a time stays in cache
        values = np.ascontiguousarray(frames[:, row].T)  # W N
        middle, level[row] = _grouped_median(values)
        distance = np.maximum(values, middle[:, None]) - np.minimum(values, middle[:, None])
        _, spread = _grouped_median(distance, folded=True)
        deviation[row] = MAD_TO_SIGMA * spread
    return Background(level, np.maximum(deviation, np.float32(DEVIATION_FLOOR)))


def _grouped_median(
    values: UInt8[np.ndarray, "W N"], folded: bool = False
) -> tuple[UInt8[np.ndarray, " W"], Float32[np.ndarray, " W"]]:
    """Median grey level, and the same within its bin of one grey level.

    Whole numbers are too coarse: a noise of 2 grey levels would get a deviation of 1.5 or 3. `folded` values are
    absolute, so their lowest bin is half as wide.
    """
    count = values.shape[1]
    middle = np.partition(values, (count - 1) // 2, axis=1)[:, (count - 1) // 2]
    below = (values < middle[:, None]).sum(axis=1)
    inside = (values == middle[:, None]).sum(axis=1)
    part = (count / 2 - below) / inside
    low, width = middle - 0.5, 1.0
    if folded:
        low, width = np.maximum(low, 0), np.where(middle == 0, 0.5, 1.0)
    return middle, (low + width * part).astype(np.float32)
