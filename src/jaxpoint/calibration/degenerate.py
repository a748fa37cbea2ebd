"""Paths of the light that cannot calibrate anything, found from what the pairs say or from the points themselves."""

from __future__ import annotations

import numpy as np

from jaxpoint.calibration.twoview import NormalisedTracks, TwoViewGeometry, undistort_points
from jaxpoint.errors import ContradictionError, InsufficientDataError
from jaxpoint.tracks import Tracks

MIN_INLIERS = 15  # matches that fit a camera's best pair
MIN_INLIER_SHARE = 0.4
PLANE_ERROR_PX = 3.0  # at a width of 1280: a homography this good between all views means a planar path
MIN_THICKNESS = 0.01  # smallest over largest extent of the light's path (standard deviations)


def check_geometry(tracks: Tracks, data: NormalisedTracks, geometry: TwoViewGeometry) -> None:
    """Refuse recordings whose pairs do not fit together or whose light stays on a plane.

    Raises:
        InsufficientDataError: with the camera, the number and what to record.
    """
    for camera, name in enumerate(tracks.names):
        inliers, shared = geometry.inliers[camera], geometry.shared[camera]
        best = int(np.argmax(inliers))
        if inliers[best] < MIN_INLIERS or inliers[best] < MIN_INLIER_SHARE * shared[best]:
            raise ContradictionError(
                f"Camera '{name}' fits no other: of {shared[best]} frames shared with '{tracks.names[best]}' only "
                f"{inliers[best]} agree with one epipolar geometry. Does it show the same light at the same time? "
                "`jaxpoint check` finds cameras that are late or run at another rate; or leave it out (--leave-out "
                f"{name}).",
                camera,
                "contradicting camera",
            )
    errors = [_homography_error(data, geometry, pair) for pair in geometry.fundamentals]
    worst = max(errors, default=np.inf)
    limit = PLANE_ERROR_PX * float(data.widths.mean()) / 1280.0
    if worst < limit:
        raise InsufficientDataError(
            f"The light moves on a plane, or all cameras stand in one place: one homography maps it between any two "
            f"cameras to {worst:.1f} px. Wave it through the whole volume of the room, near and far, high and low, and "
            "set the cameras apart."
        )


def _homography_error(data: NormalisedTracks, geometry: TwoViewGeometry, pair: tuple[int, int]) -> float:
    """The 80 % quantile of the transfer error (px) of the best homography between two views."""
    i, j = pair
    points, weight = undistort_points(data.points, geometry.lenses)
    both = data.visible[:, i] & data.visible[:, j] & (weight[:, i] > 0) & (weight[:, j] > 0)
    first, second = points[both, i], points[both, j]
    if len(first) < 10:
        return 0.0
    trust = np.ones(len(first))
    error = np.zeros(len(first))
    for _ in range(8):
        error = _transfer_error(_homography(first, second, trust), first, second) * data.half_diagonals[j]
        trust = 1.0 / (1.0 + (error / max(np.median(error), 1e-6)) ** 2)
    return float(np.quantile(error, 0.8))


def _homography(first: np.ndarray, second: np.ndarray, weights: np.ndarray) -> np.ndarray:
    ones, zeros = np.ones((len(first), 1)), np.zeros((len(first), 3))
    a = np.concatenate([first, ones], axis=1)
    rows = np.concatenate(
        [
            np.concatenate([a, zeros, -second[:, :1] * a], axis=1),
            np.concatenate([zeros, a, -second[:, 1:] * a], axis=1),
        ]
    )
    return np.linalg.svd(rows * np.sqrt(np.tile(weights, 2))[:, None], full_matrices=False)[2][8].reshape(3, 3)


def _transfer_error(matrix: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    mapped = np.concatenate([first, np.ones((len(first), 1))], axis=1) @ matrix.T
    third = np.where(np.abs(mapped[:, 2]) < 1e-9, 1e-9, mapped[:, 2])
    return np.linalg.norm(mapped[:, :2] / third[:, None] - second, axis=1)


def check_volume(points: np.ndarray) -> None:
    """Refuse a light's path (P, 3) without volume.

    Raises:
        InsufficientDataError: the path is nearly a plane or a line.
    """
    if len(points) < 4:
        raise InsufficientDataError(
            f"Only {len(points)} positions of the light could be found: the recordings do not fit together; see by "
            "`jaxpoint check` whether all cameras show one light at one time."
        )
    centred = points - np.median(points, axis=0)
    near = np.linalg.norm(centred, axis=1) <= 5 * np.median(np.linalg.norm(centred, axis=1))
    extent = np.linalg.svd(centred[near] - centred[near].mean(axis=0), compute_uv=False) / np.sqrt(near.sum())
    if extent[2] < MIN_THICKNESS * extent[0]:
        raise InsufficientDataError(
            f"The light's path is {extent[2] / extent[0]:.1%} as thick as it is long, and {MIN_THICKNESS:.0%} is the "
            "least; wave it through the whole volume of the room, not on a plane or a line."
        )
