"""Self-calibration: from the tracks of a waved light to a calibrated rig (thesis 5.3)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np

from jaxpoint.calibration.aspects import with_stated_aspects
from jaxpoint.calibration.assembly import MIN_EXPLAINED, assemble_calibration
from jaxpoint.calibration.board_calibration import boards_alone, calibrate_boards
from jaxpoint.calibration.clock_fit import Clock
from jaxpoint.calibration.contradiction import contradicted_camera, holds_without, left_out, left_out_unsolved
from jaxpoint.calibration.degenerate import check_geometry, check_volume
from jaxpoint.calibration.initial import Inputs, Start, starts
from jaxpoint.calibration.lens_checks import with_reach
from jaxpoint.calibration.objective import Solution, better_by
from jaxpoint.calibration.offset_search import joint_offsets, pair_offsets
from jaxpoint.calibration.outliers import Settled, refine_coarse_to_fine, refine_to_convergence
from jaxpoint.calibration.pairs import check_pairs, pair_table
from jaxpoint.calibration.prior_checks import given_up
from jaxpoint.calibration.readout_search import search_readouts
from jaxpoint.calibration.recording import Recording
from jaxpoint.calibration.refinement import Refinement, first_lenses, freedom_of, lenses_of
from jaxpoint.calibration.result import Calibration, PairTable, Stage
from jaxpoint.calibration.shared_lenses import groups_without, lens_owners
from jaxpoint.calibration.timing import Times
from jaxpoint.calibration.twoview import TwoViewGeometry, normalise_tracks, two_view_geometry
from jaxpoint.calibration.warmup import WarmUp
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.lenses import setting_without
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import ContradictionError, InsufficientDataError, UsageError
from jaxpoint.motion import moved_to_clock
from jaxpoint.tracks import Tracks

Progress = Callable[[str, int, int], None]
MAX_CANDIDATE_COST = 3.0  # candidates that cost this many times more than the best are not followed up
COMPARED_BELOW = 0.97  # a rig that keeps less than this share of what the pairs believe is compared with other starts,
FOLLOWED_ABOVE = 1.005  # those that keep this many times more when grown are followed to the end,
# and below `assembly.MIN_EXPLAINED` all of them


def calibrate(
    tracks: Tracks,
    settings: CalibrateSettings | None = None,
    *,
    intrinsics: CameraRig | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate all cameras from the tracks of one moving light; nothing else need be known.

    Targets of known shape (boards, wands) and points of known place may be among the tracks, alone or with a light, and
    take part in the adjustment: their sizes give it metres, known points the room's frame. Tracks of boards alone
    from one or two cameras are solved by `calibrate_boards`, in the first camera's frame, and with `init = "boards"`
    all.

    Two-view geometry votes on every observation and finds the lenses' distortion; initialisers compete for a first
    solution; a robust bundle adjustment alternates with rounds that judge every observation anew. Priors that the
    recording refutes (images not cropped, square pixels) are given up; a camera that the others contradict is left out
    of the rig. `findings` says so, and `calibration.quality.assess` whether the result passes. Computed in float64
    whatever JAX's global setting. The result has an arbitrary unit and frame until it is aligned with the
    room (`align_to_landmarks` and its kin).

    Args:
        tracks: pixels of the light, at least 3 cameras (2 with known intrinsics).
        settings: how; the defaults suit ordinary rooms.
        intrinsics: cameras whose lenses are known (poses are ignored); `settings.lens.known` says whether to hold or
            refine them.
        progress: called as `progress(what, done, total)`.

    Raises:
        InsufficientDataError: the tracks cannot determine a calibration; the message names camera and remedy.
        UsageError: `settings.lens.distortion` names no lens, or one of another kind than the known ones; or readout
            times are asked for where boards alone were seen.
        ValueError: known intrinsics of another number of cameras than the tracks have.
    """
    settings = settings or CalibrateSettings()
    if intrinsics is not None and len(intrinsics) != tracks.cameras:
        raise ValueError(f"Intrinsics of {len(intrinsics)} cameras were given for tracks of {tracks.cameras}.")
    first_lenses(settings, intrinsics, tracks.names)  # refuses a wrong setting before anything is computed
    lens_owners(settings.lens.shared, tracks.names, tracks.image_sizes)
    if settings.init == "boards" or (settings.init == "auto" and tracks.cameras <= 2 and boards_alone(tracks)):
        if settings.readout_times:
            raise UsageError(
                "Readout times are solved for from a moving light that three cameras or more see, not from boards "
                "alone; leave out --readout-times, and hold the boards still."
            )
        return calibrate_boards(tracks, settings, intrinsics=intrinsics, progress=progress)
    with jax.enable_x64(True):
        tracks = with_stated_aspects(tracks, settings.lens)
        return _solve_consistently(tracks, settings, intrinsics, progress or _silent)


