"""Work on many rows of the same kind, in parts, by all cores of a CPU."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np

from jaxpoint.devices import Device, default_device, running_on

_ALIGNMENT = 64  # bytes; what JAX wants of memory that it did not make itself

Result = TypeVar("Result")


def usable_cores() -> int:
    """Cores that this process may use: those that its affinity allows, where the system knows one."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def by_all_cores(part: Callable[[int], Result], count: int, size: int, device: Device | None = None) -> Result:
    """The first `count` rows of all parts, every core of the CPU at work on one of them at a time.

    XLA runs one program after the other, and one that loops over blocks on one core. What a part gives is copied
    where it belongs at once: the memory of parts is used again, and only the result's is new.

    Args:
        part: gives a tree of arrays of `size` rows each, those from the row of its argument on.
        device: a CPU, on which the parts run and the result lies; JAX's default if left out.
    """
    device = default_device() if device is None else device
    with running_on(device):
        first = part(0)  # compiled before many ask for it
    whole = jax.tree.map(lambda leaf: _align_memory((count, *leaf.shape[1:]), np.dtype(leaf.dtype)), first)
    wide = jax.dtypes.canonicalize_dtype(np.float64) == np.float64  # may be so in this thread alone

    def keep(start: int, found: Result) -> None:
        for kept, leaf in zip(jax.tree.leaves(whole), jax.tree.leaves(found), strict=True):
            kept[start : start + size] = np.asarray(leaf)[: count - start]

    def work(start: int) -> None:
        with jax.enable_x64(wide), running_on(device):
            keep(start, part(start))

    keep(0, first)
    with ThreadPoolExecutor(usable_cores()) as pool:
        list(pool.map(work, range(size, count, size)))
    result = jax.tree.map(jax.dlpack.from_dlpack, whole)
    return result if device == jax.local_devices()[0] else jax.device_put(result, device)


def _align_memory(shape: tuple[int, ...], kind: np.dtype) -> np.ndarray:
    """Memory that JAX can take over as it is."""
    size = math.prod(shape) * kind.itemsize
    raw = np.empty(size + _ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % _ALIGNMENT
    return raw[start : start + size].view(kind).reshape(shape)
