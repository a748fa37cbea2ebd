"""Where the outliers of one camera gather: at one place of its image, beyond a radius, or at one time."""

from __future__ import annotations

import numpy as np

from jaxpoint.report.summary import GRID, image_cells


def gathered_place(pixels: np.ndarray, size: np.ndarray) -> tuple[float, np.ndarray] | None:
    """The share of these outliers in their fullest cell and their median pixel there, where it is more than 40 %."""
    column, row = image_cells(pixels, size).T
    cells, counts = np.unique(row * GRID[0] + column, return_counts=True)
    fullest = counts.argmax()
    if counts[fullest] < max(8, 0.4 * len(pixels)):
        return None
    there = (row * GRID[0] + column) == cells[fullest]
    return float(there.mean()), np.median(pixels[there], axis=0)


def edge_of_lens(
    pixels: np.ndarray, size: np.ndarray, judged: np.ndarray, rejected: np.ndarray
) -> tuple[float, float, float] | None:
    """A radius (px from the image's middle) beyond which far more is rejected than within, and both fractions.

    Of all radii the one that tells the two apart best (largest likelihood of two fractions); None where there is none.
    """
    radius, bad = np.linalg.norm(pixels[judged] - (size - 1) / 2, axis=1), rejected[judged]
    order = np.argsort(-radius, kind="stable")
    count, caught = np.arange(1, len(bad)), np.cumsum(bad[order])[:-1]
    rest, missed = len(bad) - count, bad.sum() - caught
    beyond, within = caught / count, missed / rest
    told = _log_likelihood(beyond, count) + _log_likelihood(within, rest)
    clear = (count >= 20) & (beyond >= 0.4) & (within <= beyond / 5) & (caught >= 0.3 * bad.sum())
    if not clear.any():
        return None
    best = int(np.where(clear, told, -np.inf).argmax())
    return float(radius[order][best]), float(beyond[best]), float(within[best])


def _log_likelihood(share: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Of that share of so many, under its own best fraction."""
    safe = np.clip(share, 1e-9, 1 - 1e-9)
    return count * (share * np.log(safe) + (1 - share) * np.log(1 - safe))


def gathered_time(judged: np.ndarray, rejected: np.ndarray, window: int = 30) -> tuple[int, int] | None:
    """First and last row of a stretch of at least `window` judged observations of which 80 % are rejected."""
    rows = np.flatnonzero(judged)
    if len(rows) < 2 * window:
        return None
    share = np.convolve(rejected[rows].astype(float), np.ones(window) / window, mode="valid")
    bad = np.flatnonzero(share >= 0.8)
    if not bad.size:
        return None
    run = bad[: int(np.argmax(np.append(np.diff(bad) > window, True))) + 1]
    return int(rows[run[0]]), int(rows[run[-1] + window - 1])
