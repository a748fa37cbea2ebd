"""`jaxpoint align`: from the solver's frame to the metric room."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Inline, Outcome, SeededOptions
from jaxpoint.config import AlignSettings, RoomConfig
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    from jaxpoint.calibration.result import Calibration


@dataclass(frozen=True, kw_only=True)
class Align(SeededOptions):
    """Bring a calibration into the room, in metres with z up.

    jaxpoint align runs/room --landmarks landmarks.csv --landmark-pixels clicks.csv --out runs/room-m

    jaxpoint align runs/room --camera-centres tape.csv --out runs/room-m

    jaxpoint align runs/room --floor 10 250 480 --length-m 2.0 --out runs/room-m
    """

    run_folder: Annotated[Path, tyro.conf.Positional]
    """Run of `calibrate`."""
    settings: Annotated[AlignSettings, Inline] = field(default_factory=AlignSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Align:
        """The command's defaults under a configuration file."""
        return Align(run_folder=tyro.MISSING, settings=room.align, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Align, and write a new run beside the old one."""
        from jaxpoint.commands.written import written
        from jaxpoint.runs import read_run

        out = self.needed_folder("runs/room-m")
        run = read_run(self.run_folder)
        given = (self.settings.landmarks, self.settings.landmark_pixels, self.settings.camera_centres)
        return written(
            aligned(run.calibration, self.settings),
            out,
            replace(run.config, align=self.settings),
            sources=[run.folder / "calibration.json", *(path for path in given if path is not None)],
            detect_seconds=run.metrics["seconds"]["detect"],
            force=self.force,
        )


def aligned(calibration: Calibration, settings: AlignSettings) -> Calibration:
    """The calibration in the room, aligned as the settings ask, with its covariance there.

    Raises:
        UsageError: none or more than one kind of knowledge is given.
        FileFormatError: a file is not what it should be.
        InsufficientDataError: a point cannot be placed, or the points do not determine the room.
    """
    from jaxpoint.calibration.alignment import align_to_camera_centres, align_to_floor, align_to_landmarks
    from jaxpoint.calibration.covariance import aligned_with_covariance
    from jaxpoint.io.known import read_camera_centres, read_landmark_pixels, read_landmarks
    from jaxpoint.landmarks import CLICK_SIGMA_PX, locate

    kinds = [settings.landmarks is not None, settings.camera_centres is not None, bool(settings.floor)]
    if sum(kinds) != 1:
        raise UsageError("Give one of --landmarks, --camera-centres and --floor; they are different ways to align.")
    cameras = calibration.rig.names
    clicks = None if settings.landmark_pixels is None else read_landmark_pixels(settings.landmark_pixels, cameras)
    warnings: tuple[str, ...] = ()
    sigmas = None
    centres, _ = locate(calibration, cameras)
    if settings.landmarks is not None:
        known = read_landmarks(settings.landmarks)
        points, warnings = locate(calibration, known.names, clicks)
        sigmas = known.sigmas
        found = align_to_landmarks(points, known.points, sigmas, names=known.names, camera_centres=centres)
    elif settings.camera_centres is not None:
        known = read_camera_centres(settings.camera_centres, cameras)
        points, _ = locate(calibration, known.names)
        absent = [name for name in cameras if name not in known.names]
        if absent:
            warnings = (f"'{settings.camera_centres}' does not have {', '.join(absent)}: aligned without.",)
        sigmas = known.sigmas
        found = align_to_camera_centres(points, known.points, sigmas, names=known.names)
    elif settings.length_m is None:
        raise UsageError("--floor needs the distance between its first two points: --length-m METRES.")
    else:
        points, warnings = locate(calibration, settings.floor, clicks)
        found = align_to_floor(points, centres, settings.length_m, names=settings.floor)
    found = replace(found, warnings=(*found.warnings, *warnings))
    return aligned_with_covariance(calibration, found, sigmas, clicks, CLICK_SIGMA_PX)
