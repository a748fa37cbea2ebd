"""What follows from the uncertainty of a calibration: of pixels, triangulated points, lengths and lines.

One function a question. Every answer comes with its two sources apart: the cameras' error, which all points share, and
that of the points' own pixels. Derivatives are those of the triangulated optimum, by the implicit function theorem
(Foerstner and Wrobel 2016; for two cameras and chessboards mrcal answers the first two questions).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.calibration.uncertainty import Uncertainty
from jaxpoint.camera.camera import Camera
from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float, safe_norm
from jaxpoint.geometry.line import Ray
from jaxpoint.triangulation import triangulate


class Pixels(eqx.Module):
    """Where points of the world are seen, and how far that is uncertain because the cameras are."""

    pixels: Float[Array, "*batch C 2"]  # px
    covariance: Float[Array, "*batch C 2 2"]  # px^2


class Points(eqx.Module):
    """Triangulated points, and the two sources of their error. N points, in the rig's frame and unit."""

    points: Float[Array, "*batch 3"]
    calibration: Float[Array, "*batch 3 3"]  # covariance, because the cameras are uncertain; shared by all points
    observation: Float[Array, "*batch 3 3"]  # because their own pixels are; every point's own

    @property
    def covariance(self) -> Float[Array, "*batch 3 3"]:
        """Of both together."""
        return self.calibration + self.observation


class Estimate(eqx.Module):
    """Numbers computed from triangulated points, and the two sources of their error."""

    value: Float[Array, " M"]
    calibration: Float[Array, "M M"]  # covariance, because the cameras are uncertain
    observation: Float[Array, "M M"]  # because the points' pixels are

    @property
    def covariance(self) -> Float[Array, "M M"]:
        """Of both together."""
        return self.calibration + self.observation

    @property
    def sigma(self) -> Float[Array, " M"]:
        """One standard deviation of each number."""
        return jnp.sqrt(jnp.maximum(jnp.diagonal(self.covariance), 0.0))


@jit
def pixel_uncertainty(uncertainty: Uncertainty, points: Float[AnyArray, "*batch 3"]) -> Pixels:
    """Where known points of the rig's world (its unit) are seen, and the covariance that the cameras leave there.

    The points count as exact, and so does the frame that the gauge names: in a free gauge the frame itself is taken
    from the estimate. Only meaningful where the points lie in front of the camera.
    """
    points = as_float(points)
    blocks = uncertainty.own_blocks

    def one(camera: Camera, block: Float[Array, "p p"], point: Float[Array, "3"]) -> tuple[Array, Array]:
        by_parameters = _by_parameters(lambda moved: moved.project(point), camera)
        return camera.project(point), by_parameters @ block @ by_parameters.T

    over_cameras = jax.vmap(one, in_axes=(0, 0, None))
    flat = points.reshape(-1, 3)
    pixels, covariance = jax.vmap(over_cameras, in_axes=(None, None, 0))(uncertainty.rig.cameras, blocks, flat)
    batch = points.shape[:-1]
    return Pixels(pixels.reshape(*batch, *pixels.shape[1:]), covariance.reshape(*batch, *covariance.shape[1:]))


def point_uncertainty(
    uncertainty: Uncertainty,
    pixels: Float[AnyArray, "*batch C 2"],
    visible: Bool[AnyArray, "*batch C"],
    sigma_px: Float[AnyArray, ""] | float | None = None,
) -> Points:
    """Points triangulated from two views or more each, with covariance by source.

    Pixels are as the cameras saw them; hidden ones never matter. A point with fewer than two usable views has zeros
    for place and calibration part, and an infinite observation part.

    Args:
        sigma_px: standard deviation of one pixel coordinate; that of the calibration if not given.

    Raises:
        ValueError: shapes do not fit, or float64 would be cut to float32.
    """
    moved = _triangulate_with_derivatives(uncertainty, pixels, visible)
    by_cameras, by_pixels = moved.by_cameras, moved.by_pixels
    variance = _variance(uncertainty, sigma_px)
    size = by_cameras.shape[-1]
    spread = (by_cameras.reshape(-1, size) @ uncertainty.covariance).reshape(by_cameras.shape)
    calibration = jnp.einsum("...id,...jd->...ij", spread, by_cameras)
    observation = variance * jnp.einsum("...id,...jd->...ij", by_pixels, by_pixels)
    unknown = jnp.diag(jnp.full(3, jnp.inf, observation.dtype))
    few = ~moved.known[..., None, None]
    unknown = jnp.broadcast_to(unknown, observation.shape)
    return Points(moved.points, calibration, jnp.where(few, unknown, observation))


