"""Self-calibration: from the tracks of a waved light to a calibrated rig (SPEC 2, thesis 5.3)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np

from jaxpoint.calibration.bundle import FOCAL
from jaxpoint.calibration.degenerate import check_geometry, check_volume
from jaxpoint.calibration.hypotheses import Lenses, known_numbers
from jaxpoint.calibration.initial import Inputs, Start, starts
from jaxpoint.calibration.lens_choice import choose_lens
from jaxpoint.calibration.offset_search import joint_offsets, pair_offsets
from jaxpoint.calibration.offsets import InStep, brought_in_step
from jaxpoint.calibration.outliers import Settled, grow, settle
from jaxpoint.calibration.pairs import check_pairs, pair_table
from jaxpoint.calibration.recording import Freedom, Recording, RigState, project
from jaxpoint.calibration.result import Calibration, PairTable, Stage, TimeOffsets, Verdict
from jaxpoint.calibration.twoview import TwoViewGeometry, normalised, two_view_geometry
from jaxpoint.calibration.uncertainty import variance_px2
from jaxpoint.calibration.warmup import WarmUp
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.motion import moved_to_clock
from jaxpoint.tracks import Tracks

Progress = Callable[[str, int, int], None]
HOPELESS = 3.0  # candidates that cost this many times more than the best are not followed up
DOUBTFUL = 0.97  # a rig that keeps less than this share of what the pairs believe is compared with other starts,
PROMISING = 1.005  # those that keep this many times more when grown are followed to the end,
LOST = 0.9  # and below this share all of them; what then still keeps less is not called good
# (right rigs of random rooms and real recordings keep 0.92 to 1.02, rigs from spoilt starts 0.02 to 0.88)


def calibrate(
    tracks: Tracks,
    settings: CalibrateSettings | None = None,
    *,
    intrinsics: CameraRig | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate all cameras from the tracks of one moving light; nothing else need be known.

    Two-view geometry votes on every observation and finds the lenses' distortion; initialisers compete for a first
    solution; a robust bundle adjustment alternates with rounds that judge every observation anew. Computed in
    float64 whatever JAX's global setting. The result has an arbitrary unit and frame until it is aligned with the
    room (`align_to_landmarks` and its kin).

    Args:
        tracks: pixels of the light, at least 3 cameras (2 with known intrinsics).
        settings: how; the defaults suit ordinary rooms.
        intrinsics: cameras whose lenses are known (poses are ignored); `settings.lens.known` says whether to hold or
            refine them.
        progress: called as `progress(what, done, total)`.

    Raises:
        InsufficientDataError: the tracks cannot determine a calibration; the message names camera and remedy.
        ValueError: known intrinsics of another number of cameras than the tracks have.
    """
    settings = settings or CalibrateSettings()
    if intrinsics is not None and len(intrinsics) != tracks.cameras:
        raise ValueError(f"Intrinsics of {len(intrinsics)} cameras were given for tracks of {tracks.cameras}.")
    with jax.enable_x64(True):
        return _calibrated(tracks, settings, intrinsics, progress or _silent)


def _silent(what: str, done: int, total: int) -> None:
    """No progress is shown."""


