"""Time offsets and cameras together: the tracks brought to one clock, adjusted, and brought there anew.

The clock is the first camera's. Each round moves every observation to it with the offsets known so far, takes the
motion from what was not rejected, judges, and adjusts cameras, points and offsets together (`OffsetModel`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.bundle import LEAST_SQUARES, CameraModel, from_blocks, solve, to_blocks
from jaxpoint.calibration.offset_model import OffsetModel
from jaxpoint.calibration.outliers import (
    GROWING_PX,
    Classified,
    Settled,
    classify_observations,
    refine_to_convergence,
    robust_sigma,
)
from jaxpoint.calibration.recording import Freedom, Recording, RigState, project
from jaxpoint.calibration.result import Verdict
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns, reduced_system
from jaxpoint.compilation import jit
from jaxpoint.config import OutlierSettings
from jaxpoint.motion import OnClock, motion, on_clock
from jaxpoint.tracks import Tracks

STEPS = 30  # of one joint adjustment
MAX_ROUNDS = 15
STILL = 0.005  # frames: offsets that change less, twice in a row, no longer move
REJECTED = (Verdict.REPROJECTION, Verdict.BEHIND, Verdict.UNDECIDED)
SIMILARITY = 7  # freedoms of the frame and unit, which no observation holds


@dataclass(frozen=True)
class InStep:
    """A rig whose cameras were brought to one clock."""

    settled: Settled
    tracks: Tracks  # on the first camera's clock
    recording: Recording  # of these
    offsets: Float[np.ndarray, " C"]  # frames, the first 0
    unit_sigmas: Float[np.ndarray, " C"]  # of these, for pixels of standard deviation 1
    rounds: int
    still: bool  # the offsets no longer changed


def brought_in_step(
    tracks: Tracks,
    state: RigState,
    offsets: Float[np.ndarray, " C"],
    freedom: Freedom,
    settings: OutlierSettings,
) -> InStep:
    """Adjust cameras and offsets in turn with bringing the tracks to the clock, until the offsets stand still.

    Args:
        tracks: as recorded.
        state: a rig near its end, from tracks brought to the clock by `offsets`.
        offsets: frames by which each camera shows the light late, the first camera's 0.
    """
    good, threshold, sigma = tracks.visible, GROWING_PX[0], np.inf
    still, rounds, step = False, 0, np.inf
    while rounds < MAX_ROUNDS and not still:
        clock, recording = _at(tracks, good, offsets)
        threshold = min(threshold, GROWING_PX[min(rounds, len(GROWING_PX) - 1)] * recording.scale)
        judged = classify_observations(recording, state, threshold)
        loss = 2.0 * sigma if np.isfinite(sigma) else threshold / 2.0
        weighed = freedom.at_noise(sigma) if np.isfinite(sigma) else freedom
        state, change = _adjust(recording, clock, judged, weighed, loss)
        offsets, before, step = offsets + change, step, np.abs(change).max()
        errors = np.linalg.norm(project(state)[0] - recording.pixels, axis=-1)
        sigma = robust_sigma(errors, judged.kept, freedom.parameters)
        threshold = max(settings.sigmas * sigma, settings.floor_px)
        good = _good(tracks, clock, judged, good)
        rounds += 1
        still = bool(max(step, before) < STILL)
    clock, recording = _at(tracks, good, offsets)
    settled = refine_to_convergence(
        recording, classify_observations(recording, state, 2.0 * threshold), freedom, settings
    )
    sigmas = _unit_sigmas(recording, clock, settled.judged, freedom.at_noise(settled.sigma_px))
    return InStep(settled, clock.applied(tracks), recording, offsets, sigmas, rounds, still)


def _at(tracks: Tracks, good: Bool[np.ndarray, "F C"], offsets) -> tuple[OnClock, Recording]:
    """The observations on the clock, moved along what the good ones say of the motion."""
    clock = on_clock(tracks, motion(tracks.pixels, good, tracks.series_ids), offsets)
    return clock, Recording.of(clock.applied(tracks))


def _good(tracks: Tracks, clock: OnClock, judged: Classified, before: Bool[np.ndarray, "F C"]):
    """Observations, at the cameras' own frames, that nothing speaks against; as before where nothing new is known."""
    rejected = np.isin(judged.verdicts[: tracks.frames, : tracks.cameras], REJECTED)
    return np.where(clock.back(clock.visible), tracks.visible & ~clock.back(rejected), before)


