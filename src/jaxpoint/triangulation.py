"""Points from the pixels of several cameras, with covariance and with flags where not to believe them.

The linear start is the thesis's (4.2.1) put right: the rows x P3 - P1 and y P3 - P2 of every view. Levenberg-Marquardt
on the pixel error of the full camera model follows (Hartley and Zisserman 2004, chapter 12).
"""

from __future__ import annotations

import math
from enum import IntFlag
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.camera.camera import PARAMETERS, Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry.arrays import AnyArray, as_float, stack_last
from jaxpoint.geometry.linalg import Symmetric, Vector, symmetric_full, symmetric_inverse, symmetric_times

MIN_PARALLAX = math.radians(2.0)
_BLOCK = 1024  # points that are worked on at once on a CPU, so that they stay in its cache
_DAMPING = 1e-6  # of Levenberg-Marquardt at the start, relative to the diagonal
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Flag(IntFlag):
    """What is wrong with a triangulated point."""

    BEHIND = 1  # it lies behind a camera that sees it
    LOW_PARALLAX = 2  # all lines of sight are within 2 degrees of parallel: its distance is hardly determined
    FEW_VIEWS = 4  # fewer than two usable views: there is no point
    LENS_RANGE = 8  # a visible pixel is NaN or lies where the lens model has no ray; that view was not used


class Triangulation(eqx.Module):
    """Points seen by C cameras. All entries are finite but the covariance of points with fewer than two views."""

    points: Float[Array, "*batch 3"]  # m; 0 with fewer than two views
    covariance: Float[Array, "*batch 3 3"]  # m^2; infinite on the diagonal with fewer than two views
    residuals: Float[Array, "*batch C 2"]  # px, projected minus observed; 0 for views not used
    rms: Float[Array, "*batch"]  # px, of the residuals' lengths over the views used
    parallax: Float[Array, "*batch"]  # rad, largest angle between two lines of sight, 0 to pi / 2
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
    refine_steps: int = 4,
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
    finite = jnp.all(jnp.isfinite(pixels), axis=0)
    pixels = jnp.where((visible & finite)[None], pixels, 0.0)
    ideal, in_range = _ideal(cameras, pixels)
    used = visible & finite & in_range
    views = jnp.sum(used, axis=0)
    enough = views >= 2
    used = used & enough[None]
    pixel_x, pixel_y, ideal_x, ideal_y = (jnp.where(used, values, 0.0) for values in (*pixels, *ideal))
    seen = Seen(pixel_x, pixel_y, ideal_x, ideal_y, used)

    points = _optimum(cameras, seen, steps)
    fit = _fit(cameras, seen, points)
    inverse = symmetric_inverse(fit.normal)
    covariance = sigma_px**2 * symmetric_full(inverse)
    if camera_covariance is not None:
        covariance = covariance + _from_cameras(cameras, seen, points, inverse, camera_covariance)
    unknown = jnp.where(jnp.eye(3, dtype=bool), jnp.inf, 0.0).astype(covariance.dtype)
    parallax = _parallax(cameras, seen)
    flags = (
        Flag.BEHIND * (fit.behind > 0)
        + Flag.LOW_PARALLAX * (enough & (parallax < MIN_PARALLAX))
        + Flag.FEW_VIEWS * ~enough
        + Flag.LENS_RANGE * jnp.any(visible & ~(finite & in_range), axis=0)
    )
    return Triangulation(
        points=jnp.stack([jnp.where(enough, points[i] + origin[i], 0.0) for i in range(3)], axis=-1),
        covariance=jnp.where(enough[:, None, None], covariance, unknown[None]),
        residuals=_residuals(cameras, seen, points),
        rms=_safe_sqrt(fit.cost / jnp.maximum(views, 1)),
        parallax=parallax,
        flags=flags.astype(jnp.int32),
    )


