"""Tangential and higher radial lens terms are freed only where held-out error falls."""

from __future__ import annotations

import numpy as np

from jaxpoint.calibration.bundle import K3, TANGENTIAL
from jaxpoint.calibration.objective import Solution, solve_with
from jaxpoint.calibration.outliers import GROWING_PX, Settled, judge, settle
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, place_points, project
from jaxpoint.calibration.result import Stage
from jaxpoint.config import CalibrateSettings

LEAST_GAIN = 0.05  # of the mean held-out error: less is not worth a flatter valley of the focal lengths
STRETCHES = 40
LEAST_EVIDENCE = 3.0  # standard errors of the mean difference


def choose_lens(recording: Recording, solution: Solution, settings: CalibrateSettings) -> tuple[Solution, Stage]:
    """Solve again with p1, p2 and k3 where they predict held-out frames better; otherwise leave the rig as it is."""
    simple, rich = (_with_terms(solution.freedom, recording.exists, extra) for extra in (False, True))
    if solution.freedom.free[:, K3].any():  # chosen before another prior was given up: ask again
        solution = solve_with(recording, _without_terms(solution.settled.judged.state), simple, settings.outliers)
    settled = solution.settled
    held = _held_out_frames(settled.judged.kept, settings.held_out, settings.seed)
    if held.sum() < 10:
        return solution, Stage("Lens model", {"chosen": "k1, k2", "why": "too few frames to hold out"})
    before, after = (_held_out_errors(recording, settled, freedom, held) for freedom in (simple, rich))
    gain = before - after
    evidence = gain.mean() / max(gain.std() / np.sqrt(len(gain)), 1e-12)
    figures = {
        "held_out_frames": int(held.sum()),
        "held_out_mean_px_k1_k2": float(before.mean()),
        "held_out_mean_px_with_p1_p2_k3": float(after.mean()),
        "gain_in_standard_errors": float(evidence),
    }
    if gain.mean() <= LEAST_GAIN * before.mean() or evidence <= LEAST_EVIDENCE:
        return solution, Stage("Lens model", {"chosen": "k1, k2", **figures})
    judged = judge(recording, settled.judged.state, GROWING_PX[-1] * recording.scale)
    again = settle(recording, judged, rich, settings.outliers)
    return Solution(again, rich), Stage("Lens model", {"chosen": "k1, k2, p1, p2, k3", **figures})


def _with_terms(freedom: Freedom, exists: np.ndarray, extra: bool) -> Freedom:
    """The freedom with tangential and third radial terms free or not."""
    free = freedom.free.copy()
    free[exists, TANGENTIAL], free[exists, K3] = extra, extra
    return Freedom(free, freedom.prior_mean, freedom.prior_weight)


def _without_terms(state: RigState) -> RigState:
    cameras = state.cameras.copy()
    cameras[:, TANGENTIAL], cameras[:, K3] = 0.0, 0.0
    return RigState(cameras, state.base, state.points)


def _held_out_frames(kept: np.ndarray, share: float, seed: int) -> np.ndarray:
    """Frames (N,) set aside in whole stretches: neighbours in time share their errors and would tell too much.

    Frames with three views or more where possible, as two views predict next to nothing.
    """
    views = kept.sum(axis=1)
    usable = np.flatnonzero(views >= 3) if (views >= 3).sum() >= 100 else np.flatnonzero(views >= 2)
    stretches = np.array_split(usable, min(STRETCHES, max(len(usable) // 5, 1)))
    order = np.random.default_rng(seed).permutation(len(stretches))
    held = np.zeros(len(kept), bool)
    for stretch in order[: max(1, round(share * len(stretches)))]:
        held[stretches[stretch]] = True
    return held


def _held_out_errors(recording: Recording, settled: Settled, freedom: Freedom, held: np.ndarray) -> np.ndarray:
    """Mean error (px) of every held-out frame, triangulated with cameras fitted without them."""
    kept = settled.judged.kept
    loss = 2.0 * settled.sigma_px
    freedom = freedom.at_noise(settled.sigma_px)
    fit = adjust(recording, settled.judged.state, kept & ~held[:, None], freedom, loss_scale=loss, steps=40)
    start = RigState(fit.state.cameras, fit.state.base, settled.judged.state.points)
    placed = place_points(recording, start, kept & held[:, None], loss)
    errors = np.linalg.norm(project(placed)[0] - recording.pixels, axis=-1)
    return np.where(kept, errors, 0.0).sum(axis=1)[held] / kept.sum(axis=1)[held]
