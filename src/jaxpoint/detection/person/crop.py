"""A person's part of an image, each pixel a `Pixel`."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.evidence.limb_slices import Pixel


@dataclass(frozen=True)
class Crop:
    """A person's part of an image, each pixel a `Pixel`."""

    labels: UInt8[np.ndarray, "h w"]
    corner: tuple[int, int]  # px, x and y of the crop's first pixel in the image
    image_size: tuple[int, int]  # px, width and height of the whole image

    def at(self, pixels: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """The `Pixel`s nearest to places of the whole image; NOTHING outside the crop."""
        inside = np.round(pixels - np.array(self.corner))
        height, width = self.labels.shape
        held = np.all((inside >= 0) & (inside < (width, height)), axis=1)
        x, y = np.where(held[:, None], inside, 0).astype(int).T
        return np.where(held, self.labels[y, x], np.uint8(Pixel.NOTHING))


@dataclass(frozen=True)
class PackedCrop:
    """A crop as PNG, so that those of a recording fit in memory."""

    png: bytes
    corner: tuple[int, int]  # px
    image_size: tuple[int, int]  # px

    @staticmethod
    def of(crop: Crop) -> PackedCrop:
        """A crop, packed."""
        png = cv2.imencode(".png", crop.labels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        return PackedCrop(png, crop.corner, crop.image_size)

    def unpack(self) -> Crop:
        """The crop."""
        labels = np.asarray(cv2.imdecode(np.frombuffer(self.png, np.uint8), cv2.IMREAD_GRAYSCALE))
        return Crop(labels, self.corner, self.image_size)
