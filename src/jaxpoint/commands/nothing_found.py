"""What to say where a session's images showed nothing: why, for most of them, and what helps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jaxpoint.errors import InsufficientDataError

if TYPE_CHECKING:
    from jaxpoint.config.track import TrackSettings
    from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence
    from jaxpoint.io.session import Session

_FAINT = (
    "A lower --background.threshold finds people coloured like the room; a recording of the empty room (empty/) "
    "those who never leave."
)
_STILL = (
    "See whether these are the right videos; a lower --motion.deviations and --motion.floor-px notice less movement."
)
REMEDIES = {
    "no_image": "See whether timestamps.csv belongs to these videos, and whether they are whole.",
    "repeated": "Export the videos anew, each frame once.",
    "too_dark": "Record in more light, or with a longer exposure.",
    "blown_out": "Record in less light, or with a shorter exposure.",
    "light_switched": "Record in light that stays as it is.",
    "idle": _STILL,
    "nobody": _FAINT,
    "without_colour": "Record the empty room and the people in one mode of the cameras.",
}
"""Against each `FrameReason` but that of a person."""
OF_THIS_ROOM = (
    "See whether the cameras' names and the calibration (in m) belong to these videos, and whether their clocks are in "
    "step and their times right."
)
"""What to look for where views show something that is nowhere in the room."""


def commonest(cameras: Sequence[Mapping[str, Any]], otherwise: str = "") -> str:
    """The commonest reason of all frames, and its remedy; `otherwise` is that of a reason not known here."""
    reasons = sum((Counter(camera["reasons"]) for camera in cameras), Counter())
    if not reasons:
        return f"though none of them says why. {otherwise}".rstrip()
    (reason, count), *_ = reasons.most_common(1)
    frames = sum(camera["frames"] for camera in cameras)
    return f"most often '{reason}' ({count} of {frames}). {REMEDIES.get(reason, otherwise)}"


def nobody_followed(heads: Sequence[int], settings: TrackSettings, remedy: str) -> InsufficientDataError:
    """The error where cameras see so many heads each and no head could be followed in the room."""
    agreed, of = settings.confirm
    return InsufficientDataError(
        f"Nobody could be followed in the room: {sum(heads)} heads were seen by {sum(map(bool, heads))} of {len(heads)}"
        f" cameras, and two must agree on one in {agreed} of {of} frames. {remedy}"
    )


def remedy_of_heights(session: Session, views: Sequence[AbstractCameraEvidence], settings: TrackSettings) -> str:
    """What the height of the heads says of unit and axes, else what to look for."""
    from jaxpoint.body.head_heights import head_height, height_remedy

    assert session.rig is not None
    height = head_height(session.rig, views, len(session.frame_ids))
    return height_remedy(height, *settings.height_m) or OF_THIS_ROOM