class Seen(NamedTuple):
    """What the cameras saw of a block of points; 0 where not used."""

    pixel_x: Float[Array, "C B"]  # px
    pixel_y: Float[Array, "C B"]
    ideal_x: Float[Array, "C B"]  # undistorted, on the z = 1 plane
    ideal_y: Float[Array, "C B"]
    used: Bool[Array, "C B"]


class Fit(NamedTuple):
    """How points explain what the cameras saw, and the normal equations of a better guess."""

    behind: Float[Array, " B"]  # number of cameras that see the point behind them
    cost: Float[Array, " B"]  # px^2, sum of squared residuals
    gradient: Vector
    normal: Symmetric


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _optimum(cameras: Camera, seen: Seen, steps: int) -> Vector:
    """The points of least squared pixel error: the linear start, then Levenberg-Marquardt."""

    def step(_: Int[Array, ""], state: tuple[Vector, Vector, Fit, Array]) -> tuple[Vector, Vector, Fit, Array]:
        trial, points, fit, damping = state
        trial_fit = _fit(cameras, seen, trial)
        # A step may bring a point before a camera at any cost, and never behind one. Costs equal to rounding count as
        # less: the last steps of a converging point would else be left out.
        less = trial_fit.cost <= fit.cost * (1 + 16 * jnp.finfo(damping.dtype).eps)
        better = (trial_fit.behind < fit.behind) | ((trial_fit.behind == fit.behind) & less)
        damping = jnp.where(better, damping * 0.1, jnp.maximum(damping, 1e-4) * 30)
        points, fit = jax.tree.map(partial(jnp.where, better), (trial, trial_fit), (points, fit))
        xx, xy, xz, yy, yz, zz = fit.normal
        more = 1 + damping
        move = symmetric_times(symmetric_inverse((xx * more, xy, xz, yy * more, yz, zz * more)), fit.gradient)
        return tuple(old - by for old, by in zip(points, move, strict=True)), points, fit, damping

    start = _linear(cameras, seen)
    nothing, infinite = jnp.zeros_like(start[0]), jnp.full_like(start[0], jnp.inf)
    unknown = Fit(infinite, infinite, (nothing,) * 3, (nothing,) * 6)
    state = start, start, unknown, jnp.full_like(nothing, 10 * _DAMPING)
    return jax.lax.fori_loop(0, steps + 1, step, state)[1]


@_optimum.defjvp
def _optimum_jvp(steps: int, primals: tuple, tangents: tuple) -> tuple[Vector, Vector]:
    """The gradient of the cost stays 0: Hessian times the points' motion balances what moves the gradient."""
    cameras, seen = primals
    points = _optimum(cameras, seen, steps)

    def gradient(points: Vector, cameras: Camera, pixels: tuple[Array, Array]) -> Vector:
        return _fit(cameras, seen._replace(pixel_x=pixels[0], pixel_y=pixels[1]), points).gradient

    pixels, pixels_by = seen[:2], tangents[1][:2]
    _, change = jax.jvp(lambda c, p: gradient(points, c, p), (cameras, pixels), (tangents[0], pixels_by))
    _, hessian = jax.linearize(lambda x: gradient(x, cameras, pixels), points)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (hessian(axis) for axis in _axes(points[0]))
    moved = symmetric_times(symmetric_inverse((xx, xy, xz, yy, yz, zz)), change)
    known = jnp.any(seen.used, axis=0)
    return points, tuple(jnp.where(known, -by, 0.0) for by in moved)


def _ideal(cameras: Camera, pixels: Float[Array, "2 C B"]) -> tuple[Float[Array, "2 C B"], Bool[Array, "C B"]]:
    """Undistorted places on the z = 1 plane, and whether the lens model has them."""

    def one(camera: Camera, pixel: Float[Array, "2 B"]) -> tuple[Array, Array]:
        xy, valid = camera.distortion.undistort(camera.from_pixel(pixel.T))
        return xy.T, valid

    return jax.vmap(one, in_axes=(0, 1), out_axes=(1, 0))(cameras, pixels)


