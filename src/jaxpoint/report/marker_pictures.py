"""A marker through a session, for its page: the tip in the room, and pictures of it in every view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8

from jaxpoint.body.marker_tips import MarkerTip, TipReason
from jaxpoint.evidence.marker_views import MarkerViews
from jaxpoint.io.session import Session
from jaxpoint.report.contact_sheet import PersonView, contact_sheet
from jaxpoint.report.figures_marker import TipTrack
from jaxpoint.report.marker_tables import ends_of, why
from jaxpoint.report.people_pictures import images_of, well_apart

AROUND = 0.16  # of the image's width, the part around the marker that is shown


def track_of(session: Session, tips: Sequence[MarkerTip]) -> TipTrack:
    """The tip over time."""
    return TipTrack(
        session.times,
        np.array([tip.found for tip in tips], bool),
        np.array([tip.tip for tip in tips]).reshape(-1, 3),
        np.array([tip.direction for tip in tips]).reshape(-1, 3),
        np.array([tip.spread for tip in tips], float),
    )


def marker_sheets(
    session: Session, markers: Sequence[MarkerViews], tips: Sequence[MarkerTip] | None
) -> list[tuple[str, UInt8[np.ndarray, "H W 3"]]]:
    """A caption and a sheet of all cameras (red, green, blue) for the frames that most views show."""
    chosen = well_apart(_worth(markers, tips))
    images = [images_of(session, camera, chosen) for camera in range(len(session.names))]
    pictures = []
    for place, frame in enumerate(chosen):
        tip = None if tips is None else tips[frame]
        cells = [
            _view(session, own, camera, frame, image, tip)
            for camera, own in enumerate(markers)
            if (image := images[camera][place]) is not None
        ]
        if cells:
            pictures.append((_caption(session, frame, tip), contact_sheet(cells, columns=3)[..., ::-1]))
    return pictures


def _worth(markers: Sequence[MarkerViews], tips: Sequence[MarkerTip] | None) -> np.ndarray:
    """Of every frame: how many views show the marker, those that agree on it in the room first."""
    shown = np.array([[len(own.of(frame)) > 0 for frame in range(len(own.reasons))] for own in markers]).sum(axis=0)
    agree = 0 if tips is None else 100 * np.array([len(tip.members) for tip in tips])
    return (shown + agree).astype(float)


def _caption(session: Session, frame: int, tip: MarkerTip | None) -> str:
    text = f"Frame {session.frame_ids[frame]}, {session.times[frame]:.2f} s"
    if tip is None:
        return text
    if not tip.found:
        return f"{text}; no tip in the room: {tip.reason.name.lower().replace('_', ' ')}"
    place = ", ".join(f"{value:.3f}" for value in tip.tip)
    found = f"{text}; tip at {place} m in {len(tip.members)} views, {100 * tip.spread:.1f} cm apart"
    return found if tip.reason == TipReason.FOUND else f"{found}; no direction"


def _view(
    session: Session, own: MarkerViews, camera: int, frame: int, image: np.ndarray, tip: MarkerTip | None
) -> PersonView:
    title = f"{session.names[camera]}, {session.frame_ids[frame]}"
    ends = ends_of(own, frame, camera, tip)
    if ends is None:
        return PersonView(image, title, reason=why(own, frame).replace("_", " "))
    place, far, near = ends
    part, corner = _around(image, own.centroid[place])
    end, base = (tuple((pixel - corner).tolist()) for pixel in (far, near))
    reason = "" if tip is None or camera in tip.members else "does not count in the room"
    return PersonView(part, title, axis=(base, end), tip=end, base=base, reason=reason)


def _around(image: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of an image around a pixel, and its corner (x, y)."""
    whole = np.array(image.shape[1::-1])
    size = np.maximum(np.round(AROUND * whole), 1).astype(int)
    corner = np.clip(np.round(middle - size / 2).astype(int), 0, whole - size)
    (x, y), (width, height) = corner, size
    return image[y : y + height, x : x + width], corner
