"""A ChArUco board: a chessboard whose white squares hold markers, so that a part of it is enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.board.abstract_board import AbstractBoard, BoardCorners
from jaxpoint.detection.board.edges import edge_width_px
from jaxpoint.detection.board.markers import dictionary_of, find_either_way, marker_rectangles
from jaxpoint.targets import SIZE_SIGMA, Target

LEAST = 6  # corners; fewer hardly tell a pose


@dataclass(frozen=True)
class Charuco(AbstractBoard):
    """Counted by its squares, as OpenCV and its printed boards are; its points are the corners inside."""

    columns: int  # squares
    rows: int
    square_m: float
    marker_m: float
    dictionary: str = "DICT_4X4_50"
    inverted: bool = False  # black and white are exchanged, as caliscope prints it on request
    size_sigma: float = SIZE_SIGMA

    name = "charuco"
    ambiguous = False
    least_corners = LEAST

    @property
    def target(self) -> Target:
        """Inner corners row by row."""
        return Target.chessboard(
            self.columns - 1, self.rows - 1, self.square_m, name=self.name, size_sigma=self.size_sigma
        )

    @property
    def spec(self) -> str:
        """charuco:7x5:40mm:30mm:DICT_4X4_50"""
        sides = f"{1e3 * self.square_m:g}mm:{1e3 * self.marker_m:g}mm"
        return f"charuco:{self.columns}x{self.rows}:{sides}:{self.dictionary}" + (":inverted" if self.inverted else "")

    def find(self, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
        """The corners between markers that were decoded; also of boards of OpenCV before 4.6, and mirrored ones."""
        return find_either_way(self._find, 255 - grey if self.inverted else grey)

    def _find(self, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
        best: tuple[np.ndarray, np.ndarray] | None = None
        for detector in self._detectors:
            corners, ids, _, _ = detector.detectBoard(grey)
            if ids is not None and (best is None or len(ids) > len(best[0])):
                best = ids.ravel(), corners.reshape(-1, 2)
        if best is None or len(best[0]) < LEAST:
            return None
        return BoardCorners(best[0].astype(np.int64), best[1].astype(float), edge_width_px(grey, best[1]))

    @cached_property
    def _detectors(self) -> list[cv2.aruco.CharucoDetector]:
        """Of today's layout; of an even number of rows also of the one before OpenCV 4.6, which is another one."""
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        detectors = []
        for legacy in (False, True) if self.rows % 2 == 0 else (False,):
            board = self._board()
            board.setLegacyPattern(legacy)
            detectors.append(cv2.aruco.CharucoDetector(board, detectorParams=parameters))
        return detectors

    def _board(self) -> cv2.aruco.CharucoBoard:
        markers = dictionary_of(self.dictionary)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, markers)

    @property
    def print_size_mm(self) -> tuple[float, float]:
        """A quarter of a square of margin."""
        side = 1e3 * self.square_m
        return side * (self.columns + 0.5), side * (self.rows + 0.5)

    def dark_mm(self) -> Float[np.ndarray, "N 4"]:
        """Black squares, and the bits of the markers in the white ones, in today's layout."""
        side, inside = 1e3 * self.square_m, 1e3 * self.marker_m
        margin, gap, markers = side / 4, (side - inside) / 2, dictionary_of(self.dictionary)
        parts, number = [], 0
        for row in range(self.rows):
            for column in range(self.columns):
                left, top = margin + side * column, margin + side * row
                if (row + column) % 2 == 0:
                    parts.append(np.array([[left, top, side, side]]))
                else:
                    parts.append(marker_rectangles(markers, number, left + gap, top + gap, inside))
                    number += 1
        return np.concatenate(parts)
