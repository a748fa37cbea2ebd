"""Points from the pixels of several cameras, with covariance and with flags where not to believe them.

The linear start is the thesis's (4.2.1) put right: the rows x P3 - P1 and y P3 - P2 of every view. Levenberg-Marquardt
on the pixel error of the full camera model follows (Hartley and Zisserman 2004, chapter 12).
"""

from __future__ import annotations

import math
from enum import IntFlag
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.camera.camera import PARAMETERS, Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry.arrays import AnyArray, as_float

MIN_PARALLAX = math.radians(2.0)
_BLOCK = 1024  # points that are worked on at once on a CPU, so that they stay in its cache
_DAMPING = 1e-6  # of Levenberg-Marquardt at the start, relative to the diagonal


class Flag(IntFlag):
    """What is wrong with a triangulated point."""

    BEHIND = 1  # it lies behind a camera that sees it
    LOW_PARALLAX = 2  # no two rays differ by 2 degrees: its distance is hardly determined
    FEW_VIEWS = 4  # fewer than two usable views: there is no point
    LENS_RANGE = 8  # a visible pixel lies where the lens model has no ray; that view was not used


class Triangulation(eqx.Module):
    """Points seen by C cameras. All entries are finite but the covariance of points with fewer than two views."""

    points: Float[Array, "*batch 3"]  # m; 0 with fewer than two views
    covariance: Float[Array, "*batch 3 3"]  # m^2; infinite on the diagonal with fewer than two views
    residuals: Float[Array, "*batch C 2"]  # px, projected minus observed; 0 for views not used
    rms: Float[Array, "*batch"]  # px, of the residuals' lengths over the views used
    parallax: Float[Array, "*batch"]  # rad, largest angle between two rays
    flags: Int[Array, "*batch"]  # sum of `Flag`s

    @property
    def valid(self) -> Bool[Array, "*batch"]:
        """Whether a point has two views or more, enough parallax, and lies in front of the cameras that see it."""
        return (self.flags & (Flag.BEHIND | Flag.LOW_PARALLAX | Flag.FEW_VIEWS)) == 0


def triangulate(
    rig: CameraRig,
    pixels: Float[AnyArray, "*batch C 2"],
    visible: Bool[AnyArray, "*batch C"],
    *,
    sigma_px: Float[AnyArray, ""] | float = 1.0,
    camera_covariance: Float[AnyArray, "D D"] | None = None,
    refine_steps: int = 5,
) -> Triangulation:
    """Points of the world from their pixels in two or more cameras, one point or millions.

    Pixels are as the cameras saw them, distortion included; what stands at a hidden pixel never matters. The result
    minimises the squared pixel error over the views used, and its derivatives by pixels and cameras come from the
    implicit function theorem.

    Args:
        rig: the cameras, C of them.
        pixels: px.
        visible: which of them to use.
        sigma_px: standard deviation of one pixel coordinate, px; scales the covariance.
        camera_covariance: covariance of the rig's numbers, D = 15 C, in the order of `Camera.perturbed` camera by
            camera; its effect is added to the points' covariance.
        refine_steps: Levenberg-Marquardt steps after the linear solution.

    Raises:
        ValueError: shapes do not fit, or float64 would be cut to float32.
    """
    as_float(rig.cameras.focal)
    pixels, visible = as_float(pixels), jnp.asarray(visible, dtype=bool)
    cameras = len(rig)
    if pixels.ndim < 2 or pixels.shape[-2:] != (cameras, 2) or visible.shape != pixels.shape[:-1]:
        raise ValueError(
            f"{cameras} cameras need pixels of shape (..., {cameras}, 2) and visible of shape (..., {cameras}), "
            f"not {pixels.shape} and {visible.shape}."
        )
    size = PARAMETERS * cameras
    if camera_covariance is not None and camera_covariance.shape != (size, size):
        raise ValueError(
            f"The covariance of {cameras} cameras has shape {(size, size)} ({PARAMETERS} numbers each), "
            f"not {camera_covariance.shape}."
        )
    batch = pixels.shape[:-2]
    count = math.prod(batch)
    block, blocks = _block_shape(count)
    padding = ((0, block * blocks - count), (0, 0))
    result = _triangulate(
        rig.cameras,
        jnp.pad(pixels.reshape(count, cameras, 2), (*padding, (0, 0))),
        jnp.pad(visible.reshape(count, cameras), padding),
        as_float(sigma_px),
        None if camera_covariance is None else as_float(camera_covariance),
        refine_steps,
        block,
    )
    return jax.tree.map(lambda leaf: leaf[:count].reshape(*batch, *leaf.shape[1:]), result)


