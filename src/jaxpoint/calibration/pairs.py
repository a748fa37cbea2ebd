"""What the cameras share, and whether that is enough to calibrate: known before anything is solved."""

from __future__ import annotations

import numpy as np

from jaxpoint.calibration.result import PairTable
from jaxpoint.calibration.stuck import refuse_stuck
from jaxpoint.errors import ContradictionError, InsufficientDataError
from jaxpoint.tracks import Tracks

GRID = (8, 6)  # cells of the image, for the area covered
MIN_FRAMES = 20  # frames that a camera must share with the others
MIN_COVERAGE = 0.06  # fraction of the cells that a camera's light must visit: 3 of 48


def pair_table(tracks: Tracks) -> PairTable:
    """Frames shared by each two cameras, and the image area that the light visited."""
    visible = tracks.visible.astype(np.int64)
    cells = np.floor(tracks.pixels / tracks.image_sizes * np.array(GRID)).astype(int)
    cells = np.clip(cells, 0, np.array(GRID) - 1)
    coverage = np.zeros(tracks.cameras)
    for camera in range(tracks.cameras):
        seen = cells[tracks.visible[:, camera], camera]
        coverage[camera] = len(np.unique(seen, axis=0)) / (GRID[0] * GRID[1])
    return PairTable(tracks.names, visible.sum(axis=0), visible.T @ visible, coverage)


def check_pairs(tracks: Tracks, table: PairTable, *, known_intrinsics: bool = False) -> None:
    """Refuse tracks that cannot determine a calibration.

    Raises:
        InsufficientDataError: too few cameras or frames, a camera that shares too little, cameras that fall into
            unconnected groups, identical cameras, a light that hardly moves or stays in one corner of an image, or
            many sightings at one and the same pixel.
            The message names the camera and what to record.
    """
    needed = 2 if known_intrinsics else 3
    if tracks.cameras < needed:
        hint = "" if known_intrinsics else "; two are enough only with known intrinsics (--intrinsics)"
        raise InsufficientDataError(
            f"Self-calibration needs at least {needed} cameras, but there {_are(tracks.cameras)}{hint}."
        )
    usable = int((tracks.visible.sum(axis=1) >= 2).sum())
    if usable < MIN_FRAMES:
        raise InsufficientDataError(
            f"Only {usable} frames are seen by two or more cameras, and at least {MIN_FRAMES} are needed; if the light "
            "was in several views at once, their frame numbers do not belong together (`jaxpoint check`); else wave it "
            "longer where the views overlap."
        )
    refuse_stuck(tracks)
    _check_shared(table)
    _check_connected(table)
    _check_motion(tracks, table)
    _check_identical(tracks)


def _are(count: int) -> str:
    return f"is {count}" if count == 1 else f"are {count}"


def _check_shared(table: PairTable) -> None:
    shared = table.shared.copy()
    np.fill_diagonal(shared, 0)
    best = shared.max(axis=1)
    worst = int(best.argmin())
    if best[worst] < MIN_FRAMES:
        raise InsufficientDataError(
            f"Camera '{table.names[worst]}' shares {best[worst]} frames with its best partner, and {MIN_FRAMES} are "
            "needed. Wave the light longer in its view, or leave the camera out (--leave-out); if it saw the light, "
            "its frame numbers are not those of the others."
        )


def _check_connected(table: PairTable) -> None:
    linked = table.shared >= MIN_FRAMES
    reached = {0}
    while True:
        more = {int(j) for i in reached for j in np.flatnonzero(linked[i])} | reached
        if more == reached:
            break
        reached = more
    missing = [table.names[i] for i in range(len(table.names)) if i not in reached]
    if missing:
        raise InsufficientDataError(
            f"Cameras {', '.join(missing)} share fewer than {MIN_FRAMES} frames with all of the others "
            f"({', '.join(table.names[i] for i in sorted(reached))}); wave the light where both groups see it."
        )


def _check_motion(tracks: Tracks, table: PairTable) -> None:
    for camera, name in enumerate(tracks.names):
        seen = tracks.pixels[tracks.visible[:, camera], camera]
        spread = np.sqrt(np.linalg.eigvalsh(np.cov(seen.T)))  # px, along the two main directions
        width = tracks.image_sizes[camera, 0]
        if (seen == seen[0]).all():
            raise ContradictionError(
                f"Camera '{name}' has all its {len(seen)} sightings at one and the same pixel ({seen[0, 0]:g}, "
                f"{seen[0, 1]:g}): its images are frozen, or that pixel is hot; record anew, or drop the camera.",
                camera,
                "frozen camera",
            )
        if spread[1] < 0.005 * width:
            raise ContradictionError(
                f"The light hardly moves in camera '{name}': its pixels spread by {spread[1]:.1f} px (1 sd) of "
                f"{width}; its images are frozen, or it sees a lamp (mask it); else wave the light through the whole "
                "view.",
                camera,
                "frozen camera",
            )
        if spread[0] < 0.002 * width:
            raise InsufficientDataError(
                f"The light moves along a straight line in camera '{name}' ({spread[0]:.1f} px to its sides, 1 sd); "
                "wave it through the whole volume of the room."
            )
        if table.coverage[camera] < MIN_COVERAGE:
            raise InsufficientDataError(
                f"Camera '{name}' saw the light in {table.coverage[camera]:.0%} of its image area only, and "
                f"{MIN_COVERAGE:.0%} is the least; wave the light through the rest of its view."
            )


def _check_identical(tracks: Tracks) -> None:
    for first in range(tracks.cameras):
        for second in range(first + 1, tracks.cameras):
            both = tracks.visible[:, first] & tracks.visible[:, second]
            if both.sum() < MIN_FRAMES:
                continue
            apart = np.linalg.norm(tracks.pixels[both, first] - tracks.pixels[both, second], axis=1)
            if np.median(apart) < 1e-6 * tracks.image_sizes[first, 0]:
                raise InsufficientDataError(
                    f"Cameras '{tracks.names[first]}' and '{tracks.names[second]}' give identical pixels in "
                    f"{int(both.sum())} frames; one recording was given twice, so drop one of them."
                )
