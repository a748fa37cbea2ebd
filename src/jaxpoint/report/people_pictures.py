"""Frames of a session as pictures: what was found, drawn into every camera's image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.body.arm import ArmReason, PointingArm
from jaxpoint.body.following import Following
from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence, FrameReason
from jaxpoint.evidence.limb_slices import Pixel
from jaxpoint.io.session import Session
from jaxpoint.report.contact_sheet import PersonView, contact_sheet

MOMENTS = 6  # shown


def sheets(
    session: Session, views: Sequence[AbstractCameraEvidence], following: Following | None
) -> list[tuple[str, UInt8[np.ndarray, "H W 3"]]]:
    """A caption and a sheet of all cameras (red, green, blue) for a few telling frames."""
    chosen = telling_moments(views, following)
    images = [images_of(session, camera, chosen) for camera in range(len(session.names))]
    pictures = []
    for place, frame in enumerate(chosen):
        cells = [
            _view(session, view, following, camera, frame, image)
            for camera, view in enumerate(views)
            if (image := images[camera][place]) is not None
        ]
        if cells:
            sheet = contact_sheet(cells, columns=3, zoom=following is not None)
            pictures.append((_caption(session, following, frame), sheet[..., ::-1]))
    return pictures


def telling_moments(
    views: Sequence[AbstractCameraEvidence], following: Following | None, count: int = MOMENTS
) -> list[int]:
    """Frames with an arm stretched out far, well apart from each other; without arms, those seen by most cameras."""
    worth = np.sum([view.reasons == FrameReason.PERSON for view in views], axis=0).astype(float)
    if following is not None:
        for (frame, _), arm in following.arms.items():
            worth[frame] += 0.0 if arm is None else 10.0 * arm.stretch
    return well_apart(worth, count)


def well_apart(worth: Float[np.ndarray, " F"], count: int = MOMENTS) -> list[int]:
    """The frames that are worth most, and anything, well apart from each other; in their order."""
    frames = len(worth)
    chosen: list[int] = []
    apart = max(1, frames // (2 * count))
    for frame in np.argsort(-worth, kind="stable"):
        if worth[frame] > 0 and all(abs(frame - other) >= apart for other in chosen):
            chosen.append(int(frame))
        if len(chosen) == count:
            break
    return sorted(chosen)


def images_of(session: Session, camera: int, frames: Sequence[int]) -> list[np.ndarray | None]:
    """One camera's images of some frames; None where it has none."""
    found = dict(session.images(camera, frames))
    return [found.get(frame) for frame in frames]


def _caption(session: Session, following: Following | None, frame: int) -> str:
    text = f"Frame {session.frame_ids[frame]}, {session.times[frame]:.2f} s"
    if following is None:
        return text
    people = following.tracking.heads.people
    arms = [(people[who], arm) for (at, who), arm in following.arms.items() if at == frame and arm is not None]
    found = [
        f"person {number}: arm measured in {arm.views_used} views, {arm.stretch:.2f} m out" for number, arm in arms
    ]
    return "; ".join([text, *found])


def _view(
    session: Session,
    view: AbstractCameraEvidence,
    following: Following | None,
    camera: int,
    frame: int,
    image: np.ndarray,
) -> PersonView:
    own = view.of(frame)
    masks, heads = [], []
    for sighting in own:
        if (mask := _mask(view, sighting)) is not None:
            masks.append(mask)
        if view.head_found[sighting]:
            heads.append((*view.head[sighting].tolist(), float(view.head_height[sighting])))
    title = f"{session.names[camera]}, {session.frame_ids[frame]}"
    reason = FrameReason(int(view.reasons[frame]))
    text = "" if reason == FrameReason.PERSON else reason.name.lower().replace("_", " ")
    arm = _arm_of(following, frame)
    if arm is None:
        return PersonView(image, title, masks, heads, reason=text)
    seen = arm.views[camera]
    if seen.reason != ArmReason.FOUND:
        return PersonView(image, title, masks, heads, reason=text or f"arm {seen.reason.name.lower()}")
    tip, base = tuple(seen.tip.tolist()), tuple(seen.base.tolist())
    return PersonView(image, title, masks, heads, axis=(base, tip), tip=tip, base=base, reason=text)


def _arm_of(following: Following | None, frame: int) -> PointingArm | None:
    """The arm of the person who stretches it out farthest in a frame."""
    if following is None:
        return None
    arms = [arm for (at, _), arm in following.arms.items() if at == frame and arm is not None]
    return max(arms, key=lambda arm: arm.stretch, default=None)


def _mask(view: AbstractCameraEvidence, sighting: int) -> np.ndarray | None:
    """The pixels of a person in the whole image; None where its outline is unknown."""
    found = view.labels(sighting)
    if found is None:
        return None
    labels, (x, y) = found
    mask = np.zeros((view.size[1], view.size[0]), bool)
    mask[y : y + labels.shape[0], x : x + labels.shape[1]] = labels != Pixel.NOTHING
    return mask