def _block_shape(count: int) -> tuple[int, int]:
    """Points in a block and number of blocks: few different ones, so that few programs are compiled."""
    largest = _BLOCK if jax.default_backend() == "cpu" else 2**20
    if count <= largest:
        return 1 << max(count - 1, 0).bit_length(), 1
    blocks = -(-count // largest)
    step = 1 << max(blocks.bit_length() - 3, 0)
    return largest, -(-blocks // step) * step


@eqx.filter_jit
def _triangulate(
    cameras: Camera,
    pixels: Float[Array, "N C 2"],
    visible: Bool[Array, "N C"],
    sigma_px: Float[Array, ""],
    camera_covariance: Float[Array, "D D"] | None,
    steps: int,
    block: int,
) -> Triangulation:
    """Blocks of points one after the other, the points on the last axis of everything."""
    # The origin in the middle of the cameras: rounding is then relative to the room, not to where the world begins.
    origin = jnp.mean(jax.vmap(lambda camera: camera.position)(cameras), axis=0)
    shift = jax.vmap(lambda camera: camera.cam_from_world @ origin)(cameras)
    local = eqx.tree_at(lambda camera: camera.cam_from_world.translation, cameras, shift)
    split = (pixels.reshape(-1, block, *pixels.shape[1:]), visible.reshape(-1, block, visible.shape[1]))

    def one_block(args: tuple[Array, Array]) -> Triangulation:
        seen = args[0].transpose(2, 1, 0), args[1].T
        return _triangulate_block(local, origin, *seen, sigma_px, camera_covariance, steps)

    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), jax.lax.map(one_block, split))


def _triangulate_block(
    cameras: Camera,
    origin: Float[Array, "3"],
    pixels: Float[Array, "2 C B"],
    visible: Bool[Array, "C B"],
    sigma_px: Float[Array, ""],
    camera_covariance: Float[Array, "D D"] | None,
    steps: int,
) -> Triangulation:
    """One block; the fields of the result have the points on the first axis again."""
    pixels = jnp.where(visible[None], pixels, 0.0)
    ideal, in_range = _ideal(cameras, pixels)
    used = visible & in_range
    views = jnp.sum(used, axis=0)
    enough = views >= 2
    used = used & enough[None]
    pixels, ideal = (jnp.where(used[None], values, 0.0) for values in (pixels, ideal))

    points = _optimum(cameras, pixels, ideal, used, steps)
    residuals, jacobian = _residuals_and_jacobian(cameras, points, pixels, used)
    normal = _normal_matrix(jacobian)
    covariance = sigma_px**2 * _inverse(normal)
    if camera_covariance is not None:
        covariance = covariance + _from_cameras(cameras, points, used, jacobian, normal, camera_covariance)
    unknown = jnp.where(jnp.eye(3, dtype=bool), jnp.inf, 0.0).astype(covariance.dtype)
    squared = jnp.sum(residuals**2, axis=(0, 1)) / jnp.maximum(views, 1)
    parallax = _parallax(cameras, points, used)
    behind = jnp.any(used & (_depths(cameras, points) <= 0), axis=0)
    flags = (
        Flag.BEHIND * behind
        + Flag.LOW_PARALLAX * (enough & (parallax < MIN_PARALLAX))
        + Flag.FEW_VIEWS * ~enough
        + Flag.LENS_RANGE * jnp.any(visible & ~in_range, axis=0)
    )
    return Triangulation(
        points=jnp.where(enough[None], points + origin[:, None], 0.0).T,
        covariance=jnp.where(enough[None, None], covariance, unknown[:, :, None]).transpose(2, 0, 1),
        residuals=residuals.transpose(2, 1, 0),
        rms=_safe_sqrt(squared),
        parallax=parallax,
        flags=flags.astype(jnp.int32),
    )


@partial(jax.custom_jvp, nondiff_argnums=(4,))
def _optimum(
    cameras: Camera, pixels: Float[Array, "2 C B"], ideal: Float[Array, "2 C B"], used: Bool[Array, "C B"], steps: int
) -> Float[Array, "3 B"]:
    """The points of least squared pixel error: the linear start, then Levenberg-Marquardt."""

    def evaluate(points: Array) -> tuple[Array, Array, Array, Array]:
        residuals, jacobian = _residuals_and_jacobian(cameras, points, pixels, used)
        behind = jnp.sum(used & (_depths(cameras, points) <= 0), axis=0)
        gradient = jnp.sum(jacobian * residuals[:, None], axis=(0, 2))
        return behind, jnp.sum(residuals**2, axis=(0, 1)), gradient, _normal_matrix(jacobian)

    def step(_: int, state: tuple) -> tuple:
        points, value, damping = state
        behind, cost, gradient, normal = value
        damped = normal * (1 + damping[None, None] * jnp.eye(3, dtype=points.dtype)[:, :, None])
        trial = points - _times(_inverse(damped), gradient)
        trial_value = evaluate(trial)
        # A step may bring a point before a camera at any cost, and never behind one.
        better = (trial_value[0] < behind) | ((trial_value[0] == behind) & (trial_value[1] < cost))
        damping = jnp.where(better, damping * 0.1, jnp.maximum(damping, 1e-4) * 30)
        kept = jax.tree.map(
            lambda new, old: jnp.where(_over(better, new), new, old), (trial, trial_value), (points, value)
        )
        return *kept, damping

    start = _linear(cameras, ideal, used)
    state = start, evaluate(start), jnp.full_like(start[0], _DAMPING)
    return jax.lax.fori_loop(0, steps, step, state)[0]


