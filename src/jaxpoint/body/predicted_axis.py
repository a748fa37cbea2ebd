"""Where a predicted axis lies in every view, and the axis that the slices cut there lie on: the compiled part."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.body.limb_axis import LimbAxis, fit_axis, refit_axis
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.evidence.limb_slices import SLICES
from jaxpoint.geometry.arrays import AnyArray, as_float

NEAREST_M = 0.4  # closer to a camera than this nothing is looked at
SLICE_PX = 0.7  # error of a slice's middle: of its edges in the image,
SLICE_M = 0.003  # and of the limb, which is no perfect cone
_BEYOND_M = 0.01  # slices are cut so far beyond both ends of the span


class PredictedAxis(eqx.Module):
    """Where an axis lies in every view; C cameras, S places."""

    pixels: Float[AnyArray, "C S 2"]  # px
    across: Float[AnyArray, "C 2"]  # unit
    pixels_a_metre: Float[AnyArray, " C"]
    sigma_px: Float[AnyArray, " C"]  # error of a slice's middle
    angle: Float[AnyArray, " C"]  # rad, between the axis and the line of sight
    ahead: Bool[AnyArray, " C"]  # far enough in front of the camera


@jit
def predict_axis(
    rig: CameraRig, tip: Float[AnyArray, "3"], direction: Float[AnyArray, "3"], span_m: Float[AnyArray, "2"]
) -> PredictedAxis:
    """Where the part of an axis that lies `span_m` behind its tip should be seen.

    Args:
        rig: the cameras.
        tip: of the limb, m, on its axis.
        direction: unit, towards the tip.
        span_m: from the tip to the first and to the last slice, m.
    """
    tip, direction, span_m = as_float(tip), as_float(direction), as_float(span_m)
    reach = jnp.linspace(span_m[0] - _BEYOND_M, span_m[1] + _BEYOND_M, SLICES)
    places = tip[None] - reach[:, None] * direction[None]
    middle = places.mean(axis=0)

    def one(camera: Camera) -> tuple[Array, ...]:
        pixels = camera.project(places)
        along = pixels[-1] - pixels[0]
        along = along / jnp.maximum(jnp.hypot(along[0], along[1]), 1e-9)
        scale, angle = _scale_and_angle(camera, middle, direction)
        ahead = camera.depth(places).min() > NEAREST_M
        return pixels, jnp.stack([-along[1], along[0]]), scale, _sigma(scale, angle), angle, ahead

    return PredictedAxis(*jax.vmap(one)(rig.cameras))


@jit
def rays_through(
    rig: CameraRig, pixels: Float[AnyArray, "N P 2"], cameras: Int[AnyArray, " N"]
) -> Float[Array, "N P 3"]:
    """Unit directions in the world of what cameras see at pixels, P of one camera at a time."""

    def one(places: Array, camera: Array) -> Array:
        own = jax.tree.map(lambda leaf: leaf[camera], rig.cameras)
        return own.ray(places).direction

    return jax.vmap(one)(as_float(pixels), jnp.asarray(cameras))


@jit
def strips_axis(
    rig: CameraRig,
    pixels: Float[AnyArray, "C S 2"],
    seen: Bool[AnyArray, "C S"],
    tip: Float[AnyArray, "3"],
    direction: Float[AnyArray, "3"],
    span_m: Float[AnyArray, "2"],
) -> LimbAxis:
    """The axis nearest to the middles of all views' slices (px), from a first guess; see `fit_axis`."""
    return fit_axis(*_slice_rays(rig, pixels, seen, tip, direction, span_m))


def axis_at_optimum(
    rig: CameraRig,
    pixels: Float[AnyArray, "C S 2"],
    seen: Bool[AnyArray, "C S"],
    tip: Float[AnyArray, "3"],
    direction: Float[AnyArray, "3"],
    span_m: Float[AnyArray, "2"],
) -> LimbAxis:
    """The axis of `strips_axis` where tip and direction are those of that axis already; see `refit_axis`."""
    return refit_axis(*_slice_rays(rig, pixels, seen, tip, direction, span_m))


def _slice_rays(rig: CameraRig, pixels, seen, tip, direction, span_m) -> tuple[Any, ...]:
    """The arguments of `fit_axis`."""
    tip, direction, span_m = as_float(tip), as_float(direction), as_float(span_m)
    rays = jax.vmap(Camera.ray)(rig.cameras, as_float(pixels))
    middle = tip - span_m.mean() * direction

    def sigma(camera: Camera) -> Array:
        return _sigma(*_scale_and_angle(camera, middle, direction))

    sigma_px = jax.vmap(sigma)(rig.cameras)
    return rays.origin[:, 0], rig.cameras.focal.mean(axis=1), rays.direction, seen, tip, direction, sigma_px, span_m


def _scale_and_angle(camera: Camera, middle: Array, direction: Array) -> tuple[Array, Array]:
    """Pixels a metre at a place, and the angle between a direction and the line of sight to it."""
    sight = middle - camera.position
    cosine = jnp.abs(sight @ direction) / jnp.sqrt(sight @ sight)
    return camera.focal.mean() / jnp.maximum(camera.depth(middle), NEAREST_M), jnp.arccos(jnp.clip(cosine, 0.0, 1.0))


def _sigma(pixels_a_metre: Array, angle: Array) -> Array:
    """Error of a slice's middle, px: seen along the limb, a slice mixes many of its sections."""
    return jnp.hypot(SLICE_PX, SLICE_M * pixels_a_metre / jnp.maximum(jnp.sin(angle), 0.1))
