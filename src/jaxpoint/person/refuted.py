"""Which views see the room where an arm should be: they refute it, unless furniture stands before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.detect.arm import Crop, Pixel

THROUGH = 0.3  # of the places along an axis: where fewer lie on the person, the view looks past the arm


def looks_past(
    crops: Sequence[Crop | None], places: Float[np.ndarray, "C S 2"], sizes: Int[np.ndarray, "C 2"]
) -> Bool[np.ndarray, " C"]:
    """Whether each view has the person, and the whole axis in its image, but the room where the axis lies.

    Args:
        crops: the person's pixels in each view; None where it has none.
        places: along the axis, px.
        sizes: of the images, px, width and height.
    """
    whole = np.all((places >= 0) & (places <= sizes[:, None] - 1), axis=(1, 2))
    return np.array(
        [
            whole[c] and crop is not None and np.mean(crop.at(places[c]) != Pixel.NOTHING) < THROUGH
            for c, crop in enumerate(crops)
        ]
    )