def _linear(cameras: Camera, seen: Seen) -> Vector:
    """Least squares of the rows x P3 - P1 and y P3 - P2 in camera units, each scaled to a distance from its plane."""

    def one(camera: Camera, x: Float[Array, " B"], y: Float[Array, " B"], used: Bool[Array, " B"]) -> tuple:
        r, t = camera.cam_from_world.rotation, camera.cam_from_world.translation
        products = []
        for k, place in enumerate((x, y)):
            row = [place * r[2, i] - r[k, i] for i in range(3)]
            weight = jnp.where(used, 1 / (row[0] ** 2 + row[1] ** 2 + row[2] ** 2), 0.0)
            scaled = [weight * entry for entry in row]
            offset = place * t[2] - t[k]
            products.append([scaled[i] * row[j] for i, j in _PAIRS] + [entry * offset for entry in scaled])
        return tuple(a + b for a, b in zip(*products, strict=True))

    sums = _sum_views(*jax.vmap(one)(cameras, seen.ideal_x, seen.ideal_y, seen.used))
    return tuple(-value for value in symmetric_times(symmetric_inverse(sums[:6]), sums[6:]))


def _fit(cameras: Camera, seen: Seen, points: Vector) -> Fit:
    """Cost and normal equations of the full camera model at some points."""

    def one(camera: Camera, pixel_x: Array, pixel_y: Array, used: Array) -> tuple[Array, ...]:
        x, y, by_x, by_y, depth = _linearised(camera, points)
        x, y = jnp.where(used, x - pixel_x, 0.0), jnp.where(used, y - pixel_y, 0.0)
        by_x, by_y = ([jnp.where(used, entry, 0.0) for entry in row] for row in (by_x, by_y))
        gradient = [by_x[i] * x + by_y[i] * y for i in range(3)]
        normal = [by_x[i] * by_x[j] + by_y[i] * by_y[j] for i, j in _PAIRS]
        return (used & (depth <= 0)).astype(x.dtype), x * x + y * y, *gradient, *normal

    behind, cost, *rest = _sum_views(*jax.vmap(one)(cameras, seen.pixel_x, seen.pixel_y, seen.used))
    return Fit(behind, cost, tuple(rest[:3]), tuple(rest[3:]))


@jax.custom_jvp
def _sum_views(*terms: Float[Array, "C B"]) -> tuple[Float[Array, " B"], ...]:
    """Sums over the cameras, all in one pass: XLA would compute the terms anew for every sum of its own."""
    zero = tuple(jnp.zeros((), dtype=term.dtype) for term in terms)
    return tuple(jax.lax.reduce(terms, zero, lambda a, b: tuple(map(jnp.add, a, b)), (0,)))


@_sum_views.defjvp
def _sum_views_jvp(terms: tuple, changes: tuple) -> tuple[tuple, tuple]:
    return _sum_views(*terms), tuple(jnp.sum(change, axis=0) for change in changes)


def _residuals(cameras: Camera, seen: Seen, points: Vector) -> Float[Array, "B C 2"]:
    """Projected minus observed, px; 0 for views not used."""
    projected = jax.vmap(lambda camera: camera.project(jnp.stack(points, axis=-1)), out_axes=1)(cameras)
    observed = jnp.stack([seen.pixel_x.T, seen.pixel_y.T], axis=-1)
    return jnp.where(seen.used.T[:, :, None], projected - observed, 0.0)


