"""`jaxpoint calibrate`: tracks to a calibrated rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import check_lens, detection_summary, intrinsics_from, tracks_from
from jaxpoint.commands.options import Inline, Options, Outcome
from jaxpoint.config import CalibrateSettings, InputSettings, RoomConfig
from jaxpoint.errors import FileFormatError


@dataclass(frozen=True, kw_only=True)
class Calibrate(Options):
    """Calibrate the cameras from the tracks of a waved light.

    jaxpoint calibrate tracks.npz --out runs/room

    Nothing about the room need be known; the result has an arbitrary unit until `jaxpoint align`. Results that miss
    a quality gate are kept, marked, and end in exit code 5 (6 where the adjustment did not converge).
    """

    tracks: Annotated[Path, tyro.conf.Positional]
    """Tracks (.npz, .csv), or a folder with points.dat."""
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
        with console.progress() as progress:
            solved = calibrate(tracks, self.settings, intrinsics=intrinsics, progress=progress)
        room = replace(self.room, input=self.input, calibrate=self.settings, runtime=self.runtime)
        given = (self.tracks, self.input.timestamps, self.input.intrinsics, self.config)
        sources = [path for path in given if path is not None]
        if is_from_boards(solved):
            from jaxpoint.calibration.covariance import with_board_covariance
            from jaxpoint.commands.board_outcome import write_board_outcome

            return write_board_outcome(
                with_board_covariance(solved), None, out, room, title="Camera calibration from boards",
                sources=sources, force=self.force,
            )  # fmt: skip
        return write_outcome(
            with_covariance(solved),
            out,
            room,
            sources=sources,
            detect_seconds=detect_seconds,
            force=self.force,
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
