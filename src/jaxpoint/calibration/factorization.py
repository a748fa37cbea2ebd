"""Projective cameras and points from all views at once (thesis 5.2, 5.3).

Default: rank-4 factorisation under a mask by the pseudo object-space error and variable projection, then a projective
bundle adjustment with a division-model lens. No pairwise poses are used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.calibration.bundle import LEAST_SQUARES
from jaxpoint.calibration.factors import Factors, fit_projective
from jaxpoint.calibration.recording import padded_cameras
from jaxpoint.calibration.twoview import NormalisedTracks, undistort_points
from jaxpoint.compilation import jit


@dataclass(frozen=True)
class Projective:
    """A projective reconstruction in normalised image coordinates."""

    cameras: np.ndarray  # (C, 3, 4), unit norm, most depths positive
    points: np.ndarray  # (N, 4)
    lenses: np.ndarray  # (C,) division-model parameters
    errors: np.ndarray  # (N, C) px of the distorted image
    cost: float


def factorise_tracks(
    data: NormalisedTracks, lenses: np.ndarray, kept: np.ndarray, rng: np.random.Generator
) -> Projective:
    """One factorisation from a random start.

    Args:
        lenses: division-model parameters (C,).
        kept: observations to use (N, C); frames with fewer than two are left out.
        rng: source of the random start.
    """
    points, weights = undistort_points(data.points, lenses)
    weights = np.where(_usable(kept), weights**2, 0.0)
    start = rng.normal(size=(len(lenses), 3, 4))
    start[:, 2] = [0.0, 0.0, 0.0, 1.0] + 0.1 * start[:, 2]
    places = np.zeros((len(points), 3))
    end = _solve(data, points, weights, start, np.zeros(len(lenses)), places)
    return normalise_projective(
        data, np.asarray(end.cameras)[: len(lenses)], np.asarray(end.points), lenses, kept, float(end.cost)
    )


def refine(data: NormalisedTracks, start: Projective, kept: np.ndarray, loss_px: float) -> Projective:
    """Projective bundle adjustment: cameras, points and one lens parameter a camera, Cauchy loss."""
    cameras = len(start.cameras)
    seen = start.points[:, 3:] != 0  # a frame that nobody saw must not spread NaN
    places = np.where(seen, start.points[:, :3], 0.0) / np.where(seen, start.points[:, 3:], 1.0)
    end = _solve(data, data.points, _usable(kept).astype(float), start.cameras, start.lenses, places, loss_px)
    found, lenses = np.asarray(end.cameras)[:cameras], np.asarray(end.lenses)[:cameras]
    return normalise_projective(data, found, np.asarray(end.points), lenses, kept, float(end.cost))


def _usable(kept: np.ndarray) -> np.ndarray:
    return kept & (kept.sum(axis=1) >= 2)[:, None]


def _solve(data, pixels, weights, cameras, lenses, places, loss_px: float | None = None) -> Factors:
    """The adjustment with this loss, or without one the factorisation; rigs are padded to one of few sizes."""
    pad = padded_cameras(len(cameras)) - len(cameras)

    def widened(array, axis):
        return np.pad(array, [(0, pad if i == axis else 0) for i in range(array.ndim)])

    flags = np.full(len(cameras) + pad, 1.0 if loss_px is None else 0.0)
    loss = np.float64(LEAST_SQUARES if loss_px is None else loss_px)
    parts = widened(cameras, 0), widened(lenses, 0), places, widened(data.half_diagonals, 0)
    return _program(widened(pixels, 1), widened(weights, 1), *parts, flags, loss)


_program = jit(fit_projective)  # one for both stages, and for every loss


def normalise_projective(data, cameras, points, lenses, kept, cost) -> Projective:
    """Signs such that most depths are positive, unit norms, and the errors in pixels; points (N, 3) or (N, 4)."""
    if points.shape[1] == 3:
        points = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    depth = np.einsum("cj,fj->fc", cameras[:, 2], points)
    signs = np.where((np.sign(depth) * kept).sum(axis=0) < 0, -1.0, 1.0)
    cameras = cameras * (signs / np.linalg.norm(cameras, axis=(1, 2)))[:, None, None]
    return Projective(cameras, points, lenses, projective_errors(data, cameras, points, lenses), cost)


def projective_errors(data: NormalisedTracks, cameras, points, lenses) -> np.ndarray:
    """Reprojection errors (N, C) in pixels of the distorted images."""
    local = np.einsum("cij,fj->fci", cameras, points)
    depth = local[..., 2:]
    straight = local[..., :2] / np.where(np.abs(depth) < 1e-12, 1e-12, depth)
    inner = np.maximum(1.0 - 4.0 * lenses * (straight**2).sum(axis=-1), 1e-4)
    bent = straight * (2.0 / (1.0 + np.sqrt(inner)))[..., None]
    return np.linalg.norm(bent - data.points, axis=-1) * data.half_diagonals
