"""How corrected lines still lie about their targets: Student's t, so that gross misses neither surprise nor rule."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxpoint.compilation import jit_once
from jaxpoint.geometry.arrays import AnyArray, as_float

FREEDOMS = (2, 4, 6, 8, 12, 20)  # that are compared: from very long tails to nearly a Gaussian
_STEPS = 60
_FLOOR = 1e-10  # rad^2


class Spread(eqx.Module):
    """Student's t about no error: how far lines lie to the left of their targets and above."""

    scale: Float[Array, "2 2"] = eqx.field(converter=as_float)  # rad^2, to the left and up; no covariance
    freedom: Int[Array, ""] = eqx.field(converter=jnp.asarray)  # degrees of freedom

    def log_density(self, misses: Float[AnyArray, "*batch 2"]) -> Float[Array, "*batch"]:
        """Logarithm of the density per rad^2.

        Args:
            misses: to the left and up, rad.
        """
        squared = squares(misses, self.scale)
        volume = jnp.log(2 * jnp.pi) + 0.5 * jnp.linalg.slogdet(self.scale)[1]
        return -(self.freedom + 2) / 2 * jnp.log1p(squared / self.freedom) - volume


def squares(misses: Float[AnyArray, "*batch 2"], scale: Float[AnyArray, "2 2"]) -> Float[Array, "*batch"]:
    """Squared Mahalanobis lengths."""
    misses = as_float(misses)
    return jnp.sum(misses * (misses @ jnp.linalg.inv(scale)), axis=-1)


@jit_once
def fit_spread(misses: Float[AnyArray, "G 2"], weights: Float[AnyArray, " G"]) -> Spread:
    """The likeliest spread, over `FREEDOMS`, by EM (Liu and Rubin 1995).

    Args:
        misses: to the left and up, rad.
        weights: 0 leaves a gesture out.
    """
    misses, weights = as_float(misses), as_float(weights)

    def at(freedom: Array) -> tuple[Array, Array]:
        def step(_: object, scale: Array) -> Array:
            trusted = weights * (freedom + 2) / (freedom + squares(misses, scale))
            total = jnp.einsum("g,gi,gj->ij", trusted, misses, misses) / jnp.sum(weights)
            return total + _FLOOR * jnp.eye(2, dtype=misses.dtype)

        scale = jax.lax.fori_loop(0, _STEPS, step, jnp.eye(2, dtype=misses.dtype) * 1e-3)
        return scale, jnp.sum(weights * Spread(scale, freedom).log_density(misses))

    scales, likelihoods = jax.vmap(at)(jnp.asarray(FREEDOMS))
    best = jnp.argmax(likelihoods)
    return Spread(scales[best], jnp.asarray(FREEDOMS)[best])
