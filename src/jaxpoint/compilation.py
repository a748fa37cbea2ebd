"""How our programs are compiled.

Compilation dominates a small problem. XLA's newer emitters of CPU fusions take twice as long to compile our kernels as
the older ones, and what they make is no faster; wide vectors suit blocks of points.
"""

from __future__ import annotations

import hashlib
import platform
import warnings
from collections.abc import Callable
from functools import cache, wraps
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import jax
from jax.core import eval_context
from jax.extend.core import get_opaque_trace_state

from jaxpoint.devices import on_cpu

CPU_OPTIONS = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_prefer_vector_width": 512}
QUICK_OPTIONS = {**CPU_OPTIONS, "xla_backend_optimization_level": 0}

Result = TypeVar("Result")


def jit(function: Callable[..., Result], *, options: dict = CPU_OPTIONS, **keywords) -> Callable[..., Result]:
    """`jax.jit` with compiler options of its own where a call runs on the CPU.

    On other backends and inside transformations it is a plain `jax.jit`: an outer `jit`'s options hold for all in it.

    Args:
        options: of XLA on a CPU.
        **keywords: of `jax.jit`.
    """
    tuned = jax.jit(function, compiler_options=options, **keywords)
    plain = jax.jit(function, **keywords)

    @wraps(function)
    def call(*args, **kwargs):
        chosen = tuned if on_cpu(args, kwargs) and not _inside_transformation() else plain
        return chosen(*args, **kwargs)

    return call


def _inside_transformation() -> bool:
    """Whether a transformation of JAX is at work: `jit`, `grad`, `vmap`, `scan`, ...

    JAX takes options of programs that it runs at once, and refuses those of programs that become part of another or
    are differentiated.
    """
    return get_opaque_trace_state() != _top_level()


@cache
def _top_level() -> object:
    """The state of JAX in which nothing is traced."""
    with eval_context():
        return get_opaque_trace_state()


def jit_once(function: Callable[..., Result], **keywords: Any) -> Callable[..., Result]:
    """`jit` for programs that run once or twice: quick to compile is worth more than quick to run.

    Args:
        keywords: of `jax.jit`.
    """
    return jit(function, options=QUICK_OPTIONS, **keywords)


def keep_programs(folder: Path) -> Path:
    """Keep compiled programs in a folder, so that later processes start sooner; returns the part of it that is used.

    Each version of jaxlib and each kind of processor has a part of its own: what was compiled for another processor
    may crash on this one, and a folder may be shared.
    """
    own = folder.absolute() / f"jaxlib-{version('jaxlib')}-{_processor()}"
    # Two processes may meet at one program while it is written: the one that comes too early compiles it itself.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")
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
