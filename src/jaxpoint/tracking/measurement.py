"""A head's place from the views that see it, and the tracks' filter, a few at a time: the programs of one frame."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.tracking.kalman import State, begin, compare, predict, update
from jaxpoint.triangulation import Flag, triangulate

_STEPS = 2  # Gauss-Newton steps that bring in the weights; the start has been refined without


class Located(NamedTuple):
    """Heads of N people from their pixels in one frame."""

    points: Float[Array, "N 3"]  # m; 0 with fewer than two views
    covariances: Float[Array, "N 3 3"]  # m^2; the unit matrix there
    usable: Bool[Array, " N"]  # two views or more that the lens models know, and in front of their cameras


@jit
def locate(
    rig: CameraRig, pixels: Float[Array, "N C 2"], used: Bool[Array, "N C"], sigma_px: Float[Array, "N C"]
) -> Located:
    """Triangulated heads, each view with the weight of its own standard deviation (px).

    The calibration's covariance is no part of this: its error stays the same from frame to frame, and a filter would
    take it for noise that averages out.
    """
    start = triangulate(rig, pixels, used, covariance=False)
    usable = (start.flags & (Flag.BEHIND | Flag.FEW_VIEWS | Flag.LENS_RANGE)) == 0
    weight = jnp.where(used, 1 / jnp.where(used, sigma_px, 1.0) ** 2, 0.0)

    def normal(point: Array, pixel: Array, weights: Array) -> tuple[Array, Array]:
        def one(camera: Camera) -> tuple[Array, Array]:
            return camera.project(point), jax.jacfwd(camera.project)(point)

        shown, slope = jax.vmap(one)(rig.cameras)  # (C, 2), (C, 2, 3)
        weighted = weights[:, None, None] * slope
        return jnp.einsum("cki,ckj->ij", weighted, slope), jnp.einsum("cki,ck->i", weighted, shown - pixel)

    def refine(point: Array, pixel: Array, weights: Array, enough: Array) -> tuple[Array, Array]:
        eye = jnp.eye(3, dtype=point.dtype)

        def step(_: int, point: Array) -> Array:
            square, slope = normal(point, pixel, weights)
            return point - jnp.linalg.solve(jnp.where(enough, square, eye), jnp.where(enough, slope, 0.0))

        point = jax.lax.fori_loop(0, _STEPS, step, point)
        square = jnp.where(enough, normal(point, pixel, weights)[0], eye)
        return point, jnp.linalg.inv(square)

    points, covariances = jax.vmap(refine)(start.points, pixels, weight, usable)
    return Located(jnp.where(usable[:, None], points, 0.0), covariances, usable)


@jit
def predict_all(states: State, seconds: Float[Array, ""], acceleration: Float[Array, ""]) -> State:
    """`kalman.predict` of all tracks."""
    return jax.vmap(predict, in_axes=(0, None, None))(states, seconds, acceleration)


class Updated(NamedTuple):
    """Tracks once their measurements were used."""

    states: State  # (N,)
    differences: Float[Array, "N 3"]  # m, innovations
    distances2: Float[Array, " N"]  # squared, in standard deviations


@jit
def update_all(
    predicted: State,
    located: Located,
    new: Bool[Array, " N"],
    speed: Float[Array, ""],
    gate: Float[Array, ""],
) -> Updated:
    """`kalman.update` of tracks measured within the gate, and `kalman.begin` of new ones."""

    def one(state: State, point: Array, covariance: Array, usable: Array, fresh: Array) -> Updated:
        innovation = compare(state, point, covariance)
        inside = usable & (innovation.distance2 <= gate)
        first, next_ = begin(point, covariance, speed), update(state, point, covariance)
        kept = jax.tree.map(lambda a, b: jnp.where(inside, a, b), next_, state)
        result = jax.tree.map(lambda a, b: jnp.where(fresh, a, b), first, kept)
        return Updated(result, innovation.difference, jnp.where(fresh, 0.0, innovation.distance2))

    return jax.vmap(one)(predicted, *located, new)
