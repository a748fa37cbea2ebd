"""A head's place from the views that see it, and the tracks' filter, a few at a time: the programs of one frame."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.body.tracking.kalman import State, begin, distance2, predict, update
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.triangulation import Flag, triangulate

_STEPS = 3  # of Gauss-Newton; the start is near


class MeasuredHeads(NamedTuple):
    """Heads of N people in one frame, and their tracks after it."""

    points: Float[Array, "N 3"]  # m
    informations: Float[Array, "N 3 3"]  # 1/m^2; 0 where no view was used
    distances2: Float[Array, " N"]  # from the predictions, as `kalman.distance2`; 0 for new tracks
    accepted: Bool[Array, " N"]  # in front of the cameras, known to the lens models, within the gate
    states: State  # with what was accepted


@jit
def measure(
    rig: CameraRig,
    predicted: State,
    is_new: Bool[Array, " N"],
    pixels: Float[Array, "N C 2"],
    used: Bool[Array, "N C"],
    sigma_px: Float[Array, "N C"],
    speed: Float[Array, ""],
    gates: Float[Array, "2"],
) -> MeasuredHeads:
    """Heads triangulated from their views, each view with the weight of its own standard deviation (px).

    A new track is its measurement; of others the prediction is the start of the search, and all that is known along
    the line of sight of a single view. The calibration's covariance is no part of this: its error stays the same from
    frame to frame, and a filter would take it for noise that averages out.

    Args:
        rig: the cameras.
        predicted: the tracks where they are expected; without meaning for new ones.
        is_new: whether the track begins here, which needs two views.
        pixels: px, distorted.
        used: which views.
        sigma_px: of each view's pixel coordinates.
        speed: m/s, as in `kalman.begin`.
        gates: largest squared distance from the prediction of one view, and of more.
    """
    start = triangulate(rig, pixels, used, covariance=False)
    several = used.sum(axis=1) >= 2
    weights = jnp.where(used, 1 / jnp.where(used, sigma_px, 1.0) ** 2, 0.0)
    wrong = jnp.where(is_new, Flag.BEHIND | Flag.FEW_VIEWS | Flag.LENS_RANGE, Flag.BEHIND | Flag.LENS_RANGE)
    possible = used.any(axis=1) & ((start.flags & wrong) == 0)

    def one(state: State, new: Array, triangulated: Array, many: Array, pixel: Array, weight: Array, good: Array):
        eye = jnp.eye(3, dtype=pixel.dtype)
        prior = jnp.where(new, 0.0, jnp.linalg.inv(state.covariance[:3, :3]))

        def step(_: Array, point: Array) -> Array:
            information, slope = _normal(rig, point, pixel, weight)
            square = jnp.where(good, information + prior, eye)
            return point - jnp.linalg.solve(square, jnp.where(good, slope + prior @ (point - state.mean[:3]), 0.0))

        point = jax.lax.fori_loop(0, _STEPS, step, jnp.where(many, triangulated, state.mean[:3]))
        information, slope = _normal(rig, point, pixel, weight)
        point = point - jnp.linalg.pinv(information, hermitian=True, rtol=1e-9) @ slope
        far = jnp.where(new, 0.0, distance2(state, point, information))
        accepted = good & (far <= jnp.where(many, gates[1], gates[0]))
        information = jnp.where(accepted, information, 0.0)
        first = begin(point, jnp.where(new & accepted, information, eye), speed)
        after = jax.tree.map(lambda a, b: jnp.where(new, a, b), first, update(state, point, information))
        return MeasuredHeads(point, information, far, accepted, after)

    return jax.vmap(one)(predicted, is_new, start.points, several, pixels, weights, possible)


def _normal(
    rig: CameraRig, point: Float[Array, "3"], pixels: Float[Array, "C 2"], weights: Float[Array, " C"]
) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """What the views know of a point near it (1/m^2), and the slope of half their weighted squared pixel errors."""

    def one(camera: Camera) -> tuple[Array, Array]:
        return camera.project(point), jax.jacfwd(camera.project)(point)

    shown, by_point = jax.vmap(one)(rig.cameras)  # (C, 2), (C, 2, 3)
    weighted = weights[:, None, None] * by_point
    return jnp.einsum("cki,ckj->ij", weighted, by_point), jnp.einsum("cki,ck->i", weighted, shown - pixels)


@jit
def predict_all(states: State, seconds: Float[Array, ""], acceleration: Float[Array, ""]) -> State:
    """`kalman.predict` of all tracks."""
    return jax.vmap(predict, in_axes=(0, None, None))(states, seconds, acceleration)
