"""What every calibration board is: points of known shape, how they are found in an image, and how it is printed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.targets import Target


class BoardReason(IntEnum):
    """What became of the board in one image."""

    FOUND = 0
    NOT_FOUND = 1  # no board, or too little of it
    BLURRED = 2  # its edges are too soft to place corners
    NO_IMAGE = 3  # the camera has no image of this moment


@dataclass(frozen=True)
class BoardCorners:
    """The corners of a board in one image."""

    ids: Int[np.ndarray, " K"]  # indices of the target's points
    pixels: Float[np.ndarray, "K 2"]  # px, (0, 0) is the centre of the top-left pixel
    edge_px: float  # width of the transition from black to white, px; NaN where it was not measured
    mirrored: bool = False  # the image shows the board as a mirror does


class AbstractBoard(ABC):
    """A calibration board; its points are a flat `Target`, z = 0, x right and y down as it is seen."""

    name: str  # of the kind, as `--board` has it
    ambiguous: bool  # whether it looks the same when turned by 180 degrees
    least_corners: int  # of an image, to count as found

    @property
    @abstractmethod
    def target(self) -> Target:
        """Its points, m."""

    @property
    @abstractmethod
    def spec(self) -> str:
        """The text that `--board` takes for it."""

    @abstractmethod
    def find(self, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
        """Its corners in an image; None where it is not seen."""

    @property
    @abstractmethod
    def print_size_mm(self) -> tuple[float, float]:
        """Width and height of the printed pattern with its white margin."""

    @abstractmethod
    def dark_mm(self) -> Float[np.ndarray, "N 4"]:
        """Black rectangles of the print: left, top, width, height; y down from the top left of the margin."""


def corner_spacing_px(pixels: Float[np.ndarray, "K 2"]) -> float:
    """Median distance of a corner from its nearest neighbour."""
    if len(pixels) < 2:
        return float("nan")
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))