def _calibrated(recorded: Tracks, settings, intrinsics, progress: Progress) -> Calibration:
    clock = [time.perf_counter()]
    tracks, pairs = recorded, pair_table(recorded)
    check_pairs(tracks, pairs, known_intrinsics=intrinsics is not None)
    rough = _rough_offsets(recorded, settings, intrinsics, progress) if settings.time_offsets else None
    if rough is not None:
        tracks, pairs = _on_one_clock(recorded, rough, known_intrinsics=intrinsics is not None)
    recording, data = Recording.of(tracks), normalised(tracks, intrinsics)
    compiling = WarmUp(recording, data)
    epipolar = settings.epipolar
    if intrinsics is not None:
        epipolar = replace(epipolar, division_model=False)
    try:
        geometry = two_view_geometry(
            data, epipolar, settings.seed, lambda done, total: progress("pairs of cameras", done, total)
        )
        check_geometry(tracks, data, geometry)
    finally:
        compiling.wait()  # also before an error ends the process: a compilation left to itself would abort it
    pairs = replace(pairs, inliers=geometry.inliers)
    hold = settings.lens.known == "hold"
    distortion = "radial2" if settings.lens.distortion == "auto" else settings.lens.distortion
    freedom = _freedom(recording, settings, distortion, intrinsics)
    lenses = Lenses.of(data, geometry, intrinsics)
    inputs = Inputs(recording, data, geometry, lenses, freedom, settings.seed)
    progress("first solution", 0, 1)
    candidates, stages = starts(inputs, settings.init)
    progress("first solution", 1, 1)
    clock.append(time.perf_counter())
    progress("adjustment", 0, 1)
    settled = _best_settled(inputs, candidates, settings)
    in_step = None
    if rough is not None:
        in_step = brought_in_step(recorded, settled.judged.state, rough, freedom, settings.outliers)
        settled, recording, tracks = in_step.settled, in_step.recording, in_step.tracks
    if settings.lens.distortion == "auto" and not hold:
        rich = _freedom(recording, settings, "brown", intrinsics)
        settled, freedom, stage = choose_lens(recording, settled, freedom, rich, settings)
        stages.append(stage)
        if in_step is not None and freedom is rich:
            in_step = brought_in_step(recorded, settled.judged.state, in_step.offsets, freedom, settings.outliers)
            settled, recording, tracks = in_step.settled, in_step.recording, in_step.tracks
    progress("adjustment", 1, 1)
    clock.append(time.perf_counter())
    seconds = {"init": clock[1] - clock[0], "adjust": clock[2] - clock[1], "total": clock[2] - clock[0]}
    stages = [_pair_stage(geometry, tracks.names), *stages, _adjustment_stage(settled)]
    explained = settled.judged.kept.sum() / max(inputs.kept.sum(), 1)
    found = _calibration(tracks, recording, settled, pairs, stages, seconds, settings.seed, float(explained))
    parts = (freedom.free, freedom.prior_mean, freedom.prior_weight)
    loss_scale = 2.0 * settled.sigma_px if settings.outliers.loss == "cauchy" else None
    found = replace(found, freedom=Freedom(*(part[: tracks.cameras] for part in parts)), loss_scale=loss_scale)
    return found if in_step is None else _with_offsets(found, recorded, in_step)


def _rough_offsets(tracks: Tracks, settings: CalibrateSettings, intrinsics, progress: Progress) -> np.ndarray:
    """Time offsets from pairs of cameras, frames (C,); the first is 0."""
    pairs = pair_offsets(
        tracks,
        settings.epipolar,
        settings.seed,
        intrinsics,
        progress=lambda done, total: progress("time offsets", done, total),
    )
    return joint_offsets(pairs, tracks.cameras)


def _on_one_clock(recorded: Tracks, rough: np.ndarray, known_intrinsics: bool) -> tuple[Tracks, PairTable]:
    """The tracks as if recorded in step, once it is seen that enough is left of them."""
    tracks = moved_to_clock(recorded, rough)
    pairs = pair_table(tracks)
    try:
        check_pairs(tracks, pairs, known_intrinsics=known_intrinsics)
    except InsufficientDataError as error:
        raise InsufficientDataError(
            f"Of {recorded.visible.sum()} observations {tracks.visible.sum()} can be brought to one clock, the others "
            f"have too few neighbours in time. {error}"
        ) from None
    return tracks, pairs


def _with_offsets(found: Calibration, recorded: Tracks, in_step: InStep) -> Calibration:
    """The calibration with the offsets that it was made with."""
    sigma = in_step.unit_sigmas * np.sqrt(variance_px2(found))
    left_out = int(recorded.visible.sum() - found.tracks.visible.sum())
    stage = Stage(
        "Time offsets",
        {
            "frames": {
                name: f"{late:+.3f} ± {sure:.3f}" for name, late, sure in zip(recorded.names, in_step.offsets, sigma)
            },
            "observations_left_out_for_want_of_neighbours_in_time": left_out,
            "rounds": in_step.rounds,
        },
    )
    message = found.message if in_step.still else f"{found.message}; the time offsets did not come to rest"
    return replace(
        found,
        time_offsets=TimeOffsets(in_step.offsets, sigma),
        stages=(*found.stages, stage),
        converged=found.converged and in_step.still,
        message=message,
    )


def _freedom(recording: Recording, settings: CalibrateSettings, distortion: str, intrinsics) -> Freedom:
    """What may move, and what it is drawn to."""
    freedom = Freedom.of(recording, settings.lens, distortion, hold=settings.lens.known == "hold")
    return freedom if intrinsics is None else freedom.around(recording, known_numbers(intrinsics))


