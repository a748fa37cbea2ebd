"""Points in C3D, written by ezc3d: millimetres, with the expected error of each as its residual (-1: no point)."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from jaxpoint.errors import MissingDependencyError, UsageError
from jaxpoint.geometry.world_axes import World
from jaxpoint.io.point_formats.point_series import PointFormat, PointSeries

MOST_FRAMES = 65535  # what the two bytes of its header count
NO_POINT = -1.0  # residual of a point that is not there
STEPS = 254  # of the one byte that a residual has, in units of POINT:SCALE


def points_c3d(series: PointSeries) -> bytes:
    """The file.

    Raises:
        UsageError: the rate of the frames is not known, or there are too many frames.
        MissingDependencyError: ezc3d is not installed.
    """
    ezc3d, rate = _ezc3d(), series.needed_rate("C3D")
    if len(series.frame_ids) > MOST_FRAMES:
        raise UsageError(
            f"C3D holds {MOST_FRAMES} frames, and these are {len(series.frame_ids)}; write a .csv or .trc."
        )
    present = series.present
    file = ezc3d.c3d()
    file["header"]["points"]["first_frame"] = int(series.frame_ids[0])
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [rate], ["mm"]
    point["LABELS"]["value"] = list(series.names)
    across, up = _screen(series.world)
    file.add_parameter("POINT", "X_SCREEN", [across])
    file.add_parameter("POINT", "Y_SCREEN", [up])
    step_mm = 1e3 * float(np.nanmax(series.sigmas_m)) / STEPS
    point["SCALE"]["value"] = [-step_mm]  # negative: coordinates are floating-point numbers
    places = np.ones((4, len(series.names), len(series.frame_ids)))
    places[:3] = np.moveaxis(1e3 * series.points, -1, 0).swapaxes(1, 2)
    file["data"]["points"] = places
    residuals = np.where(present, 1e3 * series.sigmas_m, NO_POINT)
    file["data"]["meta_points"]["residuals"] = residuals.T[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, *places.shape[1:]), bool)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "points.c3d"
        file.write(str(path))
        return path.read_bytes()


def _screen(world: World) -> tuple[str, str]:
    """The axes that a viewer draws to the right and up: a level one, and that which is the room's z."""
    up = int(np.abs(world.matrix[:, 2]).argmax())
    return f"+{'YXX'[up]}", f"{'+' if world.matrix[up, 2] > 0 else '-'}{'XYZ'[up]}"


def _ezc3d() -> Any:
    try:
        import ezc3d
    except ModuleNotFoundError:
        raise MissingDependencyError("C3D needs ezc3d: pip install 'jaxpoint[c3d]', or name a .csv or .trc.") from None
    return ezc3d


def _check(path: Path) -> None:
    _ezc3d()


FORMAT = PointFormat(
    ".c3d",
    "C3D",
    points_c3d,
    losses=("C3D has no place for reprojection errors and the number of views; a .csv has them.",),
    check=_check,
)
