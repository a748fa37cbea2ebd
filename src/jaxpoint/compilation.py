"""How our programs are compiled.

Compilation dominates a small problem. XLA's newer emitters of CPU fusions take twice as long to compile our kernels as
the older ones, and what they make is no faster; wide vectors suit blocks of points.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import TypeVar

import jax

CPU_OPTIONS = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_prefer_vector_width": 512}
QUICK_OPTIONS = {**CPU_OPTIONS, "xla_backend_optimization_level": 0}

Result = TypeVar("Result")


def jit(function: Callable[..., Result], *, options: dict = CPU_OPTIONS, **keywords) -> Callable[..., Result]:
    """`jax.jit` with our options. Inside another `jit`, which decides for all, it is a plain `jax.jit`."""
    alone = jax.jit(function, compiler_options=options, **keywords)
    nested = jax.jit(function, **keywords)

    @wraps(function)
    def call(*args, **kwargs):
        try:
            return alone(*args, **kwargs)
        except ValueError as error:  # JAX has no other public way to tell
            if "nested jit" not in str(error):
                raise
            return nested(*args, **kwargs)

    return call


jit_once = partial(jit, options=QUICK_OPTIONS)
"""For programs that run once or twice: quick to compile is worth more than quick to run."""
