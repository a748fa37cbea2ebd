"""Keypoints of one camera as DeepLabCut and Lightning Pose write them, in CSV.

The header has three lines, or four with several individuals: `scorer`, `individuals`, `bodyparts`, and `coords` with
x, y and, of predictions, `likelihood`. A line is a frame, by its number or, of labelled images, by the image's name
(one column or, since version 2.2, three). Pixel (0, 0) is the centre of the top-left one.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import read_text
from jaxpoint.io.table import is_number
from jaxpoint.io.track_formats.keypoint_cameras import (
    CameraKeypoints,
    frame_of_image,
    individual_of,
    keypoint_format,
)
from jaxpoint.io.track_formats.track_format import TrackRequest

MIN_LIKELIHOOD = 0.6  # DeepLabCut's own pcutoff
Column = tuple[str, str, str]  # individual (empty where there is but one), bodypart, coordinate


def is_deeplabcut_csv(path: Path, head: str) -> bool:
    """Whether the header is DeepLabCut's."""
    lines = [line.split(",")[0].strip() for line in head.splitlines()[:4]]
    return lines[:1] == ["scorer"] and "coords" in lines[2:4]


def read_deeplabcut_csv(request: TrackRequest, path: Path) -> CameraKeypoints:
    """The keypoints of one file; those below `request.min_likelihood` (by default 0.6) are not seen.

    Raises:
        FileFormatError: a line has too few or many values, a value is no number, or a coordinate is missing.
        UsageError: it holds several individuals, and none was chosen.
    """
    lines = [line for line in csv.reader(io.StringIO(read_text(path))) if any(line)]
    head = next(i for i, line in enumerate(lines) if line[0] == "coords") + 1
    header = {line[0]: line for line in lines[:head]}
    first = next((i for i, cell in enumerate(header["coords"][1:], 1) if cell), 1)
    individuals = header.get("individuals", [""] * len(header["coords"]))
    columns = [*zip(individuals, header["bodyparts"], header["coords"])][first:]
    frames = [_frame(path, line[:first]) for line in lines[head:]]
    values = [_numbers(path, number, line[first:], len(columns)) for number, line in enumerate(lines[head:], head + 1)]
    return keypoints_of(request, path, columns, np.array(frames, int), np.array(values).reshape(-1, len(columns)))


def keypoints_of(
    request: TrackRequest,
    path: Path,
    columns: Sequence[Column],
    frames: np.ndarray,
    values: Float[np.ndarray, "F columns"],
) -> CameraKeypoints:
    """The keypoints in a table of DeepLabCut's, whether it stood in a CSV or an HDF5 file.

    Raises:
        FileFormatError: a bodypart has no x or no y, or the points are 3-D, or there are none.
        UsageError: it holds several individuals, and none was chosen.
    """
    if any(axis == "z" for _, _, axis in columns):
        raise FileFormatError(f"{path} holds points in 3-D (x, y, z), not pixels; give the files of the cameras.")
    individuals = list(dict.fromkeys(who for who, _, _ in columns))
    if not individuals or not len(frames):
        raise FileFormatError(f"{path} holds no keypoints; it needs one bodypart and one frame at least.")
    who = individuals[individual_of(request, path, individuals)]
    names = tuple(dict.fromkeys(part for owner, part, _ in columns if owner == who))
    index = {column: i for i, column in enumerate(columns)}
    missing = [(name, axis) for name in names for axis in "xy" if (who, name, axis) not in index]
    if missing:
        raise FileFormatError(f"{path}: bodypart '{missing[0][0]}' has no column '{missing[0][1]}'.")
    pixels = np.stack([values[:, [index[who, name, axis] for name in names]] for axis in "xy"], axis=-1)
    least = MIN_LIKELIHOOD if request.min_likelihood is None else request.min_likelihood
    for p, name in enumerate(names):
        if (place := index.get((who, name, "likelihood"))) is not None:
            pixels[~(values[:, place] >= least), p] = np.nan
    return CameraKeypoints(names, frames, pixels)


def _frame(path: Path, cells: Sequence[str]) -> int:
    return int(cells[0]) if len(cells) == 1 and cells[0].isdigit() else frame_of_image(path, cells[-1])


def _numbers(path: Path, number: int, cells: Sequence[str], wanted: int) -> list[float]:
    if len(cells) != wanted:
        raise FileFormatError(f"{path}, line {number}: {len(cells)} values under {wanted} columns; write it anew.")
    try:
        return [float(cell or "nan") for cell in cells]
    except ValueError:
        wrong = next(cell for cell in cells if cell and not is_number(cell))
        raise FileFormatError(f"{path}, line {number}: '{wrong}' is not a number.") from None


FORMAT = keypoint_format("deeplabcut", "DeepLabCut's CSV", is_deeplabcut_csv, read_deeplabcut_csv)
