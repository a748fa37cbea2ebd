"""Points from the pixels of several cameras, with covariance and with flags where not to believe them.

The linear start is the thesis's (4.2.1) put right: the rows x P3 - P1 and y P3 - P2 of every view. Levenberg-Marquardt
on the pixel error of the full camera model follows (Hartley and Zisserman 2004, chapter 12).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable
from enum import IntFlag
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxpoint.camera.camera import Camera
from jaxpoint.camera.lens import Slopes
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.cores import by_all_cores
from jaxpoint.geometry.arrays import AnyArray, as_float, check_whole, widest
from jaxpoint.geometry.linalg import Symmetric, Vector, symmetric_full, symmetric_inverse, symmetric_times

MIN_PARALLAX = math.radians(2.0)
_BLOCK = 6144  # pixels that are worked on at once on a CPU, so that all about them stays in its cache
_PART = 2**14  # points that one core of a CPU works on before it takes others
_LARGE = 2**20  # points in a block elsewhere
_DAMPING = 1e-6  # of Levenberg-Marquardt at the start, relative to the diagonal
_SETTLED = 1e-10  # px^2; a step that promises to lower a cost by less is taken unseen, and is the last
_MANY_VIEWS = 8  # with more, sums over views and pairs of views are not written out: quicker to compile
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


Rows3: TypeAlias = tuple[Float[Array, "C B"], Float[Array, "C B"], Float[Array, "C B"]]


class Flag(IntFlag):
    """What is wrong with a triangulated point."""

    BEHIND = 1  # it lies behind a camera that sees it, or beyond all directions of its lens
    LOW_PARALLAX = 2  # all lines of sight are within 2 degrees of parallel: its distance is hardly determined
    FEW_VIEWS = 4  # fewer than two usable views: there is no point
    BEYOND_REACH = 16  # it was seen where a calibration found that the lens model no longer holds
    LENS_RANGE = 8  # a visible pixel is NaN or lies where the lens model has no ray; that view was not used


class Triangulation(eqx.Module):
    """Points seen by C cameras. All entries are finite but the covariance of points with fewer than two views."""

    points: Float[Array, "*batch 3"]  # m; 0 with fewer than two views
    covariance_or_none: Float[Array, "*batch 3 3"] | None  # None if it was not asked for
    residuals: Float[Array, "*batch C 2"]  # px, projected minus observed; 0 for views not used
    rms: Float[Array, "*batch"]  # px, of the residuals' lengths over the views used
    parallax: Float[Array, "*batch"]  # rad, largest angle between two lines of sight, 0 to pi / 2
    flags: Int[Array, "*batch"]  # sum of `Flag`s

    @property
    def covariance(self) -> Float[Array, "*batch 3 3"]:
        """Of the points, m^2; infinite on the diagonal with fewer than two views.

        Raises:
            ValueError: it was not asked for.
        """
        if self.covariance_or_none is None:
            raise ValueError("These points were triangulated with covariance=False and have none; leave that out.")
        return self.covariance_or_none

    @property
    def valid(self) -> Bool[Array, "*batch"]:
        """Whether a point has two views or more, enough parallax, lies in front of the cameras that see it, and within
        the reach of their lens models."""
        return (self.flags & (Flag.BEHIND | Flag.LOW_PARALLAX | Flag.FEW_VIEWS | Flag.BEYOND_REACH)) == 0


def triangulate(
    rig: CameraRig,
    pixels: Float[AnyArray, "*batch C 2"],
    visible: Bool[AnyArray, "*batch C"],
    *,
    sigma_px: Float[AnyArray, ""] | float = 1.0,
    camera_covariance: Float[AnyArray, "D D"] | None = None,
    refine_steps: int = 4,
    covariance: bool = True,
) -> Triangulation:
    """Points of the world from their pixels in two or more cameras, one point or millions.

    Pixels are as the cameras saw them, distortion included; what stands at a hidden pixel never matters. Where rig,
    pixels and covariance differ in precision, the highest counts. The result
    minimises the squared pixel error over the views used, and its derivatives by pixels and cameras come from the
    implicit function theorem.

    Args:
        rig: the cameras, C of them.
        pixels: px.
        visible: which of them to use.
        sigma_px: standard deviation of one pixel coordinate, px; scales the covariance.
        camera_covariance: covariance of the rig's parameters, D = p C, in the order of `Camera.perturbed` camera by
            camera; its effect is added to the points' covariance.
        refine_steps: Levenberg-Marquardt steps after the linear solution, at most.
        covariance: whether to give the points' covariance; without it a call on a CPU takes about a fifth less time
            with two views, a twentieth with six.

    Raises:
        ValueError: shapes do not fit, or float64 would be cut to float32.
    """
    as_float(rig.cameras.focal)
    pixels, visible = (
        values if isinstance(values, np.ndarray) else jnp.asarray(values) for values in (pixels, visible)
    )
    cameras = len(rig)
    if pixels.ndim < 2 or pixels.shape[-2:] != (cameras, 2) or visible.shape != pixels.shape[:-1]:
        raise ValueError(
            f"{cameras} cameras need pixels of shape (..., {cameras}, 2) and visible of shape (..., {cameras}), "
            f"not {pixels.shape} and {visible.shape}."
        )
    size = rig.camera_size * cameras
    if camera_covariance is not None and camera_covariance.shape != (size, size):
        raise ValueError(
            f"The covariance of {cameras} cameras has shape {(size, size)} ({rig.camera_size} parameters each), "
            f"not {camera_covariance.shape}."
        )
    batch = pixels.shape[:-2]
    count = math.prod(batch)
    pixels, visible = pixels.reshape(count, cameras, 2), visible.reshape(count, cameras)
    check_whole(pixels)
    spread = None if camera_covariance is None else as_float(camera_covariance)
    dtype = widest(rig, pixels, spread)
    stacked, spread = jax.tree.map(lambda leaf: leaf.astype(dtype), (rig.cameras, spread))
    noise = as_float(sigma_px).astype(dtype), spread
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((rig, pixels, visible, noise)))
    block, size = _sizes(count, cameras, whole=traced)

    def part(start: int) -> Triangulation:
        some = slice(start, start + size)
        own = as_float(pixels[some]).astype(dtype), jnp.asarray(visible[some], dtype=bool)
        seen = tuple(_pad(values, size) for values in own)
        return _triangulate(stacked, *seen, *noise, refine_steps, block, covariance)

    if count > size:
        pixels, visible = np.asarray(pixels), np.asarray(visible)
        result = by_all_cores(part, count, size)
    else:
        result = part(0)
        result = result if count == size else jax.tree.map(lambda leaf: leaf[:count], result)
    if rig.reach is not None:
        flags = _with_reach(rig.cameras.center, rig.reach, pixels, visible, result.flags, jnp if traced else np)
        result = eqx.tree_at(lambda found: found.flags, result, jnp.asarray(flags))
    return jax.tree.map(lambda leaf: leaf.reshape(*batch, *leaf.shape[1:]), result)


def _with_reach(center, reach, pixels, visible, flags, xp: Any) -> Any:
    """The flags with that of points that some camera saw where its lens model has ended; xp is numpy or jax.numpy.

    Outside of a trace numpy does it: XLA's compiler crashed twice on a single operation here (cause unknown).
    """
    center, reach, pixels, visible, flags = (xp.asarray(part) for part in (center, reach, pixels, visible, flags))
    away = xp.sqrt((xp.where(visible[..., None], pixels - center[None], 0.0) ** 2).sum(axis=-1))
    beyond = (away > reach[None]).any(axis=-1)
    return xp.where(beyond, flags | int(Flag.BEYOND_REACH), flags)


def _sizes(count: int, cameras: int, *, whole: bool) -> tuple[int, int]:
    """Points in a block and in a part, which is whole blocks: few different ones, so that few programs are compiled."""
    cpu = jax.default_backend() == "cpu"
    block = 1 << (max(_BLOCK // cameras, 128).bit_length() - 1) if cpu else _LARGE
    if count <= block:
        block = 1 << max(count - 1, 0).bit_length()
        return block, block
    blocks = -(-count // block)
    step = 1 << max(blocks.bit_length() - 3, 0)
    size = -(-blocks // step) * step * block
    return block, min(size, _PART) if cpu and not whole else size


def _pad(values: Shaped[Array, "n ..."], size: int) -> Shaped[Array, "size ..."]:
    """With zeros at the end, if it is too short."""
    missing = size - len(values)
    return jnp.pad(values, ((0, missing), *[(0, 0)] * (values.ndim - 1))) if missing else values


@partial(jit, static_argnames=("steps", "block", "with_covariance"))
def _triangulate(
    cameras: Camera,
    pixels: Float[Array, "N C 2"],
    visible: Bool[Array, "N C"],
    sigma_px: Float[Array, ""],
    camera_covariance: Float[Array, "D D"] | None,
    steps: int,
    block: int,
    with_covariance: bool,
) -> Triangulation:
    """Blocks of points one after the other, the points on the last axis of everything."""
    # The origin in the middle of the cameras: rounding is then relative to the room, not to where the world begins.
    origin = jnp.mean(jax.vmap(lambda camera: camera.position)(cameras), axis=0)
    shift = jax.vmap(lambda camera: camera.cam_from_world @ origin)(cameras)
    local = eqx.tree_at(lambda camera: camera.cam_from_world.translation, cameras, shift)
    rows = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1)[..., None], local)
    # Turned before the loop: within it XLA would leave the views on the last axis in memory.
    turned = (
        pixels.reshape(-1, block, *pixels.shape[1:]).transpose(0, 3, 2, 1),
        visible.reshape(-1, block, visible.shape[1]).transpose(0, 2, 1),
    )

    def one_block(args: tuple[Array, Array]) -> Triangulation:
        seen, enough, result = _triangulate_block(rows, *args, steps)
        points, residuals, normal, rest = result
        covariance = None
        if with_covariance:
            inverse = tuple(entry / seen.views for entry in symmetric_inverse(normal))
            covariance = sigma_px**2 * symmetric_full(inverse)
            if camera_covariance is not None:
                # In the world's own frame, for that is where `Camera.perturbed` turns a camera about.
                placed = points[0] + origin[0], points[1] + origin[1], points[2] + origin[2]
                covariance = covariance + _from_cameras(cameras, seen, placed, inverse, camera_covariance)
            unknown = jnp.where(jnp.eye(3, dtype=bool), jnp.inf, 0.0).astype(covariance.dtype)
            covariance = jnp.where(enough[:, None, None], covariance, unknown[None])
        places = [jnp.where(enough, points[i] + origin[i], 0.0) for i in range(3)]
        return Triangulation(jnp.stack(places, axis=-1), covariance, jnp.stack(residuals).transpose(2, 1, 0), *rest)

    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), jax.lax.map(one_block, turned))


def _triangulate_block(
    cameras: Camera, pixels: Float[Array, "2 C B"], visible: Bool[Array, "C B"], steps: int
) -> tuple:
    """What was seen, where that is enough, and of one block: points, residuals, normal matrix, rms, parallax, flags.

    Here and below the cameras are `rows`: every parameter of theirs is a column (C, 1) that meets arrays (C, B).
    """
    wanted = visible & jnp.isfinite(pixels[0]) & jnp.isfinite(pixels[1])
    pixel_x, pixel_y = jnp.where(wanted[None], pixels, 0.0)
    (u, v, w), in_range = _directions(cameras, pixel_x, pixel_y, wanted)
    used = wanted & in_range
    views = _sum(used.astype(pixels.dtype))
    enough = views >= 2
    used = used & enough[None]
    # The root makes XLA keep the numbers: it would turn bits into numbers anew wherever they are used.
    weight = jnp.sqrt(jnp.where(used, 1.0, 0.0).astype(pixels.dtype))
    pixel_x, pixel_y, u, v = (jnp.where(used, values, 0.0) for values in (pixel_x, pixel_y, u, v))
    seen = Seen(pixel_x, pixel_y, u, v, jnp.where(used, w, 1.0), weight, jnp.maximum(views, 1))

    points, normal = _optimum(cameras, seen, steps)
    (x, y), behind = _project_all(cameras, seen, points)
    residuals = (x - seen.pixel_x) * weight, (y - seen.pixel_y) * weight
    cost = _mean(seen, residuals[0] ** 2 + residuals[1] ** 2)
    parallax = _parallax(cameras, seen)
    flags = (
        Flag.BEHIND * (_sum(behind) > 0)
        + Flag.LOW_PARALLAX * (enough & (parallax < MIN_PARALLAX))
        + Flag.FEW_VIEWS * ~enough
        + Flag.LENS_RANGE * jnp.any(visible & ~(wanted & in_range), axis=0)
    )
    rest = _safe_sqrt(cost), parallax, flags.astype(jnp.int32)
    return seen, enough, (points, residuals, normal, rest)


class Seen(NamedTuple):
    """What the cameras saw of a block of points; 0 where not used."""

    pixel_x: Float[Array, "C B"]  # px
    pixel_y: Float[Array, "C B"]
    sight_x: Float[Array, "C B"]  # direction of the line of sight in the camera; z = 1 unless a lens sees sideways
    sight_y: Float[Array, "C B"]
    sight_z: Float[Array, "C B"]
    weight: Float[Array, "C B"]  # 1 where used
    views: Float[Array, " B"]  # how many are used; 1 at least


class Fit(NamedTuple):
    """How points explain what the cameras saw, and the normal equations of a better guess."""

    behind: Float[Array, " B"]  # share of the views used that have the point behind the camera
    cost: Float[Array, " B"]  # px^2, mean over these views of the squared residuals; so are the others
    gradient: Vector
    normal: Symmetric


class Search(NamedTuple):
    """Where Levenberg-Marquardt stands with a block of points."""

    step: Int[Array, ""]
    points: Vector
    fit: Fit  # there
    damping: Float[Array, " B"]
    trial: Vector
    promise: Float[Array, " B"]  # px^2, by which the trial should lower the cost


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _optimum(cameras: Camera, seen: Seen, steps: int) -> tuple[Vector, Symmetric]:
    """The points of least squared pixel error: the linear start, then Levenberg-Marquardt. With their normal matrix.

    optimistix's Levenberg-Marquardt, vmapped, ends at the same points to 1e-14 m and takes 110 times as long (150 us a
    point in 4 views in place of 1.4; experiments/benchmarks/small_solvers.py).
    """
    start = _linear(cameras, seen)
    if steps == 0:
        return start, _fit(cameras, seen, start).normal

    def unsettled(search: Search) -> Bool[Array, ""]:
        return (search.step <= steps) & jnp.any(search.promise > _SETTLED)

    def step(search: Search) -> Search:
        fit = _fit(cameras, seen, search.trial)
        # A step may bring a point before a camera at any cost, and never behind one. Costs equal to rounding count as
        # less: the last steps of a converging point would else be left out.
        less = fit.cost <= search.fit.cost * (1 + 16 * jnp.finfo(fit.cost.dtype).eps)
        better = (fit.behind < search.fit.behind) | ((fit.behind == search.fit.behind) & less)
        damping = jnp.where(better, search.damping * 0.1, jnp.maximum(search.damping, 1e-4) * 30)
        there = (search.trial, fit), (search.points, search.fit)
        # Nearly always all are. XLA on a CPU makes slow loops where it may write the chosen values over the old ones.
        points, fit = jax.lax.cond(
            jnp.all(better), lambda: there[0], lambda: jax.tree.map(partial(jnp.where, better), *there)
        )
        xx, xy, xz, yy, yz, zz = fit.normal
        more = 1 + damping
        move = symmetric_times(symmetric_inverse((xx * more, xy, xz, yy * more, yz, zz * more)), fit.gradient)
        promise = move[0] * fit.gradient[0] + move[1] * fit.gradient[1] + move[2] * fit.gradient[2]
        trial = tuple(old - by for old, by in zip(points, move, strict=True))
        return Search(search.step + 1, points, fit, damping, trial, promise)

    nothing, infinite = jnp.zeros_like(start[0]), jnp.full_like(start[0], jnp.inf)
    unknown = Fit(infinite, infinite, (nothing,) * 3, (nothing,) * 6)
    damping = jnp.full_like(nothing, 10 * _DAMPING)
    end = jax.lax.while_loop(unsettled, step, Search(jnp.asarray(0), start, unknown, damping, start, infinite))
    points = jax.tree.map(partial(jnp.where, end.promise <= _SETTLED), end.trial, end.points)
    return points, end.fit.normal


@_optimum.defjvp
def _optimum_jvp(steps: int, primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
    """The gradient of the cost stays 0: Hessian times the points' motion balances what moves the gradient."""
    cameras, seen = primals
    points, normal = _optimum(cameras, seen, steps)

    def gradient(points: Vector, cameras: Camera, pixels: tuple[Array, Array]) -> Vector:
        return _fit(cameras, seen._replace(pixel_x=pixels[0], pixel_y=pixels[1]), points).gradient

    pixels, pixels_by = seen[:2], tangents[1][:2]
    _, change = jax.jvp(lambda c, p: gradient(points, c, p), (cameras, pixels), (tangents[0], pixels_by))
    _, hessian = jax.linearize(lambda x: gradient(x, cameras, pixels), points)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (hessian(axis) for axis in _axes(points[0]))
    moved = symmetric_times(symmetric_inverse((xx, xy, xz, yy, yz, zz)), change)
    known = jnp.any(seen.weight > 0, axis=0)
    points_by = tuple(jnp.where(known, -by, 0.0) for by in moved)
    _, normal_by = jax.jvp(lambda c, x: _fit(c, seen, x).normal, (cameras, points), (tangents[0], points_by))
    return (points, normal), (points_by, normal_by)


