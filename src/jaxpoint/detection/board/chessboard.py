"""A chessboard, by OpenCV's detectors, with its corners in one order whichever way it is held."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.board.abstract_board import AbstractBoard, BoardCorners, corner_spacing_px
from jaxpoint.detection.board.edges import edge_width_px
from jaxpoint.targets import SIZE_SIGMA, Target

FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
SECTOR_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
WINDOW_PX, WINDOW_SHARE = 5, 0.4  # half the side of the refinement's window, at most this share of a square
SEARCH_WIDTH = 1600  # px; larger images are searched at this width first and refined at full size


@dataclass(frozen=True)
class Chessboard(AbstractBoard):
    """Counted by its inner corners; the corner with id 0 touches a dark square on its inner side where that is unique.

    With an odd and an even side the colours tell which end is which; otherwise a turn by 180 degrees does not show, and
    corner 0 is the upper left one as the image has it. A mirrored chessboard looks like one that is not.
    """

    columns: int  # inner corners
    rows: int
    square_m: float
    size_sigma: float = SIZE_SIGMA

    name = "chessboard"

    @property
    def ambiguous(self) -> bool:
        """Whether a turn by 180 degrees changes nothing: squares trade colours only where one side is even."""
        return (self.columns + self.rows) % 2 == 0

    @property
    def least_corners(self) -> int:
        """All of them: a part of a chessboard does not say which part it is."""
        return self.columns * self.rows

    @property
    def target(self) -> Target:
        """Inner corners row by row."""
        return Target.chessboard(self.columns, self.rows, self.square_m, size_sigma=self.size_sigma)

    @property
    def spec(self) -> str:
        """chessboard:9x6:25mm"""
        return f"chessboard:{self.columns}x{self.rows}:{1e3 * self.square_m:g}mm"

    def find(self, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
        """All inner corners, refined; the sector detector comes second, for blurred and strongly bent images."""
        found = self._search(grey)
        if found is None:
            return None
        half = int(np.clip(WINDOW_SHARE * corner_spacing_px(found), 1, WINDOW_PX))
        end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        refined = cv2.cornerSubPix(grey, found.astype(np.float32)[:, None].copy(), (half, half), (-1, -1), end)[:, 0]
        grid = self._ordered(grey, refined.reshape(self.rows, self.columns, 2))
        corners = grid.reshape(-1, 2).astype(float)
        return BoardCorners(np.arange(self.least_corners), corners, edge_width_px(grey, corners))

    def _search(self, grey: UInt8[np.ndarray, "H W"]) -> Float[np.ndarray, "K 2"] | None:
        size, scale = (self.columns, self.rows), min(1.0, SEARCH_WIDTH / grey.shape[1])
        small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        there, corners = cv2.findChessboardCorners(small, size, flags=FLAGS)
        if not there:
            there, corners = cv2.findChessboardCornersSB(small, size, flags=SECTOR_FLAGS)
        return (corners.reshape(-1, 2) + 0.5) / scale - 0.5 if there else None

    def _ordered(self, grey: UInt8[np.ndarray, "H W"], grid: Float[np.ndarray, "R C 2"]) -> Float[np.ndarray, "R C 2"]:
        """The corners in the one order in which the image shows the board from its front, corner 0 at a dark square.

        Where several orders do that, as it is mostly held: corner 0 to the upper left.
        """
        turns = [np.rot90(grid, quarter) for quarter in range(4)]
        orders = [order for turn in turns for order in (turn, turn[:, ::-1])]
        fitting = [order for order in orders if order.shape == grid.shape and _handedness(order) > 0]
        dark = [order for order in fitting if _first_is_dark(grey, order)]
        return min(dark or fitting, key=lambda order: float(order[0, 0].sum()))

    @property
    def print_size_mm(self) -> tuple[float, float]:
        """One square of margin around the squares."""
        side = 1e3 * self.square_m
        return side * (self.columns + 3), side * (self.rows + 3)

    def dark_mm(self) -> Float[np.ndarray, "N 4"]:
        """Every other square, so that corner 0 touches a dark one on its inner side."""
        side = 1e3 * self.square_m
        squares = [
            (side * (column + 1), side * (row + 1), side, side)
            for row in range(self.rows + 1)
            for column in range(self.columns + 1)
            if (row + column) % 2 == 0
        ]
        return np.array(squares)


def _handedness(grid: Float[np.ndarray, "R C 2"]) -> float:
    """Positive where columns, then rows, turn clockwise in the image (y down), as on the board."""
    across, down = (grid[:, -1] - grid[:, 0]).sum(axis=0), (grid[-1] - grid[0]).sum(axis=0)
    return float(across[0] * down[1] - across[1] * down[0])


def _first_is_dark(grey: UInt8[np.ndarray, "H W"], grid: Float[np.ndarray, "R C 2"]) -> bool:
    """Whether squares like the one inside of corner 0 are darker than the others, in the mean over the board."""
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    height, width = grey.shape
    x = np.clip(np.rint(middles[..., 0]).astype(int), 0, width - 1)
    y = np.clip(np.rint(middles[..., 1]).astype(int), 0, height - 1)
    levels = cv2.GaussianBlur(grey, (3, 3), 0)[y, x].astype(float)
    # Each against its neighbours, not against the mean of all: light falls unevenly.
    even = np.add.outer(np.arange(levels.shape[0]), np.arange(levels.shape[1])) % 2 == 0
    signed = np.where(even, levels, -levels)
    return float((signed[:, 1:] + signed[:, :-1]).sum() + (signed[1:] + signed[:-1]).sum()) < 0
