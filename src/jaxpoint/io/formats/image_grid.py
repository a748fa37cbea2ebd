"""Pixels all over an image, and where Brown's lens sees directions: for lenses that are fitted to others."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def image_grid(size: tuple[int, int], columns: int = 25, rows: int = 19) -> Float[np.ndarray, "N 2"]:
    """Pixels from corner to corner of an image (px)."""
    x, y = np.linspace(0, size[0] - 1, columns), np.linspace(0, size[1] - 1, rows)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def brown_pixels(
    k: Float[np.ndarray, "3 3"], coefficients: Float[np.ndarray, " n"], directions: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 2"]:
    """Pixels of directions before the camera; coefficients of Brown's or the rational lens, in OpenCV's order."""
    given = np.asarray(coefficients, float)
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([given, np.zeros(8 - len(given))])
    x, y = (directions[:, :2] / directions[:, 2:]).T
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([k[0, 0] * bent_x + k[0, 2], k[1, 1] * bent_y + k[1, 2]], axis=1)