def _directions(
    cameras: Camera, pixel_x: Float[Array, "C B"], pixel_y: Float[Array, "C B"], wanted: Bool[Array, "C B"]
) -> tuple[Rows3, Bool[Array, "C B"]]:
    """Lines of sight in the cameras, and whether the lenses have them."""
    return cameras.lens.direction_of(cameras.lens.parameters, pixel_x, pixel_y, wanted)


def _linear(cameras: Camera, seen: Seen) -> Vector:
    """Least squares of the rows x P3 - z P1 and y P3 - z P2, each scaled to a distance from its plane.

    Where a lens sees sideways z may be 0, and the row x P2 - y P1 is taken too.
    """
    r, t = cameras.cam_from_world.rotation, cameras.cam_from_world.translation
    x, y, z = seen.sight_x, seen.sight_y, seen.sight_z
    sideways = cameras.lens.sees_sideways
    crosses = ((x, z, 2, 0), (y, z, 2, 1), (x, y, 1, 0)) if sideways else ((x, None, 2, 0), (y, None, 2, 1))
    rows, scaled, offsets = [], [], []
    for one, other, i, j in crosses:
        # The rows of a rotation are unit vectors at right angles.
        row = [one * r[i, k] - (r[j, k] if other is None else other * r[j, k]) for k in range(3)]
        weight = seen.weight if sideways else seen.weight / (1 + one * one)
        rows.append(row)
        scaled.append([weight * entry for entry in row])
        offsets.append(one * t[i] - (t[j] if other is None else other * t[j]))
    matrix = tuple(_mean(seen, _total(a[i] * b[j] for a, b in zip(scaled, rows, strict=True))) for i, j in _PAIRS)
    vector = tuple(_mean(seen, _total(a[i] * b for a, b in zip(scaled, offsets, strict=True))) for i in range(3))
    return tuple(-value for value in symmetric_times(symmetric_inverse(matrix), vector))


