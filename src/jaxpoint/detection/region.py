"""Shape of a region of pixels, by Matlab's definitions (thesis 6.2.2, 6.3.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int32, UInt8

PIXEL_MOMENT = 1 / 12  # px^2, second moment of a square pixel about its own centre

Mask = Bool[np.ndarray, "H W"] | UInt8[np.ndarray, "H W"]  # what is not 0 belongs to it


@dataclass(frozen=True)
class Region:
    """A region, and the ellipse with the same second moments, as Matlab's `regionprops` has them."""

    area: int  # px
    centroid: Float[np.ndarray, "2"]  # px (x, y)
    major: float  # px, length of the whole axis
    minor: float  # px
    eccentricity: float  # 0 a circle, 1 a line
    orientation: float  # rad in (-pi/2, pi/2], counter-clockwise with y up
    box: tuple[int, int, int, int]  # px: left, top, width, height
    label: int  # its value in the image of labels

    @property
    def ratio(self) -> float:
        """Major over minor axis."""
        return self.major / self.minor

    def shift(self, x: int, y: int) -> Region:
        """The same region in an image whose origin lies (x, y) px farther to the left and up."""
        left, top, width, height = self.box
        return replace(self, centroid=self.centroid + np.array([x, y]), box=(left + x, top + y, width, height))

    def crop(self, labels: Int32[np.ndarray, "H W"]) -> Bool[np.ndarray, "h w"]:
        """Its own mask, of the size of its box."""
        x, y, width, height = self.box
        return labels[y : y + height, x : x + width] == self.label


def label_regions(mask: Mask, min_area: int = 1) -> tuple[Int32[np.ndarray, "H W"], list[Region]]:
    """The 8-connected regions of at least `min_area` pixels, the largest first, and the image of labels."""
    pixels = _bytes(mask)
    labels = np.zeros(pixels.shape, dtype=np.int32)
    x, y, width, height = cv2.boundingRect(pixels)
    if not width:
        return labels, []
    part = np.s_[y : y + height, x : x + width]  # the rest would cost as much as the regions
    _, labels[part], stats, _ = cv2.connectedComponentsWithStats(pixels[part], connectivity=8)
    stats[:, :2] += (x, y)
    areas = stats[1:, cv2.CC_STAT_AREA]
    order = 1 + np.argsort(-areas, kind="stable")
    return labels, [_shape(labels, int(label), stats[label]) for label in order if areas[label - 1] >= min_area]


def region_of(mask: Mask) -> Region:
    """The shape of all pixels of a mask together, connected or not; its label is 1.

    Raises:
        ValueError: the mask is empty.
    """
    pixels = _bytes(mask)
    x, y, width, height = cv2.boundingRect(pixels)
    if not width:
        raise ValueError("An empty mask has no shape; ask for regions with `label_regions`.")
    return _measure(pixels[y : y + height, x : x + width], (x, y, width, height), 1)


def _bytes(mask: Mask) -> UInt8[np.ndarray, "H W"]:
    return np.ascontiguousarray(mask).view(np.uint8)


def _shape(labels: Int32[np.ndarray, "H W"], label: int, stats: Int32[np.ndarray, "5"]) -> Region:
    x, y, width, height = (int(value) for value in stats[:4])
    inside = labels[y : y + height, x : x + width] == label
    return _measure(inside.view(np.uint8), (x, y, width, height), label)


def _measure(pixels: UInt8[np.ndarray, "h w"], box: tuple[int, int, int, int], label: int) -> Region:
    moments = cv2.moments(pixels, binaryImage=True)
    area = moments["m00"]
    centroid = np.array([box[0] + moments["m10"] / area, box[1] + moments["m01"] / area])
    xx, yy = moments["mu20"] / area + PIXEL_MOMENT, moments["mu02"] / area + PIXEL_MOMENT
    xy = -moments["mu11"] / area  # y up
    spread = np.hypot(xx - yy, 2 * xy)
    major, minor = 2 * np.sqrt(2 * (xx + yy + spread)), 2 * np.sqrt(2 * (xx + yy - spread))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return Region(
        area=int(area),
        centroid=centroid,
        major=float(major),
        minor=float(minor),
        eccentricity=float(np.sqrt(1 - (minor / major) ** 2)),
        orientation=float(angle if angle > -np.pi / 2 else np.pi / 2),
        box=box,
        label=label,
    )
