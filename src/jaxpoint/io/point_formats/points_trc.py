"""Points in TRC, the markers of OpenSim (and of Motion Analysis): tabs, millimetres, y up by default.

Three lines of header (path and axes, names of figures, figures), one of names, one of X1 Y1 Z1, a blank one, and a line
for each frame with its number and its time; a missing point is three empty cells, as OpenSim reads it.
"""

from __future__ import annotations

import numpy as np

from jaxpoint.errors import UsageError
from jaxpoint.io.point_formats.point_series import PointFormat, PointSeries

DECIMALS = 4  # of millimetres
FIGURES = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
ORIGINAL = ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]


def points_trc(series: PointSeries) -> bytes:
    """The file.

    Raises:
        UsageError: the rate of the frames is not known, or a name holds a tab.
    """
    rate, count = series.needed_rate("TRC"), len(series.frame_ids)
    wrong = next((name for name in series.names if "\t" in name or "\n" in name), None)
    if wrong is not None:
        raise UsageError(f"TRC separates names by tabs, and the point '{wrong!r}' holds one; name it anew.")
    hertz, first = f"{rate:.10g}", series.frame_ids[0]
    figures = (hertz, hertz, count, len(series.names), "mm", hertz, first, count)
    axes = [f"{axis}{number}" for number in range(1, len(series.names) + 1) for axis in "XYZ"]
    lines = [
        ("PathFileType", "4", "(X/Y/Z)", "points.trc"),
        (*FIGURES, *ORIGINAL),
        figures,
        ("Frame#", "Time", *(cell for name in series.names for cell in (name, "", ""))),
        ("", "", *axes),
        (),
    ]
    for number, points in zip(series.frame_ids.tolist(), 1e3 * series.points):
        lines.append((number, f"{number / rate:.9g}", *map(_cell, points.ravel())))
    return "".join("\t".join(map(str, line)) + "\n" for line in lines).encode()


def _cell(millimetres: float) -> str:
    return "" if np.isnan(millimetres) else f"{millimetres:.{DECIMALS}f}"


FORMAT = PointFormat(
    ".trc",
    "TRC",
    points_trc,
    world="opensim",
    losses=("TRC has no place for expected errors, reprojection errors and the number of views; a .csv has them.",),
)
