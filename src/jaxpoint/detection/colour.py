"""Colours and sizes of whole images."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Image = UInt8[np.ndarray, "H W 3"]  # blue, green, red

GREY_SPREAD = 4.0  # grey levels between the channels: a pixel with less has no colour


def is_grey(image: Image, coloured: float = 0.01) -> bool:
    """Whether an image has no colour, as of an infrared or a monochrome camera: at most this part of its pixels."""
    some = image[::8, ::8] if min(image.shape[:2]) > 64 else image
    blue, green, red = (some[..., channel].ravel() for channel in range(3))
    highest, lowest = np.maximum(np.maximum(blue, green), red), np.minimum(np.minimum(blue, green), red)
    return bool(np.percentile(highest - lowest, 100 * (1 - coloured)) < GREY_SPREAD)


def scale_channels(image: Image, gains: Float[np.ndarray, "3"]) -> Image:
    """The image with blue, green and red times their gains."""
    channels = [cv2.convertScaleAbs(channel, alpha=float(gain)) for channel, gain in zip(cv2.split(image), gains)]
    return cv2.merge(channels)


def shrink_of(image_width: int, width_px: int) -> int:
    """The whole factor that brings an image to about this width, 1 where it is no wider or 0 was asked for."""
    return max(round(image_width / width_px), 1) if width_px else 1


def shrunk(image: Image, shrink: int) -> UInt8[np.ndarray, "h w 3"]:
    """The image at 1/shrink of its size, rounded up; each pixel the mean of those that it covers."""
    if shrink == 1:
        return image
    size = (-(-image.shape[1] // shrink), -(-image.shape[0] // shrink))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