def _linearised(camera: Camera, points: Vector) -> tuple[Array, Array, list[Array], list[Array], Array]:
    """Pixel x and y, their derivatives by the point, and the depth: `Camera.project` taken apart."""
    r, t = camera.cam_from_world.rotation, camera.cam_from_world.translation
    right, down, depth = (r[i, 0] * points[0] + r[i, 1] * points[1] + r[i, 2] * points[2] + t[i] for i in range(3))
    tiny = jnp.finfo(depth.dtype).eps
    inverse = 1 / jnp.where(jnp.abs(depth) < tiny, tiny, depth)
    u, v = right * inverse, down * inverse
    place = stack_last(u, v)
    along_u, along_v = (jnp.zeros_like(place).at[:, i].set(1.0) for i in range(2))
    bent, by_u = jax.jvp(camera.distortion.distort, (place,), (along_u,))
    _, by_v = jax.jvp(camera.distortion.distort, (place,), (along_v,))
    u_by = [(r[0, i] - u * r[2, i]) * inverse for i in range(3)]
    v_by = [(r[1, i] - v * r[2, i]) * inverse for i in range(3)]
    x, y = (camera.focal[k] * bent[:, k] + camera.center[k] for k in range(2))
    x_by, y_by = ([camera.focal[k] * (by_u[:, k] * u_by[i] + by_v[:, k] * v_by[i]) for i in range(3)] for k in range(2))
    return x, y, x_by, y_by, depth


def _parallax(cameras: Camera, seen: Seen) -> Float[Array, " B"]:
    """Largest angle between the lines of sight, from the chord between their directions: exact where it is small."""
    r = cameras.cam_from_world.rotation
    rays = [seen.ideal_x * r[:, 0, i, None] + seen.ideal_y * r[:, 1, i, None] + r[:, 2, i, None] for i in range(3)]
    length = jnp.sqrt(rays[0] ** 2 + rays[1] ** 2 + rays[2] ** 2)
    rays = tuple(ray / length for ray in rays)

    def widen(widest: Array, view: tuple[Vector, Array]) -> tuple[Array, None]:
        other, used = view
        apart, summed = (sum((a + sign * b[None]) ** 2 for a, b in zip(rays, other, strict=True)) for sign in (-1, 1))
        chord2 = jnp.where(seen.used & used[None], jnp.minimum(apart, summed), 0.0)
        return jnp.maximum(widest, jnp.max(chord2, axis=0)), None

    widest, _ = jax.lax.scan(widen, jnp.zeros_like(rays[0][0]), (rays, seen.used))
    return 2 * jnp.arcsin(_safe_sqrt(widest) / 2)


def _from_cameras(
    cameras: Camera, seen: Seen, points: Vector, inverse: Symmetric, camera_covariance: Float[Array, "D D"]
) -> Float[Array, "B 3 3"]:
    """What the cameras' own covariance adds to the points': both move so that the pixel error stays least."""

    def one(camera: Camera, used: Bool[Array, " B"]) -> Float[Array, "3 15 B"]:
        def pixel(change: Float[Array, "15"]) -> Float[Array, "2 B"]:
            return camera.perturbed(change).project(jnp.stack(points, axis=-1)).T

        by_camera = jax.jacfwd(pixel)(jnp.zeros(PARAMETERS, dtype=points[0].dtype))  # (2, B, 15)
        _, _, by_x, by_y, _ = _linearised(camera, points)
        rows = [x[:, None] * by_camera[0] + y[:, None] * by_camera[1] for x, y in zip(by_x, by_y, strict=True)]
        return jnp.where(used[None, None], jnp.stack(rows).transpose(0, 2, 1), 0.0)

    pull = jax.vmap(one)(cameras, seen.used).transpose(3, 1, 0, 2)  # (B, 3, C, 15)
    moved = jnp.einsum("bij,bjd->bid", symmetric_full(inverse), pull.reshape(*pull.shape[:2], -1))
    spread = (moved.reshape(-1, moved.shape[2]) @ camera_covariance).reshape(moved.shape)
    return jnp.einsum("bid,bjd->bij", spread, moved)


def _axes(like: Float[Array, " B"]) -> list[Vector]:
    """The three unit displacements of every point."""
    zero, one = jnp.zeros_like(like), jnp.ones_like(like)
    return [(one, zero, zero), (zero, one, zero), (zero, zero, one)]


def _safe_sqrt(squared: Array) -> Array:
    """Square root with gradient 0 (not NaN) at 0."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
