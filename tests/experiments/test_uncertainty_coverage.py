"""Whether the ellipsoids of a calibration hold the truth as often as they should."""

import numpy as np
from scipy.stats import binom

import uncertainty_coverage as coverage
from jaxpoint.simulate.recalibration import Recalibrated

SIGMA_PX = 0.5


def test_ellipsoids_hold_the_truth():
    """One point, centre and length of every recalibration are independent of the others': binomial bounds."""
    room = Recalibrated.of(1, cameras=6, frames=200, noise_px=SIGMA_PX)
    repeats = 100
    rows = [coverage.one(room, "least_squares", repeat) for repeat in range(repeats)]
    lowest, highest = binom.ppf([0.001, 0.999], repeats, 0.95)
    for kind in coverage.KINDS:
        ratio = np.stack([row.squares[kind] for row in rows]) / coverage.FREEDOMS[kind]
        held = np.stack([row.held(kind) for row in rows])
        which = np.arange(repeats) % held.shape[1]
        assert lowest <= held[np.arange(repeats), which].sum() <= highest, kind
        assert 0.92 <= held.mean() <= 0.98, kind
        assert 0.85 < ratio.mean() < 1.15, kind
