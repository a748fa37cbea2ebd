"""scipy's least_squares as a peer: trf with the exact sparse Jacobian, scaled by it.

The Jacobian is written out by hand, all observations at once. The linear system of a step is solved by lsmr, which is
what trf has for sparse matrices, to more digits than its default: with that one, it needs ten times as many steps or
does not reach the minimum at all.

    python experiments/benchmarks/scipy_peer.py FILE
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from problem import BundleProblem, brown, in_cameras, on_plane, read_problem
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

TOLERANCE = 1e-8
LSMR_TOLERANCE = 1e-9
MAX_EVALUATIONS = 200


@dataclass(frozen=True)
class ScipyRun:
    """Where scipy ended."""

    cost: float  # half the sum of squares, px^2
    evaluations: int
    converged: bool
    seconds: float


def run(problem: BundleProblem) -> ScipyRun:
    """Solve a problem of 11 or 15 parameters a camera."""
    size = problem.cameras.size
    shape = problem.cameras.shape

    def split(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return unknowns[:size].reshape(shape), unknowns[size:].reshape(-1, 3)

    def slopes(unknowns: np.ndarray) -> csr_matrix:
        return csr_matrix((jacobian(problem, *split(unknowns)).ravel(), columns, rows))

    rows, columns = pattern(problem)
    started = time.perf_counter()
    end = least_squares(
        lambda unknowns: problem.residuals(*split(unknowns)).ravel(),
        np.concatenate([problem.cameras.ravel(), problem.points.ravel()]),
        jac=slopes,  # pyright: ignore[reportArgumentType]
        method="trf",
        x_scale="jac",
        ftol=TOLERANCE,
        xtol=1e-15,
        gtol=1e-15,
        max_nfev=MAX_EVALUATIONS,
        tr_options={"atol": LSMR_TOLERANCE, "btol": LSMR_TOLERANCE, "maxiter": 2000},
    )
    return ScipyRun(float(end.cost), int(end.nfev), bool(end.success), time.perf_counter() - started)


def pattern(problem: BundleProblem) -> tuple[np.ndarray, np.ndarray]:
    """Starts of the rows, and the columns of the entries, of the sparse Jacobian."""
    width = problem.parameters + 3
    camera = problem.parameters * problem.camera_of[:, None] + np.arange(problem.parameters)
    point = problem.cameras.size + 3 * problem.point_of[:, None] + np.arange(3)
    columns = np.repeat(np.concatenate([camera, point], axis=1), 2, axis=0)
    return np.arange(2 * problem.observations + 1) * width, columns.ravel()


def jacobian(problem: BundleProblem, cameras: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Derivatives of every residual for its camera and its point, (M, 2, p + 3)."""
    local = in_cameras(cameras, points, problem.camera_of, problem.point_of)
    lens = cameras[problem.camera_of, 6:]
    for_plane, for_lens = lens_derivatives(lens, *on_plane(local, problem.parameters))
    for_local = for_plane @ plane_derivatives(local)
    vectors = Rotation.from_rotvec(cameras[:, :3].copy())
    turned = vectors.as_matrix()[problem.camera_of]
    arm = local - cameras[problem.camera_of, 3:6]
    for_turn = -for_local @ skew(arm) @ left_jacobian(cameras[:, :3])[problem.camera_of]
    return np.concatenate([for_turn, for_local, for_lens, for_local @ turned], axis=2)


def plane_derivatives(local: np.ndarray) -> np.ndarray:
    """Of the place on the plane of unit depth for the point in the frame of the camera, (M, 2, 3)."""
    x, y, z = local.T
    zero = np.zeros_like(z)
    rows = [np.stack([1 / z, zero, -x / z**2], axis=1), np.stack([zero, 1 / z, -y / z**2], axis=1)]
    return np.stack(rows, axis=1)


def lens_derivatives(lens: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the pixel for the place on the plane (M, 2, 2), and for the numbers of the lens (M, 2, p - 6)."""
    fx, fy, _, _, k1, k2, p1, p2, k3 = brown(lens)
    r2, uv = u * u + v * v, u * v
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    mixed = 2.0 * (slope * uv + p1 * u + p2 * v)
    across = np.stack([fx * (radial + 2.0 * slope * u * u + 2.0 * p1 * v + 6.0 * p2 * u), fx * mixed], axis=1)
    down = np.stack([fy * mixed, fy * (radial + 2.0 * slope * v * v + 6.0 * p1 * v + 2.0 * p2 * u)], axis=1)
    bent_u = u * radial + 2.0 * p1 * uv + p2 * (r2 + 2.0 * u * u)
    bent_v = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * uv
    one, zero = np.ones_like(u), np.zeros_like(u)
    tangential = [fx * 2.0 * uv, fx * (r2 + 2.0 * u * u)], [fy * (r2 + 2.0 * v * v), fy * 2.0 * uv]
    rows = [
        [bent_u, zero, one, zero, fx * u * r2, fx * u * r2**2, *tangential[0], fx * u * r2**3],
        [zero, bent_v, zero, one, fy * v * r2, fy * v * r2**2, *tangential[1], fy * v * r2**3],
    ]
    whole = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
    if lens.shape[1] == 5:  # one focal length, k1 and k2 alone
        whole = np.concatenate([whole[:, :, :2].sum(axis=2, keepdims=True), whole[:, :, 2:6]], axis=2)
    return np.stack([across, down], axis=1), whole


def skew(vectors: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 3) of the cross products with these vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def left_jacobian(rotvecs: np.ndarray) -> np.ndarray:
    """J (C, 3, 3) with exp(w + d) = exp(J d) exp(w) to first order in d; no w is zero."""
    angle = np.linalg.norm(rotvecs, axis=1)[:, None, None]
    turn = skew(rotvecs)
    square = turn @ turn
    return np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * turn + (angle - np.sin(angle)) / angle**3 * square


if __name__ == "__main__":
    sys.stdout.write(f"{run(read_problem(Path(sys.argv[1])))}\n")
