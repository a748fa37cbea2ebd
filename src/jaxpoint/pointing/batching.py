"""The same for many lines: few programs are compiled, and where they run on a CPU all its cores are at work."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxpoint.cores import by_all_cores
from jaxpoint.devices import Device, device_of, running_on

PART = 1024  # lines that one core works on before it takes others: all about them stays in its cache
PART_ELSEWHERE = 2**16  # lines in one call on another device, so that its memory suffices

Result = TypeVar("Result")


def over_lines(function: Callable[..., Result], *lines: Any) -> Result:
    """A function of trees of arrays with one leading axis, for any leading axes, which all of `lines` share.

    The number of lines that the function sees is a power of two, so that few programs are compiled. Only on a CPU is
    the work split over cores; elsewhere nothing leaves the device on which the inputs lie.
    """
    batch = jax.tree.leaves(lines[0])[0].shape[:-1]
    count = math.prod(batch)
    held = function.args if isinstance(function, partial) else ()  # a `partial` is a leaf to JAX
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((held, lines))):
        return _reshape(function(*_reshape(lines, len(batch), (count,))), 1, batch)
    device = device_of(lines, held)
    if device is None or device.platform != "cpu":
        return _on_device(function, batch, *lines)
    with running_on(device):
        return _on_cpu(function, batch, device, *lines)


def _on_cpu(function: Callable[..., Result], batch: tuple[int, ...], device: Device, *lines: Any) -> Result:
    """In numpy: for a few lines JAX's own slicing and padding takes longer than the program."""
    count = math.prod(batch)
    flat = _reshape(jax.tree.map(np.asarray, lines), len(batch), (count,))
    if count > PART:
        found = by_all_cores(lambda start: function(*_rows(flat, start, PART)), count, PART, device)
        return _reshape(found, 1, batch)
    size = _power_of_two(count)
    found = function(*_rows(flat, 0, size))
    if batch == (size,):
        return found
    some = jax.tree.map(lambda leaf: np.asarray(leaf)[:count], found)
    return jax.tree.map(jnp.asarray, _reshape(some, 1, batch))


def _on_device(function: Callable[..., Result], batch: tuple[int, ...], *lines: Any) -> Result:
    """Part after part where the inputs lie; the host sees none of it."""
    count = math.prod(batch)
    flat = _reshape(jax.tree.map(jnp.asarray, lines), len(batch), (count,))
    size = min(_power_of_two(count), PART_ELSEWHERE)
    parts = [function(*_rows(flat, start, size)) for start in range(0, max(count, 1), size)]
    found = parts[0] if len(parts) == 1 else jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    return _reshape(jax.tree.map(lambda leaf: leaf[:count], found), 1, batch)


def _power_of_two(count: int) -> int:
    return 1 << max(count - 1, 0).bit_length()


def _reshape(tree: Any, axes: int, shape: tuple[int, ...]) -> Any:
    """Other leading axes in the place of the first `axes`."""
    return jax.tree.map(lambda leaf: leaf.reshape((*shape, *leaf.shape[axes:])), tree)


def _rows(tree: Any, start: int, size: int) -> Any:
    """Some rows, with zeros at the end if there are too few."""

    def some(leaf: Any) -> Any:
        rows = leaf[start : start + size]
        missing = size - len(rows)
        pad = np.pad if isinstance(rows, np.ndarray) else jnp.pad
        return pad(rows, [(0, missing), *[(0, 0)] * (rows.ndim - 1)]) if missing else rows

    return jax.tree.map(some, tree)
