"""From the first rest of the outliers to the final solution: clocks, lens terms, and priors that are refuted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxpoint.calibration.assembly import assemble_calibration
from jaxpoint.calibration.hypotheses import Lenses
from jaxpoint.calibration.known_lenses import lens_test, refuted_lenses, unknown_again
from jaxpoint.calibration.lens_choice import choose_lens, first_lens_again
from jaxpoint.calibration.normal import normal_equations
from jaxpoint.calibration.objective import Solution, better_by, solve_with
from jaxpoint.calibration.prior_choice import PriorChoice
from jaxpoint.calibration.recording import NOISE_PX, Freedom, Recording
from jaxpoint.calibration.result import Calibration, Finding, PairTable, ReadoutTimes, Stage, TimeOffsets
from jaxpoint.calibration.shapes import has_hold, with_shapes
from jaxpoint.calibration.timing import InStep, Times, brought_in_step
from jaxpoint.calibration.twoview import NormalisedTracks, TwoViewGeometry
from jaxpoint.calibration.uncertainty import variance_px2
from jaxpoint.camera.lenses import LensChoice, chosen_lenses, lenses_of_models
from jaxpoint.camera.parameters import adjusted_lenses
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import UsageError
from jaxpoint.tracks import Tracks

FIRST_LENS = "radial2"  # the setting under which `auto` begins


def first_lenses(settings: CalibrateSettings, intrinsics: CameraRig | None, names: Sequence[str]) -> LensChoice:
    """The lenses of the cameras (`names`) in the first solution; known lenses stay of their kind.

    Raises:
        UsageError: no lens offers the setting, or the known lenses are of another kind than it asks for.
    """
    asked = settings.lens.distortion
    choice = chosen_lenses(FIRST_LENS if asked == "auto" else asked, names)
    if intrinsics is None or isinstance(intrinsics.cameras.lens, choice.model):
        return choice
    if asked != "auto":
        raise UsageError(
            f"The known lenses are of the model '{intrinsics.cameras.lens.name}', but --lens.distortion {asked} asks "
            "for another; leave it at auto, or calibrate without known lenses."
        )
    return lenses_of_models(intrinsics.lens_models)


def freedom_of(recording: Recording, settings: CalibrateSettings, intrinsics: CameraRig | None) -> Freedom:
    """The parameters that the settings leave free, and their priors."""
    choice = first_lenses(settings, intrinsics, recording.names)
    freedom = Freedom.of(recording, settings.lens, choice, hold=settings.lens.known == "hold")
    if intrinsics is None:
        return freedom
    return freedom.around(recording, adjusted_lenses(intrinsics), type(intrinsics.cameras.lens))


def lenses_of(
    recording: Recording,
    data: NormalisedTracks,
    geometry: TwoViewGeometry,
    settings: CalibrateSettings,
    intrinsics: CameraRig | None,
) -> Lenses:
    """What the first solution knows of the lenses."""
    return Lenses.of(data, geometry, intrinsics, first_lenses(settings, intrinsics, recording.names))


@dataclass
class Refinement:
    """One recording while its solution is refined; with time offsets or readout times its tracks change on the way."""

    recorded: Tracks
    tracks: Tracks
    recording: Recording
    pairs: PairTable
    settings: CalibrateSettings
    intrinsics: CameraRig | None
    stages: list[Stage] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    clocks: InStep | None = None

    def run(self, solution: Solution) -> Solution:
        """Lens terms, then priors in doubt; where one was given up, the lens terms once more."""
        first, solution = solution, self._lens(solution)
        chosen = self._priors(solution)
        if chosen is solution:
            return solution
        if chosen.state.lens is not first.state.lens:
            chosen, stage = first_lens_again(self.recording, first, chosen, self.settings)
            self.stages.append(stage)
        return self._lens(self._in_step_again(chosen))

    def in_step(self, solution: Solution, times: Times) -> Solution:
        """The solution with the cameras brought to one clock."""
        state, freedom = solution.settled.judged.state, solution.freedom
        self.clocks = brought_in_step(self.recorded, state, times, freedom, self.settings.outliers)
        self.recording, self.tracks = self.clocks.recording, self.clocks.tracks
        return Solution(self.clocks.settled, freedom)

    def with_shapes(self, solution: Solution) -> Solution:
        """The solution adjusted with the targets and known points among the tracks."""
        if not has_hold(self.recording):
            return solution
        outliers = self.settings.outliers
        self.recording, solution, stages, findings = with_shapes(self.recording, solution, outliers)
        self.stages += stages
        self.findings += findings
        return solution

    def _in_step_again(self, solution: Solution) -> Solution:
        return solution if self.clocks is None else self.in_step(solution, self.clocks.times)

    def _lens(self, solution: Solution) -> Solution:
        """Tangential and higher radial terms where they predict held-out frames better."""
        if self.settings.lens.distortion != "auto" or self.settings.lens.known == "hold":
            return solution
        chosen, stages = choose_lens(self.recording, solution, self.settings)
        self.stages += stages
        return solution if chosen is solution else self._in_step_again(chosen)

    def _priors(self, solution: Solution) -> Solution:
        """Without the priors that the recording refutes."""
        if self.settings.lens.known != "none":
            return self._given_lenses(solution)
        trials = PriorChoice(self.recording, self.tracks, self.pairs, self.settings)
        chosen, stages = trials.choose(solution)
        self.stages += stages
        self.findings += trials.findings
        return chosen

    def _given_lenses(self, solution: Solution) -> Solution:
        """Without given lenses that the recording contradicts, where they were to be refined."""
        if self.settings.lens.known != "refine":
            return solution
        parts = self.tracks, self.recording, solution.settled, solution.freedom, self.settings, self.pairs
        found = assemble_calibration(*parts)
        test = lens_test(found, normal_equations(found))
        if test is None or not test.refuted.any():
            return solution
        freedom, widths = solution.freedom, self.recording.image_sizes[:, 0].astype(float)
        for camera in np.flatnonzero(test.refuted).tolist():
            freedom = unknown_again(freedom, camera, widths, NOISE_PX)
        state, outliers = solution.settled.judged.state, self.settings.outliers
        trial = solve_with(self.recording, state, freedom, outliers)
        if better_by(trial, solution) <= 0:
            return solution
        self.findings += refuted_lenses(test, self.tracks.names)
        return trial

    def with_times(self, found: Calibration) -> Calibration:
        """The calibration with the time offsets and readout times that it was made with."""
        if self.clocks is None:
            return found
        clocks, times = self.clocks, self.clocks.times
        sigmas = clocks.unit_sigmas * np.sqrt(variance_px2(found))
        late = TimeOffsets(times.offsets, sigmas[:, 0]) if times.solve_offsets else None
        rolling = None if times.readouts is None else ReadoutTimes(times.readouts, sigmas[:, 1])
        return replace(
            found,
            stages=(*found.stages, _clock_stage(clocks, late, rolling, self.recorded, found.tracks)),
            time_offsets=late,
            readout_times=rolling,
            converged=found.converged and clocks.still,
            message=found.message if clocks.still else f"{found.message}; the {_what(late, rolling)} did not converge",
        )


def _clock_stage(
    clocks: InStep, late: TimeOffsets | None, rolling: ReadoutTimes | None, recorded: Tracks, used: Tracks
) -> Stage:
    found = {"frames": late, "readout_frames": rolling}
    return Stage(
        _what(late, rolling).capitalize(),
        {
            **{name: _shown(recorded.names, each) for name, each in found.items() if each is not None},
            "observations_left_out_for_want_of_neighbours_in_time": int(recorded.visible.sum() - used.visible.sum()),
            "rounds": clocks.rounds,
        },
    )


def _what(late: TimeOffsets | None, rolling: ReadoutTimes | None) -> str:
    return " and ".join(["time offsets"] * (late is not None) + ["readout times"] * (rolling is not None))


def _shown(names: tuple[str, ...], found: TimeOffsets | ReadoutTimes) -> dict[str, str]:
    return {name: f"{frames:+.3f} ± {sure:.3f}" for name, frames, sure in zip(names, found.frames, found.sigma)}
