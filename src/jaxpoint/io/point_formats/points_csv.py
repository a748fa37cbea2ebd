"""Points in a table: `frame,time_s,point,x_m,y_m,z_m,sigma_m,rms_px,cameras`, a line for each point that there is."""

from __future__ import annotations

import csv
import io

import numpy as np

from jaxpoint.geometry.world_axes import PER_METRE
from jaxpoint.io.point_formats.point_series import PointFormat, PointSeries
from jaxpoint.io.table import DIGITS


def points_table(series: PointSeries) -> bytes:
    """The table, in the unit of its world, which the names of the columns say."""
    unit = series.world.unit
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        ["frame", "time_s", "point", *(f"{axis}_{unit}" for axis in "xyz"), f"sigma_{unit}", "rms_px", "cameras"]
    )
    for frame, point in np.argwhere(series.present).tolist():
        number = int(series.frame_ids[frame])
        time = "" if series.rate_hz is None else f"{number / series.rate_hz:.{DIGITS}g}"
        lengths = PER_METRE[unit] * np.append(series.points[frame, point], series.sigmas_m[frame, point])
        cells = [f"{value:.{DIGITS}g}" for value in (*lengths, series.rms_px[frame, point])]
        rows.writerow([number, time, series.names[point], *cells, int(series.cameras[frame, point])])
    return text.getvalue().encode()


FORMAT = PointFormat(".csv", "A table", points_table)
