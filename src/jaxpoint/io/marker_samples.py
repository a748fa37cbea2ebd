"""Where a marker was picked in images: `samples.csv`, by which its colour is learnt.

Columns `camera,frame,x,y` and, if wanted, `radius_px`: the camera's name, the number of the frame in the session, the
pixel ((0, 0) is the centre of the top-left one), and how far around it all pixels lie on the marker.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.io.files import Row, StrPath, read_table
from jaxpoint.io.session import Session


@dataclass(frozen=True)
class MarkerSample:
    """A disc of pixels on the marker."""

    camera: int  # place among the session's
    frame: int  # place among the session's
    x: float  # px
    y: float  # px
    radius_px: float


def read_marker_samples(path: StrPath, session: Session, radius_px: float) -> list[MarkerSample]:
    """The samples in a file.

    Args:
        path: the file.
        session: in whose images they were picked.
        radius_px: where the file does not say it.

    Raises:
        FileFormatError: a missing column or value, an unknown camera, a frame of which the camera has no image, a
            place outside of the image, or a disc that is larger than it.
    """
    return [_sample(row, session, radius_px) for row in read_table(path, ("camera", "frame", "x", "y"))]


def _sample(row: Row, session: Session, radius_px: float) -> MarkerSample:
    camera = row.camera(session.names)
    frame = row.integer("frame")
    found = np.flatnonzero(session.frame_ids == frame)
    if not len(found) or session.frame_index[found[0], camera] < 0:
        raise row.error(
            f"camera '{session.names[camera]}' has no image of frame {frame}; the session's frames go from "
            f"{session.frame_ids.min()} to {session.frame_ids.max()}."
        )
    x, y = row.number("x"), row.number("y")
    width, height = session.sizes[camera].tolist()
    if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        raise row.error(
            f"({x:g}, {y:g}) lies outside the image of camera '{session.names[camera]}', which has {width} x {height} "
            "px; pick the marker inside it."
        )
    radius = radius_px if row.missing("radius_px") else row.number("radius_px")
    if radius < 0:
        raise row.error(f"column 'radius_px' is {radius:g}; give 0 or more.")
    if 2 * radius > min(width, height):
        raise row.error(
            f"a disc of {radius:g} px radius is larger than the image of camera '{session.names[camera]}', which has "
            f"{width} x {height} px; give how far around the pixel all is marker."
        )
    return MarkerSample(camera, int(found[0]), x, y, radius)
