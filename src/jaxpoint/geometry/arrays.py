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
    check_whole(values)
    array = jnp.asarray(values)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


def check_whole(values: Any) -> None:
    """Refuse float64 where JAX would cut it to float32.

    Raises:
        ValueError: it would.
    """
    cuts = jnp.result_type(float) != np.float64
    if cuts and isinstance(values, np.ndarray | jax.Array) and values.dtype == np.float64:
        raise ValueError(
            f"An array of shape {values.shape} is float64, but JAX would cut it to float32; "
            'call jax.config.update("jax_enable_x64", True) or work within `with jax.enable_x64(True):`, '
            "or hand over float32 on purpose."
        )


def widest(*trees: Any) -> np.dtype:
    """The precision of the most precise floating array in the trees; JAX's default where there is none."""
    leaves = [leaf.dtype for tree in trees for leaf in jax.tree.leaves(tree) if _is_floating(leaf)]
    return jnp.result_type(*leaves) if leaves else jnp.result_type(float)


def promote(*trees: Any) -> tuple[Any, ...]:
    """The trees as JAX arrays, with all floating ones in the precision of the most precise.

    Raises:
        ValueError: one is float64 and JAX would cut it to float32.
    """
    whole = jax.tree.map(lambda leaf: as_float(leaf) if _is_floating(leaf) else leaf, trees)
    dtype = widest(whole)
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if _is_floating(leaf) else leaf, whole)


def _is_floating(leaf: Any) -> bool:
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)


def stack_last(*components: Array) -> Array:
    """Components of equal (or broadcastable) shape as a new last axis."""
    return jnp.stack(jnp.broadcast_arrays(*components), axis=-1)


def safe_norm(vectors: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean length over the last axis, with gradient 0 (not NaN) at 0."""
    squared = jnp.sum(vectors**2, axis=-1)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def hash_or_hint(self: Any) -> int:
    """The `__hash__` of classes with methods that users compile: arrays have none, and `jax.jit(x.method)` asks for it.

    Raises:
        TypeError: always, saying how such a method is compiled.
    """
    name = type(self).__name__
    raise TypeError(
        f"A {name} holds arrays, which have no hash, so `jax.jit` cannot take its methods as they are; write "
        f"`equinox.filter_jit(x.method)`, or `jax.jit(lambda x, y: x.method(y))` with the {name} as an argument."
    )
