"""One pair of images rectified, its disparities, depths and points."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxpoint.camera.rectification import Rectification
from jaxpoint.camera.remap import undistortion_map
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.stereo_matching import StereoSettings
from jaxpoint.detection.disparity import disparity_of

Image = UInt8[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class RectifiedPair:
    """Images blue, green, red; lengths in the unit of the rig."""

    left: Image
    right: Image
    disparity: Float[np.ndarray, "H W"]  # px; NaN in holes
    points: Float[np.ndarray, "H W 3"]  # in the left camera's own frame; NaN in holes
    depth: Float[np.ndarray, "H W"]  # along the rectified axis; NaN in holes
    covered: Bool[np.ndarray, "H W"]  # where the left image shows anything after rectification

    @property
    def filled(self) -> float:
        """Share of the covered pixels that have a disparity."""
        return float(np.isfinite(self.disparity[self.covered]).mean()) if self.covered.any() else 0.0


def maps_of(rig: CameraRig, rectification: Rectification) -> list[tuple[np.ndarray, np.ndarray]]:
    """The maps of `cv2.remap` for the left and the right image."""
    found = []
    for which in range(2):
        turn = rectification.rotations[which]
        x, y = undistortion_map(rig[which], rectification.size, rectification.intrinsics, turn)
        found.append((np.asarray(x), np.asarray(y)))
    return found


def rectify_pair(
    left: Image,
    right: Image,
    maps: list[tuple[np.ndarray, np.ndarray]],
    rectification: Rectification,
    settings: StereoSettings,
) -> RectifiedPair:
    """Rectify, match, and place in space."""
    flat_left, flat_right = (
        np.asarray(cv2.remap(image, *both, cv2.INTER_LINEAR)) for image, both in zip((left, right), maps)
    )
    height, width = left.shape[:2]
    covered = (maps[0][0] >= 0) & (maps[0][0] <= width - 1) & (maps[0][1] >= 0) & (maps[0][1] <= height - 1)
    disparity = np.where(covered, disparity_of(flat_left, flat_right, settings), np.nan)
    focal = rectification.intrinsics[0, 0]
    depth = focal * rectification.baseline / np.where(disparity > 0, disparity, np.nan)
    return RectifiedPair(flat_left, flat_right, disparity, rectification.points(disparity), depth, covered)
