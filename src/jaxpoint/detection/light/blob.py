"""One frame: is there exactly one small light, and at which pixel? (thesis 5.3.1)"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from jaxpoint.config import LedSettings

NOTHING = 2.0  # grey levels: rounding and compression make as much
MIN_ECCENTRICITY_AREA = 6  # px; the shape of fewer pixels is noise
COMPETITOR_FRACTION = 0.5  # of the peak: what is fainter cannot be confused with the light
GLINT_RATIO = 0.5  # a second place with less than this part of the first one's light is its reflection
MAX_PLACES = 8


class Reason(IntEnum):
    """Why a frame of a camera gave a position, or gave none."""

    FOUND = 0
    NO_IMAGE = 1  # the camera has no image with this frame number
    DARK = 2  # nothing is brighter than the background
    TOO_LARGE = 3  # (a) far more pixels are bright than the light can cover
    WEAK = 4  # (b) the brightest place does not stand out of the background's variation
    SEVERAL = 5  # (c) more than one bright place
    BLURRED = 6  # (d) elongated: the light moved during the exposure
    UNLIKE = 7  # not the round spot that the light of this recording makes
    AT_BORDER = 8  # brightest in the outermost pixels of the image or beside a mask: part of it is outside
    BETWEEN = 9  # of a camera of another rate: not seen both before and after the time of the row


@dataclass(frozen=True)
class Blob:
    """The brightest place of a frame, and whether it can be the light."""

    x: int  # px
    y: int  # px
    peak: float  # grey levels above the background
    reason: Reason


def find_blob(
    difference: Float32[np.ndarray, "H W"], deviation: Float32[np.ndarray, "H W"], settings: LedSettings
) -> Blob:
    """The brightest blob of a frame; its `reason` is FOUND where it is the only one and of the right kind.

    Args:
        difference: grey levels above the background, 0 where below.
        deviation: the background's standard deviation, at least 1.
        settings: radius of the light, thresholds and method. `thesis` tests the mask literally. `robust` looks only
            where the difference is significant, joins blobs within two radii of the brightest pixel (JPEG noise splits
            a flat top), lets a blob that holds most of the light win over its reflections, and leaves the shape to the
            Gaussian fit, which sees more pixels.
    """
    robust = settings.method == "robust"
    _, peak, _, (x, y) = cv2.minMaxLoc(difference)
    if peak < NOTHING:
        return Blob(x, y, peak, Reason.DARK)
    if robust:
        significant = difference >= settings.min_deviations * deviation
        if not significant.any():
            return Blob(x, y, peak, Reason.WEAK)
        difference = np.where(significant, difference, np.float32(0))
        _, peak, _, (x, y) = cv2.minMaxLoc(difference)
    mask = difference > settings.threshold_fraction * peak
    if np.count_nonzero(mask) > np.pi * (3 * settings.led_radius_px) ** 2:
        return Blob(x, y, peak, Reason.TOO_LARGE)
    if peak < settings.min_deviations * deviation[y, x]:
        return Blob(x, y, peak, Reason.WEAK)
    if robust:
        winner = _dominant(difference, peak, settings)
        reason = Reason.SEVERAL if winner is None else Reason.FOUND
        x, y = winner or (x, y)
    else:
        reason = _classify_mask(mask, settings)
    rows, columns = difference.shape
    if reason == Reason.FOUND and (x in (0, columns - 1) or y in (0, rows - 1)):
        reason = Reason.AT_BORDER
    return Blob(x, y, float(difference[y, x]), reason)


def _classify_mask(mask: Bool[np.ndarray, "H W"], settings: LedSettings) -> Reason:
    """The thesis's tests (c) and (d)."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    box = mask[top : top + height, left : left + width].astype(np.uint8)
    labels, _ = cv2.connectedComponents(box, connectivity=8)
    if labels > 2:  # the first label is what is not in the mask
        return Reason.SEVERAL
    return Reason.BLURRED if _eccentricity(box) > settings.max_eccentricity else Reason.FOUND


def _dominant(difference: Float32[np.ndarray, "H W"], peak: float, settings: LedSettings) -> tuple[int, int] | None:
    """Brightest pixel (x, y) of the place that holds most of the light, None where two places are alike.

    Places are what is above half the peak, joined within two radii; only there are reflections and other lights, or the
    texture of a person while the light is hidden, bright enough to be confused with it.
    """
    mask = difference > min(COMPETITOR_FRACTION, settings.threshold_fraction) * peak
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    rows, columns = np.nonzero(mask)
    light, label = difference[rows, columns], labels[rows, columns]
    left = np.ones(len(light), dtype=bool)
    places: list[tuple[float, int, int]] = []
    while left.any() and len(places) < MAX_PLACES:
        best = int(np.argmax(np.where(left, light, 0)))
        x, y = int(columns[best]), int(rows[best])
        near = (columns - x) ** 2 + (rows - y) ** 2 <= (2 * settings.led_radius_px) ** 2
        places.append((float(light[near].sum()), x, y))
        left &= ~np.isin(label, label[near])
    places.sort(reverse=True)
    if len(places) > 1 and places[1][0] > GLINT_RATIO * places[0][0]:
        return None
    return places[0][1:]


def _eccentricity(mask: UInt8[np.ndarray, "h w"]) -> float:
    """sqrt(1 - (b/a)^2) of the ellipse with the mask's second moments (Matlab's), 0 below 6 px."""
    rows, columns = np.nonzero(mask)
    if len(rows) < MIN_ECCENTRICITY_AREA:
        return 0.0
    moments = np.cov(np.stack([columns, rows]), bias=True) + np.eye(2) / 12
    small, large = np.linalg.eigvalsh(moments)
    return float(np.sqrt(1.0 - small / large))
