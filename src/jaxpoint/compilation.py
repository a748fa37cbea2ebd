"""How our programs are compiled.

Compilation dominates a small problem. XLA's newer emitters of CPU fusions take twice as long to compile our kernels as
the older ones, and what they make is no faster; wide vectors suit blocks of points.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from functools import partial, wraps
from importlib.metadata import version
from pathlib import Path
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


def keep_programs(folder: Path) -> Path:
    """Keep compiled programs in a folder, so that later processes start sooner; returns the part of it that is used.

    Each version of jaxlib and each kind of processor has a part of its own: what was compiled for another processor
    may crash on this one, and a folder may be shared.
    """
    own = folder.absolute() / f"jaxlib-{version('jaxlib')}-{_processor()}"
    jax.config.update("jax_compilation_cache_dir", str(own))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return own


def _processor() -> str:
    """A short name for this kind of processor and what it can do."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.exists() else []
    features = {line for line in lines if line.split(":")[0].strip() in ("model name", "flags", "Features")}
    text = "\n".join([platform.machine(), platform.processor(), *sorted(features)])
    return hashlib.sha256(text.encode()).hexdigest()[:12]