def _fit(cameras: Camera, seen: Seen, points: Vector) -> Fit:
    """Cost and normal equations of the full camera model at some points.

    What many sums share ends in a division: XLA on a CPU computes cheap operations anew for every sum, and keeps the
    result of a division.
    """
    r = cameras.cam_from_world.rotation
    slopes, behind = _slopes(cameras, seen, points)
    x = (slopes.pixel[0] - seen.pixel_x) * seen.weight
    y = (slopes.pixel[1] - seen.pixel_y) * seen.weight
    x_by, y_by = (
        [seen.weight * (a * r[0, i] + b * r[1, i] + c * r[2, i]) for i in range(3)] for a, b, c in slopes.by_direction
    )
    return Fit(
        _mean(seen, behind),
        _mean(seen, x * x + y * y),
        tuple(_mean(seen, x_by[i] * x + y_by[i] * y) for i in range(3)),
        tuple(_mean(seen, x_by[i] * x_by[j] + y_by[i] * y_by[j]) for i, j in _PAIRS),
    )


def _total(parts: Iterable[Float[Array, "C B"]]) -> Float[Array, "C B"]:
    return functools.reduce(jnp.add, parts)


def _sum(rows: Float[Array, "C B"]) -> Float[Array, " B"]:
    """Over the views. Written out where they are few: XLA on a CPU has no wide instructions for the sum of rows."""
    return sum(rows[1:], rows[0]) if len(rows) <= _MANY_VIEWS else jnp.sum(rows, axis=0)


