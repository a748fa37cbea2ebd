"""A camera from points of the room that it sees (resection), and what a projection matrix is made of.

The direct linear transform with normalisation, then least squares on pixels: Hartley and Zisserman 2004, chapter 7.
It replaces the thesis's eq. 2.9, which needs projective depths that nobody knows.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.parameters import COMMON
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.arrays import AnyArray, as_float, promote
from jaxpoint.geometry.linalg import null_vector
from jaxpoint.geometry.pose import Pose

MIN_POINTS = 6
_LENS_TERMS = {0: (), 1: (0,), 2: (0, 1), 5: (0, 1, 2, 3, 4)}  # which of k1, k2, p1, p2, k3 are free


class Resection(eqx.Module):
    """A camera and how well it explains the points."""

    camera: Camera
    rms_px: Float[Array, ""]  # of the lengths of the residuals
    converged: Bool[Array, ""]
    refined: bool = eqx.field(static=True)

    @property
    def message(self) -> str:
        """Why the solver stopped, in words."""
        stopped = "converged" if self.converged else "the step limit was reached"
        return stopped if self.refined else "linear solution"


def resect(
    points: Float[AnyArray, "N 3"],
    pixels: Float[AnyArray, "N 2"],
    *,
    lens_terms: int = 0,
    refine: bool = True,
) -> Resection:
    """The camera that sees `points` (m) at `pixels` (px), from six or more points that are not on one plane.

    `resection` without the checks is for `jit`, `vmap` and `grad`; values that JAX traces are handed to it.

    Args:
        points: in the world, m.
        pixels: px, distortion included.
        lens_terms: coefficients of distortion to estimate: 0, 1 (k1), 2 (k1, k2) or 5 (all of `Brown`). It takes
            many points over the whole image to tell them.
        refine: minimise the pixel error after the linear solution; without it `lens_terms` must be 0. Skew, which
            the linear solution allows, is dropped either way.

    Raises:
        ValueError: shapes do not fit, `lens_terms` is another number, or float64 would be cut to float32.
        InsufficientDataError: fewer than six points, points that cannot tell a camera (all or nearly all on a plane),
            or a mirrored world.
    """
    points, pixels = (as_float(values) for values in promote(points, pixels))
    if points.ndim != 2 or points.shape[1] != 3 or pixels.shape != (points.shape[0], 2):
        raise ValueError(f"N points (N, 3) need pixels (N, 2), not {points.shape} and {pixels.shape}.")
    if lens_terms not in _LENS_TERMS or (lens_terms and not refine):
        raise ValueError(f"`lens_terms` is 0, 1, 2 or 5, and 0 without `refine`; not {lens_terms}.")
    if len(points) < MIN_POINTS:
        raise InsufficientDataError(f"Resection needs {MIN_POINTS} points, not {len(points)}; measure more of them.")
    if not any(isinstance(values, Tracer) for values in (points, pixels)):
        _check_points(np.asarray(points), np.asarray(pixels))
        _, depths, singular_values = _linear_camera(points, pixels)
        _check_solution(np.asarray(depths), np.asarray(singular_values))
    return resection(points, pixels, lens_terms=lens_terms, refine=refine)


@eqx.filter_jit
def resection(
    points: Float[AnyArray, "N 3"], pixels: Float[AnyArray, "N 2"], *, lens_terms: int = 0, refine: bool = True
) -> Resection:
    """`resect` as a pure function: of points that do not determine a camera it gives one that means nothing.

    Its derivatives are those of the optimum where it refines. Arguments as of `resect`.
    """
    x, u = promote(points, pixels)
    camera, _, _ = _linear_camera(x, u)
    converged = jnp.asarray(True)
    if refine:
        camera, converged = _refine(camera, x, u, lens_terms)
    rms2 = jnp.mean(jnp.sum((camera.project(x) - u) ** 2, axis=1))
    return Resection(camera, jnp.sqrt(rms2), converged, refine)


def projection_from_points(
    points: Float[AnyArray, "N 3"], pixels: Float[AnyArray, "N 2"], weights: Float[AnyArray, " N"] | None = None
) -> Float[Array, "3 4"]:
    """P of a distortion-free camera by the normalised direct linear transform; pure, for jit, vmap and grad.

    A weight of 0 hides a point. The scale is such that `P[2, :3]` has length 1 and its left 3 x 3 a positive
    determinant, so that depths come out in metres.
    """
    points, pixels = as_float(points), as_float(pixels)
    w = jnp.ones_like(points[:, 0]) if weights is None else as_float(weights)
    rows, to_points, to_pixels = _rows(points, pixels, w)
    matrix = jnp.linalg.solve(to_pixels, null_vector(rows).reshape(3, 4) @ to_points)
    sign = jnp.sign(jnp.linalg.det(matrix[:, :3]))
    return matrix * sign / jnp.sqrt(jnp.sum(matrix[2, :3] ** 2))


def decompose_projection(matrix: Float[AnyArray, "3 4"]) -> tuple[Float[Array, "3 3"], Pose]:
    """K (with `K[2, 2]` = 1 and a positive diagonal) and the pose of a projection matrix of any scale and sign.

    The pose's rotation has determinant +1. Pure: for jit, vmap and grad. The left 3 x 3 must be regular.
    """
    matrix = as_float(matrix)
    matrix = matrix * jnp.sign(jnp.linalg.det(matrix[:, :3]))
    # K R of M by the QR decomposition of its inverse: M^-1 = R^T K^-1.
    turned, upper = jnp.linalg.qr(jnp.linalg.inv(matrix[:, :3]))
    signs = jnp.sign(jnp.diagonal(upper))
    rotation = (turned * signs[None, :]).T
    intrinsics = jnp.linalg.inv(upper * signs[:, None])
    translation = jnp.linalg.solve(intrinsics, matrix[:, 3])
    return intrinsics / intrinsics[2, 2], Pose(rotation, translation)


def _rows(
    points: Float[Array, "N 3"], pixels: Float[Array, "N 2"], weights: Float[Array, " N"]
) -> tuple[Float[Array, "2*N 12"], Float[Array, "4 4"], Float[Array, "3 3"]]:
    """The linear system whose null vector is P of normalised points and pixels, and the two normalisers."""
    to_points, to_pixels = _normaliser(points, weights), _normaliser(pixels, weights)
    x = _homogeneous(points) @ to_points.T
    u = _homogeneous(pixels) @ to_pixels.T
    zero = jnp.zeros_like(x)
    rows_u = jnp.concatenate([x, zero, -u[:, :1] * x], axis=1)
    rows_v = jnp.concatenate([zero, x, -u[:, 1:2] * x], axis=1)
    return jnp.concatenate([weights[:, None] * rows_u, weights[:, None] * rows_v]), to_points, to_pixels


def _check_points(points: np.ndarray, pixels: np.ndarray) -> None:
    """Refuse what cannot tell a camera: points on a plane, or almost all of them."""
    if not (np.isfinite(points).all() and np.isfinite(pixels).all()):
        raise ValueError("A point or pixel to resect from is NaN or infinite; leave it out.")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[2] <= 1e-4 * spread[0]:
        share = spread[2] / max(spread[0], np.finfo(float).tiny)
        raise InsufficientDataError(
            f"The {len(points)} points lie on a plane (thickness {share:.1e} of their extent), which cannot tell a "
            "camera; add points off that plane."
        )


def _check_solution(depths: np.ndarray, singular_values: np.ndarray) -> None:
    """Refuse a linear solution that is not the only one, or that has the points behind the camera."""
    largest, second, last = singular_values[[0, -2, -1]]
    if second <= max(1e-7 * largest, 2 * last):
        raise InsufficientDataError(
            f"The {len(depths)} points fit more than one camera (singular values {second:.1e} and {last:.1e} are "
            "alike); add points at other depths, or look for wrong pixels."
        )
    behind = int((depths <= 0).sum())
    if 2 * behind > len(depths):
        raise InsufficientDataError(
            f"{behind} of {len(depths)} points come out behind the camera; an axis of the pixels or of the world is "
            "mirrored, or the pixels belong to other points."
        )


@eqx.filter_jit
def _linear_camera(
    points: Float[Array, "N 3"], pixels: Float[Array, "N 2"]
) -> tuple[Camera, Float[Array, " N"], Float[Array, " 12"]]:
    """The camera, the depths of the points, and the singular values of the linear system."""
    intrinsics, pose = decompose_projection(projection_from_points(points, pixels))
    camera = Camera(Brown.of(jnp.diagonal(intrinsics)[:2], intrinsics[:2, 2]), pose)
    rows, _, _ = _rows(points, pixels, jnp.ones_like(points[:, 0]))
    return camera, camera.depth(points), jnp.linalg.svd(rows, compute_uv=False)


@eqx.filter_jit
def _refine(
    start: Camera, points: Float[Array, "N 3"], pixels: Float[Array, "N 2"], lens_terms: int
) -> tuple[Camera, Array]:
    """Levenberg-Marquardt on pixels over the parameters of `Camera.perturbed`, those of the lens as chosen."""
    free = np.concatenate([np.arange(COMMON), COMMON + np.array(_LENS_TERMS[lens_terms], dtype=int)])
    # Steps of like size: radians, room sizes, and pixels by the focal length.
    focal = jnp.mean(start.focal)
    one = jnp.ones(3, dtype=points.dtype)
    scale = jnp.concatenate([one, one, jnp.tile(focal, 4), jnp.tile(one[:1], 5)])

    def camera(change: Array) -> Camera:
        return start.perturbed(jnp.zeros(start.size, dtype=points.dtype).at[free].set(change) * scale)

    def residuals(change: Array, _: None) -> Array:
        return camera(change).project(points) - pixels

    tolerance = float(np.sqrt(jnp.finfo(points.dtype).eps)) * 1e-2
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    change = jnp.zeros(len(free), dtype=points.dtype)
    solution = optx.least_squares(residuals, solver, change, max_steps=100, throw=False)
    return camera(solution.value), solution.result == optx.RESULTS.successful


def _homogeneous(points: Float[Array, "N d"]) -> Float[Array, "N d+1"]:
    return jnp.concatenate([points, jnp.ones_like(points[:, :1])], axis=1)


def _normaliser(points: Float[Array, "N d"], weights: Float[Array, " N"]) -> Float[Array, "d+1 d+1"]:
    """The matrix that moves the centroid to 0 and scales the mean square distance to the number of dimensions."""
    size = points.shape[1]
    share = weights / jnp.sum(weights)
    center = share @ points
    scale = jnp.sqrt(size / jnp.sum(share[:, None] * (points - center[None]) ** 2))
    eye = jnp.eye(size + 1, dtype=points.dtype)
    return (eye * scale).at[:size, size].set(-scale * center).at[size, size].set(1.0)
