"""Which settings fit this recording best?

Refits one recording over a list of cases (distortion model, loss, principal point, cameras left out, ...) from its
detections; the images are never touched. Every case is calibrated twice: on all frames, and on every second frame, from
which the other frames are predicted, each camera by the others (`held_out_px`): a model that only fits the noise better
does not get better there. A case that fails has its reason in its row. The table is written anew after each case, as
CSV and Markdown, so an interrupted run keeps its rows.

    python experiments/refit_calibration.py tracks.npz --cases configs/refit.toml --out refit
"""

from __future__ import annotations

import csv
import io
import sys
import time
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, InputSettings, load_settings
from jaxpoint.errors import InsufficientDataError, JaxpointError, UsageError
from jaxpoint.io.files import replacing
from jaxpoint.io.track_files import read_tracks
from jaxpoint.metrics import metrics
from jaxpoint.tracks import Tracks
from jaxpoint.validation import validate_held_out


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    name: str
    drop: tuple[str, ...] = ()  # names of the cameras left out
    calibrate: CalibrateSettings = field(default_factory=CalibrateSettings)


@dataclass(frozen=True)
class Cases:
    """The file of cases: `[[case]]` tables."""

    case: tuple[Case, ...]


@dataclass(frozen=True)
class Row:
    """What came out of one case; empty where it failed."""

    case: str
    cameras: int
    used: int | None = None
    total: int | None = None
    mean_px: float | None = None
    rms_px: float | None = None
    mean_all_px: float | None = None
    held_out_px: float | None = None  # median, each camera predicted by the others
    focal_px: str = ""
    k1: str = ""
    seconds: float | None = None
    remark: str = ""


@dataclass(frozen=True)
class Refit:
    """Refit one recording over a list of cases, and write one table."""

    tracks: Annotated[Path, tyro.conf.Positional]
    """Tracks (.npz, .csv), or a folder with points.dat."""
    cases: Path = Path("configs/refit.toml")
    """TOML file with a `[[case]]` for each row."""
    out: Path = Path("refit")
    """The table, written as OUT.csv and OUT.md."""
    input: Annotated[InputSettings, tyro.conf.arg(name="")] = field(default_factory=InputSettings)


def main(options: Refit) -> None:
    """Fit every case and write the table after each.

    Raises:
        JaxpointError: the tracks or the file of cases cannot be used.
    """
    tracks = read_tracks(options.tracks, one_based=options.input.one_based, image_sizes=options.input.image_size)
    cases = load_settings(options.cases, Cases).case
    rows: list[Row] = []
    for case in cases:
        rows.append(fit(tracks, case))
        write(options.out, rows)
    sys.stdout.write(markdown(rows))


def select(tracks: Tracks, case: Case) -> Tracks:
    """The tracks without the cameras that the case drops.

    Raises:
        UsageError: there is no camera of that name.
    """
    unknown = [name for name in case.drop if name not in tracks.names]
    if unknown:
        raise UsageError(
            f"Case '{case.name}' drops '{unknown[0]}', but the cameras are {', '.join(tracks.names)}; name one of them."
        )
    return tracks.select_cameras([i for i, name in enumerate(tracks.names) if name not in case.drop])


def fit(tracks: Tracks, case: Case) -> Row:
    """One case, on all frames and on half of them."""
    started = time.perf_counter()
    cameras = tracks.cameras - len(case.drop)
    try:
        chosen = select(tracks, case)
        solved = calibrate(chosen, case.calibrate)
        return row_of(case, solved, held_out(chosen, case.calibrate), time.perf_counter() - started)
    except JaxpointError as error:
        return Row(case.name, cameras, seconds=time.perf_counter() - started, remark=str(error))


def held_out(tracks: Tracks, settings: CalibrateSettings) -> float | None:
    """Median prediction error (px) in every second frame by a calibration from the others."""
    half = calibrate(tracks.select_frames(np.arange(0, tracks.frames, 2)), settings)
    try:
        found = validate_held_out(half.rig, tracks.select_frames(np.arange(1, tracks.frames, 2)))
    except InsufficientDataError:
        return None
    return None if found.prediction is None else found.prediction.median_px


def row_of(case: Case, solved: Calibration, held_out_px: float | None, seconds: float) -> Row:
    """The figures of a solved case."""
    figures = metrics(solved)
    reprojection, cameras = figures["reprojection"], figures["cameras"]
    failure = assess(solved, case.calibrate).failure
    return Row(
        case.name,
        len(cameras),
        figures["observations"]["used"],
        figures["observations"]["total"],
        reprojection["mean_px"],
        reprojection["rms_px"],
        reprojection["mean_all_px"],
        held_out_px,
        " ".join(f"{camera['focal_px'][0]:.1f}" for camera in cameras),
        " ".join(f"{camera['distortion'][0]:+.3f}" for camera in cameras),
        seconds,
        "" if failure is None else str(failure),
    )


def write(out: Path, rows: list[Row]) -> None:
    """The table as OUT.csv and OUT.md, each replaced at once."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(column.name for column in fields(Row))
    writer.writerows(cells(row) for row in rows)
    for suffix, content in ((".csv", text.getvalue()), (".md", markdown(rows))):
        with replacing(out.with_name(out.name + suffix)) as file:
            file.write(content.encode())


def markdown(rows: list[Row]) -> str:
    """The table as Markdown."""
    header = [column.name for column in fields(Row)]
    lines = [header, ["---"] * len(header), *(cells(row) for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cells(row: Row) -> list[str]:
    """The values of a row as text: three decimals, empty where there is none."""
    values = [getattr(row, column.name) for column in fields(Row)]
    return ["" if v is None else f"{v:.3f}" if isinstance(v, float) else str(v) for v in values]


if __name__ == "__main__":
    try:
        with jax.enable_x64(True):
            main(tyro.cli(Refit, description=__doc__))
    except JaxpointError as error:
        sys.stderr.write(f"refit_calibration: {error}\n")
        sys.exit(error.exit_code)