def _mean(seen: Seen, rows: Float[Array, "C B"]) -> Float[Array, " B"]:
    """Over the views used."""
    return _sum(rows) / seen.views


def _local(cameras: Camera, seen: Seen, points: Vector) -> Rows3:
    """Points in every camera; straight ahead where a view is not used."""
    r, t = cameras.cam_from_world.rotation, cameras.cam_from_world.translation
    x, y, z = points
    right, down, depth = (r[i, 0] * x[None] + r[i, 1] * y[None] + r[i, 2] * z[None] + t[i] for i in range(3))
    used = seen.weight > 0
    if cameras.lens.sees_sideways:
        right, down = jnp.where(used, right, 0.0), jnp.where(used, down, 0.0)
    return right, down, jnp.where(used, depth, 1.0)


def _slopes(cameras: Camera, seen: Seen, points: Vector) -> tuple[Slopes, Float[Array, "C B"]]:
    """Pixels of points in every camera and their derivatives, and where a camera has the point behind it."""
    local = _local(cameras, seen, points)
    return cameras.lens.slopes_of(cameras.lens.parameters, local), _behind(cameras, local, seen.weight)


def _project_all(
    cameras: Camera, seen: Seen, points: Vector
) -> tuple[tuple[Float[Array, "C B"], Float[Array, "C B"]], Float[Array, "C B"]]:
    """Pixels of points in every camera, which mean nothing where a view is not used, and where they lie behind it."""
    local = _local(cameras, seen, points)
    return cameras.lens.image_of(cameras.lens.parameters, local), _behind(cameras, local, seen.weight)