@_optimum.defjvp
def _optimum_jvp(steps: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    cameras, pixels, _, used = primals
    points = _optimum(*primals, steps)

    def cost(points: Array, cameras: Camera, pixels: Array) -> Array:
        return 0.5 * jnp.sum(_residuals(cameras, points, pixels, used) ** 2)

    gradient = jax.grad(cost)
    _, change = jax.jvp(lambda c, p: gradient(points, c, p), (cameras, pixels), (tangents[0], tangents[1]))
    hessian = jnp.stack([jax.jvp(lambda x: gradient(x, cameras, pixels), (points,), (e,))[1] for e in _axes(points)])
    moved = -_times(_inverse(hessian), change)
    return points, jnp.where(jnp.any(used, axis=0)[None], moved, 0.0)


def _ideal(cameras: Camera, pixels: Float[Array, "2 C B"]) -> tuple[Float[Array, "2 C B"], Bool[Array, "C B"]]:
    """Undistorted places on the z = 1 plane, and whether the lens model has them."""

    def one(camera: Camera, pixel: Float[Array, "2 B"]) -> tuple[Array, Array]:
        xy, valid = camera.distortion.undistort(camera.from_pixel(pixel.T))
        return xy.T, valid

    return jax.vmap(one, in_axes=(0, 1), out_axes=(1, 0))(cameras, pixels)


def _linear(cameras: Camera, ideal: Float[Array, "2 C B"], used: Bool[Array, "C B"]) -> Float[Array, "3 B"]:
    """Least squares of the rows x P3 - P1 and y P3 - P2 in camera units, each scaled to a distance from its plane."""

    def one(camera: Camera, place: Float[Array, "2 B"]) -> tuple[Array, Array]:
        r, t = camera.cam_from_world.rotation, camera.cam_from_world.translation
        rows = jnp.stack([jnp.stack([place[k] * r[2, i] - r[k, i] for k in range(2)]) for i in range(3)])
        offsets = jnp.stack([place[k] * t[2] - t[k] for k in range(2)])
        length = jnp.sqrt(jnp.sum(rows**2, axis=0))
        return rows / length[None], offsets / length

    rows, offsets = jax.vmap(one, in_axes=(0, 1), out_axes=-2)(cameras, ideal)  # (3, 2, C, B), (2, C, B)
    rows = jnp.where(used[None, None], rows, 0.0)
    normal = jnp.stack([jnp.stack([jnp.sum(rows[i] * rows[j], axis=(0, 1)) for j in range(3)]) for i in range(3)])
    return -_times(_inverse(normal), jnp.sum(rows * offsets[None], axis=(1, 2)))


def _residuals(
    cameras: Camera, points: Float[Array, "3 B"], pixels: Float[Array, "2 C B"], used: Bool[Array, "C B"]
) -> Float[Array, "2 C B"]:
    """Projected minus observed, px; 0 for views not used."""
    projected = jax.vmap(lambda camera: camera.project(points.T), out_axes=1)(cameras)  # (B, C, 2)
    return jnp.where(used[None], projected.transpose(2, 1, 0) - pixels, 0.0)


def _residuals_and_jacobian(
    cameras: Camera, points: Float[Array, "3 B"], pixels: Float[Array, "2 C B"], used: Bool[Array, "C B"]
) -> tuple[Float[Array, "2 C B"], Float[Array, "2 3 C B"]]:
    residuals, derivative = jax.linearize(lambda x: _residuals(cameras, x, pixels, used), points)
    return residuals, jnp.stack([derivative(e) for e in _axes(points)], axis=1)


def _depths(cameras: Camera, points: Float[Array, "3 B"]) -> Float[Array, "C B"]:
    return jax.vmap(lambda camera: camera.depth(points.T))(cameras)


def _parallax(cameras: Camera, points: Float[Array, "3 B"], used: Bool[Array, "C B"]) -> Float[Array, " B"]:
    """Largest angle between two rays, from the largest chord between their directions: exact where it is small."""
    positions = jax.vmap(lambda camera: camera.position)(cameras)
    rays = points[None] - positions[:, :, None]
    length = _safe_sqrt(jnp.sum(rays**2, axis=1, keepdims=True))
    rays = rays / jnp.where(length > 0, length, 1.0)

    def widen(widest: Array, view: tuple[Array, Array]) -> tuple[Array, None]:
        chord2 = jnp.sum((rays - view[0][None]) ** 2, axis=1)
        return jnp.maximum(widest, jnp.max(jnp.where(used & view[1][None], chord2, 0.0), axis=0)), None

    widest, _ = jax.lax.scan(widen, jnp.zeros_like(points[0]), (rays, used))
    return 2 * jnp.arcsin(jnp.minimum(_safe_sqrt(widest) / 2, 1.0))


def _from_cameras(
    cameras: Camera,
    points: Float[Array, "3 B"],
    used: Bool[Array, "C B"],
    jacobian: Float[Array, "2 3 C B"],
    normal: Float[Array, "3 3 B"],
    camera_covariance: Float[Array, "D D"],
) -> Float[Array, "3 3 B"]:
    """What the cameras' own covariance adds to the points': both move so that the pixel error stays least."""

    def by_numbers(camera: Camera) -> Float[Array, "B 2 15"]:
        zero = jnp.zeros(PARAMETERS, dtype=points.dtype)
        return jax.jacfwd(lambda change: camera.perturbed(change).project(points.T))(zero)

    by_camera = jnp.where(used[:, :, None, None], jax.vmap(by_numbers)(cameras), 0.0)  # (C, B, 2, 15)
    pull = jnp.einsum("kicb,cbkp->bicp", jacobian, by_camera)
    moved = jnp.einsum("jib,bicp->bjcp", _inverse(normal), pull).reshape(points.shape[1], 3, -1)
    return jnp.einsum("bid,de,bje->ijb", moved, camera_covariance, moved, optimize=[(0, 1), (0, 1)])


def _normal_matrix(jacobian: Float[Array, "2 3 C B"]) -> Float[Array, "3 3 B"]:
    half = {(i, j): jnp.sum(jacobian[:, i] * jacobian[:, j], axis=(0, 1)) for i in range(3) for j in range(3) if i <= j}
    return jnp.stack([jnp.stack([half[min(i, j), max(i, j)] for j in range(3)]) for i in range(3)])


def _inverse(matrix: Float[Array, "3 3 B"]) -> Float[Array, "3 3 B"]:
    """Inverse of symmetric positive matrices by L D L^T; pivots too small to mean anything are raised."""
    m = matrix
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    least = jnp.where(trace > 0, trace, 1.0) * jnp.finfo(m.dtype).eps
    d0 = jnp.maximum(m[0, 0], least)
    l10, l20 = m[1, 0] / d0, m[2, 0] / d0
    d1 = jnp.maximum(m[1, 1] - l10 * m[1, 0], least)
    l21 = (m[2, 1] - l20 * m[1, 0]) / d1
    d2 = jnp.maximum(m[2, 2] - l20 * m[2, 0] - l21 * l21 * d1, least)
    a = l10 * l21 - l20
    i22 = 1 / d2
    i12 = -l21 * i22
    i02 = a * i22
    i11 = 1 / d1 - l21 * i12
    i01 = -l10 / d1 - l21 * i02
    i00 = 1 / d0 + l10 * l10 / d1 + a * i02
    return jnp.stack([jnp.stack([i00, i01, i02]), jnp.stack([i01, i11, i12]), jnp.stack([i02, i12, i22])])


def _times(matrix: Float[Array, "3 3 B"], vector: Float[Array, "3 B"]) -> Float[Array, "3 B"]:
    return jnp.stack([sum((matrix[i, j] * vector[j] for j in range(1, 3)), matrix[i, 0] * vector[0]) for i in range(3)])


def _over(mask: Bool[Array, " B"], values: Float[Array, "*front B"]) -> Bool[Array, "*front B"]:
    return jnp.broadcast_to(mask.reshape((1,) * (values.ndim - 1) + mask.shape), values.shape)


def _axes(points: Float[Array, "3 B"]) -> list[Float[Array, "3 B"]]:
    """The three unit displacements of every point."""
    return [jnp.zeros_like(points).at[i].set(1.0) for i in range(3)]


def _safe_sqrt(squared: Array) -> Array:
    """Square root with gradient 0 (not NaN) at 0."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
