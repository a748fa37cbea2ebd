"""A shirt of the colour of skin: distinguished from bare arms by the person's own chest and face.

A model of skin that holds for everybody takes beige cloth for skin. On one person both colours are seen: the chest
shows the shirt's, the face the skin's. Where the two differ, pixels of the shirt's colour are no skin.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxpoint.detection.colour import Image

CHEST = (1.0, 2.6, 0.5)  # of the head's height: below its middle from, to; and half as wide
FACE = (0.33, 0.36, 0.18)  # of the head's height: half as wide, half as high, below its middle
MOSTLY = 0.5  # of the chest that must look like skin before it is doubted
MIN_PIXELS = 60
MOST_PIXELS = 1500  # of which a colour is learnt: more add nothing
APART = 2.0  # standard deviations between face and chest: less is a bare chest, or cloth that looks like skin
KEPT = 0.7  # of the face that must not have the shirt's colour
ALIKE = 3.0  # standard deviations from the chest's colour within which a pixel is the shirt
_LOG = np.log(np.arange(256) + 4.0)  # of a channel; near black its noise is not blown up
_FLOOR = 2.0  # variance that noise leaves, in the units of `_features`


def shirt_like_skin(
    image: Image, person: Bool[np.ndarray, "H W"], skin: Bool[np.ndarray, "H W"], head: tuple[float, float, float]
) -> Bool[np.ndarray, "H W"] | None:
    """The pixels of a shirt that was taken for skin; None where the chest is not, or looks like the face.

    Args:
        image: around the person.
        person: the pixels of the person.
        skin: those that have the colour of skin.
        head: x, y of its middle, and its height, px of this image.
    """
    x, y, height = head
    chest = _part(
        skin.shape, (x - CHEST[2] * height, y + CHEST[0] * height), (x + CHEST[2] * height, y + CHEST[1] * height)
    )
    seen = person[chest]
    if seen.sum() < MIN_PIXELS or skin[chest].sum() < MOSTLY * seen.sum():
        return None
    face = np.zeros(skin.shape, np.uint8)
    centre = (round(x), round(y + FACE[2] * height))
    cv2.ellipse(face, centre, (round(FACE[0] * height), round(FACE[1] * height)), 0, 0, 360, 1, -1)
    face = (face > 0) & skin
    if face.sum() < MIN_PIXELS:
        return None
    shirt, bare = _cloud(image[chest][skin[chest]]), _cloud(image[face])
    gap = bare[0] - shirt[0]
    if gap @ np.linalg.solve((shirt[1] + bare[1]) / 2, gap) < APART**2:
        return None
    found = np.zeros(skin.shape, bool)
    off = (_features(image[skin]) - shirt[0]) @ np.linalg.cholesky(np.linalg.inv(shirt[1]))
    found[skin] = (off**2).sum(axis=1) < ALIKE**2
    return found if found[face].mean() <= 1 - KEPT else None


def _part(shape: tuple[int, ...], low: tuple[float, float], high: tuple[float, float]) -> tuple[slice, slice]:
    """Rows and columns of a box, cut to the image."""
    left, top = (max(round(v), 0) for v in low)
    return slice(top, max(min(round(high[1]), shape[0]), top)), slice(left, max(min(round(high[0]), shape[1]), left))


def _features(pixels: UInt8[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Ratios of the channels, which the light's strength leaves as they are, and that strength with less weight."""
    blue, green, red = (_LOG[pixels[:, i]] for i in range(3))
    strength = pixels @ np.array([0.114, 0.587, 0.299]) + 8.0
    return np.stack([60 * (red - green), 60 * (green - blue), 20 * np.log(strength)], axis=1)


def _cloud(pixels: UInt8[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Mean and covariance without what lies far off: hair, a pattern, an arm before the chest."""
    values = _features(pixels[:: 1 + len(pixels) // MOST_PIXELS])
    off = np.abs(values - np.median(values, axis=0))
    kept = values[(off < 4.5 * np.median(off, axis=0) + 3.0).all(axis=1)]
    return kept.mean(axis=0), np.cov(kept.T) + _FLOOR * np.eye(3)
