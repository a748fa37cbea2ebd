"""A camera from points of which some are wrong: the start of one camera beside others that are known."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxpoint.camera.resection import MIN_POINTS, decompose_projection, projection_from_points
from jaxpoint.compilation import jit_once
from jaxpoint.geometry.pose import Pose

SAMPLES = 512  # 6 inliers in a row at 40 % outliers come once in 22 draws
SIZES = (64, 256, 1024, 4096)  # points are padded to these, and thinned to the last


class RobustResection(NamedTuple):
    """A distortion-free camera and the points that agree with it."""

    intrinsics: Float[np.ndarray, "3 3"]
    cam_from_world: Pose
    inliers: np.ndarray  # (N,) bool


def resect_robustly(
    points: Float[np.ndarray, "N 3"], pixels: Float[np.ndarray, "N 2"], threshold: float, seed: int = 0
) -> RobustResection:
    """The projection on which most points agree (RANSAC over the direct linear transform), fitted to all of them.

    Args:
        points: six or more, not on a plane.
        pixels: without distortion, or with so little that `threshold` bears it; in any unit.
        threshold: greatest distance of an inlier, in the unit of `pixels`.
        seed: of the samples.
    """
    rng = np.random.default_rng(seed)
    size = next((size for size in SIZES if size >= len(points)), SIZES[-1])
    chosen = np.sort(rng.permutation(len(points))[:size])
    used = np.arange(size) < len(chosen)
    filled = np.resize(chosen, size)
    samples = np.stack([rng.choice(len(chosen), MIN_POINTS, replace=False) for _ in range(SAMPLES)])
    matrix = _search(points[filled], pixels[filled], used, samples, threshold)
    intrinsics, pose = decompose_projection(matrix)
    near = np.asarray(_distances(matrix, jnp.asarray(points), jnp.asarray(pixels))) < threshold
    return RobustResection(np.asarray(intrinsics), pose, near)


@jit_once
def _search(points, pixels, used, samples: Int[Array, "S 6"], threshold) -> Float[Array, "3 4"]:
    def support(matrix) -> Float[Array, ""]:
        ratio2 = (_distances(matrix, points, pixels) / threshold) ** 2
        return jnp.where(used, jnp.maximum(1.0 - ratio2, 0.0), 0.0).sum()

    def of_sample(chosen):
        matrix = projection_from_points(points[chosen], pixels[chosen])
        return matrix, support(matrix)

    matrices, supports = jax.lax.map(of_sample, samples, batch_size=64)
    best = matrices[jnp.argmax(jnp.nan_to_num(supports, nan=-1.0))]
    near = used & (_distances(best, points, pixels) < threshold)
    fitted = projection_from_points(points, pixels, near.astype(points.dtype))
    return jnp.where(support(fitted) >= support(best), fitted, best)


def _distances(matrix, points, pixels) -> Float[Array, " N"]:
    """From pixel to projection; infinite behind the camera."""
    local = points @ matrix[:, :3].T + matrix[None, :, 3]
    ahead = local[:, 2] > 0
    seen = local[:, :2] / jnp.where(ahead, local[:, 2], 1.0)[:, None]
    return jnp.where(ahead, jnp.linalg.norm(seen - pixels, axis=1), jnp.inf)
