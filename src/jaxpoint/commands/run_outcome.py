"""What `calibrate`, `align` and `demo` share: write the run, and say in a few lines how it went."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxpoint.calibration.clock_findings import readout_flags
from jaxpoint.calibration.quality import Quality, assess
from jaxpoint.calibration.result import Calibration
from jaxpoint.commands.console import table
from jaxpoint.commands.options import Outcome, at
from jaxpoint.config import RoomConfig
from jaxpoint.extras import extra
from jaxpoint.report.tables import offset_texts, readout_texts
from jaxpoint.runs import write_run


def write_outcome(
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
    missing: list[str] = []
    figures = write_run(
        out,
        calibration,
        room,
        command=shlex.join(["jaxpoint", *sys.argv[1:]]),
        inputs=sources,
        detect_seconds=detect_seconds,
        quality=quality,
        force=force,
        missing=missing,
    )
    report = out / "report.html"
    lines: tuple[str, ...] = ()
    with extra("the table of cameras on the terminal", missing):
        lines = _lines(calibration, quality, figures)
    told = {**figures, "run": str(out), "report": str(report) if report.exists() else None}
    return Outcome(told, (*lines, *at("Report", report)), quality.failure, tuple(missing))


def _lines(calibration: Calibration, quality: Quality, figures: dict[str, Any]) -> tuple[str, ...]:
    errors, observations, frames = figures["reprojection"], figures["observations"], figures["frames"]
    rows = [
        (
            camera["name"],
            _number(camera["focal_px"][0], ".1f"),
            " ".join(_number(value, ".1f") for value in camera["center_px"]),
            _number(next(iter(camera["distortion"]), None), "+.3f"),
            f"{camera['used']}/{camera['total']}",
            _number(mean, ".3f"),
        )
        for camera, mean in zip(figures["cameras"], errors["per_camera_mean_px"])
    ]
    first_coefficients = {next((c.name for c in model.coefficients), None) for model in calibration.rig.lens_models}
    first_coefficient = next(iter(first_coefficients)) if len(first_coefficients) == 1 else None
    first_coefficient = first_coefficient or "distortion"
    header = ("camera", "focal px", "centre px", first_coefficient, "kept", "mean px")
    late = calibration.time_offsets
    if late is not None:
        header = (*header, f"frames after {rows[0][0]}")
        rows = [(*row, offset) for row, offset in zip(rows, offset_texts(late))]
    rolling = calibration.readout_times
    if rolling is not None:
        header = (*header, "frames first row to last")
        rows = [(*row, readout) for row, readout in zip(rows, readout_texts(rolling))]
    given = (
        ()
        if rolling is None
        else (f"in other recordings: {readout_flags(calibration.rig.names, rolling.frames.tolist())}",)
    )
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
    return (*table(header, rows), *given, summary, *in_room, *care)


def _number(value: float | None, digits: str) -> str:
    """A dash for what is not known, as of a camera that kept no observation."""
    return "-" if value is None else format(value, digits)
