"""The tables of the report: numbers made into text, row by row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxpoint.calibration.camera_clock import CameraClock
from jaxpoint.calibration.offset_search import PairOffset
from jaxpoint.calibration.result import PairTable, ReadoutTimes, Stage, TimeOffsets, Verdict
from jaxpoint.report.advice import ENOUGH_SHARED
from jaxpoint.report.style import short_names
from jaxpoint.report.summary import BEST, Summary, mean, mean_of_best, worst_outliers

_REASONS = {
    Verdict.REPROJECTION: "too far from where the other cameras say the light is",
    Verdict.BEHIND: "its point lies behind the camera",
    Verdict.UNDECIDED: "the views contradict each other and too few agree to say which is wrong",
}


_MOST_LINES = 12  # of one figure of a stage


@dataclass(frozen=True)
class Table:
    """Text, ready to be shown; the first cell of a row is its head."""

    header: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Cell:
    """One cell of a matrix: its text, how strongly it is coloured (0..1), and a class of the style sheet."""

    text: str
    heat: float = 0.0
    small: str = ""
    kind: str = ""
    hint: str = ""


@dataclass(frozen=True)
class Matrix:
    """A table of every camera against every other."""

    names: Sequence[str]
    rows: list[list[Cell]]
    inliers: bool = False


def counted_reasons(reasons: Mapping[str, int]) -> str:
    """How often each reason stood in the way."""
    return ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in reasons.items()) or "–"


def fit_table(summary: Summary) -> Table:
    """One row a camera: what it saw, what was kept of it, and how well that fits."""
    header = [
        "Camera", "Seen", "Kept", "Rejected", "Not\ncompared", "Mean error\nof kept", "95% of\nkept below",
        "Mean error\nof all",
    ]  # fmt: skip
    rows = []
    for c, name in enumerate(summary.names):
        kept, judged, seen = summary.kept[:, c], summary.judged[:, c], summary.visible[:, c]
        errors = summary.errors[:, c]
        rows.append([
            name,
            f"{seen.sum():,}",
            f"{kept.sum():,} ({kept.sum() / max(seen.sum(), 1):.1%})",
            f"{summary.rejected[:, c].sum():,}",
            f"{(seen & ~judged).sum():,}",
            _px(mean(errors[kept])),
            _px(float(np.quantile(errors[kept], 0.95)) if kept.any() else float("nan")),
            _px(mean(errors[judged])),
        ])  # fmt: skip
    return Table(header, rows)


def lens_table(summary: Summary, late: TimeOffsets | None = None, rolling: ReadoutTimes | None = None) -> Table:
    """One row a camera: its lens and its place, and its time offset and readout time where these were solved for."""
    unit = "m" if summary.scene.unit == "m" else "solver's unit"
    header = [
        "Camera", "Image", "Focal length", "Principal point", "View\nacross", "Distortion", f"Position, {unit}",
    ]  # fmt: skip
    rows = []
    for c, name in enumerate(summary.names):
        fx, fy = summary.focal[c]
        rows.append([
            name,
            "{} × {}".format(*summary.sizes[c]),
            f"{fx:.1f}" if abs(fx - fy) < 1e-9 * fx else f"{fx:.1f}, {fy:.1f}",
            "{:.1f}, {:.1f}".format(*summary.center[c]),
            f"{summary.view_deg[c]:.0f}°",
            _distortion_text(summary, c),
            "{:.3f}, {:.3f}, {:.3f}".format(*summary.scene.centers[c]),
        ])  # fmt: skip
    if late is not None:
        header.append(f"Frames after\n{summary.names[0]}")
        rows = [[*row, offset] for row, offset in zip(rows, offset_texts(late))]
    if rolling is not None:
        header.append("Frames, first\nrow to last")
        rows = [[*row, readout] for row, readout in zip(rows, readout_texts(rolling))]
    return Table(header, rows)


_SHORT = {"kannala_brandt": "fisheye"}  # names of lens models that a table has room for


def _distortion_text(summary: Summary, camera: int) -> str:
    """The coefficients of a lens that are not 0 at the end, with the model's name where it is not Brown's."""
    model = summary.lens_models[camera]
    brown = model == "brown"
    digits = ".4g" if brown else ".2g"
    values = ", ".join(format(k, digits) for k in _without_tail(summary.distortion[camera].tolist())) or "none"
    return values if brown else f"{_SHORT.get(model, model)}: {values}"


def offset_texts(late: TimeOffsets) -> list[str]:
    """The offset of every camera with its standard deviation, frames; the first is the clock."""
    return ["the clock", *(f"{by:+.3f} ± {sure:.3f}" for by, sure in zip(late.frames[1:], late.sigma[1:]))]


def readout_texts(rolling: ReadoutTimes) -> list[str]:
    """The readout time of every camera with its standard deviation, frames."""
    return [f"{frames:+.3f} ± {sure:.3f}" for frames, sure in zip(rolling.frames, rolling.sigma)]


def moment_table(names: Sequence[str], pairs: Sequence[PairOffset]) -> Table:
    """At which offset the views of each pair agree best."""
    header = ["Cameras", "Agree best, frames\nfrom first to second", "Matches\nthat fit then", "and in step"]
    rows = [
        [f"{names[p.first]} and {names[p.second]}", f"{p.frames:+.2f}", f"{p.fit:.0%}", f"{p.fit_in_step:.0%}"]
        for p in pairs
    ]
    return Table(header, rows)


def pair_matrix(pairs: PairTable) -> Matrix:
    """Frames shared by each two cameras, with the inliers of the pair where they are known."""
    shared = pairs.shared.copy()
    np.fill_diagonal(shared, 0)
    top = max(int(shared.max(initial=0)), 1)
    rows = []
    for a, name in enumerate(pairs.names):
        row = []
        for b, other in enumerate(pairs.names):
            if a == b:
                row.append(
                    Cell(f"{pairs.seen[a]:,}", kind="own", hint=f"{name} saw the light in {pairs.seen[a]} frames")
                )
                continue
            small = "" if pairs.inliers is None else f"{pairs.inliers[a, b]:,}"
            weak = "weak" if shared[a, b] < ENOUGH_SHARED else ""
            row.append(Cell(f"{shared[a, b]:,}", shared[a, b] / top, small, weak, f"{name} and {other}"))
        rows.append(row)
    return Matrix(short_names(pairs.names), rows, pairs.inliers is not None)


def clock_table(names: Sequence[str], clocks: Sequence[CameraClock]) -> Table:
    """How each camera lies in time, and how many of its matches agree."""
    header = [
        "Camera",
        "Late, frames",
        "Frames to one\nof the others",
        "Matches that fit\nas recorded",
        "and on one clock",
        "",
    ]
    rows = [
        [
            name,
            f"{clock.offset_frames:+.2f}" if clock.certain else "?",
            f"{clock.rate:.6g}" if clock.certain else "?",
            f"{clock.share_before:.0%}",
            f"{clock.share_after:.0%}",
            "" if clock.certain else "fits no other",
        ]
        for name, clock in zip(names, clocks)
    ]
    if any(clock.readout_frames is not None for clock in clocks):
        header.insert(3, "Frames, first\nrow to last")
        for row, clock in zip(rows, clocks):
            row.insert(3, _readout_text(clock.readout_frames, clock.readout_sigma))
    return Table(header, rows)


def _readout_text(frames: float | None, sigma: float | None) -> str:
    return "?" if frames is None or sigma is None else f"{frames:+.2f} ± {sigma:.2f}"


def kept_table(summary: Summary) -> Table:
    """Mean error at fixed fractions kept, for every camera and all of them."""
    fractions = (0.5, 0.8, BEST, 0.97, 1.0)
    groups = [(name, summary.errors[summary.judged[:, c], c]) for c, name in enumerate(summary.names)]
    groups.append(("all", summary.errors[summary.judged]))
    return Table(
        ["Mean error, px", *(f"best {f:.0%}" if f < 1 else "all" for f in fractions), "observations"],
        [[name, *(_px(mean_of_best(errors, f)) for f in fractions), f"{errors.size:,}"] for name, errors in groups],
    )


def outlier_table(summary: Summary) -> Table:
    """The observations with the largest residuals, worst first."""
    rows = []
    for camera, row in worst_outliers(summary):
        found = summary.pixels[row, camera]
        verdict = Verdict(int(summary.verdicts[row, camera]))
        rows.append([
            summary.names[camera],
            str(summary.frame_ids[row]),
            f"{summary.errors[row, camera]:.1f}",
            "{:.0f}, {:.0f}".format(*found),
            "{:.0f}, {:.0f}".format(*(found + summary.residuals[row, camera])),
            _REASONS.get(verdict, verdict.name.lower()),
        ])  # fmt: skip
    return Table(["Camera", "Frame", "Error, px", "Found at", "Expected at", "Why it was rejected"], rows)


def stage_list(stages: Sequence[Stage]) -> list[dict[str, Any]]:
    """Stages of the pipeline; each figure as its name and the lines of text that say it."""
    return [
        {"name": stage.name, "figures": [(_spaced(key), _lines(value)) for key, value in stage.figures.items()]}
        for stage in stages
    ]


def _lines(value: Any) -> list[str]:
    """One line, or one for each entry of a dictionary or of a list of dictionaries."""
    if isinstance(value, Mapping) and len(value) > 2:
        lines = [f"{key}: {as_text(item)}" for key, item in value.items()]
    elif isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
        lines = [as_text(item) for item in value]
    else:
        return [as_text(value)]
    more = len(lines) - _MOST_LINES
    return lines if more <= 0 else [*lines[:_MOST_LINES], f"and {more} more"]


def _spaced(key: Any) -> str:
    return str(key).replace("_", " ")


def origin_table(provenance: Mapping[str, Any] | None, seconds: Mapping[str, Any], seed: int | None) -> Table:
    """What the result was made with and from."""
    rows = [[_spaced(key), _origin(value)] for key, value in (provenance or {}).items()]
    if seed is not None and "seed" not in (provenance or {}):
        rows.append(["seed", str(seed)])
    spent = {name: f"{value:.2f}" for name, value in seconds.items() if value is not None}
    if spent:
        rows.append(["seconds", as_text(spent)])
    return Table([], rows)


def _origin(value: Any) -> str:
    """What it was made from: the keys of a dictionary are names of files and packages, told as they are."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {as_text(item)}" for key, item in value.items())
    return as_text(value)


def as_text(value: Any) -> str:
    """A figure of any kind, short: four digits of a float, lists with commas, dictionaries as `key value`."""
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return f"{value:,.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{_spaced(key)} {as_text(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple, np.ndarray)):
        return ", ".join(as_text(item) for item in value)
    return "none" if value is None else str(value)


def _px(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "none"


def _without_tail(values: Sequence[float]) -> list[float]:
    """The values without zeros at the end: terms that the lens model does not use."""
    values = list(values)
    while values and values[-1] == 0:
        values.pop()
    return values
