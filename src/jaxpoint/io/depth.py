"""Images of any depth to the 8 bits that everything here looks at, one scale for all images of a camera."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from jaxtyping import Num, UInt8

BITS = (8, 10, 12, 14, 16)  # that cameras put into files of 16
LEFT_ALIGNED = 3  # the lowest two bits are empty in each image of 10, 12 or 14 bits that fills the file from the top
ALIGNED_FROM = 2**12  # darker ones are 8 or 10 bits times a constant
FLOAT_ONE = 2.0  # images of 0..1 may be overexposed, but those of 0..255 are brighter


def full_scale(images: Iterable[Num[np.ndarray, "..."]]) -> float:
    """The value that white has in a recording, from a sample of its images.

    Whole numbers: the largest of the fewest bits (8, 10, 12, 14 or 16) that hold the brightest pixel; the file's own
    16 where the lowest bits are always empty, as the values are then aligned to the left. Fractions: 1, or what holds
    the brightest.
    """
    brightest, used, fraction = 0.0, 0, False
    for image in images:
        if image.dtype == np.uint8:
            return 255.0
        brightest = max(brightest, float(image.max()))
        fraction = np.issubdtype(image.dtype, np.floating)
        if image.dtype == np.uint16:
            used |= int(np.bitwise_or.reduce(image, axis=None))
    if fraction and brightest <= FLOAT_ONE:
        return 1.0
    if used and not used & LEFT_ALIGNED and brightest >= ALIGNED_FROM:
        return 65535.0
    return float(next((2**bits - 1 for bits in BITS if brightest < 2**bits), brightest))


def to_8_bits(image: Num[np.ndarray, "..."], white: float) -> UInt8[np.ndarray, "H W 3"]:
    """Blue, green and red of 0..255; what is brighter than white is white."""
    if image.dtype != np.uint8:
        image = np.asarray(cv2.convertScaleAbs(np.maximum(image.astype(np.float32), 0), alpha=255.0 / white))
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)) if image.ndim == 2 else image