def propagate(
    uncertainty: Uncertainty,
    pixels: Float[AnyArray, "N C 2"],
    visible: Bool[AnyArray, "N C"],
    function: Callable[[Float[Array, "N 3"]], Float[Array, " M"]],
    sigma_px: Float[AnyArray, ""] | float | None = None,
) -> Estimate:
    """Anything that is computed from N triangulated points (`function`, differentiable), with covariance by source.

    All points hang on the same cameras, so their errors are not independent; here that is accounted for. Every point
    needs two views or more; where one has fewer, the observation part is not finite.

    Raises:
        ValueError: shapes do not fit, or float64 would be cut to float32.
    """
    moved = _triangulate_with_derivatives(uncertainty, pixels, visible)
    jacobian = jax.jacfwd(function)(moved.points)  # (M, N, 3)
    by_cameras = jnp.einsum("mni,nid->md", jacobian, moved.by_cameras)
    by_pixels = jnp.einsum("mni,nid->mnd", jacobian, moved.by_pixels).reshape(jacobian.shape[0], -1)
    observation = _variance(uncertainty, sigma_px) * by_pixels @ by_pixels.T
    return Estimate(
        function(moved.points),
        by_cameras @ uncertainty.covariance @ by_cameras.T,
        jnp.where(jnp.all(moved.known), observation, jnp.inf),
    )


def joint_uncertainty(
    uncertainty: Uncertainty,
    pixels: Float[AnyArray, "N C 2"],
    visible: Bool[AnyArray, "N C"],
    sigma_px: Float[AnyArray, ""] | float | None = None,
) -> Estimate:
    """All 3 N coordinates of N points, the first point's x, y, z first, with their full covariance."""
    return propagate(uncertainty, pixels, visible, jnp.ravel, sigma_px)


def length_uncertainty(
    uncertainty: Uncertainty,
    pixels: Float[AnyArray, "2 C 2"],
    visible: Bool[AnyArray, "2 C"],
    sigma_px: Float[AnyArray, ""] | float | None = None,
) -> Estimate:
    """The distance between two triangulated points, M = 1."""
    return propagate(uncertainty, pixels, visible, lambda ends: safe_norm(ends[1:] - ends[:1]), sigma_px)


class Line(eqx.Module):
    """The line from one triangulated point through another."""

    ray: Ray
    line: Estimate  # M = 6: origin (rig's unit), then direction (unit length)
    angles: Estimate  # M = 2: azimuth and elevation of the direction, rad


def line_uncertainty(
    uncertainty: Uncertainty,
    pixels: Float[AnyArray, "2 C 2"],
    visible: Bool[AnyArray, "2 C"],
    sigma_px: Float[AnyArray, ""] | float | None = None,
) -> Line:
    """The line from the first point through the second, and its azimuth and elevation."""

    def both(ends: Float[Array, "2 3"]) -> Float[Array, "8"]:
        ray = Ray.through(ends[0], ends[1])
        x, y, z = ray.direction
        angles = jnp.stack([jnp.arctan2(y, x), jnp.arctan2(z, safe_norm(ray.direction[:2]))])
        return jnp.concatenate([ray.origin, ray.direction, angles])

    whole = propagate(uncertainty, pixels, visible, both, sigma_px)
    line, angles = (
        Estimate(whole.value[part], whole.calibration[part, part], whole.observation[part, part])
        for part in (slice(0, 6), slice(6, 8))
    )
    return Line(Ray(line.value[:3], line.value[3:]), line, angles)


