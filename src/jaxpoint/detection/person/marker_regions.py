"""A coloured marker on the pointing finger (thesis 6.3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxpoint.config.person import MarkerSettings
from jaxpoint.detection.colour import Image, is_grey
from jaxpoint.detection.person.endpoints import Endpoints
from jaxpoint.detection.person.silhouette import Silhouette
from jaxpoint.detection.region import Region, label_regions
from jaxpoint.errors import InsufficientDataError

LEVELS = np.arange(256.0)
BAR = np.sqrt(12) / 4  # length of a bar over the major axis of the ellipse with its second moments
DEVIATION_OF_MEDIAN = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
WIDEST = 2  # times the fixed gates, that learnt ones reach
CIRCLE = 180  # OpenCV's hues of 8-bit images


class MarkerReason(IntEnum):
    """Why a silhouette gave a marker, or gave none."""

    FOUND = 0
    GREY = 1  # the image has no colour
    NO_COLOUR = 2  # no pixel of the person has the marker's
    TOO_SMALL = 3  # what has it is no larger than noise


@dataclass(frozen=True)
class MarkerModel:
    """Colour of a marker: hue of 180, saturation and value of 255, and how far a pixel may lie from each."""

    hue: float
    saturation: float
    value: float
    hue_gate: float
    saturation_gate: float
    value_gate: float


@dataclass(frozen=True)
class Markers:
    """Regions of the marker's colour in a silhouette, in the whole image, the largest first."""

    regions: tuple[Region, ...]
    reason: MarkerReason  # why there are none, or FOUND


def train_marker(bgr_pixels: UInt8[np.ndarray, "N 3"], settings: MarkerSettings) -> MarkerModel:
    """The marker's colour from pixels picked on it; the hue is averaged on the circle.

    Raises:
        InsufficientDataError: fewer than `min_pixels`, or hardly any saturation: a grey marker has no hue.
    """
    if len(bgr_pixels) < settings.min_pixels:
        raise InsufficientDataError(
            f"A marker's colour is learnt from at least {settings.min_pixels} pixels, and {len(bgr_pixels)} were "
            "picked; pick more of them, in several images."
        )
    hue, saturation, value = cv2.cvtColor(bgr_pixels[None], cv2.COLOR_BGR2HSV)[0].astype(float).T
    if np.median(saturation) < settings.min_saturation:
        raise InsufficientDataError(
            f"The picked pixels have a median saturation of {np.median(saturation):.0f} of 255, below "
            f"{settings.min_saturation:.0f}, so that their hue is noise; use a marker of a strong colour."
        )
    # A click beside the marker, or on its edge, must neither move the middle nor open the gates.
    nearest = np.argmin([np.median(_hue_distance(hue, float(level))) for level in range(CIRCLE)])
    kept = _hue_distance(hue, float(nearest)) <= 2 * settings.hue_gate
    hue, saturation, value = hue[kept], saturation[kept], value[kept]
    middle = np.array([_mean_hue(hue), np.median(saturation), np.median(value)])
    off = (_hue_distance(hue, middle[0]), np.abs(saturation - middle[1]), np.abs(value - middle[2]))
    spreads = DEVIATION_OF_MEDIAN * np.median(off, axis=1)
    fixed = _fixed(settings)
    learnt = np.clip(settings.deviations * spreads, fixed / 2, WIDEST * fixed)
    gates = learnt if settings.gates == "sigma" else fixed
    return MarkerModel(*middle.tolist(), *gates.tolist())


def is_mixture(model: MarkerModel, settings: MarkerSettings) -> bool:
    """Whether the pixels that taught a marker differ so much that all learnt gates are as wide as they go."""
    gates = np.array([model.hue_gate, model.saturation_gate, model.value_gate])
    return settings.gates == "sigma" and bool((gates >= WIDEST * _fixed(settings)).all())


def find_markers(image: Image, silhouette: Silhouette, model: MarkerModel, settings: MarkerSettings) -> Markers:
    """The largest regions of the marker's colour in a silhouette or close to it.

    The thesis also asks for a shape and takes the farthest region (`thesis_finger`); a marker that points at the camera
    or at the floor has another one. All views together decide which region is the marker.
    """
    if is_grey(image):
        return Markers((), MarkerReason.GREY)
    reach = settings.reach_px
    x, y, width, height = silhouette.box
    left, top = max(x - reach, 0), max(y - reach, 0)
    part = image[top : y + height + reach, left : x + width + reach]
    near = np.zeros(part.shape[:2], dtype=np.uint8)
    near[y - top : y - top + height, x - left : x - left + width] = silhouette.mask
    near = cv2.dilate(near, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    mask = marker_mask(np.ascontiguousarray(part), model) & near
    if not mask.any():
        return Markers((), MarkerReason.NO_COLOUR)
    _, regions = label_regions(mask, min_area=settings.min_area_px + 1)
    if not regions:
        return Markers((), MarkerReason.TOO_SMALL)
    return Markers(tuple(region.shift(left, top) for region in regions[: settings.candidates]), MarkerReason.FOUND)


def marker_ends(region: Region, silhouette_centroid: Float[np.ndarray, "2"]) -> Endpoints:
    """The ends of a marker on its principal axis, to a fraction of a pixel; the tip is the far end from the person.

    A marker holds a few dozen pixels, too few for slices: its length is that of the bar with the same second moments,
    which every pixel determines and not the outermost alone.
    """
    half = BAR * region.major / 2 * np.array([np.cos(region.orientation), -np.sin(region.orientation)])
    near, far = sorted(
        (region.centroid - half, region.centroid + half), key=lambda end: float(np.hypot(*(end - silhouette_centroid)))
    )
    return Endpoints(far, near)


def marker_mask(image: Image, model: MarkerModel) -> Bool[np.ndarray, "H W"]:
    """Pixels of the marker's colour."""
    near = np.stack(
        [
            _hue_distance(LEVELS, model.hue) <= model.hue_gate,
            np.abs(LEVELS - model.saturation) <= model.saturation_gate,
            np.abs(LEVELS - model.value) <= model.value_gate,
        ],
        axis=-1,
    )
    passed = cv2.LUT(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), near.view(np.uint8)[None])
    hue, saturation, value = cv2.split(passed)
    return cv2.bitwise_and(hue, cv2.bitwise_and(saturation, value)) > 0


def _fixed(settings: MarkerSettings) -> Float[np.ndarray, "3"]:
    return np.array([settings.hue_gate, settings.saturation_gate, settings.value_gate])


def _mean_hue(hues: Float[np.ndarray, " N"]) -> float:
    angles = hues * (2 * np.pi / CIRCLE)
    return float(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()) * CIRCLE / (2 * np.pi) % CIRCLE)


def _hue_distance(hues: Float[np.ndarray, " N"], middle: float) -> Float[np.ndarray, " N"]:
    return np.abs((hues - middle + CIRCLE / 2) % CIRCLE - CIRCLE / 2)
