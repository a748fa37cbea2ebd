"""What holds the scale and the frame of a rig beside its own observations: sizes of targets, and known points."""

from __future__ import annotations

import numpy as np

from jaxpoint.calibration.recording import Recording, RigState
from jaxpoint.calibration.result import FrameHold


def hold_of(recording: Recording, state: RigState) -> FrameHold | None:
    """None where nothing does, and a similarity is open."""
    if state.anchored:
        return FrameHold(open_freedoms=0, scale_sigma=0.0)
    if not state.poses:
        return None
    sizes = [owned.target.size_sigma for owned in recording.targets]
    return FrameHold(open_freedoms=6, scale_sigma=max((size for size in sizes if np.isfinite(size)), default=0.0))


def is_metric(recording: Recording, state: RigState) -> bool:
    """Whether lengths come out in metres."""
    measured = any(np.isfinite(owned.target.size_sigma) for owned in recording.targets)
    return state.anchored or (bool(state.poses) and measured)
