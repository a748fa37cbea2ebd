"""Arrays at the edge of the library: numpy or JAX in, JAX out, never cut silently."""

from __future__ import annotations

from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

AnyArray: TypeAlias = jax.Array | np.ndarray


def as_float(values: Any) -> Float[Array, "..."]:
    """A JAX array of floats in the precision that `values` have; integers and lists take JAX's default.

    Raises:
        ValueError: the values are float64 and JAX would cut them to float32.
    """
    cuts = jnp.result_type(float) != np.float64
    if cuts and isinstance(values, np.ndarray | jax.Array) and values.dtype == np.float64:
        raise ValueError(
            f"An array of shape {values.shape} is float64, but JAX would cut it to float32; "
            'call jax.config.update("jax_enable_x64", True) or work within `with jax.enable_x64(True):`, '
            "or hand over float32 on purpose."
        )
    array = jnp.asarray(values)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


def stack_last(*components: Array) -> Array:
    """Components of equal (or broadcastable) shape as a new last axis."""
    return jnp.stack(jnp.broadcast_arrays(*components), axis=-1)


def safe_norm(vectors: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean length over the last axis, with gradient 0 (not NaN) at 0."""
    squared = jnp.sum(vectors**2, axis=-1)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
