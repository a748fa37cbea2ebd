"""The same for many lines, in blocks: few programs are compiled, and what they work on stays in the cache."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

Result = TypeVar("Result")


def over_lines(function: Callable[..., Result], *lines: Any) -> Result:
    """A function of lines with one leading axis, for lines with any leading axes; all of `lines` share these."""
    leaf = jax.tree.leaves(lines[0])[0]
    batch = leaf.shape[:-1]
    count = math.prod(batch)
    size = 1 << max(count - 1, 0).bit_length()

    def flat(leaf: jax.Array) -> jax.Array:
        flat = leaf.reshape(count, *leaf.shape[len(batch) :])
        return jnp.pad(flat, [(0, size - count), *[(0, 0)] * (flat.ndim - 1)])

    found = function(*jax.tree.map(flat, lines))
    return jax.tree.map(lambda leaf: leaf[:count].reshape(*batch, *leaf.shape[1:]), found)
