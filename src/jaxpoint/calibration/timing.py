"""Time offsets, readout times and cameras together: the tracks brought to one clock, adjusted, and brought there anew.

The clock is the middle row of the first camera's images. Each round moves every observation to it with the times
known so far, takes the motion from what was not rejected, judges, and adjusts cameras, points and times together
(`TimingModel`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.bundle import LEAST_SQUARES, CameraModel, from_blocks, solve, to_blocks
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
from jaxpoint.calibration.shared_lenses import places_of, summed, with_common_lenses
from jaxpoint.calibration.timing_model import OBSERVED, TIMES, TimingModel
from jaxpoint.compilation import jit
from jaxpoint.config import OutlierSettings
from jaxpoint.motion import OnClock, motion, on_clock, row_delays
from jaxpoint.tracks import Tracks

STEPS = 30  # of one joint adjustment
MAX_ROUNDS = 15
STILL = 0.005  # frames: times that change less, twice in a row, no longer move
REJECTED = (Verdict.REPROJECTION, Verdict.BEHIND, Verdict.UNDECIDED)
SIMILARITY = 7  # freedoms of the frame and unit, which no observation holds


@dataclass(frozen=True)
class Times:
    """When the cameras of a rig saw the light, frames."""

    offsets: Float[np.ndarray, " C"]  # by which each shows it late, the first 0
    readouts: Float[np.ndarray, " C"] | None = None  # from the first image row to the last; None: global shutters
    solve_offsets: bool = True

    @property
    def table(self) -> Float[np.ndarray, "C 2"]:
        """As columns, in the order of `TimingModel`."""
        readouts = np.zeros(len(self.offsets)) if self.readouts is None else self.readouts
        return np.stack([self.offsets, readouts], axis=1)

    @property
    def free(self) -> Bool[np.ndarray, "C 2"]:
        """Those that are solved for."""
        free = np.zeros((len(self.offsets), TIMES), bool)
        free[1:, 0] = self.solve_offsets  # the first camera is the clock
        free[:, 1] = self.readouts is not None
        return free

    def changed(self, by: Float[np.ndarray, "C 2"]) -> Times:
        """After a step."""
        readouts = None if self.readouts is None else self.readouts + by[:, 1]
        return replace(self, offsets=self.offsets + by[:, 0], readouts=readouts)


@dataclass(frozen=True)
class InStep:
    """A rig whose cameras were brought to one clock."""

    settled: Settled
    tracks: Tracks  # on the first camera's clock
    recording: Recording  # of these
    times: Times
    unit_sigmas: Float[np.ndarray, "C 2"]  # of these, for pixels of standard deviation 1; 0 where not solved for
    rounds: int
    still: bool  # the times no longer changed


def brought_in_step(
    tracks: Tracks,
    state: RigState,
    times: Times,
    freedom: Freedom,
    settings: OutlierSettings,
) -> InStep:
    """Adjust cameras and times in turn with bringing the tracks to the clock, until the times stand still.

    Args:
        tracks: as recorded.
        state: a rig near its end, from tracks brought to the clock by `times`.
        times: where to start, and what is solved for.
    """
    good, threshold, sigma = tracks.visible, GROWING_PX[0], np.inf
    still, rounds, step = False, 0, np.inf
    while rounds < MAX_ROUNDS and not still:
        clock, recording = _at(tracks, good, times)
        threshold = min(threshold, GROWING_PX[min(rounds, len(GROWING_PX) - 1)] * recording.scale)
        judged = classify_observations(recording, state, threshold)
        loss = 2.0 * sigma if np.isfinite(sigma) else threshold / 2.0
        weighed = freedom.at_noise(sigma) if np.isfinite(sigma) else freedom
        state, change = _adjust(recording, clock, times, judged, weighed, loss)
        times, before, step = times.changed(change), step, np.abs(change).max()
        errors = np.linalg.norm(project(state)[0] - recording.pixels, axis=-1)
        sigma = robust_sigma(errors, judged.kept, freedom.parameters)
        threshold = max(settings.sigmas * sigma, settings.floor_px)
        good = _good(tracks, clock, judged, good)
        rounds += 1
        still = bool(max(step, before) < STILL)
    clock, recording = _at(tracks, good, times)
    settled = refine_to_convergence(
        recording, classify_observations(recording, state, 2.0 * threshold), freedom, settings
    )
    sigmas = _unit_sigmas(recording, clock, times, settled.judged, freedom.at_noise(settled.sigma_px))
    return InStep(settled, clock.applied(tracks), recording, times, sigmas, rounds, still)


def _at(tracks: Tracks, good: Bool[np.ndarray, "F C"], times: Times) -> tuple[OnClock, Recording]:
    """The observations on the clock, moved along what the good ones say of the motion."""
    moving = motion(tracks.pixels, good, tracks.series_ids, row_delays(tracks, times.readouts))
    clock = on_clock(tracks, moving, times.offsets, readouts=times.readouts)
    return clock, Recording.of(clock.applied(tracks))


def _good(tracks: Tracks, clock: OnClock, judged: Classified, before: Bool[np.ndarray, "F C"]):
    """Observations, at the cameras' own frames, that nothing speaks against; as before where nothing new is known."""
    rejected = np.isin(judged.verdicts[: tracks.frames, : tracks.cameras], REJECTED)
    return np.where(clock.back(clock.visible), tracks.visible & ~clock.back(rejected), before)


