"""Where single views of a board put one camera against another, beside where the calibration has it.

Both poses of a view come from its own camera alone, its lens as calibrated, so that a board that moved between two
exposures shows: the poses then differ from view to view by more than the noise of corners explains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.row_groups import posed_rows
from jaxpoint.calibration.sight import derivatives, poses

STEPS = 6
LEAST = 6  # corners of a view
LEAST_VIEWS = 4


@dataclass(frozen=True)
class ViewPose:
    """What one view says of where the second camera stands: the difference from the calibration, in its frame."""

    frame_id: int
    turn: Float[np.ndarray, "3"]  # rad
    shift: Float[np.ndarray, "3"]  # m
    chi_square: float  # of these six against their covariance


@dataclass(frozen=True)
class PairScatter:
    """How the views of two cameras scatter."""

    first: int
    second: int
    views: tuple[ViewPose, ...]

    @property
    def ratio(self) -> float:
        """Scatter over what noise explains, 1 where it explains all: of the median view."""
        # The median of chi-square with six degrees of freedom is 5.35.
        return float(np.sqrt(np.median([view.chi_square for view in self.views]) / 5.35))

    @property
    def shift_m(self) -> float:
        """Rms length of the shifts."""
        return float(np.sqrt(np.mean([view.shift @ view.shift for view in self.views])))

    @property
    def turn_deg(self) -> float:
        """Rms angle of the turns."""
        return float(np.degrees(np.sqrt(np.mean([view.turn @ view.turn for view in self.views]))))


def pair_scatter(calibration: Calibration) -> list[PairScatter]:
    """Of every two cameras that share enough views of one of the targets."""
    found: dict[tuple[int, int], list[ViewPose]] = {}
    for number in range(len(calibration.tracks.targets)):
        for rows in calibration.tracks.rows_of_target(number, posed_rows(calibration)):
            rows = rows[rows >= 0]
            seen = calibration.tracks.visible[rows].sum(axis=0) >= LEAST
            own = {camera: _moved(calibration, rows, camera) for camera in np.flatnonzero(seen).tolist()}
            for first in own:
                for second in own:
                    if first < second:
                        pose = _between(calibration, rows, own[first], own[second], second)
                        found.setdefault((first, second), []).append(pose)
    return [PairScatter(*pair, tuple(views)) for pair, views in found.items() if len(views) >= LEAST_VIEWS]


Moved = tuple[np.ndarray, np.ndarray, np.ndarray]  # rotation, translation (target moved in the world), covariance


def _moved(calibration: Calibration, rows: np.ndarray, camera: int) -> Moved:
    """The motion of the target (about its middle) that fits its view in one camera best, and its covariance."""
    points = calibration.points[rows]
    middle = points.mean(axis=0)
    seen = calibration.tracks.visible[rows, camera]
    pixels = calibration.tracks.pixels[rows, camera]
    one = calibration.rig.select([camera])
    rotation, shift = np.eye(3), np.zeros(3)
    weights, normal = seen.astype(float), np.eye(6)
    for _ in range(STEPS):
        placed = (points - middle) @ rotation.T + middle + shift
        residual = np.asarray(_project(one, placed)) - pixels
        _, by_point = derivatives(one, placed, seen[:, None])
        lever = placed - middle - shift
        turning = np.swapaxes(np.cross(np.eye(3)[None], lever[:, None, :]), 1, 2)  # (K, 3, 3 of w)
        columns = by_point[:, 0] @ np.concatenate([turning, np.broadcast_to(np.eye(3), turning.shape)], axis=2)
        square = (residual**2).sum(axis=1)
        weights = seen / (1.0 + square / (3.0 * calibration.sigma_px) ** 2)  # Cauchy, so that one corner spoils nothing
        normal = np.einsum("kia,k,kib->ab", columns, weights, columns)
        step = -np.linalg.solve(normal, np.einsum("kia,k,ki->a", columns, weights, residual))
        rotation = Rotation.from_rotvec(step[:3]).as_matrix() @ rotation
        shift = shift + step[3:]
    return rotation, shift, calibration.sigma_px**2 * np.linalg.inv(normal)


def _project(rig, points: np.ndarray) -> np.ndarray:
    """Pixels (K, 2) in the only camera of a rig, by numpy."""
    rotation, translation = (part[0] for part in poses(rig))
    local = points @ rotation.T + translation
    lens = rig[0].lens
    return np.stack(type(lens).slopes_of(list(np.asarray(lens.parameters)), tuple(local.T), np).pixel, axis=1)


def _between(calibration: Calibration, rows, one: Moved, other: Moved, second: int) -> ViewPose:
    """What the second camera's pose must change by for both views to be of one board."""
    # The board stands at M1 by the first camera and at M2 by the second: the second camera errs by M2 M1^-1 about the
    # board's middle, seen from its own frame.
    middle = calibration.points[rows].mean(axis=0)
    turn = other[0] @ one[0].T
    vector = Rotation.from_matrix(turn).as_rotvec()
    gap = np.concatenate([vector, other[1] - one[1]])
    chi = float(gap @ np.linalg.solve(one[2] + other[2], gap))
    rotation, translation = (part[second] for part in poses(calibration.rig))
    at = middle + one[1]
    shift = other[1] - one[1] + (at - turn @ at)  # of the world, x -> turn x + shift
    # cam2_from_world after (turn, shift): R turn, R shift + t; against R, t in the camera's frame.
    changed = rotation @ turn @ rotation.T
    moved = rotation @ shift + translation - changed @ translation
    return ViewPose(int(calibration.tracks.frame_ids[rows[0]]), rotation @ vector, moved, chi)
