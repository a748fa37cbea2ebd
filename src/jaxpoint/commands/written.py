"""What `calibrate`, `align` and `demo` share: write the run, and say in a few lines how it went."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxpoint.calibration.quality import Quality, assess
from jaxpoint.calibration.result import Calibration
from jaxpoint.commands.console import table
from jaxpoint.commands.options import Outcome
from jaxpoint.config import RoomConfig
from jaxpoint.report.tables import offset_texts
from jaxpoint.runs import write_run


def written(
    calibration: Calibration,
    out: Path,
    room: RoomConfig,
    *,
    sources: Sequence[Path] = (),
    detect_seconds: float | None = None,
    force: bool = False,
) -> Outcome:
    """The run directory, and its outcome with the failure of the quality gate, if any."""
    quality = assess(calibration, room.calibrate, room.align)
    figures = write_run(
        out,
        calibration,
        room,
        command=shlex.join(["jaxpoint", *sys.argv[1:]]),
        inputs=sources,
        detect_seconds=detect_seconds,
        quality=quality,
        force=force,
    )
    report = out / "report.html"
    lines = _lines(calibration, quality, figures, report)
    return Outcome({**figures, "run": str(out), "report": str(report)}, lines, quality.failure)


def _lines(calibration: Calibration, quality: Quality, figures: dict[str, Any], report: Path) -> tuple[str, ...]:
    errors, observations, frames = figures["reprojection"], figures["observations"], figures["frames"]
    rows = [
        (
            camera["name"],
            f"{camera['focal_px'][0]:.1f}",
            " ".join(f"{value:.1f}" for value in camera["center_px"]),
            f"{camera['distortion'][0]:+.3f}",
            f"{camera['used']}/{camera['total']}",
            "-" if mean is None else f"{mean:.3f}",
        )
        for camera, mean in zip(figures["cameras"], errors["per_camera_mean_px"])
    ]
    header = ("camera", "focal px", "centre px", "k1", "kept", "mean px")
    late = calibration.time_offsets
    if late is not None:
        header = (*header, f"frames after {rows[0][0]}")
        rows = [(*row, offset) for row, offset in zip(rows, offset_texts(late))]
    summary = (
        f"mean {errors['mean_px']:.3f} px, rms {errors['rms_px']:.3f} px over {observations['used']} of "
        f"{observations['total']} observations, {frames['used']} of {frames['total']} frames, "
        f"{figures['seconds']['total']:.1f} s"
        if errors["mean_px"] is not None
        else "no observation was kept"
    )
    aligned = calibration.alignment
    in_room = (
        ()
        if aligned is None
        else (
            f"aligned by {aligned.method}: rms {aligned.rms_mm:.1f} mm, largest {aligned.max_mm:.1f} mm",
            *aligned.warnings,
        )
    )
    care = [f"{item.finding} {item.remedy}." for item in quality.findings if item.level == "care"]
    return (*table(header, rows), summary, *in_room, *care, f"Report: {report}")
