"""A camera's clock to a hundredth of a frame: offset, rate and epipolar geometry adjusted together.

The share of matches that fit hardly changes within a tenth of a frame, but a drift of a tenth over a recording is a
pixel or more where the light is fast. Here the epipolar error of every match is made least (`solve_pair`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.clock_fit import APART, Agreement, Clock
from jaxpoint.calibration.pair_solve import Mover, solve_pair

ROUNDS = 4  # of moving the pixels to the clock anew
LEAST = 50  # matches


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
    span = max(float(np.ptp(times[seen])), 1.0)
    about = (times[seen] - times[seen].mean()) / span
    late = solve_pair(now, seen, (Mover(1, motion), Mover(1, motion * about[:, None]))).values
    slope = late[1] / span
    return np.array([late[0] - slope * times[seen].mean(), slope])
