"""Corners of a board as caliscope writes them (`xy_CHARUCO.csv`), with the image sizes of its `camera_array.toml`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import Row, StrPath, read_table
from jaxpoint.io.formats.caliscope_toml import read_camera_array_sizes
from jaxpoint.io.track_formats.long_csv import is_table, scatter_pixels, sizes_of_rows
from jaxpoint.io.track_formats.track_format import ImageSizes, TrackFormat
from jaxpoint.targets import Target
from jaxpoint.tracks import Tracks

BOARD_COLUMNS = ("obj_loc_x", "obj_loc_y", "obj_loc_z")  # m, on the board
CORNER_COLUMNS = ("sync_index", "cam_id", "keypoint_id", "img_loc_x", "img_loc_y")


def is_caliscope_corners(path: Path, head: str) -> bool:
    """Whether a table has the column `keypoint_id`."""
    first = next((line for line in head.splitlines() if line.strip() and not line.startswith("#")), "")
    return is_table(path, head) and re.search(r"\bkeypoint_id\b", first.casefold()) is not None


def read_caliscope_corners(path: StrPath, image_sizes: ImageSizes | None = None) -> Tracks:
    """Corners of a board as caliscope writes them (`xy_CHARUCO.csv`): point ids are its keypoint ids.

    Where the file says where each corner lies on the board, the board is a target of that shape. Cameras are named
    cam_<id>. The image sizes come from `image_sizes` or a `camera_array.toml` in this folder or one of the three above
    it.

    Raises:
        FileFormatError: a missing column or value, a corner twice, a board beside another, or no image size.
    """
    rows = read_table(path, CORNER_COLUMNS)
    for row in rows:
        row.values["camera"] = f"cam_{row.integer('cam_id')}"
    if len({row.values.get("object_id") for row in rows}) > 1:
        raise FileFormatError(f"{path} holds several boards (object_id); keep the lines of one.")
    if image_sizes is None:
        image_sizes = _camera_array_sizes(Path(path), {row.values["camera"] for row in rows})
    order, sizes = sizes_of_rows(path, rows, image_sizes)
    keys = [(row.integer("keypoint_id"), row.integer("sync_index")) for row in rows]
    different = sorted(set(keys))
    pixels = scatter_pixels(rows, keys, different, order, ("img_loc_x", "img_loc_y"))
    points, frames = np.array(different).T
    corners, target = _board_of(rows)
    return Tracks.from_pixels(
        pixels,
        np.array([sizes[name] for name in order]),
        frame_ids=frames,
        names=order,
        point_ids=points if target is None else np.array([corners.index(point) for point in points.tolist()]),
        target=target,
    )


def _board_of(rows: list[Row]) -> tuple[list[int], Target | None]:
    """The corners' ids in order, and the board that they are of; None where the file does not say where they lie."""
    corners = sorted({row.integer("keypoint_id") for row in rows})
    if any(column not in rows[0].values or row.missing(column) for row in rows for column in BOARD_COLUMNS):
        return corners, None
    places: dict[int, list[float]] = {}
    for row in rows:
        place = [row.number(column) for column in BOARD_COLUMNS]
        if places.setdefault(row.integer("keypoint_id"), place) != place:
            raise row.error(f"corner {row.integer('keypoint_id')} lies elsewhere on the board than in a line before.")
    try:
        return corners, Target("board", np.array([places[corner] for corner in corners]))
    except ValueError as error:
        raise rows[0].error(f"obj_loc is of no board: {error}") from None


def _camera_array_sizes(path: Path, cameras: set[str]) -> dict[str, tuple[int, int]] | None:
    for folder in path.resolve().parents[:4]:
        if (folder / "camera_array.toml").exists():
            sizes = read_camera_array_sizes(folder / "camera_array.toml")
            return {name: size for name, size in sizes.items() if name in cameras}
    return None


FORMAT = TrackFormat(
    "caliscope-corners",
    "caliscope's corners",
    is_caliscope_corners,
    lambda request: read_caliscope_corners(request.path, request.image_sizes),
)
