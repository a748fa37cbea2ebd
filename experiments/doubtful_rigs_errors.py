"""How far a delivered calibration of `doubtful_rigs.py` is from the truth, beside what it predicts.

Light and centres, as estimated, are brought to the truth by the similarity that fits all of them best, every point and
every centre alike: the gauge of the predicted covariance (`calibration.uncertainty`, gauge "free"). What then is more
than five times as far off as the middle one no longer counts for the fit. Where cameras were brought to one clock, the
light may be on the first camera's; the clock that fits better counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from doubtful_rigs_generator import Rig
from jaxpoint.calibration.gauge import centres_by_parameters
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.sight import centres

FAR = 5.0  # times the median distance


@dataclass(frozen=True)
class CameraError:
    """One camera beside the truth; `sigma`: predicted standard deviation (of a vector: rms length), 0 without one.

    `square`: squared distance in units of the predicted covariance, None without one.
    """

    name: str
    focal: tuple[float, float]  # relative, in x and y
    focal_sigma: tuple[float, float]
    centre: float  # of the rig's extent
    centre_sigma: float
    centre_square: float | None
    rotation_deg: float
    rotation_sigma_deg: float
    rotation_square: float | None


@dataclass(frozen=True)
class Fit:
    """world = scale * turn @ solver + shift."""

    scale: float
    turn: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]
    misfit: float  # median distance, m

    def __call__(self, places: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Places of the solver's frame in the world."""
        return self.scale * places @ self.turn.T + self.shift


def errors_of(calibration: Calibration, rig: Rig) -> tuple[CameraError, ...]:
    """Every delivered camera beside its truth."""
    found, names = calibration.rig, calibration.rig.names
    true = rig.cameras.select(np.array([rig.tracks.names.index(name) for name in names]))
    fit = best_fit(calibration, rig, true.position)
    turned = np.asarray(found.cameras.cam_from_world.rotation) @ fit.turn.T
    angles = Rotation.from_matrix(turned @ np.swapaxes(true.rotation, 1, 2)).as_rotvec()
    focal = np.asarray(found.cameras.focal) / true.focals - 1
    extent = rig.cameras.extent_m
    moved = (fit(centres(found)) - true.position) / extent
    focal_sigma, centre, rotation = _predicted(calibration, fit)
    centre = centre / extent**2
    focal_sigma = focal_sigma / true.focals
    return tuple(
        CameraError(
            name,
            (float(focal[c, 0]), float(focal[c, 1])),
            (float(focal_sigma[c, 0]), float(focal_sigma[c, 1])),
            float(np.linalg.norm(moved[c])),
            _length(centre[c]),
            _square(moved[c], centre[c]),
            float(np.rad2deg(np.linalg.norm(angles[c]))),
            float(np.rad2deg(_length(rotation[c]))),
            _square(angles[c], rotation[c]),
        )
        for c, name in enumerate(names)
    )


def best_fit(calibration: Calibration, rig: Rig, positions: Float[np.ndarray, "C 3"]) -> Fit:
    """From the solver's frame to the world, by light and centres."""
    rows = np.asarray(calibration.tracks.frame_ids)
    valid = np.asarray(calibration.point_valid) & (rows >= 0) & (rows < len(rig.light))
    source = np.concatenate([centres(calibration.rig), np.asarray(calibration.points)[valid]])
    clocks = (rig.light, rig.clock_of_first)
    fits = [_robust_fit(source, np.concatenate([positions, light[rows[valid]]])) for light in clocks]
    return min(fits, key=lambda fit: fit.misfit)


def _robust_fit(source: np.ndarray, target: np.ndarray) -> Fit:
    spread = np.linalg.norm(source - np.median(source, axis=0), axis=1)
    chosen = spread <= FAR * np.median(spread)  # a point that is far out would decide alone
    fit = similarity(source[chosen], target[chosen])
    for _ in range(5):
        away = np.linalg.norm(fit(source) - target, axis=1)
        chosen = away <= FAR * max(float(np.median(away)), 1e-12)
        fit = similarity(source[chosen], target[chosen])
    away = np.linalg.norm(fit(source) - target, axis=1)
    return Fit(fit.scale, fit.turn, fit.shift, float(np.median(away)))


def similarity(source: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]) -> Fit:
    """The similarity (never a mirror image) that fits best in the least-squares sense (Umeyama 1991)."""
    middle, aim = source.mean(axis=0), target.mean(axis=0)
    left, stretch, right = np.linalg.svd((target - aim).T @ (source - middle))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = (left * sign) @ right
    scale = float((stretch * sign).sum() / max(((source - middle) ** 2).sum(), 1e-30))
    return Fit(scale, turn, aim - scale * turn @ middle, 0.0)


def _predicted(calibration: Calibration, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations of focal lengths (C, 2), px; covariances of centres (m^2, world) and rotations (rad^2)."""
    count = len(calibration.rig)
    if calibration.camera_covariance is None:
        return np.zeros((count, 2)), np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    whole = np.asarray(calibration.camera_covariance).reshape(count, -1, count, calibration.rig.camera_size)
    own = np.einsum("cpcq->cpq", whole)
    turn = fit.scale * fit.turn @ centres_by_parameters(calibration.rig)
    focal = np.sqrt(np.maximum(np.diagonal(own, axis1=1, axis2=2)[:, 6:8], 0.0))
    return focal, turn @ own @ np.swapaxes(turn, 1, 2), own[:, :3, :3]


def _length(covariance: np.ndarray) -> float:
    return float(np.sqrt(max(np.trace(covariance), 0.0)))


def _square(error: np.ndarray, covariance: np.ndarray) -> float | None:
    if not np.trace(covariance) > 0:
        return None
    return float(error @ np.linalg.pinv(covariance, rcond=1e-12, hermitian=True) @ error)
