"""Where calls run: on the device of their inputs, split over cores on a CPU alone."""

import os
import subprocess
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint import cores, devices
from jaxpoint.pointing import batching as lines

TWO_DEVICES = """
import jax, jax.numpy as jnp, numpy as np
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing import batching as lines
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.shapes import Sphere
from jaxpoint.pointing.posterior import posterior

second = jax.devices()[1]
objects = Objects.of([Thing("ball", Sphere(np.ones(3), 0.3))])
lines.PART = 2
for count, ask in ((1, posterior), (3, lambda given, objects: intersect(given.ray, objects))):
    tip, ahead = np.zeros((count, 3)), np.tile(np.ones(3) / 3**0.5, (count, 1))
    for device in (None, second):
        put = (lambda leaf: leaf) if device is None else (lambda leaf: jax.device_put(leaf, device))
        given = jax.tree.map(put, PointingLine(Ray(tip, ahead), np.zeros((count, 6, 6))))
        for leaf in jax.tree.leaves(ask(given, objects)):
            assert leaf.devices() == {device or jax.devices()[0]}, (count, device, leaf.devices())
            assert leaf.shape[0] == count
print("done")
"""


def test_results_lie_where_the_inputs_lie():
    """In a process of its own: a CPU has two devices only where JAX is configured so before it starts."""
    told = {
        **os.environ,
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_X64": "1",
    }
    ran = subprocess.run([sys.executable, "-c", TWO_DEVICES], capture_output=True, text=True, env=told)
    assert ran.stdout == "done\n", ran.stderr


def double(values):
    assert isinstance(values, jax.Array)
    return 2 * values


@pytest.mark.parametrize("count", [1, 5, 40])
def test_elsewhere_than_on_a_cpu_nothing_is_pulled_to_the_host(monkeypatch, count):
    monkeypatch.setattr(lines, "device_of", lambda *trees: None)  # as of arrays on several devices, or on a GPU
    monkeypatch.setattr(lines, "by_all_cores", None)
    monkeypatch.setattr(lines, "PART_ELSEWHERE", 16)
    values = jnp.arange(3.0 * count).reshape(count, 3)
    found = lines.over_lines(double, values)
    np.testing.assert_array_equal(found, 2 * values)
    np.testing.assert_array_equal(lines.over_lines(double, values[None]), 2 * values[None])


def test_what_is_committed_nowhere_goes_to_the_default_device():
    device = jax.devices()[0]
    assert devices.device_of(np.ones(3), {"a": jnp.ones(2)}) == device
    assert devices.device_of(jax.device_put(jnp.ones(3), device)) == device
    assert devices.on_cpu(jax.device_put(jnp.ones(3), device))
    with jax.default_device("cpu"):
        assert devices.default_device().platform == "cpu"


def test_where_there_are_other_devices_inputs_decide(monkeypatch):
    monkeypatch.setattr(devices, "_cpu_alone", lambda: False)
    assert devices.on_cpu(jnp.ones(2))
    monkeypatch.setattr(devices, "_devices_of", lambda *trees: [SimpleNamespace(platform="gpu")])
    assert not devices.on_cpu(jnp.ones(2))


def test_only_the_cores_that_this_process_may_use_are_counted(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 5, 8}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert cores.usable_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS
    assert cores.usable_cores() == 64
