"""What was seen of a marker, as tables, with a reason wherever it was not found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxpoint.body.marker_tips import MarkerTip, TipReason
from jaxpoint.detection.person.marker_regions import MarkerReason
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.evidence.marker_views import MarkerViews
from jaxpoint.io.session import Session

Pixel = Float[np.ndarray, "2"]  # x, y
SEEN_COLUMNS = (
    "frame", "time_s", "camera", "reason", "area_px", "x", "y", "tip_x", "tip_y", "base_x", "base_y", "counts",
)  # fmt: skip
TIP_COLUMNS = (
    "frame", "time_s", "reason", "views", "tip_x_m", "tip_y_m", "tip_z_m", "base_x_m", "base_y_m", "base_z_m",
    "spread_m", "direction_x", "direction_y", "direction_z", "sigma_deg",
)  # fmt: skip


def views_table(session: Session, markers: Sequence[MarkerViews], tips: Sequence[MarkerTip] | None) -> dict[str, list]:
    """Every frame of every camera: the marker, or why there is none.

    `counts` is 1 where the view is used for the marker in the room; where it is not, the largest place of the marker's
    colour is given.
    """
    lines = []
    for frame, (frame_id, time) in enumerate(zip(session.frame_ids.tolist(), session.times.tolist())):
        tip = None if tips is None else tips[frame]
        for camera, (name, own) in enumerate(zip(session.names, markers)):
            line = {"frame": frame_id, "time_s": time, "camera": name, "reason": why(own, frame)}
            ends = ends_of(own, frame, camera, tip)
            if ends is not None:
                line.update(_columns(own, camera, ends, tip))
            lines.append(line)
    return {column: [line.get(column) for line in lines] for column in SEEN_COLUMNS}


def room_table(session: Session, tips: Sequence[MarkerTip]) -> dict[str, list]:
    """Every frame: the marker in the room, or why it is not known."""
    lines = []
    for frame_id, time, tip in zip(session.frame_ids.tolist(), session.times.tolist(), tips):
        line: dict[str, Any] = {"frame": frame_id, "time_s": time, "reason": tip.reason.name.lower()}
        line["views"] = len(tip.members)
        if tip.found:
            line["spread_m"] = tip.spread
            line.update({f"tip_{axis}_m": float(tip.tip[i]) for i, axis in enumerate("xyz")})
            line.update({f"base_{axis}_m": float(tip.base[i]) for i, axis in enumerate("xyz")})
        if tip.reason == TipReason.FOUND:
            line["sigma_deg"] = float(np.degrees(tip.direction_sigma))
            line.update({f"direction_{axis}": float(tip.direction[i]) for i, axis in enumerate("xyz")})
        lines.append(line)
    return {column: [line.get(column) for line in lines] for column in TIP_COLUMNS}


def why(own: MarkerViews, frame: int) -> str:
    """In a word: `found`, or why a camera does not show the marker in a frame."""
    reason = FrameReason(int(own.reasons[frame]))
    if reason != FrameReason.PERSON:
        return reason.name.lower()
    return MarkerReason(int(own.markers[frame])).name.lower()


def ends_of(own: MarkerViews, frame: int, camera: int, tip: MarkerTip | None) -> tuple[int, Pixel, Pixel] | None:
    """Which place of a camera is the marker in a frame, its tip and its base, px; None where it shows none."""
    places = own.of(frame)
    if not len(places):
        return None
    place = places[0] if tip is None else tip.members.get(camera, places[0])
    far, near = own.tip[place], own.base[place]
    return (place, near, far) if tip is not None and camera in tip.flipped else (place, far, near)


def _columns(own: MarkerViews, camera: int, ends: tuple[int, Pixel, Pixel], tip: MarkerTip | None) -> dict[str, Any]:
    place, far, near = ends
    return {
        "area_px": int(own.area[place]),
        "x": float(own.centroid[place, 0]),
        "y": float(own.centroid[place, 1]),
        "tip_x": float(far[0]),
        "tip_y": float(far[1]),
        "base_x": float(near[0]),
        "base_y": float(near[1]),
        "counts": None if tip is None else int(camera in tip.members),
    }
