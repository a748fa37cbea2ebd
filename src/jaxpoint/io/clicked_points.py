"""Points clicked or tracked by DLTdv, Argus and easyWand, and two points of a frame as the ends of a wand.

- DLTdv and Argus: a header `pt1_cam1_X,pt1_cam1_Y,pt1_cam2_X,...`, one line a frame.
- easyWand's wand points: no header, one line a place of the wand; first one end in all cameras (x, y each), then the
  other. Its background points: no header, one line a point at rest, x and y in all cameras.

All count pixels as MATLAB does, from 1, and y from below. Empty cells and NaN mean: not seen.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import StrPath, read_text
from jaxpoint.io.table import is_number
from jaxpoint.io.track_formats.long_csv import is_table
from jaxpoint.io.track_formats.track_format import TrackFormat
from jaxpoint.targets import Target
from jaxpoint.tracks import Tracks, join_tracks

COLUMN = re.compile(r"pt(\d+)_cam(\d+)_([XY])", re.IGNORECASE)
Size = tuple[int, int]


def is_clicked(path: Path, head: str) -> bool:
    """Whether the first line of a table is that of DLTdv, or numbers alone as easyWand's."""
    first = next((line for line in head.splitlines() if line.strip()), "")
    if not is_table(path, head):
        return False
    cells = [cell.strip().strip('"') for cell in re.split(r"[,;\t]", first)]
    return bool(COLUMN.fullmatch(cells[0])) or (len(cells) > 1 and all(map(is_number, cells)))


def read_clicked_points(path: StrPath, image_size: Size | None, ends: int = 2) -> Tracks:
    """Tracks of the points of DLTdv or Argus, or of an easyWand file without a header.

    Args:
        image_size: width and height of all cameras, px: y counts from below.
        ends: points of a line in a file without a header: 2 of a wand, 1 at rest.

    Raises:
        FileFormatError: a line has another number of values, or a value is no number.
        UsageError: the image size is not given.
    """
    path = Path(path)
    if image_size is None:
        raise UsageError(f"'{path}' does not say the size of the images, and counts y from below; give --image-size.")
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    header = [COLUMN.fullmatch(cell.strip().strip('"')) for cell in re.split(r"[,;\t]", lines[0])]
    if all(header):
        values = _values(path, lines[1:], len(header), start=2)
        columns = [(int(cell[1]), int(cell[2]), cell[3].upper()) for cell in header if cell]
        return _tracks(_by_column(path, columns, values), image_size)
    values = _values(path, lines, len(header), start=1)
    count, rest = divmod(values.shape[1], 2 * ends)
    if rest or count < 2:
        what = "ends of a wand" if ends == 2 else "points at rest"
        raise FileFormatError(
            f"{path} has {values.shape[1]} columns; {what} need {2 * ends} for each of two cameras or more."
        )
    pixels = values.reshape(len(values), ends, count, 2)
    return _tracks(pixels, image_size)


def wand_tracks(tracks: Tracks, length_m: float, path: StrPath) -> Tracks:
    """The tracks, points 0 and 1 of every frame being the ends of a wand; its length gives the scale.

    Raises:
        UsageError: frames hold one point only, or the tracks have targets already.
    """
    if tracks.targets:
        raise UsageError(f"'{path}' has a target of known shape already; leave out --wand-m.")
    ids = np.zeros(tracks.frames, int) if tracks.point_ids is None else tracks.point_ids
    if not {0, 1} <= set(ids.tolist()):
        raise UsageError(
            f"'{path}' has no two points a frame, so none of a wand; the ends are points 0 and 1 in its column `point`."
        )
    return replace(tracks, target_ids=np.where(ids <= 1, 0, -1), targets=(Target.wand(length_m),))


def with_static_points(tracks: Tracks, path: StrPath, image_size: Size | None) -> Tracks:
    """The tracks and easyWand's background points, which stay where they are: one frame more.

    Raises:
        UsageError: the file is of another number of cameras.
    """
    fixed = read_clicked_points(path, image_size, ends=1)
    if fixed.cameras != tracks.cameras:
        raise UsageError(f"'{path}' has points in {fixed.cameras} cameras, the tracks in {tracks.cameras}.")
    after = np.full(fixed.frames, tracks.frame_ids.max(initial=-1) + 1)
    return join_tracks(tracks, replace(fixed, names=tracks.names, frame_ids=after, point_ids=np.arange(fixed.frames)))


def _values(path: Path, lines: list[str], columns: int, start: int) -> Float[np.ndarray, "R columns"]:
    rows = []
    for number, line in enumerate(lines, start):
        cells = [cell.strip() for cell in re.split(r"[,;\t]", line)]
        if len(cells) != columns:
            raise FileFormatError(f"{path}, line {number}: {len(cells)} values where the first line has {columns}.")
        wrong = next((cell for cell in cells if cell and not is_number(cell)), None)
        if wrong is not None:
            raise FileFormatError(f"{path}, line {number}: '{wrong}' is no number.")
        rows.append([float(cell or "nan") for cell in cells])
    if not rows:
        raise FileFormatError(f"{path} holds no points; it needs a line for each frame.")
    return np.array(rows)


def _by_column(path: Path, columns: list[tuple[int, int, str]], values: np.ndarray) -> Float[np.ndarray, "R P C 2"]:
    points, cameras = max(column[0] for column in columns), max(column[1] for column in columns)
    wanted = {(p, c, axis) for p in range(1, points + 1) for c in range(1, cameras + 1) for axis in "XY"}
    if set(columns) != wanted or len(columns) != len(wanted):
        raise FileFormatError(
            f"{path} names {len(columns)} columns; {points} points in {cameras} cameras need pt1_cam1_X to "
            f"pt{points}_cam{cameras}_Y, each once."
        )
    found = np.full((len(values), points, cameras, 2), np.nan)
    for (point, camera, axis), column in zip(columns, values.T):
        found[:, point - 1, camera - 1, "XY".index(axis)] = column
    return found


def _tracks(clicked: Float[np.ndarray, "R P C 2"], size: Size) -> Tracks:
    """Pixels from 0, y downwards; rows of all points of a frame after each other."""
    rows, points, cameras, _ = clicked.shape
    pixels = np.stack([clicked[..., 0] - 1.0, size[1] - clicked[..., 1]], axis=-1).reshape(-1, cameras, 2)
    visible = np.all(np.isfinite(pixels), axis=-1)
    return Tracks(
        pixels=np.where(visible[..., None], pixels, 0.0),
        visible=visible,
        image_sizes=np.tile(np.array(size), (cameras, 1)),
        frame_ids=np.repeat(np.arange(rows), points),
        names=tuple(f"cam_{i}" for i in range(1, cameras + 1)),
        point_ids=np.tile(np.arange(points), rows),
        target_ids=np.full(rows * points, -1),
    )


FORMAT = TrackFormat(
    "clicked-points",
    "points of DLTdv, Argus or easyWand",
    is_clicked,
    lambda request: read_clicked_points(request.path, request.common_size()),
)
