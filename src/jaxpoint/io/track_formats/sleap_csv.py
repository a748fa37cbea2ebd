"""Keypoints of one camera in SLEAP's analysis CSV: `track,frame_idx,instance.score,nodeA.x,nodeA.y,nodeA.score,...`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxpoint.io.files import Row, read_table
from jaxpoint.io.track_formats.keypoint_cameras import CameraKeypoints, individual_of, keypoint_format
from jaxpoint.io.track_formats.track_format import TrackRequest

UNTRACKED = "untracked"  # what an instance without a track is called here


def is_sleap_csv(path: Path, head: str) -> bool:
    """Whether the header is SLEAP's."""
    return head.startswith("track,frame_idx,instance.score")


def read_sleap_csv(request: TrackRequest, path: Path) -> CameraKeypoints:
    """The keypoints of one file.

    Raises:
        FileFormatError: a value is missing or no number.
        UsageError: it holds several tracks, and none was chosen.
    """
    header = path.read_text("utf-8-sig").splitlines()[0].split(",")
    nodes = tuple(name.removesuffix(".x") for name in header if name.endswith(".x"))
    rows = read_table(path, ("track", "frame_idx", *(f"{node}.{axis}" for node in nodes for axis in "xy")))
    tracks = list(dict.fromkeys(_track(row) for row in rows))
    who = tracks[individual_of(request, path, tracks)]
    own = [row for row in rows if _track(row) == who]
    pixels = np.array([[_pixel(row, node, request.min_likelihood) for node in nodes] for row in own])
    return CameraKeypoints(nodes, np.array([row.integer("frame_idx") for row in own]), pixels)


def _track(row: Row) -> str:
    return row.values["track"] or UNTRACKED


def _pixel(row: Row, node: str, least: float | None) -> tuple[float, float]:
    x, y, score = (f"{node}.{what}" for what in ("x", "y", "score"))
    unsure = least is not None and not row.missing(score) and row.number(score) < least
    return (np.nan, np.nan) if unsure or row.missing(x) or row.missing(y) else (row.number(x), row.number(y))


FORMAT = keypoint_format("sleap-csv", "SLEAP's analysis CSV", is_sleap_csv, read_sleap_csv)
