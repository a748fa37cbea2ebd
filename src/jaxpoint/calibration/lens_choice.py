"""Which lens model a recording supports: more coefficients, or a fisheye, only where they predict it better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.objective import Solution, better_by, solve_with
from jaxpoint.calibration.outliers import GROWING_PX, Settled, classify_observations, refine_to_convergence
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, place_points, priors, project
from jaxpoint.calibration.result import Stage
from jaxpoint.camera.conversion import convert
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.lenses import chosen_lenses, lens_of_choice
from jaxpoint.camera.parameters import COEFFICIENTS, FOCAL, chosen_coefficients, lens_parameters
from jaxpoint.config import CalibrateSettings

SIMPLE, RICH, FISHEYE = "radial2", "brown", "fisheye"  # settings of `lens.distortion` that `auto` chooses from
LEAST_GAIN = 0.05  # of the mean held-out error: less is not worth a flatter valley of the focal lengths
STRETCHES = 40
LEAST_EVIDENCE = 3.0  # standard errors of the mean difference
LEAST_DOUBT = 1.5  # standard errors of the same, from which another kind of lens is tried too
WIDE = 0.75  # focal lengths from the principal point: cameras that see less are taken as Brown's
FAR_SHARE = 0.98  # of a camera's observations lie within the radius by which it counts as wide
WORTH = 4.0  # fall of the objective for every coefficient more (twice what Akaike 1974 asks: lenses are alike)


def choose_lens(recording: Recording, solution: Solution, settings: CalibrateSettings) -> tuple[Solution, list[Stage]]:
    """More of Brown's coefficients where they predict held-out frames better, then a fisheye where it explains more."""
    if solution.state.lens is not lens_of_choice(SIMPLE)[0]:
        return solution, []  # chosen before another prior was given up
    solution, stage = _choose_terms(recording, solution, settings)
    doubtful = stage.figures.get("gain_in_standard_errors", 0.0) > LEAST_DOUBT
    known = settings.lens.known != "none"  # a given lens is refined in its own model, never replaced by another
    if known or not (doubtful or _is_wide(recording, solution.state)):
        return solution, [stage]
    return _choose_fisheye(recording, solution, settings, stage)


def _choose_terms(recording: Recording, solution: Solution, settings: CalibrateSettings) -> tuple[Solution, Stage]:
    """Solve again with p1, p2 and k3 where they predict held-out frames better; otherwise leave the rig as it is."""
    simple, rich = (_with_choice(solution, recording.exists, choice) for choice in (SIMPLE, RICH))
    if (solution.freedom.free & ~simple.free).any():  # chosen before another prior was given up: ask again
        solution = solve_with(recording, _at_prior(solution.state, simple), simple, settings.outliers)
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
    judged = classify_observations(recording, settled.judged.state, GROWING_PX[-1] * recording.scale)
    again = refine_to_convergence(recording, judged, rich, settings.outliers)
    return Solution(again, rich), Stage("Lens model", {"chosen": "k1, k2, p1, p2, k3", **figures})


def _choose_fisheye(
    recording: Recording, solution: Solution, settings: CalibrateSettings, stage: Stage
) -> tuple[Solution, list[Stage]]:
    """The fisheye model for all cameras where it lowers the objective over all observations."""
    freedom = fisheye_freedom(recording, solution.freedom, settings)
    trial = solve_with(recording, as_fisheye(recording, solution.state), freedom, settings.outliers)
    more = freedom.parameters - solution.freedom.parameters
    gain = better_by(trial, solution)
    figures = {
        "fall_of_the_objective": float(gain),
        "coefficients_more": more,
        "inliers_before": int(solution.settled.judged.kept.sum()),
        "inliers_with_fisheye": int(trial.settled.judged.kept.sum()),
    }
    better = gain > WORTH * max(more, 1)
    chosen = Stage("Wide lenses", {"chosen": "fisheye" if better else "Brown's", **figures})
    return (trial if better else solution), [stage, chosen]


def fisheye_freedom(recording: Recording, freedom: Freedom, settings: CalibrateSettings) -> Freedom:
    """The freedom with the fisheye's coefficients in place of Brown's; all else as it was."""
    choice = chosen_lenses(FISHEYE, recording.names)
    mean, weight = priors(recording, settings.lens, choice)
    free = np.zeros(mean.shape, bool)
    free[recording.exists, COEFFICIENTS] = choice.free
    common = slice(0, COEFFICIENTS.start)
    for new, old in ((free, freedom.free), (mean, freedom.prior_mean), (weight, freedom.prior_weight)):
        new[:, common] = old[:, common]
    return replace(freedom, free=free, prior_mean=mean, prior_weight=weight).with_shared_priors()