def _best_settled(inputs: Inputs, candidates: list[Start], settings: CalibrateSettings) -> Settled:
    """Settle from the best start; where much of what the pairs believe is lost, look at the others too."""
    recording, freedom = inputs.recording, inputs.freedom
    expected = inputs.kept.sum()
    first = grow(recording, candidates[0].state, freedom)
    best = settle(recording, first, freedom, settings.outliers)
    for candidate in candidates[1:]:
        share = best.judged.kept.sum() / max(expected, 1)
        if (share >= DOUBTFUL and best.converged) or candidate.cost > HOPELESS * candidates[0].cost:
            break
        grown = grow(recording, candidate.state, freedom)
        if share >= LOST and best.converged and grown.kept.sum() <= PROMISING * first.kept.sum():
            continue
        other = settle(recording, grown, freedom, settings.outliers)
        best = other if other.cost < best.cost else best
    if not best.converged:
        again = settle(recording, grow(recording, best.judged.state, freedom), freedom, settings.outliers)
        best = again if again.cost < best.cost else best
    return best


def _pair_stage(geometry: TwoViewGeometry, names: tuple[str, ...]) -> Stage:
    return Stage(
        "Pairs of cameras",
        {
            "inliers": {
                f"{names[i]} - {names[j]}": f"{geometry.inliers[i, j]} of {geometry.shared[i, j]}"
                for i, j in geometry.fundamentals
            },
            "division_model": dict(zip(names, geometry.lenses.tolist())),
        },
    )


def _adjustment_stage(settled: Settled) -> Stage:
    kept, errors = settled.judged.kept, settled.judged.errors
    return Stage(
        "Adjustment",
        {
            "mean_px": float(errors[kept].mean()) if kept.any() else None,
            "sigma_px": settled.sigma_px,
            "robust_cost_px2": settled.cost,
            "rounds": settled.rounds,
        },
    )


def _calibration(
    tracks, recording, settled: Settled, pairs: PairTable, stages, seconds, seed, explained: float
) -> Calibration:
    frames, cameras = tracks.frames, tracks.cameras
    state = centred(settled.judged.state, settled.judged.kept, cameras)
    pixels, _ = project(state)
    verdicts = settled.judged.verdicts[:frames, :cameras]
    known = (settled.judged.errors > 0)[:frames, :cameras]
    residuals = np.where(known[..., None], pixels[:frames, :cameras] - tracks.pixels, 0.0)
    valid = (verdicts == Verdict.KEPT).sum(axis=1) >= 2
    check_volume(state.points[:frames][valid])
    return Calibration(
        rig=rig_of(state, tracks),
        tracks=tracks,
        points=np.where(valid[:, None], state.points[:frames], 0.0),
        point_valid=valid,
        residuals=residuals,
        verdicts=verdicts,
        sigma_px=settled.sigma_px,
        converged=settled.converged and explained >= LOST,
        message=_message(settled, explained),
        pairs=pairs,
        stages=tuple(stages),
        seconds=seconds,
        seed=seed,
    )


def _message(settled: Settled, explained: float) -> str:
    if explained < LOST:
        return (
            f"ended in a rig that keeps only {explained:.0%} of the observations on which pairs of cameras agree "
            f"({LOST:.0%} wanted): it is probably wrong; try another --init or wave the light longer"
        )
    if settled.converged:
        return f"converged after {settled.rounds} rounds: the cost and the believed observations no longer change"
    return f"stopped after {settled.rounds} rounds without settling"


def centred(state: RigState, kept: np.ndarray, cameras: int) -> RigState:
    """The same rig with the origin amid the light's path and the cameras 1 from their middle (root mean square)."""
    placed = state.points[kept.sum(axis=1) >= 2]
    middle = np.median(placed, axis=0) if len(placed) else np.zeros(3)
    positions = state.positions[:cameras]
    length = np.sqrt(((positions - positions.mean(axis=0)) ** 2).sum(axis=1).mean())
    numbers = state.cameras.copy()
    numbers[:, 3:6] = (numbers[:, 3:6] + np.einsum("cij,j->ci", state.rotation, middle)) / length
    return RigState(numbers, state.base, (state.points - middle) / length)


def rig_of(state: RigState, tracks: Tracks) -> CameraRig:
    """The solved cameras as a `CameraRig`."""
    count = tracks.cameras
    numbers = state.cameras[:count]
    focal = np.exp(numbers[:, FOCAL])
    return CameraRig.from_parameters(
        np.stack([focal * np.exp(numbers[:, 7]), focal], axis=1),
        numbers[:, 8:10],
        numbers[:, 10:15],
        state.rotation[:count],
        numbers[:, 3:6],
        tracks.image_sizes,
        tracks.names,
    )
