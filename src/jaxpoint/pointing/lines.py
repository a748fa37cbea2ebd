"""The same for many lines: few programs are compiled, and all cores of a CPU are at work."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxpoint.cores import by_all_cores

PART = 1024  # lines that one core works on before it takes others: all about them stays in its cache

Result = TypeVar("Result")


def over_lines(function: Callable[..., Result], *lines: Any) -> Result:
    """A function of trees of arrays with one leading axis, for any leading axes, which all of `lines` share.

    The number of lines that the function sees is a power of two, so that few programs are compiled.
    """
    batch = jax.tree.leaves(lines[0])[0].shape[:-1]
    count = math.prod(batch)
    flat = jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[len(batch) :]), lines)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((function, lines))):
        found = function(*flat)
    elif count > PART:
        flat = jax.tree.map(np.asarray, flat)
        found = by_all_cores(lambda start: function(*_rows(flat, start, PART)), count, PART)
    else:
        size = 1 << max(count - 1, 0).bit_length()
        found = jax.tree.map(lambda leaf: leaf[:count], function(*_rows(flat, 0, size)))
    return jax.tree.map(lambda leaf: leaf.reshape(*batch, *leaf.shape[1:]), found)


def _rows(tree: Any, start: int, size: int) -> Any:
    """Some rows, with zeros at the end if there are too few."""

    def some(leaf: Any) -> jax.Array:
        rows = leaf[start : start + size]
        missing = size - len(rows)
        return jnp.asarray(np.pad(rows, [(0, missing), *[(0, 0)] * (rows.ndim - 1)]) if missing else rows)

    return jax.tree.map(some, tree)