def _silent(what: str, done: int, total: int) -> None:
    """No progress is shown."""


def _solve_consistently(tracks: Tracks, settings, intrinsics: CameraRig | None, progress: Progress) -> Calibration:
    """Solve all cameras; those that the others contradict are left out, one after the other, and named."""
    spare = tracks.cameras > (3 if intrinsics is None else 2)
    try:
        found = _solve(tracks, settings, intrinsics, progress)
    except ContradictionError as error:
        others = _solve_without(tracks, error.camera, settings, intrinsics, progress, error) if spare else None
        if others is None:
            raise
        return others
    odd = contradicted_camera(found) if spare else None
    others = None if odd is None else _solve_without(tracks, odd, settings, intrinsics, progress)
    return others if others is not None and holds_without(others, found) else found


def _solve_without(
    tracks: Tracks,
    camera: int,
    settings: CalibrateSettings,
    intrinsics: CameraRig | None,
    progress: Progress,
    error: ContradictionError | None = None,
) -> Calibration | None:
    """The calibration of the other cameras, which says why this one was left out; None where they do not suffice."""
    rest = [other for other in range(tracks.cameras) if other != camera]
    fewer = None if intrinsics is None else intrinsics.select(rest)
    name, lens = tracks.names[camera], settings.lens
    shared = groups_without(lens.shared, name)
    lens = replace(lens, distortion=setting_without(lens.distortion, name), shared=shared)
    settings = replace(settings, lens=lens)
    try:
        others = _solve_consistently(tracks.select_cameras(rest), settings, fewer, progress)
    except InsufficientDataError:
        return None
    frozen = error is not None and error.causes == ("frozen camera",)
    why = (
        left_out_unsolved(tracks, error) if error is not None and frozen else left_out(tracks, camera, others, settings)
    )
    return replace(others, findings=(why, *others.findings))


def _solve(recorded: Tracks, settings, intrinsics: CameraRig | None, progress: Progress) -> Calibration:
    clock = [time.perf_counter()]
    tracks, pairs = recorded, pair_table(recorded)
    check_pairs(tracks, pairs, known_intrinsics=intrinsics is not None)
    rough = _rough_times(recorded, settings, intrinsics, progress)
    if rough is not None:
        tracks, pairs = _on_one_clock(recorded, rough, known_intrinsics=intrinsics is not None)
    recording, data = Recording.of(tracks), normalise_tracks(tracks, intrinsics)
    geometry = _pair_geometry(tracks, recording, data, settings, intrinsics, progress)
    pairs = replace(pairs, inliers=geometry.inliers)
    freedom = freedom_of(recording, settings, intrinsics)
    lenses = lenses_of(recording, data, geometry, settings, intrinsics)
    inputs = Inputs(recording, data, geometry, lenses, freedom, settings.seed)
    progress("first solution", 0, 1)
    candidates, stages = starts(inputs, settings.init)
    progress("first solution", 1, 1)
    clock.append(time.perf_counter())
    progress("adjustment", 0, 1)
    solution = _best_solution(inputs, candidates, settings)
    refining = Refinement(recorded, tracks, recording, pairs, settings, intrinsics)
    if rough is not None:
        solution = refining.run(refining.in_step(solution, rough))
        solution = refining.with_shapes(solution)
    else:
        solution = refining.run(refining.with_shapes(solution))
    progress("adjustment", 1, 1)
    clock.append(time.perf_counter())
    explained = solution.settled.judged.kept.sum() / max(inputs.kept.sum(), 1)
    found = assemble_calibration(
        refining.tracks, refining.recording, solution.settled, solution.freedom, settings, pairs, float(explained)
    )
    check_volume(found.points[found.point_valid])
    chosen = intrinsics is None and settings.lens.distortion == "auto"
    another_lens = chosen and not isinstance(found.rig.cameras.lens, Brown)
    stages = (_pair_stage(geometry, tracks.names), *stages, *refining.stages, _adjustment_stage(solution.settled))
    return replace(
        with_reach(refining.with_times(replace(found, stages=stages))),
        seconds={"init": clock[1] - clock[0], "adjust": clock[2] - clock[1], "total": clock[2] - clock[0]},
        findings=(*refining.findings, *given_up(freedom, solution.freedom, found.rig, another_lens)),
    )


