"""Compiled programs that are kept from run to run: where, how many, and how they stay few.

They lie in the user's cache folder unless the settings name another, each version of jaxlib and each kind of processor
in a part of its own (`compilation.keep_programs`).
"""

from __future__ import annotations

import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from jaxpoint.commands.inputs import user_cache
from jaxpoint.config.room import RuntimeSettings
from jaxpoint.errors import UsageError

MAX_BYTES = 500_000_000  # some 35,000 programs; all commands together keep about 3,000 (measured)
EMPTY_FOR_S = 60.0  # a file that is still empty after so long was left by a process that ended while it wrote


@dataclass(frozen=True)
class KeptPrograms:
    """What a folder holds."""

    folder: Path
    files: int
    size_bytes: int

    def __str__(self) -> str:
        return f"{self.files} in {self.folder} ({self.size_bytes / 1e6:.0f} MB)"


def programs_folder(settings: RuntimeSettings) -> Path | None:
    """The folder for compiled programs, made where it was missing; None where none are to be kept, or none can be.

    Raises:
        UsageError: the folder that the settings name cannot be made.
    """
    if not settings.keep_programs:
        return None
    folder = settings.compilation_cache or user_cache() / "programs"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if settings.compilation_cache is None:  # a user without a home compiles anew
            return None
        raise UsageError(
            f"The folder '{folder}' for compiled programs cannot be made ({error.strerror}); name another, or leave "
            "out --compilation-cache."
        ) from error
    return folder


def kept_programs(folder: Path) -> KeptPrograms:
    """How many files a folder of compiled programs holds, and their size."""
    sizes = [size for _, size, _ in _files(folder)]
    return KeptPrograms(folder, len(sizes), sum(sizes))


def trim_programs(folder: Path, now_s: float, max_bytes: int = MAX_BYTES) -> None:
    """Remove what was not written to its end, and above `max_bytes` the programs unused for longest, down to half."""
    files = sorted(_files(folder))
    for used_s, size, path in files:
        if size == 0 and now_s - used_s > EMPTY_FOR_S:
            _remove(path)
    total = sum(size for _, size, _ in files)
    if total <= max_bytes:
        return
    for _, size, path in files:
        _remove(path)
        total -= size
        if total <= max_bytes // 2:
            return


def clear_programs(folder: Path) -> KeptPrograms:
    """Remove all kept programs, and nothing else; returns what there was."""
    found = kept_programs(folder)
    for part in folder.glob("jaxlib-*"):
        shutil.rmtree(part, ignore_errors=True)
    return found


def _files(folder: Path) -> list[tuple[float, int, Path]]:
    """Time of last use (s), size (bytes) and path of every kept program."""
    found = []
    for path in folder.glob("jaxlib-*/*"):
        with suppress(OSError):  # another process removed it
            entry = path.stat()
            found.append((max(entry.st_atime, entry.st_mtime), entry.st_size, path))
    return found


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()