def _adjust(
    recording: Recording, clock: OnClock, times: Times, judged: Classified, freedom: Freedom, loss_scale: float
) -> tuple[RigState, Float[np.ndarray, "C 2"]]:
    """The rig, and what is to be added to the times."""
    state = judged.state.rebased()
    problem, start = _problem(recording, clock, times, state, judged.kept, freedom, loss_scale)
    solver = SchurLevenbergMarquardt(model=TimingModel(CameraModel(state.lens)), rtol=jnp.asarray(1e-6))
    end = solve(solver, start, problem)
    cameras = np.asarray(end.cameras)
    change = cameras[: recording.cameras, -TIMES:]
    return replace(state, cameras=cameras[:, :-TIMES], points=from_blocks(end.points)), change


def _problem(
    recording: Recording, clock: OnClock, times: Times, state: RigState, kept, freedom: Freedom, loss_scale: float
) -> tuple[Problem, Unknowns]:
    frames, cameras = recording.frames, recording.cameras
    observed = np.zeros((*recording.visible.shape, OBSERVED))
    moving = (clock.pixels, clock.velocity, clock.acceleration, clock.down[..., None])
    observed[:frames, :cameras] = np.concatenate(moving, axis=-1)
    free = np.zeros((len(state.cameras), TIMES), bool)
    free[:cameras] = times.free
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
        owner=None
        if freedom.owner is None
        else jnp.asarray(places_of(freedom.owner, len(freedom.free), freedom.free.shape[1], TIMES)),
    )
    start = np.concatenate([with_common_lenses(state.cameras, freedom.owner), nothing], axis=1)
    return problem, Unknowns(jnp.asarray(start), jnp.asarray(to_blocks(state.points)))


@jit
def _camera_system(model: TimingModel, start: Unknowns, problem: Problem):
    diagonal, product, _, _ = reduced_system(model, start, problem, jnp.zeros((), start.cameras.dtype))
    return diagonal, product


def _unit_sigmas(
    recording: Recording, clock: OnClock, times: Times, judged: Classified, freedom: Freedom
) -> Float[np.ndarray, "C 2"]:
    """Standard deviations of the times (frames) for pixels of variance 1, cameras and points unknown too.

    The observations leave a similarity open; the times do not depend on it, so that the inverse over everything
    else holds theirs.
    """
    problem, start = _problem(recording, clock, times, judged.state.rebased(), judged.kept, freedom, LEAST_SQUARES)
    model = TimingModel(CameraModel(judged.state.lens))
    diagonal, product = (np.asarray(part) for part in _camera_system(model, start, problem))
    count, size, _ = diagonal.shape
    matrix = -product.reshape(count, size, count, size)
    each = np.arange(count)
    matrix[each, :, each] += diagonal
    places = places_of(freedom.owner, len(freedom.free), freedom.free.shape[1], TIMES).ravel()
    free = np.asarray(problem.free).reshape(-1) & (places == np.arange(count * size))
    matrix = summed(matrix.reshape(count * size, -1), places)[free][:, free]
    own = np.zeros(count * size)
    np.add.at(own, places, np.diagonal(diagonal, axis1=1, axis2=2).ravel())
    scale = 1.0 / np.sqrt(own[free])
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    parts = (vectors * scale[:, None])[:, SIMILARITY:] / np.sqrt(np.maximum(values[SIMILARITY:], 1e-300))
    sigmas = np.zeros(count * size)
    sigmas[free] = np.sqrt((parts**2).sum(axis=1))
    return sigmas.reshape(count, size)[: recording.cameras, -TIMES:]
