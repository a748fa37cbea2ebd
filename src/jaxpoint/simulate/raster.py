"""A z-buffer for many small triangles: which triangle each sample of an image sees, and where on it.

The caller projects the corners, so any lens is exact as long as a projected edge may be taken for a straight line.
Plain numpy: triangles become spans of rows, spans become samples, and the nearest sample of a pixel wins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

NOTHING = -1


@dataclass(frozen=True)
class Raster:
    """What H x W samples see. `NOTHING` and depth infinity where no triangle is."""

    triangle: Int[np.ndarray, "H W"]
    depth: Float[np.ndarray, "H W"]  # in the unit of the corners' depth


def rasterise(
    corners: Float[np.ndarray, "T 3 2"],
    depth: Float[np.ndarray, "T 3"],
    size: tuple[int, int],
    *,
    both_sides: bool = False,
) -> Raster:
    """The nearest triangle at every sample; sample (x, y) lies at those coordinates.

    Args:
        corners: in samples, x right and y down; counter-clockwise to the eye where the outside is seen.
        depth: of the corners; triangles with a corner at depth 0 or less, or one that is not finite, are left out.
        size: width and height of the image, in samples.
        both_sides: also draw triangles seen from their inside.
    """
    width, height = size
    nearness = np.zeros(width * height, np.float32)
    triangle = np.full(width * height, NOTHING, np.int32)
    corners = corners.astype(np.float32)
    index = _drawable(corners, depth, size, both_sides)
    if len(index):
        found, place, near = _samples(corners[index], depth[index], size)
        np.maximum.at(nearness, place, near)
        wins = near == nearness[place]
        triangle[place[wins]] = index[found[wins]]
    with np.errstate(divide="ignore"):
        far = np.float32(1.0) / nearness
    return Raster(triangle.reshape(height, width), far.reshape(height, width))


def weights_on(
    corners: Float[np.ndarray, "T 3 2"],
    depth: Float[np.ndarray, "T 3"],
    triangle: Int[np.ndarray, " N"],
    sample: Float[np.ndarray, "N 2"],
) -> Float[np.ndarray, "N 3"]:
    """How much each corner counts at a sample of a triangle, in perspective; the three sum to 1."""
    corner = corners[triangle]
    a, b, c = (corner[:, i] - sample for i in range(3))
    areas = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    weights = areas / depth[triangle]
    return weights / (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]


def _drawable(corners, depth, size, both_sides) -> np.ndarray:
    """Indices of the triangles that lie in front, face the eye and touch the image."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    with np.errstate(invalid="ignore"):  # comparisons with what is not finite are false
        kept = (high[:, 0] >= 0) & (high[:, 1] >= 0) & (low[:, 0] <= size[0] - 1) & (low[:, 1] <= size[1] - 1)
        kept &= (depth[:, 0] > 0) & (depth[:, 1] > 0) & (depth[:, 2] > 0)
        area = _cross(b - a, c - a)
        kept &= (area != 0) if both_sides else (area < 0)
    return np.flatnonzero(kept)


def _samples(corner, depth, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every sample inside each triangle: the triangle's number, the sample's place (y * width + x), 1 / depth."""
    width, height = size
    a, b, c = corner[:, 0, 1], corner[:, 1, 1], corner[:, 2, 1]
    first = np.clip(np.ceil(np.minimum(np.minimum(a, b), c)), 0, height).astype(np.int32)
    last = np.clip(np.floor(np.maximum(np.maximum(a, b), c)), -1, height - 1).astype(np.int32)
    span, offset = _repeated(np.maximum(last - first + 1, 0))
    row = first[span] + offset
    left, right = _span_ends(corner, span, row)
    left = np.clip(np.ceil(left), 0, width).astype(np.int32)
    right = np.clip(np.floor(right), -1, width - 1).astype(np.int32)
    inside, step = _repeated(np.maximum(right - left + 1, 0))
    near, slope_x, slope_y = _planes(corner, 1.0 / depth)
    start = near[span] + slope_x[span] * (left - corner[span, 0, 0]) + slope_y[span] * (row - corner[span, 0, 1])
    nearness = start[inside] + slope_x[span][inside] * step
    place = (row * width + left)[inside] + step
    return span[inside], place, nearness.astype(np.float32)


def _span_ends(corner, span, row) -> tuple[np.ndarray, np.ndarray]:
    """Where row `row` enters and leaves its triangle `span`, in samples."""
    left = np.full(len(span), -np.inf, np.float32)
    right = np.full(len(span), np.inf, np.float32)
    area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    for i in range(3):
        start, edge = corner[:, i], corner[:, (i + 1) % 3] - corner[:, i]
        rises = edge[:, 1] * np.sign(area)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = edge[:, 0] / edge[:, 1]
            crossing = start[span, 0] + (row - start[span, 1]) * slope[span]
        down = rises[span] > 0
        up = rises[span] < 0
        right[down] = np.minimum(right[down], crossing[down])
        left[up] = np.maximum(left[up], crossing[up])
    return left, right


def _planes(corner, near) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """1 / depth at the first corner of every triangle, and its slopes in x and y."""
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    rise_a, rise_b = near[:, 1] - near[:, 0], near[:, 2] - near[:, 0]
    area = _cross(a, b)
    slope_x = (rise_a * b[:, 1] - rise_b * a[:, 1]) / area
    slope_y = (rise_b * a[:, 0] - rise_a * b[:, 0]) / area
    return near[:, 0], slope_x, slope_y


def _repeated(counts) -> tuple[np.ndarray, np.ndarray]:
    """For counts 2, 0, 3: the owners 0 0 2 2 2 and the steps 0 1 0 1 2."""
    owner = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    starts = np.cumsum(counts) - counts
    return owner, np.arange(len(owner), dtype=np.int32) - starts[owner].astype(np.int32)


def _cross(a, b) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
