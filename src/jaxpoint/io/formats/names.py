"""Names of cameras from files, and files from names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from jaxpoint.errors import UsageError


def file_stem(name: str) -> str:
    """A camera's name as the name of a file: other characters than letters, digits, -, _ and . become _."""
    return re.sub(r"[^\w.-]", "_", name).lstrip(".") or "camera"


def file_stems(names: Sequence[str]) -> tuple[str, ...]:
    """Cameras' names as names of files.

    Raises:
        UsageError: two become one.
    """
    stems = tuple(file_stem(name) for name in names)
    twice = [name for name, stem in zip(names, stems) if stems.count(stem) > 1]
    if twice:
        raise UsageError(f"The cameras {' and '.join(twice)} would share the name of a file; rename one of them.")
    return stems


def shortest_names(paths: Sequence[str]) -> tuple[str, ...]:
    """Names of images: without folder and suffix where these differ, else with as much of the path as is needed."""
    parts = [PurePosixPath(path.replace("\\", "/").lstrip("./")).with_suffix("").parts or (path,) for path in paths]
    for length in range(1, max((len(part) for part in parts), default=1) + 1):
        names = tuple("/".join(part[-length:]) for part in parts)
        if len(set(names)) == len(names):
            return names
    return tuple(paths)
