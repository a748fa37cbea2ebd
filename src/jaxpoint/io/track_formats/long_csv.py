"""Tracks in a long table: `frame,time,camera,x,y`, one line for each light seen.

`time` (s; or `time_ms`, `time_us`, `time_ns`) may be left out; x or y empty or NaN means hidden. With several points a
frame (ends of a wand, corners of a board, keypoints) the column `point` tells them apart, by whole numbers or by names.
Columns named u and v, or cam_id, are read too (`ALIASES`). The image sizes come from the columns `width,height`, else
from the caller, else from a file `cameras.csv` (`camera,width,height`) in that folder, which also fixes the order of
the cameras; without it they are sorted by name, cam_2 before cam_10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import PIXEL_ALIASES, Row, StrPath, natural_key, read_table
from jaxpoint.io.track_formats.track_format import ImageSizes, TrackFormat
from jaxpoint.tracks import Tracks

LONG_COLUMNS = ("frame", "camera", "x", "y")
ALIASES = {
    "frame": ("sync_index", "frame_id", "frame_number", "frame_index"),  # what all cameras share first
    **PIXEL_ALIASES,
    "width": ("image_width", "width_px"),
    "height": ("image_height", "height_px"),
}
TIME_UNITS = {"time": 1.0, "time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6, "time_ns": 1e-9}  # s
SLOWEST = 10.0  # s from frame to frame; more in a column `time` is no time in seconds

Key = tuple[int, int]  # point and frame


def is_table(path: Path, head: str) -> bool:
    """Whether its name is that of a table; what is wrong in it is said when it is read."""
    return path.suffix.lower() in (".csv", ".tsv", ".txt")


def read_long_csv(path: StrPath, one_based: bool = False, image_sizes: ImageSizes | None = None) -> Tracks:
    """Tracks from a table `frame,time,camera,x,y` (this module says which columns are optional).

    Raises:
        FileFormatError: a missing column or value, a camera twice in one frame, or no image size.
    """
    rows = read_table(path, LONG_COLUMNS, ALIASES)
    order, sizes = sizes_of_rows(path, rows, image_sizes)
    several = "point" in rows[0].values
    point_names = _point_names(rows) if several else ()
    ids = {name: place for place, name in enumerate(point_names)}
    keys = [(_point(row, ids) if several else 0, row.integer("frame")) for row in rows]
    different = sorted(set(keys))
    pixels = scatter_pixels(rows, keys, different, order, ("x", "y"))
    times = _times(path, rows, keys, different)
    points, frames = np.array(different).T
    return Tracks.from_pixels(
        pixels - float(one_based),
        np.array([sizes[name] for name in order]),
        frame_ids=frames,
        times=times,
        names=order,
        point_ids=points if several else None,
        point_names=point_names,
    )


def _point_names(rows: list[Row]) -> tuple[str, ...]:
    """The names of points in the order of the table; none where the column `point` holds numbers."""
    texts = tuple(dict.fromkeys(row.text("point") for row in rows))
    return () if any(text[:1].isdigit() or text[:1] in "+-." for text in texts) else texts


def _point(row: Row, ids: Mapping[str, int]) -> int:
    return ids[row.text("point")] if ids else row.integer("point")


def scatter_pixels(
    rows: list[Row], keys: list[Key], different: list[Key], cameras: Sequence[str], xy: tuple[str, str]
) -> np.ndarray:
    """(F, C, 2) pixels, NaN where there is no line."""
    index = {key: i for i, key in enumerate(different)}
    camera_index = {name: i for i, name in enumerate(cameras)}
    pixels = np.full((len(different), len(cameras), 2), np.nan)
    taken = np.zeros(pixels.shape[:2], bool)
    for row, key in zip(rows, keys):
        name = row.text("camera")
        place = index[key], camera_index[name]
        if taken[place]:
            again = f"camera '{name}' has a second line for frame {key[1]}"
            if "point" in row.values or "keypoint_id" in row.values:
                raise row.error(f"{again} and point {key[0]}; keep one line.")
            raise row.error(
                f"{again}; a file holds one light, unless a column 'point' tells several apart: keep one line, or add "
                "that column."
            )
        taken[place] = True
        if not (row.missing(xy[0]) or row.missing(xy[1])):
            pixels[place] = row.number(xy[0]), row.number(xy[1])
    return pixels


def _times(path: StrPath, rows: list[Row], keys: list[Key], different: list[Key]) -> np.ndarray | None:
    """(F,) mean time of each frame's lines, s; None where there is no such column or it is empty throughout."""
    column = next((name for name in TIME_UNITS if name in rows[0].values), None)
    if column is None or all(row.missing(column) for row in rows):
        return None
    seconds: dict[int, list[float]] = {frame: [] for _, frame in different}
    for row, (_, frame) in zip(rows, keys):
        if not row.missing(column):
            seconds[frame].append(TIME_UNITS[column] * row.number(column))
    empty = [frame for frame, values in seconds.items() if not values]
    if empty:
        raise FileFormatError(f"{path}: frame {empty[0]} has no time, others do; give all or drop the column.")
    mean = {frame: float(np.mean(values)) for frame, values in sorted(seconds.items())}
    if column == "time":
        _check_seconds(path, np.array(list(mean.values())))
    return np.array([mean[frame] for _, frame in different])


