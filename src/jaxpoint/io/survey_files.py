"""What is known about the room: landmarks, where they were clicked in images, measured lengths, camera centres.

- `landmarks.csv`: `name,x_m,y_m,z_m`, and optionally `sigma_m` (standard deviation of each coordinate, m).
- `landmark_pixels.csv`: `name,camera,x,y`, a point clicked in the image of a camera (px, (0, 0) is the centre of the
  top-left pixel); each point in two or more images. Empty cells of x and y mean: not clicked there.
- `lengths.csv`: `name,end_a,end_b,length_m`, the ends named as in `landmark_pixels.csv`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.exchange import is_calibration, read_calibration
from jaxpoint.io.files import PIXEL_ALIASES, UNITS, Row, StrPath, read_table
from jaxpoint.io.rig_entries import UNSTATED, needs_metres
from jaxpoint.io.svoboda import read_matrix
from jaxpoint.landmarks import LandmarkPixels, Landmarks, Lengths


def read_landmarks(path: StrPath) -> Landmarks:
    """Known points from `name,x_m,y_m,z_m[,sigma_m]`.

    Raises:
        FileFormatError: a missing column or value, a name twice, or a sigma that is not positive.
    """
    rows = read_table(path, ("name", "x_m", "y_m", "z_m"))
    names = _unique(rows, "name")
    points = np.array([[row.number(axis) for axis in ("x_m", "y_m", "z_m")] for row in rows])
    if "sigma_m" not in rows[0].values:
        return Landmarks(names, points)
    return Landmarks(names, points, np.array([_positive(row, "sigma_m") for row in rows]))


def read_landmark_pixels(path: StrPath, cameras: Sequence[str]) -> LandmarkPixels:
    """Clicked points from `name,camera,x,y`; `cameras` names the columns of the result.

    Raises:
        FileFormatError: a missing column or value, a camera that is not among `cameras`, or a point clicked twice in
            one image.
    """
    rows = read_table(path, ("name", "camera", "x", "y"), PIXEL_ALIASES)
    _check_stand_ins(path, rows)
    names = tuple(dict.fromkeys(row.text("name") for row in rows))
    pixels = np.zeros((len(names), len(cameras), 2))
    visible = np.zeros((len(names), len(cameras)), bool)
    point_index = {name: i for i, name in enumerate(names)}
    for row in rows:
        place = point_index[row.text("name")], row.camera(cameras)
        if visible[place]:
            raise row.error(f"'{row.text('name')}' is given twice for camera '{row.text('camera')}'; keep one.")
        if not (row.missing("x") or row.missing("y")):
            pixels[place], visible[place] = (row.number("x"), row.number("y")), True
    return LandmarkPixels(names, pixels, visible)


def _check_stand_ins(path: StrPath, rows: list[Row]) -> None:
    """Refuse clicks at (0, 0) or (-1, -1), by which many write "not clicked"."""
    for stand_in in ((0.0, 0.0), (-1.0, -1.0)):
        given = [row for row in rows if not (row.missing("x") or row.missing("y"))]
        at = [row for row in given if (row.number("x"), row.number("y")) == stand_in]
        if len(at) > 1:
            raise FileFormatError(
                f"{path}: {len(at)} points are clicked at one and the same pixel ({stand_in[0]:g}, {stand_in[1]:g}); "
                "leave the cells of x and y empty where a point was not clicked."
            )


def read_lengths(path: StrPath) -> Lengths:
    """Measured lengths from `name,end_a,end_b,length_m`.

    Raises:
        FileFormatError: a missing column or value, a name twice, equal ends, or a length that is not positive.
    """
    rows = read_table(path, ("name", "end_a", "end_b", "length_m"))
    for row in rows:
        if row.text("end_a") == row.text("end_b"):
            raise row.error(f"both ends are '{row.text('end_a')}'; a length needs two.")
    return Lengths(
        _unique(rows, "name"),
        tuple((row.text("end_a"), row.text("end_b")) for row in rows),
        np.array([_positive(row, "length_m") for row in rows]),
    )


def read_camera_centres(path: StrPath, cameras: Sequence[str], unit: str | None = None) -> Landmarks:
    """Known places of the cameras, in metres, in the order of `cameras`.

    From `landmarks.csv` with the cameras' names (some may be missing), from a calibration (of any exchange
    format; names again), or from a matrix of text with one row a camera
    (`original_cam_centers.dat`, or a folder that holds it).

    Args:
        path: the file or folder.
        cameras: names of the rig's.
        unit: of a file that does not say it, m, cm or mm; a matrix is in metres without.

    Raises:
        FileFormatError: it is none of these, names no camera of the rig, or has not one row a camera.
    """
    path = Path(path)
    if path.is_dir() and (path / "original_cam_centers.dat").is_file():
        path = path / "original_cam_centers.dat"
    if path.suffix.lower() == ".dat":
        centres = read_matrix(path)
        if centres.shape != (len(cameras), 3) or not np.isfinite(centres).all():
            raise FileFormatError(
                f"{path} is {centres.shape[0]} x {centres.shape[1]}; {len(cameras)} cameras need {len(cameras)} rows "
                "of three finite numbers."
            )
        return Landmarks(tuple(cameras), centres / UNITS.get(unit or "m", 1.0))
    if path.suffix.lower() in (".csv", ".tsv", ".txt") and not is_calibration(path):
        known = read_landmarks(path)
    else:
        saved = read_calibration(path)
        if saved.unit not in ("m", UNSTATED):
            raise FileFormatError(f"{path} is in the unit '{saved.unit}'; known camera centres must be in metres.")
        saved = needs_metres(path, saved, unit)
        with jax.enable_x64(True):
            known = Landmarks(saved.rig.names, np.asarray(saved.rig.positions))
    names = [name for name in cameras if name in known.names]
    if not names:
        raise FileFormatError(
            f"{path} names {', '.join(known.names)}, none of which is a camera of the rig ({', '.join(cameras)})."
        )
    return known.select(names)


def _unique(rows: list[Row], column: str) -> tuple[str, ...]:
    seen: set[str] = set()
    for row in rows:
        if row.text(column) in seen:
            raise row.error(f"the name '{row.text(column)}' is used twice; names must differ.")
        seen.add(row.text(column))
    return tuple(row.text(column) for row in rows)


def _positive(row: Row, column: str) -> float:
    if row.number(column) <= 0:
        raise row.error(f"column '{column}' is {row.text(column)}; it must be positive.")
    return row.number(column)
