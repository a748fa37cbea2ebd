"""How soft edges are near the corners of a board: what motion, focus and lens leave of a step from black to white."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.board.abstract_board import corner_spacing_px

MOST_CORNERS = 24


def edge_width_px(grey: UInt8[np.ndarray, "H W"], pixels: Float[np.ndarray, "K 2"]) -> float:
    """Width of edges near corners, px: their contrast over their steepest slope, the median over corners.

    Around each corner the levels' range is the height of the step, and the largest gradient its slope; motion in one
    direction leaves edges along it sharp, so the slope is the mean of the largest ones in x and in y.
    """
    half = int(np.clip(0.45 * corner_spacing_px(pixels), 3, 20)) if len(pixels) > 1 else 5
    widths = []
    for x, y in np.rint(pixels[:: max(len(pixels) // MOST_CORNERS, 1)]).astype(int):
        patch = grey[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1].astype(float)
        if min(patch.shape) < 4:
            continue
        low, high = np.quantile(patch, [0.05, 0.95])
        slopes = [np.quantile(np.abs(np.diff(patch, axis=axis)), 0.98) for axis in (0, 1)]
        if high - low > 8 and min(slopes) > 0:
            widths.append((high - low) / min(slopes))
    return float(np.median(widths)) if widths else float("nan")
