"""Ends and axis of a pointing region (thesis 7.2.2).

The thesis takes the topmost pixels of the outermost columns. They lie on the upper outline and not on the axis, which
tilts the line up, and they are not the same point of the body in two views. The axis line is what can be carried to
3-D: it is the image of one line in every view.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from jaxpoint.detection.region import Mask

MIN_SLICES = 4  # columns along the axis; a shorter region has no direction
ROUNDS = 3  # the slices stand across the axis of the round before
REWEIGHTED = 8  # steps of each robust fit
CAUCHY = 2.4  # robust standard deviations beyond which a slice counts little
SIGMA_FLOOR = 0.3  # px; a midpoint between two pixel borders is not known better


@dataclass(frozen=True)
class Endpoints:
    """The two ends of the thesis's line of pointing."""

    tip: Float[np.ndarray, "2"]  # px, the one farther from the silhouette's centroid
    base: Float[np.ndarray, "2"]  # px


@dataclass(frozen=True)
class AxisLine:
    """The axis of an elongated region: `point + t direction`, t from `start` to `end`."""

    point: Float[np.ndarray, "2"]  # px
    direction: Float[np.ndarray, "2"]  # unit length; its sign has no meaning
    start: float  # px
    end: float  # px
    width: float  # px, area over length
    residual: float  # px, robust deviation of the slices' midpoints from the line

    @property
    def length(self) -> float:
        """From end to end, px."""
        return self.end - self.start

    @property
    def ends(self) -> Float[np.ndarray, "2 2"]:
        """Its two ends, px."""
        return self.point + np.array([[self.start], [self.end]]) * self.direction


def finger_endpoints(mask: Mask, silhouette_centroid: Float[np.ndarray, "2"]) -> Endpoints:
    """Thesis 7.2.2, finger: of the left-top and right-top pixels the one farther from the person is the tip.

    Raises:
        ValueError: the mask is empty.
    """
    near, far = _by_distance(_left_and_right_top(mask), silhouette_centroid)
    return Endpoints(far, near)


def forearm_endpoints(mask: Mask, silhouette_centroid: Float[np.ndarray, "2"], shift_to_top: bool = False) -> Endpoints:
    """Thesis 7.2.2, forearm: the tip as for the finger, the base the region's centroid.

    The thesis takes the two farthest of left-top, right-top and centroid, and calls one of them the centroid; where
    left-top and right-top are the two farthest, this is the only reading that works (thesis 7.2.2).

    Args:
        mask: the region.
        silhouette_centroid: of the person, px.
        shift_to_top: the thesis's step 5: the base is moved up to the topmost pixel of its column. The tip is there.

    Raises:
        ValueError: the mask is empty.
    """
    _, tip = _by_distance(_left_and_right_top(mask), silhouette_centroid)
    rows, columns = np.nonzero(mask)
    base = np.array([columns.mean(), rows.mean()])
    if shift_to_top:
        column = columns[np.abs(columns - base[0]).argmin()]
        base[1] = rows[columns == column].min()
    return Endpoints(tip, base)


def axis_line(mask: Mask) -> AxisLine | None:
    """The straight axis of a region, by a robust line through the middles of its slices; None where it has none.

    The principal axis alone is drawn aside by a thumb, a fist or a piece of the upper arm, each of which holds many
    pixels; here every slice across the axis is one observation, and the few that do not lie on the line of the others
    count little.
    """
    pixels = _pixels(mask)
    if len(pixels) < MIN_SLICES:
        return None
    middle = pixels.mean(axis=0)
    variance, vectors = np.linalg.eigh(np.cov((pixels - middle).T))
    direction = vectors[:, 1]
    if variance[1] < MIN_SLICES**2 / 12:
        return None
    residual = 0.0
    for _ in range(ROUNDS):
        along, center, widths = _slices(pixels - middle, direction)
        if len(along) < MIN_SLICES:
            return None
        slope, offset, residual = _robust_line(along, center, np.minimum(widths, np.median(widths)))
        normal = np.array([-direction[1], direction[0]])
        middle = middle + offset * normal
        direction = (direction + slope * normal) / np.hypot(1.0, slope)
    along = (pixels - middle) @ direction
    start, end = float(along.min()) - 0.5, float(along.max()) + 0.5
    return AxisLine(middle, direction, start, end, len(pixels) / (end - start), residual)


def _pixels(mask: Mask) -> Float[np.ndarray, "N 2"]:
    found = cv2.findNonZero(np.ascontiguousarray(mask).view(np.uint8))
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(float)


def _slices(
    offsets: Float[np.ndarray, "N 2"], direction: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Places along the axis, and the middles and widths across it, of slices one pixel thick."""
    along = offsets @ direction
    across = offsets @ np.array([-direction[1], direction[0]])
    index = np.round(along - along.min()).astype(np.int64)
    counts = np.bincount(index)
    kept = counts > 0
    sums = [np.bincount(index, weights)[kept] / counts[kept] for weights in (along, across)]
    return sums[0], sums[1], counts[kept].astype(float)


def _robust_line(
    x: Float[np.ndarray, " S"], y: Float[np.ndarray, " S"], weights: Float[np.ndarray, " S"]
) -> tuple[float, float, float]:
    """Slope, offset and robust deviation of y = slope x + offset, with a Cauchy loss."""
    slope = offset = 0.0
    sigma = max(1.4826 * float(np.median(np.abs(y - np.median(y)))), SIGMA_FLOOR)
    for _ in range(REWEIGHTED):
        residuals = y - slope * x - offset
        sigma = max(1.4826 * float(np.median(np.abs(residuals))), SIGMA_FLOOR)
        w = weights / (1 + (residuals / (CAUCHY * sigma)) ** 2)
        mx, my = np.average(x, weights=w), np.average(y, weights=w)
        slope = float((w * (x - mx) * (y - my)).sum() / (w * (x - mx) ** 2).sum())
        offset = float(my - slope * mx)
    return slope, offset, sigma


def _left_and_right_top(mask: Mask) -> Int[np.ndarray, "2 2"]:
    """Topmost pixel of the leftmost and of the rightmost column, (x, y)."""
    columns = np.flatnonzero(np.asarray(mask).any(axis=0))
    if not len(columns):
        raise ValueError("An empty mask has no endpoints.")
    ends = columns[[0, -1]]
    return np.stack([ends, np.asarray(mask)[:, ends].argmax(axis=0)], axis=1)


def _by_distance(
    points: Int[np.ndarray, "2 2"], center: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The nearer and the farther of two points; of two equally far ones the first is the farther."""
    distance = np.hypot(*(points - center).T)
    far = int(distance[1] > distance[0])
    return points[1 - far].astype(float), points[far].astype(float)
