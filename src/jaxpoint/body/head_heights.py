"""Why nobody could be followed in the room: at which height the heads come out, and which unit or axis that shows."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence
from jaxpoint.triangulation import triangulate

ENOUGH = 5  # fewest heads whose height is used
AGREED_PX = 20.0  # by which two views of one head may miss each other
UNITS = {"cm": 100.0, "mm": 1000.0}  # in a metre


def head_height(rig: CameraRig, views: Sequence[AbstractCameraEvidence], frames: int) -> float | None:
    """Median height (in the rig's unit) of heads that were the only ones in two images or more; None where too few."""
    pixels = np.zeros((frames, len(views), 2))
    seen = np.zeros((frames, len(views)), bool)
    for camera, view in enumerate(views):
        found = view.head_found
        alone = found & (np.bincount(view.frame[found], minlength=frames)[view.frame] == 1)
        pixels[view.frame[alone], camera], seen[view.frame[alone], camera] = view.head[alone], True
    with jax.enable_x64(True):
        result = triangulate(rig, pixels, seen, covariance=False)
    good = np.asarray(result.valid) & (np.asarray(result.rms) < AGREED_PX)
    return float(np.median(np.asarray(result.points)[good, 2])) if good.sum() >= ENOUGH else None


def height_remedy(height: float | None, low: float, high: float) -> str:
    """What a height of heads outside `low` to `high` (m) means for the calibration; nothing where it lies between."""
    if height is None or low <= height <= high:
        return ""
    where = f"The heads come out at {height:.3g} m (z), where people have {low:g} to {high:g} m"
    for unit, many in UNITS.items():
        if low <= abs(height) / many <= high:
            return f"{where}: the calibration is in {unit}, so give --unit {unit} or bring it into metres by `align`."
    if low <= -height <= high:
        return f"{where}: z points down; turn the room about x by 180 degrees, (x, y, z) -> (x, -y, -z), in `align`."
    return f"{where}: see that the calibration is in metres, z points up, and z = 0 is the floor."
