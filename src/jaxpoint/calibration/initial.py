"""The first solution: initialisers compete, and the lowest robust cost over all observations wins."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jaxpoint.calibration.factorization import Projective, factorise_tracks, refine
from jaxpoint.calibration.hypotheses import Lenses, essential_chains, euclidean_upgrades
from jaxpoint.calibration.outliers import FIRST_LOSS_PX, robust_cost
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust
from jaxpoint.calibration.result import Stage
from jaxpoint.calibration.sturm_triggs import thesis_factorisation
from jaxpoint.calibration.twoview import NormalisedTracks, TwoViewGeometry
from jaxpoint.camera.parameters import COEFFICIENTS
from jaxpoint.errors import InsufficientDataError

VOTES = 0.5  # an observation joins the first solution if it fits at least this share of its pairs
RANDOM_STARTS = 3  # of the factorisation


@dataclass(frozen=True)
class Start:
    """One candidate, shortly adjusted."""

    method: str
    state: RigState
    cost: float  # Cauchy cost over all observations, px^2


@dataclass(frozen=True)
class Inputs:
    """What every initialiser works from."""

    recording: Recording
    data: NormalisedTracks
    geometry: TwoViewGeometry
    lenses: Lenses
    freedom: Freedom
    seed: int

    @property
    def kept(self) -> np.ndarray:
        """(N, C) observations that the pairs believe, in frames with two or more of them."""
        kept = self.data.visible & (self.geometry.votes >= VOTES)
        return kept & (kept.sum(axis=1) >= 2)[:, None]


def starts(inputs: Inputs, method: str) -> tuple[list[Start], list[Stage]]:
    """Shortly adjusted candidates of an initialiser (or of several for `auto`), best first, and its stages.

    Raises:
        InsufficientDataError: no initialiser reaches every camera.
    """
    found: list[Start] = []
    stages: list[Stage] = []
    wanted = ("factorisation", "essential") if method == "auto" else (method,)
    for name in wanted:
        states, more = _INITIALISERS[name](inputs)
        stages += more
        found += [_adjust_candidate(inputs, name, state) for state in states]
    found = sorted((start for start in found if np.isfinite(start.cost)), key=lambda start: start.cost)
    if not found:
        raise InsufficientDataError(
            f"No first solution was found (--init {method}): the cameras share too few frames, are out of step "
            "(`jaxpoint check`), or have very wide lenses; wave the light longer where several cameras see it, or give "
            "known lenses (--intrinsics)."
        )
    figures = {
        "candidates": [{"method": s.method, "robust_cost_px2": s.cost} for s in found],
        "chosen": found[0].method,
    }
    return found, [*stages, Stage("First solution", figures)]


def _adjust_candidate(inputs: Inputs, method: str, state: RigState) -> Start:
    """A short robust adjustment on what the pairs believe, then the cost over everything."""
    recording = inputs.recording
    state = _without_held_bends(state, inputs.freedom)
    kept = np.pad(inputs.kept, ((0, 0), (0, recording.visible.shape[1] - recording.cameras)))
    if not state.points.any():
        from jaxpoint.calibration.consensus import consensus

        found = consensus(recording, state, 3.0 * FIRST_LOSS_PX * recording.scale)
        state, kept = replace(state, points=found.points), kept & found.placed[:, None]
    loss = FIRST_LOSS_PX * recording.scale
    end = adjust(recording, state, kept, inputs.freedom, loss_scale=loss, steps=25, rtol=1e-4)
    return Start(method, end.state, robust_cost(recording, end.state))


def _without_held_bends(state: RigState, freedom: Freedom) -> RigState:
    """Lens coefficients that do not move stand at their prior (0, or what is known), not at the pairs' guess."""
    cameras = state.cameras.copy()
    cameras[:, COEFFICIENTS] = np.where(freedom.free, cameras, freedom.prior_mean)[:, COEFFICIENTS]
    return replace(state, cameras=cameras)


def _factorisation(inputs: Inputs) -> tuple[list[RigState], list[Stage]]:
    """Rank-4 factorisation under a mask from random starts, projective adjustment, Euclidean upgrade."""
    rng = np.random.default_rng(inputs.seed)
    tries = [factorise_tracks(inputs.data, inputs.geometry.lenses, inputs.kept, rng) for _ in range(RANDOM_STARTS)]
    best = min(tries, key=lambda start: start.cost if np.isfinite(start.cost) else np.inf)
    return _euclidean(inputs, "Factorisation", best, {"start_costs": [start.cost for start in tries]})


def _thesis(inputs: Inputs) -> tuple[list[RigState], list[Stage]]:
    """The thesis's depths, fill and rank-4 factorisation, then the same upgrade."""
    rng = np.random.default_rng(inputs.seed)
    start = thesis_factorisation(inputs.data, inputs.geometry, inputs.kept, rng)
    return _euclidean(inputs, "Factorisation (thesis)", start, {})


def _euclidean(inputs: Inputs, name: str, start: Projective, figures: dict) -> tuple[list[RigState], list[Stage]]:
    loss = FIRST_LOSS_PX * inputs.recording.scale
    refined = refine(inputs.data, start, inputs.kept, loss)
    kept = inputs.kept
    figures = {
        "projective_mean_px_before": float(start.errors[kept].mean()),
        "projective_mean_px_after": float(refined.errors[kept].mean()),
        "frames": int(kept.any(axis=1).sum()),
        "per_camera_mean_px": [float(refined.errors[kept[:, c], c].mean()) for c in range(kept.shape[1])],
        **figures,
    }
    return euclidean_upgrades(inputs.recording, inputs.data, refined, kept, inputs.lenses), [Stage(name, figures)]


def _essential(inputs: Inputs) -> tuple[list[RigState], list[Stage]]:
    """Focal lengths by vote, then a chain of essential matrices."""
    return essential_chains(inputs.recording, inputs.data, inputs.geometry, inputs.kept, inputs.lenses), []


_INITIALISERS = {"factorisation": _factorisation, "thesis": _thesis, "essential": _essential}
