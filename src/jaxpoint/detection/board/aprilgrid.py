"""Kalibr's AprilGrid: a grid of AprilTags of the family 36h11, each of whose corners is a point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.detection.board.abstract_board import AbstractBoard, BoardCorners, corner_spacing_px
from jaxpoint.detection.board.edges import edge_width_px
from jaxpoint.detection.board.markers import dictionary_of, find_either_way, marker_rectangles
from jaxpoint.targets import SIZE_SIGMA, Target

FAMILY, BORDERS = "DICT_APRILTAG_36h11", (2, 1)  # black modules around the bits: Kalibr's two, and the usual one
LEAST_TAGS = 3
WINDOW_PX, WINDOW_SHARE = 4, 0.2
NEIGHBOURS = 12  # corners that predict one,
FAR, LEAST_FAR_PX = 0.05, 2.0  # and how far off (of their spacing, and at least) it is drawn away by something
AGREE = 0.4  # of a tag: corners farther from the grid's homography belong to something else; lenses bend it too


@dataclass(frozen=True)
class AprilGrid(AbstractBoard):
    """Tags are numbered from the lower left, row by row, as Kalibr prints them.

    Point 4 n + i is corner i of tag n, clockwise from its upper left as the board stands.
    """

    columns: int  # tags
    rows: int
    tag_m: float  # side of a tag
    spacing: float  # gap between tags over their side
    size_sigma: float = SIZE_SIGMA

    name = "aprilgrid"
    ambiguous = False
    least_corners = 4 * LEAST_TAGS

    @property
    def target(self) -> Target:
        """Four corners of every tag."""
        flat = self._corners()
        points = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
        return Target(self.name, points, self.size_sigma)

    @property
    def spec(self) -> str:
        """aprilgrid:6x6:55mm:0.3"""
        return f"aprilgrid:{self.columns}x{self.rows}:{1e3 * self.tag_m:g}mm:{self.spacing:g}"

    def _corners(self) -> Float[np.ndarray, "K 2"]:
        pitch = self.tag_m * (1 + self.spacing)
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        first = pitch * np.stack([column, self.rows - 1 - row], axis=1)
        square = self.tag_m * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        return (first[:, None] + square[None]).reshape(-1, 2)

    def find(self, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
        """The corners of all tags that were decoded and lie on the grid, mirrored or not."""
        return find_either_way(self._find, grey)

    def _find(self, grey: UInt8[np.ndarray, "H W"]) -> BoardCorners | None:
        seen = max((self._tags(detector, grey) for detector in self._detectors), key=lambda found: len(found[0]))
        numbers, corners = self._on_grid(*seen)
        if len(numbers) < LEAST_TAGS:
            return None
        ids = (4 * numbers[:, None] + np.arange(4)).ravel()
        pixels = self._by_neighbours(ids, corners.reshape(-1, 2))
        half = int(np.clip(WINDOW_SHARE * corner_spacing_px(pixels), 1, WINDOW_PX))
        end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        there = cv2.cornerSubPix(grey, pixels.astype(np.float32)[:, None].copy(), (half, half), (-1, -1), end)[:, 0]
        near = np.linalg.norm(there - pixels, axis=1) <= max(LEAST_FAR_PX, FAR * corner_spacing_px(pixels))
        if near.sum() < self.least_corners:
            return None
        return BoardCorners(ids[near], there[near].astype(float), edge_width_px(grey, there[near]))

    def _by_neighbours(self, ids: Int[np.ndarray, " K"], pixels: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
        """Each corner where the homography of those around it has it, if it lies far from there.

        The small squares between tags touch their corners, and now and then draw one of a tag's corners away.
        """
        flat = self._corners()[ids]
        far = max(LEAST_FAR_PX, FAR * corner_spacing_px(pixels)) / 2
        found = pixels.copy()
        for own, place in enumerate(flat):
            around = np.argsort(np.linalg.norm(flat - place, axis=1))[1 : NEIGHBOURS + 1]
            local, _ = cv2.findHomography(flat[around], pixels[around], cv2.LMEDS)
            if local is None:
                continue
            there = cv2.perspectiveTransform(place.reshape(1, 1, 2), local)[0, 0]
            if np.linalg.norm(there - pixels[own]) > far:
                found[own] = there
        return found

    def _tags(
        self, detector: cv2.aruco.ArucoDetector, grey: UInt8[np.ndarray, "H W"]
    ) -> tuple[Int[np.ndarray, " T"], Float[np.ndarray, "T 4 2"]]:
        corners, ids, _ = detector.detectMarkers(grey)
        if ids is None:
            return np.zeros(0, int), np.zeros((0, 4, 2))
        numbers, once = np.unique(ids.ravel(), return_index=True)
        own = numbers < self.columns * self.rows
        return numbers[own].astype(np.int64), np.stack(corners)[once[own], 0].astype(float)

    def _on_grid(
        self, numbers: Int[np.ndarray, " T"], corners: Float[np.ndarray, "T 4 2"]
    ) -> tuple[Int[np.ndarray, " T"], Float[np.ndarray, "T 4 2"]]:
        """Tags that one homography explains, with the corner first that is the upper left of the standing board.

        How a printed family is turned against a detector's idea of it differs, so each of four ways is tried.
        """
        best = numbers[:0], corners[:0]
        if len(numbers) < LEAST_TAGS:
            return best
        grid = self._corners().reshape(-1, 4, 2)[numbers].astype(np.float32)
        side = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)))
        for turn in range(4):
            turned = np.roll(corners, turn, axis=1)
            there, _ = cv2.findHomography(grid.reshape(-1, 2), turned.reshape(-1, 2), cv2.RANSAC, AGREE * side)
            if there is None:
                continue
            seen = cv2.perspectiveTransform(grid.reshape(1, -1, 2), there).reshape(-1, 4, 2)
            fits = (np.linalg.norm(seen - turned, axis=-1) < AGREE * side).all(axis=1)
            if fits.sum() > len(best[0]):
                best = numbers[fits], turned[fits]
        return best

    @cached_property
    def _detectors(self) -> list[cv2.aruco.ArucoDetector]:
        detectors = []
        for border in BORDERS:
            parameters = cv2.aruco.DetectorParameters()
            parameters.markerBorderBits = border
            parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
            detectors.append(cv2.aruco.ArucoDetector(dictionary_of(FAMILY), parameters))
        return detectors

    @property
    def print_size_mm(self) -> tuple[float, float]:
        """A gap of margin around the small squares at the outer corners."""
        tag, gap = 1e3 * self.tag_m, 1e3 * self.tag_m * self.spacing
        return self.columns * (tag + gap) + 3 * gap, self.rows * (tag + gap) + 3 * gap

    def dark_mm(self) -> Float[np.ndarray, "N 4"]:
        """The tags, and the small squares where their corners meet."""
        tag, gap = 1e3 * self.tag_m, 1e3 * self.tag_m * self.spacing
        family = dictionary_of(FAMILY)
        parts = []
        for number in range(self.columns * self.rows):
            row, column = divmod(number, self.columns)
            left, top = 2 * gap + (tag + gap) * column, 2 * gap + (tag + gap) * (self.rows - 1 - row)
            parts.append(marker_rectangles(family, number, left, top, tag, BORDERS[0]))
        across, down = np.meshgrid(np.arange(self.columns + 1), np.arange(self.rows + 1))
        spots = gap + (tag + gap) * np.stack([across.ravel(), down.ravel()], axis=1)
        parts.append(np.concatenate([spots, np.full(spots.shape, gap)], axis=1))
        return np.concatenate(parts)
