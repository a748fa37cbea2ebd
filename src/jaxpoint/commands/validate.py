"""`jaxpoint validate`: is the calibration right?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import intrinsics_from, tracks_from
from jaxpoint.commands.options import Inline, Outcome, SeededOptions
from jaxpoint.config import RoomConfig, ValidateSettings
from jaxpoint.errors import JaxpointError, QualityError, UsageError

if TYPE_CHECKING:
    from jaxpoint.runs import Run
    from jaxpoint.validation import CalibrationDifference, HeldOutValidation, LengthValidation


@dataclass(frozen=True, kw_only=True)
class Validate(SeededOptions):
    """Hold a calibration against measured lengths, another recording, or its own halves.

    jaxpoint validate runs/room-m --lengths lengths.csv --landmark-pixels clicks.csv

    jaxpoint validate runs/room --held-out

    `--out` also keeps the figures, as validation.json in a new folder.
    """

    run_folder: Annotated[Path, tyro.conf.Positional]
    """Run of `calibrate` or `align`; lengths need an aligned one."""
    settings: Annotated[ValidateSettings, Inline] = field(default_factory=ValidateSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Validate:
        """The command's defaults under a configuration file."""
        return Validate(run_folder=tyro.MISSING, settings=room.validate, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Every test that was asked for; too large an error of the lengths is a failure of the outcome."""
        from jaxpoint.runs import read_run

        chosen = self.settings
        if chosen.lengths is None and chosen.tracks is None and not chosen.held_out:
            raise UsageError("Say what to hold the calibration against: --lengths, --tracks or --held-out.")
        if self.out is not None:
            self.needed_folder("")
        if chosen.lengths is not None and chosen.landmark_pixels is None:
            raise UsageError("--lengths needs the pixels of their ends: --landmark-pixels FILE.")
        run = read_run(self.run_folder)
        figures: dict[str, Any] = {}
        lines: list[str] = []
        failures: list[JaxpointError] = []
        for test in (_against_lengths, _against_tracks, _against_halves):
            try:  # what one test found is kept whatever becomes of the next
                found, told, failure = test(run, chosen, console)
            except JaxpointError as error:
                found, told, failure = {}, (), error
            figures |= found
            lines += told
            failures += [] if failure is None else [failure]
        if not figures:
            raise failures[0]
        self._keep(figures)
        return Outcome(figures, (*lines, *map(str, failures[1:])), failures[0] if failures else None)

    def _keep(self, figures: dict[str, Any]) -> None:
        if self.out is None:
            return
        from jaxpoint.runs import MARK, new_run, provenance, write_json

        inputs = [self.run_folder / "calibration.json", self.settings.lengths, self.settings.landmark_pixels]
        made = provenance("jaxpoint validate", [path for path in inputs if path is not None], self.seed)
        with new_run(self.out, self.force) as folder:
            write_json(folder / MARK, made)
            write_json(folder / "validation.json", figures)


Findings = tuple[dict[str, Any], Sequence[str], JaxpointError | None]
"""Of one test: figures, lines for a person, and why it failed, if it did."""


def _against_lengths(run: Run, settings: ValidateSettings, console: Console) -> Findings:
    if settings.lengths is None:
        return {}, (), None
    lengths = _lengths(run, settings)
    lines = _length_lines(lengths, run.calibration.camera_covariance is not None)
    return {"lengths": _plain(asdict(lengths))}, lines, _judge(lengths, settings.max_mean_mm)


def _against_tracks(run: Run, settings: ValidateSettings, console: Console) -> Findings:
    if settings.tracks is None:
        return {}, (), None
    again = _other_recording(run, settings.tracks)
    return {"tracks": _plain(asdict(again))}, _held_out_lines("another recording", again), None


def _against_halves(run: Run, settings: ValidateSettings, console: Console) -> Findings:
    if not settings.held_out:
        return {}, (), None
    predicted, difference = _halves(run, console)
    lines = [*_held_out_lines("half of the frames", predicted), *_difference_lines(difference)]
    return {"held_out": _plain(asdict(predicted)), "halves": _plain(asdict(difference))}, lines, None


def _lengths(run: Run, settings: ValidateSettings) -> LengthValidation:
    from jaxpoint.io.survey_files import read_landmark_pixels, read_lengths
    from jaxpoint.validation import validate_lengths

    assert settings.lengths is not None
    assert settings.landmark_pixels is not None
    clicks = read_landmark_pixels(settings.landmark_pixels, run.calibration.rig.names)
    return validate_lengths(run.calibration, read_lengths(settings.lengths), clicks)


def _judge(lengths: LengthValidation, allowed_mm: float) -> QualityError | None:
    if lengths.mean_mm <= allowed_mm:
        return None
    return QualityError(
        f"The {lengths.count} lengths are off by {lengths.mean_mm:.1f} mm in the mean, above the {allowed_mm:g} mm "
        f"allowed; {_cause(lengths, allowed_mm)}."
    )


def _cause(lengths: LengthValidation, allowed_mm: float) -> str:
    """The scale, where all would fit after a change of it; else the length that is worst."""
    import numpy as np

    counted = np.asarray(lengths.independent)
    measured, found = np.asarray(lengths.length_m)[counted], np.asarray(lengths.triangulated_m)[counted]
    ratio = float(np.median(found / measured))
    if counted.sum() >= 3 and 1e3 * np.abs(found / ratio - measured).mean() <= allowed_mm:
        how = "long" if ratio > 1 else "short"
        return (
            f"all come out {abs(ratio - 1):.1%} too {how}, so it is the scale: measure again what the room was aligned "
            "to, and see whether both are in metres"
        )
    worst = int(np.argmax(np.where(counted, np.abs(lengths.error_mm), -1.0)))
    return f"look at '{lengths.names[worst]}' first, which is worst: its ends may be clicked or measured wrongly"


def _other_recording(run: Run, path: Path) -> HeldOutValidation:
    from jaxpoint.commands.given_clocks import with_known_readouts
    from jaxpoint.validation import validate_held_out

    # The timestamps and clocks of the run belong to its own recording, but for the readout times of its cameras; a
    # camera left out is none of the rig.
    settings = replace(run.config.input, timestamps=None, offset=(), rate=())
    tracks, names = tracks_from(path, settings), run.calibration.rig.names
    if sorted(tracks.names) != sorted(names):
        raise UsageError(
            f"'{path}' has the cameras {', '.join(tracks.names)}, the calibration {', '.join(names)}; give tracks of "
            "the same cameras under the same names."
        )
    tracks = with_known_readouts(
        tracks.select_cameras([tracks.names.index(name) for name in names]), settings, run.calibration
    )
    return validate_held_out(run.calibration.rig, tracks)


def _halves(run: Run, console: Console) -> tuple[HeldOutValidation, CalibrationDifference]:
    """Both halves of the frames (even and odd) calibrated anew as the run was."""
    import numpy as np

    from jaxpoint.calibration.selfcal import calibrate
    from jaxpoint.validation import compare_calibrations, validate_held_out

    tracks = run.calibration.tracks
    settings = replace(
        run.config.calibrate, time_offsets=False, readout_times=False
    )  # these tracks stand on one clock already
    intrinsics = intrinsics_from(run.config.input, tracks)
    even, odd = (tracks.select_frames(np.arange(start, tracks.frames, 2)) for start in (0, 1))
    with console.progress() as progress:
        first, second = (calibrate(half, settings, intrinsics=intrinsics, progress=progress) for half in (even, odd))
    return validate_held_out(first.rig, odd), compare_calibrations(first, second)


def _length_lines(lengths: LengthValidation, cameras_known: bool) -> tuple[str, ...]:
    rows = [
        (name, f"{1e3 * measured:.1f}", f"{1e3 * found:.1f}", f"{error:+.1f}", f"{sigma:.1f}", "" if counted else "no")
        for name, measured, found, error, sigma, counted in zip(
            lengths.names,
            lengths.length_m,
            lengths.triangulated_m,
            lengths.error_mm,
            lengths.sigma_mm,
            lengths.independent,
        )
    ]
    noise = "of the clicks and of the cameras" if cameras_known else "of the clicks alone"
    return (
        *table(("length", "measured mm", "found mm", "error mm", "sigma mm", "counted"), rows),
        f"mean error {lengths.mean_mm:.1f} mm, largest {lengths.max_mm:.1f} mm over {lengths.count} lengths; the noise "
        f"{noise} allows {lengths.expected_mean_mm:.1f} mm",
        *lengths.warnings,
    )


def _held_out_lines(what: str, found: HeldOutValidation) -> tuple[str, ...]:
    again = found.reprojection
    line = f"{what}: {found.frames} frames, median {again.median_px:.3f} px, mean {again.mean_px:.3f} px"
    if found.prediction is None:
        return (line,)
    return (line, f"each camera predicted by the others: median {found.prediction.median_px:.3f} px")


def _difference_lines(found: CalibrationDifference) -> tuple[str, ...]:
    rows = [
        (name, f"{centre:.3g}", f"{turned:.3f}", f"{focal:+.2f}")
        for name, centre, turned, focal in zip(found.names, found.centre, found.rotation_deg, found.focal_px)
    ]
    header = ("one half against the other", f"centre {found.unit}", "rotation deg", "focal px")
    return (*table(header, rows), f"projections differ by {found.pixel_rms:.3f} px (rms)")


def _plain(value: Any) -> Any:
    """Strict JSON out of nested dictionaries with numpy arrays; None for what is not finite."""
    import numpy as np

    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not np.isfinite(value) else value
