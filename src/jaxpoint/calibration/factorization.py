"""Projective cameras and points from all views at once (SPEC 2.3, 2.4).

Default: rank-4 factorisation under a mask by the pseudo object-space error and variable projection, then a projective
bundle adjustment with a division-model lens. No pairwise poses are used.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxpoint.calibration.bundle import BLOCK, LEAST_SQUARES, from_blocks, solve, to_blocks
from jaxpoint.calibration.projective import ProjectiveModel
from jaxpoint.calibration.recording import padded_cameras
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.calibration.twoview import NormalisedTracks, undistorted

LENS_SIGMA = 0.1  # of a division-model parameter in the projective adjustment
SOLVER = SchurLevenbergMarquardt(model=ProjectiveModel(), rtol=1e-5, start_damping=1e-2, project_points=True)


@dataclass(frozen=True)
class Projective:
    """A projective reconstruction in normalised image coordinates."""

    cameras: np.ndarray  # (C, 3, 4), unit norm, most depths positive
    points: np.ndarray  # (N, 4)
    lenses: np.ndarray  # (C,) division-model parameters
    errors: np.ndarray  # (N, C) px of the distorted image
    cost: float


def factorise(data: NormalisedTracks, lenses: np.ndarray, kept: np.ndarray, rng: np.random.Generator) -> Projective:
    """One factorisation from a random start.

    Args:
        lenses: division-model parameters (C,).
        kept: observations to use (N, C); frames with fewer than two are left out.
        rng: source of the random start.
    """
    points, weights = undistorted(data.points, lenses)
    weights = np.where(_usable(kept), weights**2, 0.0)
    cameras = data.points.shape[1]
    start = rng.normal(size=(cameras, 3, 4))
    start[:, 2] = [0.0, 0.0, 0.0, 1.0] + 0.1 * start[:, 2]
    problem, unknowns = _problem(data, points, weights, start, np.zeros(cameras), np.zeros((len(points), 3)))
    end = solve(SOLVER, unknowns, problem)
    found = np.asarray(end.cameras)[:cameras, :12].reshape(cameras, 3, 4)
    return finished(data, found, from_blocks(end.points), lenses, kept, float(end.cost))


def refine(data: NormalisedTracks, start: Projective, kept: np.ndarray, loss_px: float) -> Projective:
    """Projective bundle adjustment: cameras, points and one lens parameter a camera, Cauchy loss."""
    cameras = len(start.cameras)
    seen = start.points[:, 3:] != 0  # a frame that nobody saw must not spread NaN
    points = np.where(seen, start.points[:, :3], 0.0) / np.where(seen, start.points[:, 3:], 1.0)
    weights = _usable(kept).astype(float)
    problem, unknowns = _problem(data, data.points, weights, start.cameras, start.lenses, points, loss_px)
    end = solve(SOLVER, unknowns, problem)
    found = np.asarray(end.cameras)[:cameras]
    return finished(
        data, found[:, :12].reshape(cameras, 3, 4), from_blocks(end.points), found[:, 12], kept, float(end.cost)
    )


def _usable(kept: np.ndarray) -> np.ndarray:
    return kept & (kept.sum(axis=1) >= 2)[:, None]


def _problem(data, pixels, weights, projections, lenses, points, loss_px=None) -> tuple[Problem, Unknowns]:
    """Blocks padded to one of few rig sizes: the adjustment with this loss, or without one the factorisation.

    In the adjustment the lens parameters are free, drawn to where they start.
    """
    cameras = len(projections)
    pad = padded_cameras(cameras) - cameras

    def widened(array, axis):
        return np.pad(array, [(0, pad if i == axis else 0) for i in range(array.ndim)])

    adjusting = loss_px is not None
    numbers = widened(np.concatenate([projections.reshape(cameras, 12), lenses[:, None]], axis=1), 0)
    free = np.zeros(numbers.shape, bool)
    free[:cameras, : 13 if adjusting else 12] = True
    weight = np.zeros(numbers.shape)
    weight[:cameras, 12] = 1.0 / LENS_SIGMA**2 if adjusting else 0.0
    flags = np.full(cameras + pad, 0.0 if adjusting else 1.0)
    problem = Problem(
        jnp.asarray(to_blocks(widened(pixels, 1))),
        jnp.asarray(to_blocks(widened(weights, 1))),
        (jnp.asarray(widened(data.half_diagonals, 0)), jnp.asarray(flags)),
        jnp.asarray(free),
        jnp.asarray(numbers),
        jnp.asarray(weight),
        jnp.asarray(float(loss_px if adjusting else LEAST_SQUARES)),
        jnp.asarray(100),
    )
    return problem, Unknowns(jnp.asarray(numbers), jnp.asarray(to_blocks(points, BLOCK)))


def finished(data, cameras, points, lenses, kept, cost) -> Projective:
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
