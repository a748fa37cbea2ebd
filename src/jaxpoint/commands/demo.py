"""`jaxpoint demo`: the main job on a simulated room, through the same code as real data."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Outcome, SeededOptions
from jaxpoint.config import RoomConfig

if TYPE_CHECKING:
    from jaxpoint.calibration.result import Calibration
    from jaxpoint.simulate.known import KnownRoom


@dataclass(frozen=True, kw_only=True)
class Demo(SeededOptions):
    """Calibrate, align and validate a simulated room: six cameras, a waved light, gaps and wrong detections.

    jaxpoint demo --out demo-run
    """

    room: tyro.conf.Suppress[RoomConfig] = field(default_factory=RoomConfig)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Demo:
        """The command's defaults under a configuration file."""
        return Demo(out=Path("demo-run"), room=room, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """The run, with what the truth says about it."""
        from jaxpoint.calibration.alignment import align_to_landmarks
        from jaxpoint.calibration.covariance import aligned_with_covariance
        from jaxpoint.calibration.selfcal import calibrate
        from jaxpoint.commands.written import written
        from jaxpoint.landmarks import locate
        from jaxpoint.runs import check_out
        from jaxpoint.simulate.known import CLICK_PX, known_in
        from jaxpoint.simulate.rooms import random_room

        out = self.needed_out("demo-run")
        check_out(out, self.force)
        simulated = random_room(self.seed, cameras=6, layout="around", visibility=0.8, outliers=0.05, noise_px=0.5)
        known = known_in(simulated, self.seed)
        settings = replace(self.room.calibrate, seed=self.seed)
        with console.progress() as progress:
            solved = calibrate(simulated.tracks, settings, progress=progress)
        points, _ = locate(solved, known.landmarks.names, known.clicks)
        centres, _ = locate(solved, solved.rig.names)
        sigmas = known.landmarks.sigmas
        alignment = align_to_landmarks(
            points, known.landmarks.points, sigmas, names=known.landmarks.names, camera_centres=centres
        )
        aligned = aligned_with_covariance(solved, alignment, sigmas, known.clicks, CLICK_PX)
        outcome = written(aligned, out, replace(self.room, calibrate=settings), force=self.force)
        truth, lines = _against_truth(aligned, known)
        *figures, report = outcome.lines
        return replace(outcome, figures={**outcome.figures, **truth}, lines=(*figures, *lines, report))


def _against_truth(calibration: Calibration, known: KnownRoom) -> tuple[dict, tuple[str, ...]]:
    """What only a simulation can know: how far the cameras are off, and which wrong detections were found."""
    import numpy as np

    from jaxpoint.calibration.result import Verdict
    from jaxpoint.validation import validate_lengths

    room = known.room
    apart = 1e3 * np.linalg.norm(np.asarray(calibration.rig.positions) - room.positions, axis=1)
    lengths = validate_lengths(calibration, known.lengths, known.clicks)
    found = int((room.is_outlier & (calibration.verdicts != Verdict.KEPT)).sum())
    planted = int(room.is_outlier.sum())
    truth = {
        "truth": {"camera_mean_mm": float(apart.mean()), "outliers_found": found, "outliers_planted": planted},
        "lengths": {"mean_mm": lengths.mean_mm, "max_mm": lengths.max_mm, "count": lengths.count},
    }
    return truth, (
        f"Against the truth of the simulation: cameras off by {apart.mean():.1f} mm in the mean, "
        f"{found} of {planted} wrong detections not believed.",
        f"{lengths.count} lengths not used for the alignment: mean error {lengths.mean_mm:.1f} mm, largest "
        f"{lengths.max_mm:.1f} mm.",
    )