def _pair_geometry(tracks, recording, data, settings, intrinsics, progress: Progress) -> TwoViewGeometry:
    """Two-view geometry of all pairs, while later programs compile."""
    compiling = WarmUp(recording, data, first_lenses(settings, intrinsics, tracks.names))
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
    return geometry


def _rough_times(tracks: Tracks, settings: CalibrateSettings, intrinsics, progress: Progress) -> Times | None:
    """Where to start with what the settings ask for: time offsets and readout times from pairs of cameras."""
    if not settings.time_offsets and not settings.readout_times:
        return None
    offsets = np.zeros(tracks.cameras)
    if settings.time_offsets:
        offsets = _rough_offsets(tracks, settings, intrinsics, progress)
    readouts = None
    if settings.readout_times:
        known = {camera: Clock(offset) for camera, offset in enumerate(offsets.tolist())}
        readouts = search_readouts(tracks.of_one_point(), known, settings.epipolar, settings.seed, intrinsics).frames
    return Times(offsets, readouts, settings.time_offsets)


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


def _on_one_clock(recorded: Tracks, rough: Times, known_intrinsics: bool) -> tuple[Tracks, PairTable]:
    """The tracks as if recorded in step, once it is seen that enough is left of them."""
    tracks = moved_to_clock(recorded, rough.offsets, readouts=rough.readouts)
    pairs = pair_table(tracks)
    try:
        check_pairs(tracks, pairs, known_intrinsics=known_intrinsics)
    except InsufficientDataError as error:
        raise InsufficientDataError(
            f"Of {recorded.visible.sum()} observations {tracks.visible.sum()} can be brought to one clock, the others "
            f"have too few neighbours in time. {error}"
        ) from None
    return tracks, pairs


def _best_solution(inputs: Inputs, candidates: list[Start], settings: CalibrateSettings) -> Solution:
    """The solution from the best start; where much is lost or the lenses are implausible, from the others too."""
    recording, freedom = inputs.recording, inputs.freedom
    expected = inputs.kept.sum()
    first = refine_coarse_to_fine(recording, candidates[0].state, freedom)
    best = Solution(refine_to_convergence(recording, first, freedom, settings.outliers), freedom)
    for candidate in candidates[1:]:
        share, plausible = best.settled.judged.kept.sum() / max(expected, 1), best.plausible
        sound = best.settled.converged and plausible
        if (share >= COMPARED_BELOW and sound) or candidate.cost > MAX_CANDIDATE_COST * candidates[0].cost:
            break
        grown = refine_coarse_to_fine(recording, candidate.state, freedom)
        if share >= MIN_EXPLAINED and sound and grown.kept.sum() <= FOLLOWED_ABOVE * first.kept.sum():
            continue
        other = Solution(refine_to_convergence(recording, grown, freedom, settings.outliers), freedom)
        best = other if better_by(other, best) > 0 else best
    if not best.settled.converged:
        grown = refine_coarse_to_fine(recording, best.settled.judged.state, freedom)
        again = Solution(refine_to_convergence(recording, grown, freedom, settings.outliers), freedom)
        best = again if better_by(again, best) > 0 else best
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
