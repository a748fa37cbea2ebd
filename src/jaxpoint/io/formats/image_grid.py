"""Pixels all over an image, and where Brown's lens sees directions: for lenses that are fitted to others."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float


def image_grid(size: tuple[int, int], columns: int = 25, rows: int = 19) -> Float[np.ndarray, "N 2"]:
    """Pixels from corner to corner of an image (px)."""
    x, y = np.linspace(0, size[0] - 1, columns), np.linspace(0, size[1] - 1, rows)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def brown_pixels(
    k: Float[np.ndarray, "3 3"], coefficients: Float[np.ndarray, " n"], directions: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 2"]:
    """Pixels of directions before the camera, coefficients in OpenCV's order."""
    return cv2.projectPoints(directions, np.zeros(3), np.zeros(3), k, np.asarray(coefficients, float))[0].reshape(-1, 2)
