"""Images that are results: disparities and depths as 16-bit PNG, pictures, and tables of remapping."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.io.files import replacing

DISPARITY_SCALE, DEPTH_SCALE = 256.0, 1e3  # as KITTI writes disparities; depths in mm


def write_disparity(path: Path, disparity: Float[np.ndarray, "H W"]) -> None:
    """Disparity (px) times 256 as a 16-bit PNG; 0 where there is none."""
    _write(path, _sixteen_bits(disparity, DISPARITY_SCALE))


def write_depth(path: Path, depth_m: Float[np.ndarray, "H W"]) -> None:
    """Depth in mm as a 16-bit PNG; 0 where there is none, or where it is 65.5 m or more."""
    _write(path, _sixteen_bits(depth_m, DEPTH_SCALE))


def write_image(path: Path, image: UInt8[np.ndarray, "H W 3"]) -> None:
    """An image (blue, green, red) in the format of its ending, whole or not at all."""
    _write(path, image)


def write_maps(path: Path, maps: dict[str, np.ndarray]) -> None:
    """Arrays as `.npz`, whole or not at all."""
    with replacing(path) as file:
        np.savez_compressed(file, allow_pickle=False, **maps)


def _sixteen_bits(values: Float[np.ndarray, "H W"], scale: float) -> np.ndarray:
    scaled = np.rint(scale * np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0))
    return np.where((scaled > 0) & (scaled < 65535), scaled, 0).astype(np.uint16)


def _write(path: Path, image: np.ndarray) -> None:
    done, data = cv2.imencode(path.suffix, image)
    if not done:
        raise OSError(f"The image could not be written as {path.suffix}")
    with replacing(path) as file:
        file.write(data.tobytes())
