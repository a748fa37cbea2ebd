"""The axis of a limb in the room, from its middle lines in all views (thesis 7.2).

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

from jaxpoint.geometry.arrays import AnyArray, promote
from jaxpoint.geometry.linalg import solve_positive
from jaxpoint.geometry.line import normalise

STEPS = 16
_EDGE_M = 0.02  # over which a slice's weight rises at the ends of the span
_DAMPING = 1e-6


class LimbAxis(eqx.Module):
    """The axis of a limb; all fields may carry leading axes."""

    near: Float[Array, "*batch 3"]  # m, the point of the axis at the tip's end of the span
    far: Float[Array, "*batch 3"]  # m, the one at the elbow's end
    direction: Float[Array, "*batch 3"]  # unit length, towards the tip
    direction_covariance: Float[Array, "*batch 3 3"]  # of the direction, if slices were independent
    ends_covariance: Float[Array, "*batch 6 6"]  # m^2, of near and far, in that order
    rms: Float[Array, "*batch"]  # in units of `sigma_px`, over the slices that count
    slices: Float[Array, "*batch C"]  # weight of each view: slices that count

    @property
    def near_covariance(self) -> Float[Array, "*batch 3 3"]:
        """Of the point at the tip's end, m^2."""
        return self.ends_covariance[..., :3, :3]


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

    Differentiable in all arguments that are not flags, by the implicit function theorem; batch it with `vmap`.
    """
    given = _Given(*promote(origins, focal, rays, tip, direction, sigma_px, span_m), seen=seen)
    return _axis_at(given, jax.lax.stop_gradient(_optimum(jax.lax.stop_gradient(given))))


def refit_axis(
    origins: Float[AnyArray, "C 3"],
    focal: Float[AnyArray, " C"],
    rays: Float[AnyArray, "C S 3"],
    seen: Bool[AnyArray, "C S"],
    tip: Float[AnyArray, "3"],
    direction: Float[AnyArray, "3"],
    sigma_px: Float[AnyArray, " C"],
    span_m: Float[AnyArray, "2"],
) -> LimbAxis:
    """The axis of `fit_axis`, given that axis: nothing is searched for, and the derivatives are the same.

    The arguments are those of `fit_axis`, with `tip` and `direction` on the fitted axis, so that the span starts at its
    `near`.
    """
    given = _Given(*promote(origins, focal, rays, tip, direction, sigma_px, span_m), seen=seen)
    return _axis_at(given, jnp.zeros(4, given.tip.dtype))


def _axis_at(given: _Given, offsets: Array) -> LimbAxis:
    """The axis at the optimum, differentiable in what is given."""
    # One step more, which does not move the optimum, but whose derivative is that of the optimum.
    turning = jax.lax.stop_gradient(jax.jacfwd(lambda x: _gradient(given, x))(offsets))
    offsets = offsets - jnp.linalg.solve(_damp(turning), _gradient(given, offsets))
    matrix, _, value, counted = _normal_equations(given, offsets, 1.0)
    near, far = _ends(given, offsets)
    total = jnp.sum(counted)
    some = total > 0
    rms2 = jnp.sum(counted * value**2) / jnp.where(some, total, 1.0)
    covariance = jnp.linalg.inv(_damp(matrix)) * jnp.maximum(rms2, 1.0)

    def direction_of(x: Array) -> Array:
        near, far = _ends(given, x)
        return normalise(near - far)

    of_direction = jax.jacfwd(direction_of)(offsets)
    of_ends = jax.jacfwd(lambda x: jnp.concatenate(_ends(given, x)))(offsets)
    return LimbAxis(
        near,
        far,
        normalise(near - far),
        of_direction @ covariance @ of_direction.T,
        of_ends @ covariance @ of_ends.T,
        jnp.sqrt(jnp.where(some, rms2, 0.0)),
        jnp.sum(counted, axis=1),
    )


class _Given(eqx.Module):
    """The arguments of `fit_axis`."""

    origins: Array
    focal: Array
    rays: Array
    tip: Array
    direction: Array
    sigma_px: Array
    span: Array
    seen: AnyArray


def _ends(given: _Given, offsets: Array) -> tuple[Array, Array]:
    """Both ends of the span, moved across the first guess."""
    side = _across(given.direction)
    near = given.tip - given.span[0] * given.direction + offsets[:2] @ side
    far = given.tip - given.span[1] * given.direction + offsets[2:] @ side
    return near, far


def _residuals(given: _Given, offsets: Array) -> Array:
    near, far = _ends(given, offsets)
    normal = normalise(jnp.cross(near[None] - given.origins, far[None] - given.origins))
    return (given.focal / given.sigma_px)[:, None] * jnp.sum(given.rays * normal[:, None, :], axis=-1)


def _slice_weights(given: _Given, offsets: Array) -> Array:
    """The weight of each slice by its place along the axis."""
    near, far = _ends(given, offsets)
    behind = _behind(given.origins, given.rays, near, normalise(near - far)) + given.span[0]
    rise = jnp.clip((behind - given.span[0] + _EDGE_M) / _EDGE_M, 0.0, 1.0)
    fall = jnp.clip((given.span[1] + _EDGE_M - behind) / _EDGE_M, 0.0, 1.0)
    return jnp.where(given.seen, rise * fall, 0.0)


def _normal_equations(given: _Given, offsets: Array, scale: Array | float) -> tuple[Array, Array, Array, Array]:
    value = _residuals(given, offsets)
    rows = jax.jacfwd(lambda x: _residuals(given, x))(offsets)
    counted = _slice_weights(given, offsets)
    robust = counted / (1.0 + (value / scale) ** 2)
    matrix = jnp.einsum("cs,csi,csj->ij", robust, rows, rows)
    gradient = jnp.einsum("cs,csi,cs->i", robust, rows, value)
    return matrix, gradient, value, counted


def _gradient(given: _Given, offsets: Array) -> Array:
    """What is zero at the optimum."""
    return _normal_equations(given, offsets, 1.0)[1]


def _optimum(given: _Given) -> Array:
    """The optimum. optimistix's Levenberg-Marquardt finds the same to 1 um and takes 17 times as long: 2.8 ms an axis
    of a batch of 64 in place of 0.17 (experiments/benchmarks/small_solvers.py)."""

    def step(count: Array, offsets: Array) -> Array:
        # The scale shrinks to its end: a start that is off by a few pixels must not lose the right slices.
        scale = jnp.maximum(1.0, 8.0 * 0.5**count)
        matrix, gradient, _, _ = _normal_equations(given, offsets, scale)
        return offsets - solve_positive(_damp(matrix), gradient)

    return jax.lax.fori_loop(0, STEPS, step, jnp.zeros(4, given.tip.dtype))


def _damp(matrix: Array) -> Array:
    """Never singular: with one view two of the four numbers are unknown and stay where they are."""
    return matrix + (_DAMPING * jnp.trace(matrix) + 1e-9) * jnp.eye(4, dtype=matrix.dtype)


def _across(direction: Array) -> Array:
    """Two unit vectors across a direction, as rows."""
    helper = jnp.where(jnp.abs(direction[2]) < 0.9, jnp.eye(3)[2], jnp.eye(3)[0]).astype(direction.dtype)
    first = normalise(jnp.cross(direction, helper))
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
