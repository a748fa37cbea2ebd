"""Public names that load on first use, so that importing a package stays quick.

A package's stub (`__init__.pyi`, which type checkers read as well) lists its names and says where each one lives.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def exports(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package whose stub lies beside its `__init__.py`.

    Nothing is kept: a name is looked up in its home each time, so that what replaces it there is seen here.

    Args:
        package: its `__name__`.
        file: its `__file__`.
    """
    homes = homes_in(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        home, own = homes[name]
        return getattr(import_module(f".{home}", package), own)

    return get, lambda: sorted(homes), list(homes)


def homes_in(stub: str) -> dict[str, tuple[str, str]]:
    """Of each name that a stub imports from beside it: the module, relative to the package, and the name there."""
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node in ast.parse(stub).body
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module
        for alias in node.names
    }
