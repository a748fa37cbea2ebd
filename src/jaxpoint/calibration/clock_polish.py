"""A camera's clock to a hundredth of a frame: offset, rate and epipolar geometry adjusted together.

The share of matches that fit hardly changes within a tenth of a frame, but a drift of a tenth over a recording is a
pixel or more where the light is fast. Here the epipolar error of every match is made least, linear in the geometry
(nine entries, of any norm), the lenses and the two unknowns of the clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.clock_fit import Agreement, Clock, PairView

ROUNDS = 4  # of moving the pixels to the clock anew
REWEIGHTED = 8  # times, robustly, in each
SCALE_PX = 1.0  # at an image width of 1280 px: error at which a match begins to count as an outlier
LEAST = 50  # matches
APART = 0.25  # frames before and after, between which the light's motion is taken


def polish(agreement: Agreement, camera: int, clock: Clock, others: Sequence[tuple[int, Clock]]) -> Clock:
    """The clock near the given one with the least errors; the given one where nothing better is found."""
    after = (agreement.tracks.frame_ids - agreement.tracks.frame_ids.min()).astype(float)
    best = clock
    for _ in range(ROUNDS):
        changes = np.array([_change(agreement, (camera, best), other, after) for other in others])
        changes = changes[np.isfinite(changes).all(axis=1)]
        if not len(changes):
            return clock
        offset, slope = np.median(changes, axis=0)
        best = Clock(best.offset + float(offset), best.rate + float(slope))
    before, polished = (agreement.shares((camera, one), others) for one in (clock, best))
    return best if polished.fit > before.fit - 0.01 else clock


def _change(agreement: Agreement, own: tuple[int, Clock], other: tuple[int, Clock], after) -> Float[np.ndarray, "2"]:
    """What a pair of cameras adds to the offset and rate of one of them; NaN where they share too little."""
    camera, clock = own
    step = APART * agreement.step
    now = agreement.pair(other, own)
    sides = [agreement.pair(other, (camera, replace(clock, offset=clock.offset + by))) for by in (-step, step)]
    seen = now.seen & sides[0].seen & sides[1].seen
    if seen.sum() < LEAST:
        return np.full(2, np.nan)
    motion = (sides[1].second[seen] - sides[0].second[seen]) / (2.0 * step)
    times = np.zeros(len(seen))
    times[: len(now.rows)] = after[now.rows]
    return _solve(now, seen, motion, times[seen])


def _solve(
    now: PairView, seen: Bool[np.ndarray, " P"], motion: Float[np.ndarray, "N 2"], times: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "2"]:
    """Offset and rate to add, with the geometry, both lenses and the clock free."""
    first, second, lenses = now.first[seen], now.second[seen], now.lenses.copy()
    matrix, span = now.fundamental, max(float(np.ptp(times)), 1.0)
    about, late = (times - times.mean()) / span, np.zeros(2)
    for _ in range(REWEIGHTED):
        rays_a, rays_b = _lift(first, lenses[0]), _lift(second, lenses[1])
        moved = np.concatenate([motion, 2.0 * lenses[1] * (second * motion).sum(axis=1)[:, None]], axis=1)
        line_a, line_b = rays_b @ matrix, rays_a @ matrix.T
        by_clock = (moved * line_b).sum(axis=1)
        columns = [
            (rays_b[:, :, None] * rays_a[:, None, :]).reshape(-1, 9),
            (line_a[:, 2] * (first**2).sum(axis=1))[:, None],
            (line_b[:, 2] * (second**2).sum(axis=1))[:, None],
            np.stack([by_clock, by_clock * about], axis=1),
        ]
        scale = _gradient(line_a, line_b, now.half_diagonals)[:, None]
        design = np.concatenate(columns, axis=1) / scale
        error = design[:, :9] @ matrix.reshape(9) + design[:, 11:] @ late
        root = 1.0 / np.sqrt(1.0 + (error / (SCALE_PX * now.width / 1280.0)) ** 2)
        # A longer F changes nothing: its length is held by a row of its own.
        held = np.concatenate([1e3 * matrix.reshape(1, 9), np.zeros((1, 4))], axis=1)
        step = np.linalg.lstsq(np.vstack([design * root[:, None], held]), np.append(-error * root, 0.0))[0]
        matrix = matrix + step[:9].reshape(3, 3)
        matrix, lenses, late = matrix / np.linalg.norm(matrix), lenses + step[9:11], late + step[11:]
    slope = late[1] / span
    return np.array([late[0] - slope * times.mean(), slope])


def _lift(points: Float[np.ndarray, "N 2"], lens: float) -> Float[np.ndarray, "N 3"]:
    return np.concatenate([points, 1.0 + lens * (points**2).sum(axis=1, keepdims=True)], axis=1)


def _gradient(line_a, line_b, half_diagonals) -> Float[np.ndarray, " N"]:
    """Length of the gradient of the epipolar form by the pixels, about: lenses taken as straight."""
    square = (line_a[:, :2] ** 2).sum(axis=1) / half_diagonals[0] ** 2
    return np.sqrt(square + (line_b[:, :2] ** 2).sum(axis=1) / half_diagonals[1] ** 2 + 1e-20)
