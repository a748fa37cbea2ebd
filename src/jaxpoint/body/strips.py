"""A limb between its edges in one view: where it was predicted, as wide as a forearm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.evidence.limb_slices import LimbEdges

LIMB_WIDTH_M = (0.035, 0.13)  # of a forearm, clothes included
TAPER = 0.2  # by which a width may miss that of an evenly widening forearm
_SLOPE_PRIOR = 0.5  # slices, by which an even width is expected


@dataclass(frozen=True)
class Strip:
    """A limb where other views predict it: the middle between its two edges at S places along it."""

    middle: Float[np.ndarray, "S 2"]  # px, of the whole image
    width: Float[np.ndarray, " S"]  # px between the edges, 0 where the corridor does not hold both

    @property
    def base(self) -> Float[np.ndarray, "2"]:
        """Middle of the slice farthest from the tip, px."""
        return self.middle[np.flatnonzero(self.width > 0)[-1]]


def cut_strip(edges: LimbEdges) -> Strip:
    """The limb between both its edges: of skin or of the outline, whichever has more slices of a forearm's width.

    Where a run reaches the border of the corridor (a shirt of that colour behind), there is no edge.
    """
    low, high = edges.low, edges.high
    whole = (low > 1 - edges.half) & (high < edges.half - 1)
    width = np.where(_tapers(high - low, whole, edges.pixels_a_metre), high - low, 0.0)
    kind = int((width > 0).sum(axis=1).argmax())
    return Strip(edges.at((low + high)[kind] / 2), width[kind])


def beside_one_edge(
    edges: LimbEdges, width: Float[np.ndarray, " S"], axis: Float[np.ndarray, " S"], within: float
) -> Strip | None:
    """The limb beside the one edge that it has, where something of its colour lies on its other side.

    Args:
        edges: across the axis.
        width: of the limb, as other views have it, px.
        axis: where all views see the axis, px from the predicted one.
        within: distance from the axis up to which a slice is the limb's, px.

    Returns:
        The run and the side with the most slices near the axis; None where there are none.
    """
    some = edges.high > edges.low
    best = None
    for kind in range(2):
        for side, offset in ((edges.low, width / 2), (edges.high, -width / 2)):
            clean = some[kind] & (np.abs(side[kind]) < edges.half - 1)
            middle = side[kind] + offset
            held = clean & (np.abs(middle - axis) <= within)
            if held.any() and (best is None or held.sum() > (best.width > 0).sum()):
                best = Strip(edges.at(middle), np.where(held, width, 0.0))
    return best


def _tapers(
    width: Float[np.ndarray, "K S"], whole: Bool[np.ndarray, "K S"], pixels_a_metre: float
) -> Bool[np.ndarray, "K S"]:
    """Slices as wide as a forearm that widens evenly to the elbow: a hole, a hand or a shirt behind is not."""
    low, high = (limit * pixels_a_metre for limit in LIMB_WIDTH_M)
    usable = whole & (width >= low) & (width <= high)
    place = np.linspace(-1, 1, width.shape[1])
    powers = np.stack([np.ones_like(place), place, place**2], axis=1)
    weight = usable.astype(float)
    expected = width
    for _ in range(5):
        n, x, xx = (weight @ powers + [1e-9, 0.0, _SLOPE_PRIOR]).T
        y, xy = ((weight * width) @ powers[:, :2]).T
        level, slope = (xx * y - x * xy), (n * xy - x * y)
        expected = (level[:, None] + slope[:, None] * place) / (n * xx - x * x)[:, None]
        weight = usable / (1 + ((width - expected) / (0.07 * np.maximum(expected, low))) ** 2)
    tapers = usable & (np.abs(width - expected) <= TAPER * np.maximum(expected, low))
    return np.where(usable.sum(axis=1, keepdims=True) < 3, usable, tapers)
