"""The axis of a limb in the room, from its middle lines in all views (SPEC 6).

The middle line of a limb in one view spans a plane with the camera; the axis lies in the planes of all views. Unlike
the ends of a region, which are other points of the body in every view (thesis 7.2), planes need no correspondence.
Only slices between hand and elbow count: their place along the axis in metres is known once there is a first axis, so
neither a bent wrist nor an upper arm bends the line.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.linalg import solve_positive
from jaxpoint.geometry.line import normalised

STEPS = 12
_EDGE_M = 0.02  # over which a slice's weight rises at the ends of the span
_DAMPING = 1e-6


class LimbAxis(eqx.Module):
    """The axis of a limb; all fields may carry leading axes."""

    near: Float[Array, "*batch 3"]  # m, the point of the axis at the tip's end of the span
    far: Float[Array, "*batch 3"]  # m, the one at the elbow's end
    direction: Float[Array, "*batch 3"]  # unit length, towards the tip
    direction_covariance: Float[Array, "*batch 3 3"]  # of the direction, if slices were independent
    near_covariance: Float[Array, "*batch 3 3"]  # m^2
    rms: Float[Array, "*batch"]  # in units of `sigma_px`, over the slices that count
    slices: Float[Array, "*batch C"]  # weight of each view: slices that count


def fit_axis(
    origins: Float[AnyArray, "C 3"],
    focal: Float[AnyArray, " C"],
    rays: Float[AnyArray, "C S 3"],
    seen: Bool[AnyArray, "C S"],
    tip: Float[AnyArray, "3"],
    direction: Float[AnyArray, "3"],
    sigma_px: Float[AnyArray, " C"],
    span_m: Float[AnyArray, "2"],
) -> LimbAxis:
    """The axis that lies nearest to the slices of all views, by Gauss-Newton with a Cauchy loss.

    Args:
        origins: camera centres, m.
        focal: focal lengths, px, by which angles become pixels.
        rays: unit directions in the world through the middle of each of S slices.
        seen: which slices hold something.
        tip: first guess of the end of the limb, m; the span in which slices count starts from it.
        direction: first guess, unit length, towards the tip.
        sigma_px: by how much a slice's middle may miss the axis in each view, px: the scale of the robust loss.
        span_m: where slices count, behind the tip along the axis, m: behind the wrist, and before the elbow.

    Differentiable in all arguments that are not flags; batch it with `vmap`.
    """
    origins, focal, rays, tip = as_float(origins), as_float(focal), as_float(rays), as_float(tip)
    direction, sigma_px, span = as_float(direction), as_float(sigma_px), as_float(span_m)
    side = _across(direction)

    def ends(offsets: Array) -> tuple[Array, Array]:
        near = tip - span[0] * direction + offsets[:2] @ side
        far = tip - span[1] * direction + offsets[2:] @ side
        return near, far

    def residuals(offsets: Array) -> Array:
        near, far = ends(offsets)
        normal = normalised(jnp.cross(near[None] - origins, far[None] - origins))
        return (focal / sigma_px)[:, None] * jnp.sum(rays * normal[:, None, :], axis=-1)

    def weights(offsets: Array) -> Array:
        near, far = ends(offsets)
        behind = _behind(origins, rays, near, normalised(near - far)) + span[0]
        rise = jnp.clip((behind - span[0] + _EDGE_M) / _EDGE_M, 0.0, 1.0)
        fall = jnp.clip((span[1] + _EDGE_M - behind) / _EDGE_M, 0.0, 1.0)
        return jnp.where(seen, rise * fall, 0.0)

    def normal_equations(offsets: Array, scale: Array | float) -> tuple[Array, Array, Array, Array]:
        value = residuals(offsets)
        rows = jax.jacfwd(residuals)(offsets)
        counted = weights(offsets)
        robust = counted / (1.0 + (value / scale) ** 2)
        matrix = jnp.einsum("cs,csi,csj->ij", robust, rows, rows)
        gradient = jnp.einsum("cs,csi,cs->i", robust, rows, value)
        return matrix, gradient, value, counted

    def step(count: Array, offsets: Array) -> Array:
        # The scale shrinks to its end: a start that is off by a few pixels must not lose the right slices.
        scale = jnp.maximum(1.0, 8.0 * 0.5**count)
        matrix, gradient, _, _ = normal_equations(offsets, scale)
        return offsets - solve_positive(_damped(matrix), gradient)

    offsets = jax.lax.fori_loop(0, STEPS, step, jnp.zeros(4, tip.dtype))
    matrix, _, value, counted = normal_equations(offsets, 1.0)
    near, far = ends(offsets)
    total = jnp.sum(counted)
    some = total > 0
    rms2 = jnp.sum(counted * value**2) / jnp.where(some, total, 1.0)
    covariance = jnp.linalg.inv(_damped(matrix)) * jnp.maximum(rms2, 1.0)
    of_direction = jax.jacfwd(lambda x: normalised(ends(x)[0] - ends(x)[1]))(offsets)
    of_near = jax.jacfwd(lambda x: ends(x)[0])(offsets)
    return LimbAxis(
        near,
        far,
        normalised(near - far),
        of_direction @ covariance @ of_direction.T,
        of_near @ covariance @ of_near.T,
        jnp.sqrt(jnp.where(some, rms2, 0.0)),
        jnp.sum(counted, axis=1),
    )


def _damped(matrix: Array) -> Array:
    """Never singular: with one view two of the four numbers are unknown and stay where they are."""
    return matrix + (_DAMPING * jnp.trace(matrix) + 1e-9) * jnp.eye(4, dtype=matrix.dtype)


def _across(direction: Array) -> Array:
    """Two unit vectors across a direction, as rows."""
    helper = jnp.where(jnp.abs(direction[2]) < 0.9, jnp.eye(3)[2], jnp.eye(3)[0]).astype(direction.dtype)
    first = normalised(jnp.cross(direction, helper))
    return jnp.stack([first, jnp.cross(direction, first)])


def _behind(origins: Array, rays: Array, near: Array, direction: Array) -> Array:
    """How far behind `near` along the axis each ray passes it, m."""
    gap = near[None] - origins
    cosine = rays @ direction
    along_ray = jnp.sum(rays * gap[:, None, :], axis=-1)
    sine2 = 1.0 - cosine**2
    parallel = sine2 < 1e-4
    ahead = (cosine * along_ray - (gap @ direction)[:, None]) / jnp.where(parallel, 1.0, sine2)
    return jnp.where(parallel, 1e3, -ahead)
