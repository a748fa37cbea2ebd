"""`jaxpoint calibrate`: tracks to a calibrated rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import check_lens, detection_summary, intrinsics_from, tracks_from
from jaxpoint.commands.options import Inline, Options, Outcome
from jaxpoint.config import CalibrateSettings, InputSettings, RoomConfig
from jaxpoint.errors import FileFormatError, UsageError

if TYPE_CHECKING:
    from jaxpoint.calibration.quality import Quality
    from jaxpoint.calibration.result import Calibration, Finding
    from jaxpoint.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Calibrate(Options):
    """Calibrate the cameras from the tracks of a waved light.

    jaxpoint calibrate tracks.npz --out runs/room

    jaxpoint calibrate tracks.npz --extend runs/room-m --recalibrate cam_2 --out runs/room-again

    Nothing about the room need be known; the result has an arbitrary unit until `jaxpoint align`. Results that miss
    a quality gate are kept, marked, and end in exit code 5 (6 where the adjustment did not converge).
    """

    tracks: Annotated[Path, tyro.conf.Positional]
    """Tracks (.npz, .csv), or a folder with points.dat."""
    extend: Path | None = field(default=None)
    """Run of a calibrated room: its cameras stay as they are, and the tracks' other cameras are found beside them."""
    recalibrate: tuple[str, ...] = field(default=())
    """With `--extend`: cameras of the room that were moved, to be found again; their lenses stay."""
    input: Annotated[InputSettings, Inline] = field(default_factory=InputSettings)
    settings: Annotated[CalibrateSettings, Inline] = field(default_factory=CalibrateSettings)
    room: tyro.conf.Suppress[RoomConfig] = field(default_factory=RoomConfig)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Calibrate:
        """The command's defaults under a configuration file."""
        return Calibrate(
            tracks=tyro.MISSING, input=room.input, settings=room.calibrate, room=room, runtime=room.runtime
        )

    def run(self, console: Console) -> Outcome:
        """Solve, write the run, and judge it."""
        from jaxpoint.calibration.board_calibration import is_from_boards
        from jaxpoint.calibration.covariance import with_covariance
        from jaxpoint.calibration.selfcal import calibrate
        from jaxpoint.commands.run_outcome import write_outcome

        out = self.needed_folder("runs/room")
        check_lens(self.settings.lens, self.input.intrinsics)
        tracks = tracks_from(self.tracks, self.input)
        intrinsics = intrinsics_from(self.input, tracks)
        detect_seconds = _detect_seconds(self.tracks)  # before the work: a damaged file must not cost it
        if self.extend is not None or self.recalibrate:
            solved = self._extended(tracks)
        else:
            with console.progress() as progress:
                solved = with_covariance(calibrate(tracks, self.settings, intrinsics=intrinsics, progress=progress))
        room = replace(self.room, input=self.input, calibrate=self.settings, runtime=self.runtime)
        before = None if self.extend is None else self.extend / "calibration.json"
        given = (
            self.tracks,
            self.input.static_points,
            self.input.timestamps,
            self.input.intrinsics,
            self.config,
            before,
        )
        sources = [path for path in given if path is not None]
        if is_from_boards(solved):
            from jaxpoint.calibration.covariance import with_board_covariance
            from jaxpoint.commands.board_outcome import write_board_outcome

            return write_board_outcome(
                with_board_covariance(solved), None, out, room, title="Camera calibration from boards",
                sources=sources, force=self.force,
            )  # fmt: skip
        return write_outcome(
            solved,
            out,
            room,
            sources=sources,
            detect_seconds=detect_seconds,
            force=self.force,
        )

    def _extended(self, tracks: Tracks) -> Calibration:
        """The tracks' cameras beside those of a calibrated room."""
        from jaxpoint.calibration.extension import extend_calibration
        from jaxpoint.calibration.quality import assess
        from jaxpoint.commands.given_clocks import with_known_readouts
        from jaxpoint.runs import read_run

        if self.extend is None:
            raise UsageError("--recalibrate names cameras of a calibrated room; give its run by --extend RUN.")
        if self.input.intrinsics is not None:
            raise UsageError("--extend takes its lenses from the room; leave out --intrinsics.")
        if self.settings.time_offsets:
            raise UsageError("--extend needs cameras in step; leave out --time-offsets, and give --offset or --rate.")
        if self.settings.readout_times:
            raise UsageError("--extend solves for no readout times; leave out --readout-times, and give --readout.")
        run = read_run(self.extend)
        tracks = with_known_readouts(tracks, self.input, run.calibration)
        found = extend_calibration(tracks, run.calibration, self.settings, self.recalibrate)
        before = assess(run.calibration, run.config.calibrate, run.config.align)
        return found if before.holds else replace(found, findings=(*found.findings, _did_not_pass(before)))


def _did_not_pass(before: Quality) -> Finding:
    """What is said of a room that was no good before it was extended: cameras beside it are no better."""
    from jaxpoint.calibration.result import Finding

    return Finding(
        "extended room",
        "bad",
        f"The room that was extended did not pass: {before.failure}",
        "Calibrate that room anew, and extend it then",
    )


def _detect_seconds(tracks: Path) -> float | None:
    """How long `detect` took, where it left word beside the tracks."""
    from jaxpoint.runs import read_json

    summary = detection_summary(tracks)
    if tracks.suffix != ".npz" or not summary.is_file():
        return None
    kept = read_json(summary)
    if not isinstance(kept, dict):
        raise FileFormatError(f"'{summary}' is not what `detect led` writes beside its tracks; delete or move it.")
    return kept.get("seconds")
