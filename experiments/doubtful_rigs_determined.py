"""What a recording of `doubtful_rigs.py` determines at best: the covariance at the truth, by the true projection.

Unknown are, of every camera, pose, focal length, principal point (drawn to the middle of the image by 5 % of its width
where the image is not cropped; free where it is), k1 and k2 (drawn to 0 by 1), and the pixel aspect of all cameras
where some have pixels that are not square; and every point. The free gauge is that of the calibration: light and
centres alike. Cameras at fault in time, frozen, mirrored or of another room are left out, gross outliers too.

A rig counts as determined where this predicts every focal length better than 3 % and every centre better than 2 % of
the rig's extent (1 sigma), and where a Brown lens with the right focal length follows each equidistant lens to within
the noise as far as the light was seen (a lens that no model offered can express is determined by no data).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from doubtful_rigs_cameras import PARAMETERS, Cameras
from doubtful_rigs_faults import ONE_CAMERA
from doubtful_rigs_generator import Rig

FOCAL_BOUND, CENTRE_BOUND = 0.03, 0.02
CENTRE_SIGMA, RADIAL_SIGMA = 0.05, 1.0  # of the image width; of k1 and k2
STEPS = np.array([1e-6] * 3 + [1e-6] * 3 + [1e-6] * 2 + [1e-4] * 2 + [1e-6] * 2)
POINT_STEP_M = 1e-6


@dataclass(frozen=True)
class Determined:
    """How well a rig is determined at best; None where nothing holds it."""

    focal: float | None = None  # largest relative standard deviation
    centre: float | None = None  # largest, of the rig's extent
    lens_px: float = 0.0  # rms by which the best Brown lens misses an equidistant one, over the noise at most 1

    @property
    def enough(self) -> bool:
        """Whether a right result can be asked for."""
        if self.focal is None or self.centre is None:
            return False
        return self.focal < FOCAL_BOUND and self.centre < CENTRE_BOUND and self.lens_px <= 1.0


def determined(rig: Rig) -> Determined:
    """Predict the error of a rig from its truth."""
    left_out = {camera for fault in rig.faults if fault.kind in ONE_CAMERA for camera in fault.cameras}
    chosen = np.array([c for c in range(len(rig.cameras)) if c not in left_out])
    seen = (rig.tracks.visible & ~rig.outliers)[:, chosen]
    frames = np.flatnonzero(seen.sum(axis=1) >= 2)
    cameras, points, seen = rig.cameras.select(chosen), rig.light[frames], seen[frames]
    if len(cameras) < 3:
        return Determined()
    covariance = _covariance(cameras, points, seen, rig.noise_px, *_unknown(rig, chosen))
    if covariance is None:
        return Determined()
    variance = np.diagonal(covariance).reshape(len(cameras), PARAMETERS)
    focal = np.sqrt(np.maximum(variance[:, 6], 0.0)).max()
    centre = np.sqrt(np.maximum(variance[:, 3:6].sum(axis=1), 0.0)).max() / cameras.extent_m
    return Determined(float(focal), float(centre), _lens_misfit(cameras, points, seen) / rig.noise_px)


def _unknown(rig: Rig, chosen: np.ndarray) -> tuple[Bool[np.ndarray, "C 12"], Float[np.ndarray, "C 12"]]:
    """What is free, and the standard deviation of its prior."""
    kinds = {fault.kind: set(fault.cameras) for fault in rig.faults}
    free, sigma = np.ones((len(chosen), PARAMETERS), bool), np.full((len(chosen), PARAMETERS), np.inf)
    free[:, 7] = "aspect" in kinds
    sigma[:, 8:10] = CENTRE_SIGMA * rig.cameras.size[chosen, :1]
    sigma[[camera in kinds.get("crop", ()) for camera in chosen], 8:10] = np.inf
    sigma[:, 10:] = RADIAL_SIGMA
    return free, sigma


def _covariance(
    cameras: Cameras,
    points: Float[np.ndarray, "F 3"],
    seen: Bool[np.ndarray, "F C"],
    noise_px: float,
    free: Bool[np.ndarray, "C 12"],
    sigma: Float[np.ndarray, "C 12"],
) -> Float[np.ndarray, "D D"] | None:
    """Of the cameras, in the frame that fits light and centres best; None where more than a similarity is open."""
    normal = _normal(cameras, points, seen) / noise_px**2
    size = free.size
    normal[np.arange(size), np.arange(size)] += sigma.ravel() ** -2.0
    ways, placed = _similarities(cameras, points)
    every = np.concatenate([free.ravel(), np.ones(3 * len(points), bool)])
    normal, ways, placed = normal[np.ix_(every, every)], ways[every], placed[every]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal), 1e-30))
    hold = placed * np.sqrt(np.diagonal(normal)[-3 * len(points) :].mean() / (placed**2).sum(axis=0))
    matrix = (normal + hold @ hold.T) * np.outer(scale, scale)
    try:
        root = cho_factor(matrix, check_finite=False)
        left = np.linalg.inv(hold.T @ ways)
    except LinAlgError:
        return None
    count = int(free.sum())
    inverse = cho_solve(root, np.eye(len(matrix), count))[:count] * np.outer(scale[:count], scale[:count])
    found = np.zeros((size, size))
    found[np.ix_(free.ravel(), free.ravel())] = inverse - ways[:count] @ left @ left.T @ ways[:count].T
    return found


def _normal(cameras: Cameras, points: np.ndarray, seen: np.ndarray) -> Float[np.ndarray, "N N"]:
    """J^T J of all cameras and points, by central differences."""
    count, frames = len(cameras), len(points)
    by_camera, by_point = _derivatives(cameras, points, seen)
    size = PARAMETERS * count
    normal = np.zeros((size + 3 * frames, size + 3 * frames))
    own = np.einsum("fcip,fciq->cpq", by_camera, by_camera)
    mixed = np.einsum("fcip,fcix->cpfx", by_camera, by_point).reshape(size, 3 * frames)
    each = np.einsum("fcix,fciy->fxy", by_point, by_point)
    for c in range(count):
        block = slice(PARAMETERS * c, PARAMETERS * (c + 1))
        normal[block, block] = own[c]
    normal[:size, size:], normal[size:, :size] = mixed, mixed.T
    for x in range(3):
        for y in range(3):
            normal[size + 3 * np.arange(frames) + x, size + 3 * np.arange(frames) + y] = each[:, x, y]
    return normal


def _derivatives(cameras: Cameras, points: np.ndarray, seen: np.ndarray):
    """Of the pixels by the parameters of `Cameras.moved` (F, C, 2, 12) and by the points (F, C, 2, 3)."""
    shown = np.repeat(points[:, None], len(cameras), axis=1)
    by_camera, by_point = np.zeros((*seen.shape, 2, PARAMETERS)), np.zeros((*seen.shape, 2, 3))
    for p, step in enumerate(STEPS):
        change = np.zeros((len(cameras), PARAMETERS))
        change[:, p] = step
        ahead, behind = cameras.moved(change).project(shown), cameras.moved(-change).project(shown)
        by_camera[..., p] = (ahead - behind) / (2 * step)
    for x, step in enumerate(POINT_STEP_M * np.eye(3)):
        by_point[..., x] = (cameras.project(shown + step) - cameras.project(shown - step)) / (2 * POINT_STEP_M)
    return np.where(seen[..., None, None], by_camera, 0.0), np.where(seen[..., None, None], by_point, 0.0)


def _similarities(cameras: Cameras, points: np.ndarray):
    """How shift, turn and growth of the world move everything (N, 7), and the same for points and centres alone."""
    places = np.concatenate([cameras.position, points])
    moved = np.zeros((len(places), 3, 7))
    moved[:, :, :3], moved[:, :, 6] = np.eye(3), places
    moved[:, :, 3:6] = np.cross(places[:, None, :], -np.eye(3)[None]).swapaxes(1, 2)
    count = len(cameras)
    ways = np.zeros((count, PARAMETERS, 7))
    ways[:, :3, 3:6], ways[:, 3:6] = -cameras.rotation, moved[:count]
    placed = ways.copy()
    placed[:, :3] = 0.0
    rest = moved[count:].reshape(-1, 7)
    return tuple(np.concatenate([part.reshape(-1, 7), rest]) for part in (ways, placed))


def _lens_misfit(cameras: Cameras, points: np.ndarray, seen: np.ndarray) -> float:
    """Largest rms (px) by which k1, k2, k3 of a perspective lens of the same focal length miss an equidistant one."""
    local = cameras.local(np.repeat(points[:, None], len(cameras), axis=1))
    angles = np.arctan2(np.hypot(local[..., 0], local[..., 1]), local[..., 2])
    worst = 0.0
    for c in np.flatnonzero(cameras.equidistant):
        angle = angles[seen[:, c], c]
        slope = np.tan(angle)
        powers = slope[:, None] ** [3, 5, 7]
        size = np.linalg.norm(powers, axis=0)
        found = np.linalg.lstsq(powers / size, angle - slope)[0]
        miss = cameras.focal[c] * (powers / size @ found - (angle - slope))
        worst = max(worst, float(np.sqrt((miss**2).mean())))
    return worst
