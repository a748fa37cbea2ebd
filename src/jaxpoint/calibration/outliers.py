"""Which observations to believe: rounds that shrink and grow until nothing changes.

Every round judges all visible observations anew against the point on which most views of their frame agree; nothing
that was thrown out stays out for that reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from jaxpoint.calibration.bodies import Bodies, bodies_of, firm_rows, held_rows
from jaxpoint.calibration.consensus import consensus, no_consensus
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, place_points, project
from jaxpoint.calibration.result import Verdict
from jaxpoint.config import OutlierSettings

GROWING_STEPS, ROUGH_STEPS = 15, 6  # of an adjustment that the next judgement overtakes
GROWING_PX = (30.0, 15.0, 8.0)  # readmission thresholds at an image width of 1280
FIRST_LOSS_PX = 10.0  # Cauchy scale of the adjustments before the noise is known, likewise
JUDGED_LOSS_PX = 3.0  # Cauchy scale with which whole hypotheses are compared, likewise
FEW_CHANGES = 0.003  # of the kept observations: from here on every round solves exactly
LEAST_SIGMA_PX = 0.02  # keeps the loss defined on data without noise


@dataclass(frozen=True)
class Classified:
    """Points, and a verdict on every observation."""

    state: RigState
    kept: np.ndarray  # (N, D)
    verdicts: np.ndarray  # (N, D) values of Verdict
    errors: np.ndarray  # (N, D) px; 0 where there is no point or no pixel


def classify_observations(
    recording: Recording, state: RigState, threshold: float, loss_scale: float | None = None
) -> Classified:
    """Points by consensus, refined robustly on all visible observations, then everything judged at `threshold` px.

    Points of targets stand where their poses put them, and known points start where they are known to be.
    """
    held = held_rows(recording, state)
    loose = recording.visible.any(axis=1) & ~held
    found = consensus(recording, state, 1.5 * threshold) if loose.any() else no_consensus(recording)
    visible = recording.visible & (found.placed | held)[:, None]
    start = replace(state, points=np.where(held[:, None], state.points, found.points))
    placed = place_points(recording, start, visible, loss_scale or threshold / 2.0)
    pixels, depth = project(placed)
    errors = np.linalg.norm(pixels - recording.pixels, axis=-1)
    near = visible & (errors < threshold) & (depth > 0)
    enough = np.where(held, firm_rows(recording, placed, near), (near.sum(axis=1) >= 2) & ~found.ambiguous)
    kept = near & enough[:, None]
    verdicts = np.full(kept.shape, Verdict.REPROJECTION, dtype=np.int8)
    verdicts[visible & (depth <= 0)] = Verdict.BEHIND
    verdicts[recording.visible & ~enough[:, None]] = Verdict.UNDECIDED
    verdicts[recording.visible & ((recording.visible.sum(axis=1) < 2) & ~held)[:, None]] = Verdict.FEW_VIEWS
    verdicts[~recording.visible] = Verdict.HIDDEN
    verdicts[kept] = Verdict.KEPT
    return Classified(placed, kept, verdicts, np.where(visible, errors, 0.0))


def robust_sigma(errors: np.ndarray, kept: np.ndarray, parameters: int, bodies: Bodies | None = None) -> float:
    """Standard deviation of one pixel coordinate.

    A point seen by V cameras leaves 2 V - 3 degrees of freedom for its summed squared error: 1 of 4 with two views,
    so a plain median over residuals would be far too small. The median over points of the sum over its chi-square
    median is robust and right for every V. The points of a target share the 6 of its pose.

    Args:
        bodies: which rows have a pose in common; every row is a point of its own if not given.
    """
    bodies = bodies or Bodies.single(len(kept))
    views = bodies.sums(kept.sum(axis=1))
    freedom = 2 * views - bodies.freedoms
    seen = freedom >= 1
    if not seen.any():
        return np.inf
    freedom = freedom[seen]
    squares = bodies.sums(np.where(kept, errors**2, 0.0).sum(axis=1))[seen] / (2 * gammaincinv(freedom / 2, 0.5))
    total = freedom.sum()
    inflate = total / max(total - parameters, 0.1 * total)
    return float(max(np.sqrt(np.median(squares) * inflate), LEAST_SIGMA_PX))


def robust_cost(recording: Recording, state: RigState) -> float:
    """Cauchy cost over all visible observations, points placed anew: what hypotheses are compared by (px^2)."""
    scale = JUDGED_LOSS_PX * recording.scale
    judged = classify_observations(recording, state, 3.0 * scale, scale)
    return cost_of(recording, judged, scale)


def cost_of(recording: Recording, judged: Classified, scale: float) -> float:
    """Cauchy cost of all observations of frames seen twice; one whose frame has no point costs as one far off."""
    alone = recording.visible.sum(axis=1) < 2
    testable = recording.visible & (~alone | held_rows(recording, judged.state))[:, None]
    placed = judged.verdicts != Verdict.UNDECIDED
    errors = np.where(placed, np.minimum(judged.errors, 1e4), 10.0 * scale)
    return float((scale**2 * np.log1p((errors[testable] / scale) ** 2)).sum())


@dataclass(frozen=True)
class Settled:
    """A rig whose set of believed observations no longer changes."""

    judged: Classified
    sigma_px: float
    cost: float
    converged: bool
    rounds: int


def refine_coarse_to_fine(recording: Recording, state: RigState, freedom: Freedom) -> Classified:
    """Adjust and judge in turn at thresholds that start rough: a rig near its end, and what to believe there."""
    scale = recording.scale
    for threshold in GROWING_PX:
        judged = classify_observations(recording, state, threshold * scale)
        loss = FIRST_LOSS_PX * scale
        state = adjust(
            recording, judged.state, judged.kept, freedom, loss_scale=loss, steps=GROWING_STEPS, rtol=1e-5
        ).state
    return classify_observations(recording, state, GROWING_PX[-1] * scale)


def refine_to_convergence(
    recording: Recording, judged: Classified, freedom: Freedom, settings: OutlierSettings
) -> Settled:
    """Adjust and judge in turn at the noise level until nothing changes.

    While the set still changes the solves are rough; the last ones are exact. Now and then an observation at the very
    threshold goes in and out for ever: a set that comes back is the end too. Without a frame that tells the noise the
    sigma is infinite, and nothing converges.
    """
    parameters = freedom.parameters
    bodies = bodies_of(recording, judged.state)
    sigma = robust_sigma(judged.errors, judged.kept, parameters, bodies)
    converged, rounds, exact = False, 0, False
    before: set[bytes] = set()
    while rounds < settings.max_rounds and not converged and np.isfinite(sigma):
        rounds += 1
        loss = {"loss_scale": 2.0 * sigma} if settings.loss == "cauchy" else {}
        rtol, steps = (1e-7, 100) if exact else (1e-4, ROUGH_STEPS)
        end = adjust(recording, judged.state, judged.kept, freedom.at_noise(sigma), steps=steps, rtol=rtol, **loss)
        sigma = robust_sigma(_errors(recording, end.state), judged.kept, parameters, bodies)
        again = classify_observations(
            recording, end.state, max(settings.sigmas * sigma, settings.floor_px), 2.0 * sigma
        )
        changed = int((again.kept != judged.kept).sum())
        returned = again.kept.tobytes() in before
        converged = exact and end.settled and (changed == 0 or returned)
        before.add(again.kept.tobytes())
        if not exact and (returned or changed <= FEW_CHANGES * judged.kept.sum()):
            exact, before = True, set()
        judged = again
    return Settled(judged, sigma, robust_cost(recording, judged.state), converged, rounds)


def _errors(recording: Recording, state: RigState) -> np.ndarray:
    return np.linalg.norm(project(state)[0] - recording.pixels, axis=-1)