def first_lens_again(
    recording: Recording, first: Solution, chosen: Solution, settings: CalibrateSettings
) -> tuple[Solution, Stage]:
    """Back to the lens model of `first` where it now explains as much, priors having been given up since.

    Pixels that are not square bend an image as another lens would: what was chosen to explain them is asked again.

    Args:
        first: before another lens was chosen.
        chosen: with that lens, and without the priors that the recording refutes.
    """
    common = slice(0, COEFFICIENTS.start)
    parts = [part.copy() for part in (first.freedom.free, first.freedom.prior_mean, first.freedom.prior_weight)]
    now = chosen.freedom.free, chosen.freedom.prior_mean, chosen.freedom.prior_weight
    for part, own in zip(parts, now):
        part[:, common] = own[:, common]
    freedom = replace(chosen.freedom, free=parts[0], prior_mean=parts[1], prior_weight=parts[2])
    used = np.asarray(np.any(freedom.free[recording.exists, COEFFICIENTS], axis=0))
    state = with_lens(recording, chosen.state, first.state.lens, used)
    trial = solve_with(recording, state, freedom, settings.outliers)
    fewer = chosen.freedom.parameters - freedom.parameters
    gain = better_by(trial, chosen)
    back = gain > -WORTH * max(fewer, 1)
    figures = {"chosen": "the first again" if back else "as before", "fall_of_the_objective": float(gain)}
    return (trial if back else chosen), Stage("Lenses after the priors", figures)


def as_fisheye(recording: Recording, state: RigState) -> RigState:
    """The rig with fisheye lenses that see each camera's observations where its lens sees them."""
    model, names = lens_of_choice(FISHEYE)
    return with_lens(recording, state, model, chosen_coefficients(model, names))


def with_lens(
    recording: Recording, state: RigState, model: type[AbstractLens], free: Bool[np.ndarray, " k"]
) -> RigState:
    """The rig with lenses of another model, that see each camera's observations where its lens sees them.

    Args:
        free: the coefficients of the model that may take part; the others are zero.
    """
    cameras = np.zeros((len(state.cameras), COEFFICIENTS.start + len(free)))
    cameras[:, : COEFFICIENTS.start] = state.cameras[:, : COEFFICIENTS.start]
    for camera in range(recording.cameras):
        own = np.array(lens_parameters(state.cameras[camera, FOCAL:], np))
        pixels = recording.pixels[recording.visible[:, camera], camera]
        cameras[camera, COEFFICIENTS] = convert(own, state.lens, model, pixels, free)[4:]
    return replace(state, cameras=cameras, lens=model)


def _is_wide(recording: Recording, state: RigState) -> bool:
    """Whether some camera has observations far off its axis, as its lens has it."""
    for camera in range(recording.cameras):
        fx, fy, cx, cy, *_ = lens_parameters(state.cameras[camera, FOCAL:], np)
        away = (recording.pixels[recording.visible[:, camera], camera] - [cx, cy]) / [fx, fy]
        if len(away) and np.quantile(np.linalg.norm(away, axis=1), FAR_SHARE) > WIDE:
            return True
    return False


def _with_choice(solution: Solution, exists: np.ndarray, choice: str) -> Freedom:
    """The freedom with the coefficients free that a setting frees."""
    free = solution.freedom.free.copy()
    free[exists, COEFFICIENTS] = chosen_coefficients(*lens_of_choice(choice))
    return replace(solution.freedom, free=free)


def _at_prior(state: RigState, freedom: Freedom) -> RigState:
    """Coefficients that are not free stand at their prior."""
    cameras = state.cameras.copy()
    held = np.where(freedom.free, cameras, freedom.prior_mean)
    cameras[:, COEFFICIENTS] = held[:, COEFFICIENTS]
    return replace(state, cameras=cameras)


def _held_out_frames(kept: Bool[np.ndarray, "N D"], share: float, seed: int) -> Bool[np.ndarray, " N"]:
    """Frames set aside in whole stretches: neighbours in time share their errors and would say too much.

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


def _held_out_errors(
    recording: Recording, settled: Settled, freedom: Freedom, held: Bool[np.ndarray, " N"]
) -> Float[np.ndarray, " M"]:
    """Mean error (px) of every held-out frame, triangulated with cameras fitted without them."""
    kept = settled.judged.kept
    loss = 2.0 * settled.sigma_px
    freedom = freedom.at_noise(settled.sigma_px)
    fit = adjust(recording, settled.judged.state, kept & ~held[:, None], freedom, loss_scale=loss, steps=40)
    start = replace(fit.state, points=settled.judged.state.points)
    placed = place_points(recording, start, kept & held[:, None], loss)
    errors = np.linalg.norm(project(placed)[0] - recording.pixels, axis=-1)
    return np.where(kept, errors, 0.0).sum(axis=1)[held] / kept.sum(axis=1)[held]
