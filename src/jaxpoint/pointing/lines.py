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
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((function, lines))):
        found = function(*_reshaped(lines, len(batch), (count,)))
    else:
        # In numpy: for a few lines JAX's own slicing and padding takes longer than the program.
        flat = _reshaped(jax.tree.map(np.asarray, lines), len(batch), (count,))
        if count > PART:
            found = by_all_cores(lambda start: function(*_rows(flat, start, PART)), count, PART)
        else:
            size = 1 << max(count - 1, 0).bit_length()
            found = function(*_rows(flat, 0, size))
            if batch == (size,):
                return found
            some = jax.tree.map(lambda leaf: np.asarray(leaf)[:count], found)
            return jax.tree.map(jnp.asarray, _reshaped(some, 1, batch))
    return _reshaped(found, 1, batch)


def _reshaped(tree: Any, axes: int, shape: tuple[int, ...]) -> Any:
    """Other leading axes in the place of the first `axes`."""
    return jax.tree.map(lambda leaf: leaf.reshape((*shape, *leaf.shape[axes:])), tree)


def _rows(tree: Any, start: int, size: int) -> Any:
    """Some rows, with zeros at the end if there are too few."""

    def some(leaf: np.ndarray) -> np.ndarray:
        rows = leaf[start : start + size]
        missing = size - len(rows)
        return np.pad(rows, [(0, missing), *[(0, 0)] * (rows.ndim - 1)]) if missing else rows

    return jax.tree.map(some, tree)
