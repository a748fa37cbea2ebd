"""What boards of square markers share: dictionaries by name, bits as rectangles, and looking into mirrored images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.board.abstract_board import BoardCorners
from jaxpoint.errors import UsageError

Find = Callable[[UInt8[np.ndarray, "H W"]], BoardCorners | None]


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """One of OpenCV's dictionaries of markers.

    Raises:
        UsageError: there is none of this name.
    """
    known = sorted(item for item in dir(cv2.aruco) if item.startswith("DICT_"))
    if name not in known:
        raise UsageError(f"There is no dictionary of markers '{name}'; choose one of {', '.join(known)}.")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_rectangles(
    dictionary: cv2.aruco.Dictionary, number: int, left: float, top: float, side: float, border: int = 1
) -> Float[np.ndarray, "N 4"]:
    """Black parts of one marker as rectangles, one for each run of black bits in a row."""
    modules = dictionary.markerSize + 2 * border
    bits = dictionary.generateImageMarker(number, modules, borderBits=border) < 128
    step, found = side / modules, []
    for row, dark in enumerate(bits):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], dark.astype(int), [0]])))
        found += [(left + step * a, top + step * row, step * (b - a), step) for a, b in edges.reshape(-1, 2)]
    return np.array(found)


def find_either_way(find: Find, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
    """What is found in the image, or in its mirror image; in pixels of the image as it is."""
    found = find(grey)
    if found is not None:
        return found
    found = find(np.ascontiguousarray(grey[:, ::-1]))
    if found is None:
        return None
    pixels = found.pixels.copy()
    pixels[:, 0] = grey.shape[1] - 1 - pixels[:, 0]
    return replace(found, pixels=pixels, mirrored=True)
