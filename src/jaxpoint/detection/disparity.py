"""Disparities of a rectified pair of images by OpenCV's semi-global matching, checked from both sides."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.config.stereo_matching import StereoSettings

SCALE, UNIQUENESS, SPECKLE_SIZE, SPECKLE_RANGE = 16.0, 10, 100, 2


def sgbm_disparity(
    left: UInt8[np.ndarray, "H W 3"], right: UInt8[np.ndarray, "H W 3"], settings: StereoSettings
) -> Float[np.ndarray, "H W"]:
    """Disparities of the left image as OpenCV gives them, px; NaN where it gives none."""
    found = _matcher(left.shape[1], settings).compute(left, right).astype(np.float32) / SCALE
    return np.where(found > 0, found, np.nan)


def disparity_of(
    left: UInt8[np.ndarray, "H W 3"], right: UInt8[np.ndarray, "H W 3"], settings: StereoSettings
) -> Float[np.ndarray, "H W"]:
    """Disparities of the left image that the right image's do not deny, px; NaN in holes.

    What one image shows and the other does not (occlusions) is matched to something all the same; the right image's
    own disparities do not come back to it. OpenCV leaves out the columns at the left for which the largest disparity
    ends outside; the images are widened, so that far things are matched there too.
    """
    wide = disparities_of(left.shape[1], settings)
    wider = replace(settings, disparities=wide)
    left, right = (cv2.copyMakeBorder(one, 0, 0, wide, wide, cv2.BORDER_REPLICATE) for one in (left, right))
    found = sgbm_disparity(left, right, wider)[:, wide:-wide]
    flipped_right, flipped_left = (np.ascontiguousarray(image[:, ::-1]) for image in (right, left))
    back = sgbm_disparity(flipped_right, flipped_left, wider)[:, ::-1][:, wide:-wide]
    rows, columns = np.indices(found.shape)
    there = np.rint(columns - np.nan_to_num(found)).astype(int)
    inside = there >= 0
    other = back[rows, np.where(inside, there, 0)]
    denied = np.abs(other - found) > settings.agree_px  # False where the right image's own disparity is unknown
    return np.where(inside & ~denied, found, np.nan)


def _matcher(width: int, settings: StereoSettings) -> cv2.StereoSGBM:
    count, block = disparities_of(width, settings), settings.block
    return cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=block,
        P1=8 * 3 * block**2,
        P2=32 * 3 * block**2,
        disp12MaxDiff=1,
        uniquenessRatio=UNIQUENESS,
        speckleWindowSize=SPECKLE_SIZE,
        speckleRange=SPECKLE_RANGE,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )


def disparities_of(width: int, settings: StereoSettings) -> int:
    """The number of disparities that are tried, a multiple of 16."""
    return max(16 * -(-(settings.disparities or width // 4) // 16), 16)
