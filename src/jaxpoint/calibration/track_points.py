"""Points in 3-D of tracks, by known cameras: views that contradict the others are left out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.camera.rig import CameraRig
from jaxpoint.tracks import Tracks
from jaxpoint.triangulation import Triangulation, triangulate

MAD = 1.4826  # standard deviations of a Gaussian in its median absolute deviation


@dataclass(frozen=True)
class TrackPoints:
    """The point of each of the F rows of tracks."""

    points: Float[np.ndarray, "F 3"]  # in the unit of the rig, 0 where not valid
    valid: Bool[np.ndarray, " F"]
    sigmas: Float[np.ndarray, " F"]  # standard deviation of each coordinate (root mean square of the three)
    rms_px: Float[np.ndarray, " F"]
    used: Bool[np.ndarray, "F C"]  # the views that it is made of
    sigma_px: float  # noise of a pixel coordinate, as the residuals show it


def points_of_tracks(
    rig: CameraRig, tracks: Tracks, max_error_px: float, camera_covariance: Float[np.ndarray, "D D"] | None = None
) -> TrackPoints:
    """The points of tracks, each by two views or more whose reprojection error is small enough.

    Where the error of a point is above `max_error_px`, the view is left out without which it is smallest, as long as
    two are left; then the point is.

    Args:
        rig: the cameras of the tracks, in their order.
        tracks: with C cameras.
        max_error_px: largest root-mean-square reprojection error of a point.
        camera_covariance: of the rig's parameters, D = p C; its effect is part of the sigmas.
    """
    used = tracks.visible.copy()
    find = partial(triangulate, rig, tracks.pixels, camera_covariance=camera_covariance)  # one program for all rounds
    found = find(used)
    for _ in range(tracks.cameras - 2):
        bad = np.flatnonzero((np.asarray(found.rms) > max_error_px) & (used.sum(axis=1) > 2))
        if not len(bad):
            break
        used[bad] = _without_worst(rig, tracks.pixels[bad], used[bad])
        found = find(used)
    sigma_px = _noise(found, used)
    found = find(used, sigma_px=sigma_px)
    rms, valid = np.asarray(found.rms), np.asarray(found.valid) & (np.asarray(found.rms) <= max_error_px)
    variance = np.trace(np.asarray(found.covariance), axis1=-2, axis2=-1) / 3
    return TrackPoints(
        np.where(valid[:, None], np.asarray(found.points), 0.0),
        valid,
        np.sqrt(np.where(valid, variance, 0.0)),
        np.where(valid, rms, 0.0),
        used & valid[:, None],
        sigma_px,
    )


def _without_worst(
    rig: CameraRig, pixels: Float[np.ndarray, "N C 2"], used: Bool[np.ndarray, "N C"]
) -> Bool[np.ndarray, "N C"]:
    """The views without that one whose absence leaves the smallest error."""
    cameras = used.shape[1]
    without = used[:, None] & ~np.eye(cameras, dtype=bool)[None]  # N, left out, C
    repeated = np.broadcast_to(pixels[:, None], (len(pixels), cameras, cameras, 2))
    rms = np.asarray(triangulate(rig, repeated, without, covariance=False).rms)
    best = np.where(used, rms, np.inf).argmin(axis=1)
    return without[np.arange(len(pixels)), best]


def _noise(found: Triangulation, used: Bool[np.ndarray, "F C"]) -> float:
    """Standard deviation of a pixel coordinate, px, robust; each point has taken three unknowns from its residuals."""
    enough = np.asarray(found.valid)
    views = used[enough].sum(axis=1)
    spare = float((2 * views - 3).sum())
    if spare <= 0:
        return 1.0
    residuals = np.asarray(found.residuals)[enough][used[enough]]
    return MAD * float(np.median(np.abs(residuals))) * np.sqrt(2 * views.sum() / spare)
