"""One frame: is there exactly one small light, and at which pixel? (thesis 5.3.1)"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from jaxpoint.config import LedSettings

NOTHING = 2.0  # grey levels: rounding and compression make as much
MIN_ECCENTRICITY_AREA = 6  # px; the shape of fewer pixels is noise
GLINT_RATIO = 0.5  # a second blob with less than this part of the largest one's light is its reflection


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
    AT_BORDER = 8  # brightest in the outermost pixels of the image: part of it is outside


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
    mask = (difference > settings.threshold_fraction * peak).astype(np.uint8)
    if cv2.countNonZero(mask) > np.pi * (3 * settings.led_radius_px) ** 2:
        return Blob(x, y, peak, Reason.TOO_LARGE)
    if peak < settings.min_deviations * deviation[y, x]:
        return Blob(x, y, peak, Reason.WEAK)
    left, top, width, height = cv2.boundingRect(mask)
    box = np.s_[top : top + height, left : left + width]
    blobs, labels = cv2.connectedComponents(mask[box], connectivity=8)
    reason = Reason.FOUND
    if blobs > 2:  # the first label is the rest of the image
        winner = _dominant(difference[box], labels, settings.led_radius_px) if robust else None
        if winner is None:
            reason = Reason.SEVERAL
        else:
            x, y = left + winner[0], top + winner[1]
    elif not robust and _eccentricity(mask[box]) > settings.max_eccentricity:
        reason = Reason.BLURRED
    rows, columns = difference.shape
    if reason == Reason.FOUND and (x in (0, columns - 1) or y in (0, rows - 1)):
        reason = Reason.AT_BORDER
    return Blob(x, y, float(difference[y, x]), reason)


def _dominant(difference: Float32[np.ndarray, "h w"], labels: np.ndarray, led_radius: float) -> tuple[int, int] | None:
    """Brightest pixel (x, y) of the place that holds most of the light, None where two places are alike."""
    remaining = np.where(labels > 0, difference, np.float32(0))
    rows, columns = np.ogrid[: labels.shape[0], : labels.shape[1]]
    places: list[tuple[float, int, int]] = []
    while len(places) < 8:
        y, x = np.unravel_index(int(np.argmax(remaining)), remaining.shape)
        if remaining[y, x] <= 0:
            break
        disc = np.square(rows - y) + np.square(columns - x) <= (2 * led_radius) ** 2
        places.append((float(difference[disc].sum()), int(x), int(y)))
        joined = np.unique(labels[disc & (labels > 0)])
        remaining[np.isin(labels, joined)] = 0
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