def _check_seconds(path: StrPath, times: np.ndarray) -> None:
    step = float(np.median(np.abs(np.diff(times)))) if len(times) > 1 else 0.0
    if step > SLOWEST:
        unit = next((name for name in ("time_ms", "time_us") if step * TIME_UNITS[name] <= 1), "time_ns")
        raise FileFormatError(
            f"{path}: column 'time' rises by {step:.3g} from frame to frame, which are hardly seconds; name it {unit} "
            f"if it is in {unit[5:]}, or time_s if these are seconds."
        )


def sizes_of_rows(
    path: StrPath, rows: list[Row], given: ImageSizes | None
) -> tuple[tuple[str, ...], dict[str, tuple[int, int]]]:
    """The cameras in order, and the image size of each."""
    seen = sorted({row.text("camera") for row in rows}, key=natural_key)
    order: Sequence[str] = seen
    sidecar = Path(path).parent / "cameras.csv"
    if {"width", "height"} <= rows[0].values.keys():
        sizes = _sizes_in(rows)
    elif isinstance(given, Mapping):
        sizes, order = dict(given), list(given)
    elif given is not None:
        sizes = dict.fromkeys(seen, given)
    elif sidecar.exists():
        sizes = _sizes_in(read_table(sidecar, ("camera", "width", "height"), ALIASES))
        order = list(sizes)
    else:
        raise FileFormatError(
            f"{path} does not say how large the images are; add columns width,height (px), or a file {sidecar} "
            "(camera,width,height), or give --image-size WIDTH HEIGHT where all are alike."
        )
    missing = [name for name in seen if name not in sizes]
    if missing:
        raise FileFormatError(f"{path}: no image size is known for camera '{missing[0]}', only for {list(sizes)}.")
    return tuple(order), sizes


def _sizes_in(rows: list[Row]) -> dict[str, tuple[int, int]]:
    sizes: dict[str, tuple[int, int]] = {}
    for row in rows:
        size = row.integer("width"), row.integer("height")
        if min(size) <= 0:
            raise row.error(f"an image of {size[0]} x {size[1]} px; width and height must be positive.")
        name = row.text("camera")
        if sizes.setdefault(name, size) != size:
            raise row.error(f"camera '{name}' is {size} here and {sizes[name]} before.")
    return sizes


FORMAT = TrackFormat(
    "long-csv",
    "a table frame,camera,x,y",
    is_table,
    lambda request: read_long_csv(request.path, request.one_based, request.image_sizes),
)