def _behind(cameras: Camera, local: Rows3, weight: Float[Array, "C B"]) -> Float[Array, "C B"]:
    """1 where a camera cannot see a point that it is said to see."""
    if cameras.lens.sees_sideways:
        return jnp.where(cameras.lens.in_range(cameras.lens.parameters, local), 0.0, weight)
    return jnp.where(local[2] < 0, weight, 0.0)


def _parallax(cameras: Camera, seen: Seen) -> Float[Array, " B"]:
    """Largest angle between the lines of sight, from the chord between their directions: exact where it is small."""
    r = cameras.cam_from_world.rotation
    rays = [seen.sight_x * r[0, i] + seen.sight_y * r[1, i] + seen.sight_z * r[2, i] for i in range(3)]
    length = jnp.sqrt(seen.sight_x**2 + seen.sight_y**2 + seen.sight_z**2)
    rays = tuple(ray / length for ray in rays)

    def chord2(one: tuple[Array, ...], other: tuple[Array, ...]) -> Array:
        apart, summed = (sum((a + sign * b) ** 2 for a, b in zip(one, other, strict=True)) for sign in (-1, 1))
        return jnp.minimum(apart, summed)

    def widen(widest: Array, view: tuple[Vector, Array]) -> tuple[Array, None]:
        other, weight = view
        wide = chord2(rays, tuple(part[None] for part in other)) * (seen.weight * weight[None])
        return jnp.maximum(widest, jnp.max(wide, axis=0)), None

    widest = jnp.zeros_like(rays[0][0])
    if len(seen.weight) > _MANY_VIEWS:
        widest, _ = jax.lax.scan(widen, widest, (rays, seen.weight))
    else:
        for i, j in itertools.combinations(range(len(seen.weight)), 2):
            one, other = (tuple(ray[k] for ray in rays) for k in (i, j))
            widest = jnp.maximum(widest, chord2(one, other) * (seen.weight[i] * seen.weight[j]))
    return 2 * jnp.arcsin(_safe_sqrt(widest) / 2)


def _from_cameras(
    cameras: Camera, seen: Seen, points: Vector, inverse: Symmetric, camera_covariance: Float[Array, "D D"]
) -> Float[Array, "B 3 3"]:
    """What the cameras' own covariance adds to the points': both move so that the pixel error stays least."""
    places = jnp.stack(points, axis=-1)

    def one(camera: Camera, weight: Float[Array, " B"]) -> Float[Array, "3 p B"]:
        def pixel(change: Float[Array, " p"]) -> Float[Array, "2 B"]:
            return camera.perturbed(change).project(places).T

        by_camera = jax.jacfwd(pixel)(jnp.zeros(camera.size, dtype=places.dtype))  # (2, B, p)
        by_point = [jax.jvp(camera.project, (places,), (jnp.stack(axis, axis=-1),))[1] for axis in _axes(points[0])]
        rows = [by[:, 0, None] * by_camera[0] + by[:, 1, None] * by_camera[1] for by in by_point]
        return jnp.where(weight[None, None] > 0, jnp.stack(rows).transpose(0, 2, 1), 0.0)

    pull = jax.vmap(one)(cameras, seen.weight).transpose(3, 1, 0, 2)  # (B, 3, C, p)
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
