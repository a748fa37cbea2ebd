"""What stays the same while an arm is held: a robust mean over its frames, and how far to trust it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float, safe_norm

STEPS = 30  # of the geometric median
_SMALLEST_M = 1e-3  # of a distance by which is divided: frames nearer than this weigh alike


@jit
def held_mean(
    values: Float[AnyArray, "G F N"], covariance: Float[AnyArray, "G F N N"], seen: Bool[AnyArray, "G F"]
) -> tuple[Float[Array, "G N"], Float[Array, "G N N"], Float[Array, "G F"]]:
    """The geometric median of numbers over the frames of G holds, its covariance, and the frames' weights.

    All numbers of a frame share one weight, so they still belong together; half of the frames may be wrong (Vardi and
    Zhang 2000). Of an arm that is held, the error of measuring is nearly the same in all frames: the same outline is
    seen by the same cameras. It is not divided by their number; of unlike frames the harmonic mean is taken. What
    changes from frame to frame, tremor among it, is divided by the number of independent frames that its correlation
    leaves.

    Args:
        values: of every frame; padded ones never matter.
        covariance: of each frame's measurement.
        seen: which frames there are; one or more a gesture.
    """
    return jax.vmap(_held_mean)(as_float(values), as_float(covariance), jnp.asarray(seen))


def _held_mean(values: Array, covariance: Array, seen: Array) -> tuple[Array, Array, Array]:
    values = jnp.where(seen[:, None], values, 0.0)
    start = _weighted_mean(values, seen.astype(values.dtype))

    def step(_: Array, middle: Array) -> Array:
        return _weighted_mean(values, _weights(values, middle, seen))

    middle = jax.lax.fori_loop(0, STEPS, step, start)
    weights = _weights(values, middle, seen)
    weights = weights / jnp.sum(weights)
    off = jnp.where(seen[:, None], values - middle[None], 0.0)
    scatter = jnp.einsum("f,fi,fj->ij", weights, off, off)
    measured = _harmonic_mean(jnp.where(seen[:, None, None], covariance, 0.0), weights)
    return middle, measured + scatter / _independent(off, seen, weights), weights


def _harmonic_mean(covariance: Array, weights: Array) -> Array:
    """Each frame counts by its information: one that saw next to nothing must not make the others worthless."""
    size = jnp.trace(covariance, axis1=1, axis2=2)
    known = size > 0
    by = jnp.where(known, weights / jnp.where(known, size, 1.0), 0.0)
    total = jnp.sum(by)
    return jnp.einsum("f,fij->ij", by, covariance) / jnp.where(total > 0, total, 1.0)


def _weighted_mean(values: Array, weights: Array) -> Array:
    return jnp.sum(weights[:, None] * values, axis=0) / jnp.maximum(jnp.sum(weights), 1e-12)


def _weights(values: Array, middle: Array, seen: Array) -> Array:
    return jnp.where(seen, 1.0 / jnp.maximum(safe_norm(values - middle[None]), _SMALLEST_M), 0.0)


def _independent(off: Array, seen: Array, weights: Array) -> Array:
    """How many independent frames there are as many as: by the correlation of neighbours (Bartlett 1935)."""
    count = 1.0 / jnp.sum(weights**2)
    both = seen[1:] & seen[:-1]
    pairs = jnp.sum(both)
    own = jnp.sum(off**2) / jnp.maximum(jnp.sum(seen), 1)
    next_to = jnp.sum(jnp.where(both, jnp.sum(off[1:] * off[:-1], axis=1), 0.0)) / jnp.maximum(pairs, 1)
    known = (own > 0) & (pairs > 0)
    correlation = jnp.clip(jnp.where(known, next_to / jnp.where(known, own, 1.0), 0.0), 0.0, 0.95)
    return jnp.maximum(1.0, count * (1.0 - correlation) / (1.0 + correlation))