def _adjust(
    recording: Recording, clock: OnClock, judged: Classified, freedom: Freedom, loss_scale: float
) -> tuple[RigState, Float[np.ndarray, " C"]]:
    """The rig, and what is to be added to the offsets."""
    state = judged.state.rebased()
    problem, start = _problem(recording, clock, state, judged.kept, freedom, loss_scale)
    solver = SchurLevenbergMarquardt(model=OffsetModel(CameraModel(state.lens)), rtol=jnp.asarray(1e-6))
    end = solve(solver, start, problem)
    cameras = np.asarray(end.cameras)
    return replace(state, cameras=cameras[:, :-1], points=from_blocks(end.points)), cameras[: recording.cameras, -1]


def _problem(
    recording: Recording, clock: OnClock, state: RigState, kept, freedom: Freedom, loss_scale: float
) -> tuple[Problem, Unknowns]:
    frames, cameras = recording.frames, recording.cameras
    observed = np.zeros((*recording.visible.shape, 6))
    observed[:frames, :cameras] = np.concatenate([clock.pixels, clock.velocity, clock.acceleration], axis=-1)
    free = np.zeros((len(state.cameras), 1), bool)
    free[1:cameras] = True  # the first camera is the clock
    nothing = np.zeros(free.shape)
    problem = Problem(
        jnp.asarray(to_blocks(observed)),
        jnp.asarray(to_blocks(kept.astype(np.float64))),
        jnp.asarray(state.base),
        jnp.asarray(np.concatenate([freedom.free, free], axis=1)),
        jnp.asarray(np.concatenate([freedom.prior_mean, nothing], axis=1)),
        jnp.asarray(np.concatenate([freedom.prior_weight, nothing], axis=1)),
        jnp.asarray(float(loss_scale)),
        jnp.asarray(STEPS),
    )
    start = np.concatenate([state.cameras, nothing], axis=1)
    return problem, Unknowns(jnp.asarray(start), jnp.asarray(to_blocks(state.points)))


@jit
def _camera_system(model: OffsetModel, start: Unknowns, problem: Problem):
    diagonal, product, _, _ = reduced_system(model, start, problem, jnp.zeros((), start.cameras.dtype))
    return diagonal, product


def _unit_sigmas(recording: Recording, clock: OnClock, judged: Classified, freedom: Freedom) -> Float[np.ndarray, " C"]:
    """Standard deviations of the offsets (frames) for pixels of variance 1, cameras and points unknown too.

    The observations leave a similarity open; the offsets do not depend on it, so that the inverse over everything
    else holds theirs.
    """
    problem, start = _problem(recording, clock, judged.state.rebased(), judged.kept, freedom, LEAST_SQUARES)
    model = OffsetModel(CameraModel(judged.state.lens))
    diagonal, product = (np.asarray(part) for part in _camera_system(model, start, problem))
    count, size, _ = diagonal.shape
    matrix = -product.reshape(count, size, count, size)
    each = np.arange(count)
    matrix[each, :, each] += diagonal
    free = np.asarray(problem.free).reshape(-1)
    matrix = matrix.reshape(count * size, -1)[free][:, free]
    scale = 1.0 / np.sqrt(np.diagonal(diagonal, axis1=1, axis2=2).reshape(-1)[free])
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    parts = (vectors * scale[:, None])[:, SIMILARITY:] / np.sqrt(np.maximum(values[SIMILARITY:], 1e-300))
    sigmas = np.zeros(count * size)
    sigmas[free] = np.sqrt((parts**2).sum(axis=1))
    return sigmas.reshape(count, size)[: recording.cameras, -1]
