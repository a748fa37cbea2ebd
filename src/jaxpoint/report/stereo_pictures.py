"""Pictures of a rectified pair: rows that correspond, undistorted beside original, disparities with holes shown."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.rectified_pair import RectifiedPair

WIDTH, LINES = 560, 12
LINE, HOLE = (255, 170, 40), (60, 60, 66)  # RGB
Picture = UInt8[np.ndarray, "_ _ 3"]


def stereo_sheets(
    pair: RectifiedPair, originals: tuple[np.ndarray, np.ndarray], length: str
) -> list[tuple[str, Picture]]:
    """Captions and RGB pictures; `length` is the unit of depths."""
    rows = np.concatenate([_lined(pair.left), _lined(pair.right)], axis=1)
    beside = np.concatenate([_small(originals[0]), _small(pair.left)], axis=1)
    (low, high), nearest = _range(pair.depth), _range(pair.disparity)
    return [
        ("Rectified left and right: what is on a line here is on the same line there.", rows),
        ("The left image as recorded, and rectified: straight edges are straight.", beside),
        (
            f"Left: disparity, {nearest[0]:.0f} to {nearest[1]:.0f} px. Right: depth, {low:.2f} to {high:.2f} {length};"
            " blue is the lower end. Grey: holes, where the two images do not agree or show nothing.",
            np.concatenate([coloured(pair.disparity), coloured(pair.depth, low, high)], axis=1),
        ),
    ]


def coloured(
    values: Float[np.ndarray, "H W"], low: float | None = None, high: float | None = None, width: int = WIDTH
) -> Picture:
    """A colour image of values, holes grey."""
    known = np.isfinite(values)
    if low is None or high is None:
        low, high = _range(values)
    shown = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-12), 0, 1)
    image = cv2.applyColorMap((255 * shown).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1].copy()
    image[~known] = HOLE
    scale = width / image.shape[1]
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _range(values: Float[np.ndarray, "H W"]) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    return (float(np.quantile(known, 0.02)), float(np.quantile(known, 0.98))) if known.size else (0.0, 1.0)


def _small(image: np.ndarray) -> Picture:
    scale = WIDTH / image.shape[1]
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[..., ::-1])


def _lined(image: np.ndarray) -> Picture:
    small = _small(image).copy()
    for y in np.linspace(0, small.shape[0] - 1, LINES + 2)[1:-1].astype(int):
        small[y] = LINE
    return small