class _Moved(NamedTuple):
    """Triangulated points and their derivatives, by the implicit function theorem."""

    points: Float[Array, "*batch 3"]
    by_cameras: Float[Array, "*batch 3 D"]
    by_pixels: Float[Array, "*batch 3 K"]  # K = 2 C
    known: Bool[Array, "*batch"]  # False with fewer than two usable views


def _triangulate_with_derivatives(uncertainty: Uncertainty, pixels, visible) -> _Moved:
    """The gradient of a point's squared pixel error stays 0 while cameras and pixels move."""
    rig = uncertainty.rig
    pixels, visible = as_float(pixels), jnp.asarray(visible, bool)
    points = triangulate(rig, pixels, visible).points
    finite = jnp.all(jnp.isfinite(pixels), axis=-1)
    pixels = jnp.where((visible & finite)[..., None], pixels, 0.0)
    used = visible & finite & rig.undistort(pixels)[1]
    used = used & (jnp.sum(used, axis=-1, keepdims=True) >= 2)
    batch, cameras = points.shape[:-1], len(rig)
    flat = points.reshape(-1, 3), pixels.reshape(-1, cameras, 2), used.reshape(-1, cameras)
    by_cameras, by_pixels = _derivatives(rig.cameras, *flat)
    return _Moved(
        points,
        by_cameras.reshape(*batch, *by_cameras.shape[1:]),
        by_pixels.reshape(*batch, *by_pixels.shape[1:]),
        jnp.any(used, axis=-1),
    )


@jit
def _derivatives(
    cameras: Camera, points: Float[Array, "N 3"], pixels: Float[Array, "N C 2"], used: Bool[Array, "N C"]
) -> tuple[Float[Array, "N 3 D"], Float[Array, "N 3 K"]]:
    """Of triangulated points by the parameters of all cameras, and by all pixels; zero without views."""
    return jax.vmap(_point_derivatives, in_axes=(None, 0, 0, 0))(cameras, points, pixels, used)


def _point_derivatives(
    cameras: Camera, point: Float[Array, "3"], pixels: Float[Array, "C 2"], used: Bool[Array, " C"]
) -> tuple[Float[Array, "3 D"], Float[Array, "3 K"]]:
    def one(camera: Camera, pixel: Float[Array, "2"], use: Bool[Array, ""]) -> tuple[Array, Array, Array]:
        def gradient(moved: Camera, place: Float[Array, "3"]) -> Float[Array, "3"]:
            seen, back = jax.vjp(moved.project, place)
            return back(seen - pixel)[0]

        by_parameters = _by_parameters(lambda moved: gradient(moved, point), camera)
        hessian = jax.jacfwd(lambda place: gradient(camera, place))(point)
        by_pixel = -jax.jacfwd(camera.project)(point).T
        zero = jnp.zeros((), hessian.dtype)
        return jnp.where(use, hessian, zero), jnp.where(use, by_parameters, zero), jnp.where(use, by_pixel, zero)

    hessian, by_parameters, by_pixel = jax.vmap(one)(cameras, pixels, used)
    hessian = jnp.where(jnp.any(used), hessian.sum(axis=0), jnp.eye(3, dtype=point.dtype))
    pull = jnp.concatenate([part.transpose(1, 0, 2).reshape(3, -1) for part in (by_parameters, by_pixel)], axis=1)
    moved = -jnp.linalg.solve(hessian, pull)
    size = by_parameters.shape[0] * by_parameters.shape[2]
    return moved[:, :size], moved[:, size:]


def _by_parameters(function: Callable[[Camera], Float[Array, " M"]], camera: Camera) -> Float[Array, "M p"]:
    """Derivative by the parameters of a camera, in the order of `Camera.perturbed`."""
    return jax.jacfwd(lambda change: function(camera.perturbed(change)))(jnp.zeros(camera.size, camera.focal.dtype))


def _variance(uncertainty: Uncertainty, sigma_px) -> Float[Array, ""]:
    return (uncertainty.sigma_px if sigma_px is None else as_float(sigma_px)) ** 2
