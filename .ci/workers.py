"""How many test processes this machine bears: one a core, and one for every 4 GB of memory that is available.

Prints the number; `make test` asks for it. Standard library alone, for it runs before anything is installed.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

BYTES_A_WORKER = 4 * 1024**3  # a worker's programs and arrays took up to 3 GB (measured); the rest is for the machine
MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/sys/fs/cgroup")  # of version 2, as containers have it
RECLAIMABLE = ("free", "inactive", "speculative", "purgeable")  # pages, as macOS calls them


def workers(cores: int, memory: int | None) -> int:
    """Of `cores` processors and `memory` bytes; at least one. None: nobody knows the memory."""
    return max(1, cores if memory is None else min(cores, memory // BYTES_A_WORKER))


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_memory() -> int | None:
    """Bytes that new processes may take without pushing others out: what the system has, and a container's limit."""
    system = linux_memory(MEMINFO.read_text()) if MEMINFO.exists() else macos_memory()
    return min((known for known in (system, container_memory(CGROUP)) if known is not None), default=None)


def linux_memory(meminfo: str) -> int | None:
    """From /proc/meminfo, in bytes."""
    found = re.search(r"^MemAvailable:\s+(\d+) kB", meminfo, re.MULTILINE)
    return int(found[1]) * 1024 if found else None


def container_memory(folder: Path) -> int | None:
    """What a limit on this process's group leaves, in bytes; None without one."""
    try:
        limit = (folder / "memory.max").read_text().strip()
        return None if limit == "max" else max(int(limit) - int((folder / "memory.current").read_text()), 0)
    except (OSError, ValueError):
        return None


def macos_memory() -> int | None:
    """From `vm_stat`, in bytes; None on systems that have no such program."""
    try:
        return pages_of_macos(subprocess.run(["vm_stat"], capture_output=True, text=True, check=True).stdout)
    except (OSError, subprocess.CalledProcessError):
        return None


def pages_of_macos(vm_stat: str) -> int | None:
    """From what `vm_stat` prints, in bytes: pages that are free or can be had at once."""
    size = re.search(r"page size of (\d+) bytes", vm_stat)
    pages = [re.search(rf"^Pages {kind}:\s+(\d+)", vm_stat, re.MULTILINE) for kind in RECLAIMABLE]
    return int(size[1]) * sum(int(found[1]) for found in pages if found) if size and any(pages) else None


if __name__ == "__main__":
    print(workers(usable_cores(), available_memory()))
