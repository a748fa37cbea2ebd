"""A bundle adjustment as every solver of the benchmark gets it: a list of observations and a start, in one file.

The numbers of a camera, in this order, for the three lenses that the benchmark knows (the lens is named by how many):

    9   rotation vector, translation, focal, k1, k2                   BAL: the camera looks along -z, no principal point
    11  rotation vector, translation, focal, cx, cy, k1, k2           one focal length
    15  rotation vector, translation, fx, fy, cx, cy, k1, k2, p1, p2, k3
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

LENSES = (9, 11, 15)


@dataclass(frozen=True)
class BundleProblem:
    """Observations and a start: C cameras, P points, M observations sorted by point."""

    cameras: Float[np.ndarray, "C p"]
    points: Float[np.ndarray, "P 3"]
    camera_of: Int[np.ndarray, " M"]
    point_of: Int[np.ndarray, " M"]
    pixels: Float[np.ndarray, "M 2"]

    @property
    def parameters(self) -> int:
        """Numbers a camera, which names the lens."""
        return self.cameras.shape[1]

    @property
    def observations(self) -> int:
        """M."""
        return len(self.pixels)

    @property
    def visibility(self) -> float:
        """Share of all pairs of a camera and a point that are observed."""
        return self.observations / (len(self.cameras) * len(self.points))

    def residuals(self, cameras: Float[np.ndarray, "C p"], points: Float[np.ndarray, "P 3"]) -> np.ndarray:
        """Projected minus observed (M, 2), px."""
        local = in_cameras(cameras, points, self.camera_of, self.point_of)
        return bent(cameras[self.camera_of, 6:], *on_plane(local, self.parameters)) - self.pixels

    def cost(self, cameras: Float[np.ndarray, "C p"], points: Float[np.ndarray, "P 3"]) -> float:
        """Half the sum of squares, px^2: every solver's answer is judged by this one function."""
        return 0.5 * float((self.residuals(cameras, points) ** 2).sum())


def in_cameras(cameras: np.ndarray, points: np.ndarray, camera_of: np.ndarray, point_of: np.ndarray) -> np.ndarray:
    """The observed point of every observation in the frame of its camera, (M, 3)."""
    turned = Rotation.from_rotvec(cameras[:, :3].copy()).as_matrix()
    return np.einsum("mij,mj->mi", turned[camera_of], points[point_of]) + cameras[camera_of, 3:6]


def on_plane(local: np.ndarray, parameters: int) -> tuple[np.ndarray, np.ndarray]:
    """Where points in the frame of a camera (M, 3) meet its plane of unit depth."""
    depth = -local[:, 2] if parameters == 9 else local[:, 2]
    return local[:, 0] / depth, local[:, 1] / depth


def bent(lens: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Pixels (M, 2) of places on the plane of unit depth through the lenses (M, p - 6)."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = brown(lens)
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)
    y = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v
    return np.stack([fx * x + cx, fy * y + cy], axis=1)


def brown(lens: np.ndarray) -> np.ndarray:
    """The nine numbers (9, M) of Brown's lens, fx fy cx cy k1 k2 p1 p2 k3, of any of the three lenses (M, p - 6)."""
    zero = np.zeros(len(lens))
    columns = list(lens.T)
    if len(columns) == 9:
        return np.stack(columns)
    if len(columns) == 5:
        focal, cx, cy, k1, k2 = columns
        return np.stack([focal, focal, cx, cy, k1, k2, zero, zero, zero])
    focal, k1, k2 = columns
    return np.stack([focal, focal, zero, zero, k1, k2, zero, zero, zero])


def write_problem(path: Path, problem: BundleProblem) -> None:
    """Four int64 counts (p, C, P, M), camera and point of every observation (int32), pixels, cameras, points."""
    counts = np.array([problem.parameters, len(problem.cameras), len(problem.points), problem.observations], np.int64)
    with path.open("wb") as file:
        counts.tofile(file)
        problem.camera_of.astype(np.int32).tofile(file)
        problem.point_of.astype(np.int32).tofile(file)
        for values in (problem.pixels, problem.cameras, problem.points):
            np.ascontiguousarray(values, np.float64).tofile(file)


def read_problem(path: Path) -> BundleProblem:
    """What `write_problem` wrote."""
    with path.open("rb") as file:
        parameters, cameras, points, observations = (int(count) for count in np.fromfile(file, np.int64, 4))
        camera_of = np.fromfile(file, np.int32, observations)
        point_of = np.fromfile(file, np.int32, observations)
        pixels = np.fromfile(file, np.float64, 2 * observations).reshape(-1, 2)
        first = np.fromfile(file, np.float64, cameras * parameters).reshape(cameras, parameters)
        places = np.fromfile(file, np.float64, 3 * points).reshape(points, 3)
    return BundleProblem(first, places, camera_of, point_of, pixels)
