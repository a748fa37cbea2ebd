"""On which device a call runs: where its inputs lie, or else JAX's default."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any, TypeAlias

import jax
from jax.core import Tracer
from jax.extend.backend import backends

Device: TypeAlias = Any  # jax.Device, which type checkers take for a variable


def device_of(*trees: Any) -> Device | None:
    """The device of the arrays that are committed to one; JAX's default where none is; None where they span several."""
    devices = _devices_of(*trees)
    return next(iter(devices)) if len(devices) == 1 else None


def on_cpu(*trees: Any) -> bool:
    """Whether a call with these inputs runs on a CPU, or on several devices of one."""
    return _cpu_alone() or all(device.platform == "cpu" for device in _devices_of(*trees))


@cache
def _cpu_alone() -> bool:
    """Whether JAX knows no other kind of device: then nobody need look where arrays lie, which takes 8 us a call."""
    return all(client.platform == "cpu" for client in backends().values())


def _devices_of(*trees: Any) -> set[Device]:
    """Where the first committed array lies; the default device if there is none."""
    for leaf in jax.tree.leaves(trees):
        if isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer) and leaf.committed:
            return leaf.devices()
    return {default_device()}


def default_device() -> Device:
    """Where JAX puts what is committed nowhere."""
    chosen = jax.config.jax_default_device  # type: ignore[attr-defined]  # set by `jax.default_device` in this thread
    if isinstance(chosen, str):
        return jax.local_devices(backend=chosen)[0]
    return jax.local_devices()[0] if chosen is None else chosen


def running_on(device: Device) -> AbstractContextManager:
    """A context in which new arrays and programs go to this device; nothing is changed where they go there anyway."""
    return nullcontext() if device == default_device() else jax.default_device(device)
