"""One figure by which whole solutions are compared: robust cost and priors, in variances of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from jaxpoint.calibration.outliers import Settled, refine_coarse_to_fine, refine_to_convergence
from jaxpoint.calibration.recording import NOISE_PX, Freedom, Recording, RigState
from jaxpoint.config import OutlierSettings

IMPLAUSIBLE = 1e-4  # chance of a larger pull on the priors; other starts are looked at below it


@dataclass(frozen=True)
class Solution:
    """A rig whose inliers no longer change, and what was free in it."""

    settled: Settled
    freedom: Freedom

    def objective(self, sigma_px: float) -> float:
        """Minus twice the log posterior but for a constant, at this noise; over all observations, outliers clipped."""
        return self.settled.cost / sigma_px**2 + self.pull

    @property
    def state(self) -> RigState:
        """The rig."""
        return self.settled.judged.state

    @property
    def pull(self) -> float:
        """Chi-square of the free parameters against their priors."""
        freedom, cameras = self.freedom, self.settled.judged.state.cameras
        square = freedom.prior_weight / NOISE_PX**2 * (cameras - freedom.prior_mean) ** 2
        return float(square[freedom.free].sum())

    @property
    def plausible(self) -> bool:
        """Whether the free parameters agree with their priors, all together."""
        count = int((self.freedom.free & (self.freedom.prior_weight > 0)).sum())
        return count == 0 or bool(chi2.sf(self.pull, count) >= IMPLAUSIBLE)


def solve_with(recording: Recording, state: RigState, freedom: Freedom, settings: OutlierSettings) -> Solution:
    """The solution near a state when other parameters are free, outliers judged anew from coarse to fine."""
    return Solution(
        refine_to_convergence(recording, refine_coarse_to_fine(recording, state, freedom), freedom, settings), freedom
    )


def better_by(one: Solution, other: Solution) -> float:
    """By how much the objective of `one` lies below that of `other`; both at the smaller noise of the two."""
    sigma = min(one.settled.sigma_px, other.settled.sigma_px)
    return other.objective(sigma) - one.objective(sigma) if np.isfinite(sigma) else 0.0
