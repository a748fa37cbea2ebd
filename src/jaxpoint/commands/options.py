"""What every command takes, and what it returns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from jaxpoint.config import Count, RuntimeSettings
from jaxpoint.errors import JaxpointError, UsageError

Inline = tyro.conf.arg(name="")
"""Marks a nested group of settings whose flags carry no prefix."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of every command."""

    config: Path | None = None
    """TOML file of settings; flags override it."""
    out: Path | None = None
    """Where the results go."""
    force: bool = False
    """Replace what an earlier run left in `--out`."""
    json: bool = False
    """Print one JSON object, and nothing else, on standard output."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Say more on the way; show where in the program an error arose."""
    runtime: Annotated[RuntimeSettings, Inline] = field(default_factory=RuntimeSettings)

    def needed_out(self, example: str) -> Path:
        """`--out`, where the command cannot do without.

        Raises:
            UsageError: it was not given.
        """
        if self.out is None:
            raise UsageError(f"Say where the results go: --out {example}")
        return self.out

    def needed_folder(self, example: str) -> Path:
        """`--out`, where it is a new folder, looked at before any work is done.

        Raises:
            UsageError: it was not given, cannot be used (see `jaxpoint.runs.check_out`), or holds what is read.
        """
        from jaxpoint.runs import check_out

        out = self.needed_out(example)
        check_out(out, self.force)
        self._spare_inputs(out)
        return out

    def needed_file(self, example: str) -> Path:
        """`--out`, where it is one new file.

        Raises:
            UsageError: it was not given, ends otherwise than the example, exists (without `--force`), is read by the
                command, or its folder does not exist.
        """
        out, ending = self.needed_out(example), Path(example).suffix
        if out.suffix != ending:
            raise UsageError(f"--out must name a file that ends in {ending}, not '{out}'.")
        if out.exists() and not (self.force and out.is_file()):
            raise UsageError(f"'{out}' exists; choose another --out, or replace it by --force.")
        if not out.absolute().parent.is_dir():
            raise UsageError(f"There is no folder '{out.parent}'; make it, or choose another --out.")
        self._spare_inputs(out)
        return out

    def _spare_inputs(self, out: Path) -> None:
        """Refuse to replace what the command reads, be it all of `out` or a file within."""
        place = out.resolve()
        for field_ in fields(self):
            if field_.name in ("out", "cache", "runtime"):
                continue
            for path in _paths(getattr(self, field_.name)):
                if path.exists() and path.resolve().is_relative_to(place):
                    raise UsageError(f"'{path}' is read and lies where the results go; choose another --out.")


@dataclass(frozen=True, kw_only=True)
class SeededOptions(Options):
    """Flags of a command whose settings hold no seed of their own."""

    seed: Count = 0
    """Seed of everything drawn at random; written into the run."""


@dataclass(frozen=True)
class Outcome:
    """What a command did: figures for a program, lines for a person, and a failure where the results are kept."""

    figures: dict[str, Any]
    lines: tuple[str, ...] = ()
    failure: JaxpointError | None = None
    missing: tuple[str, ...] = ()  # pages and pictures that could not be made, a sentence each; no failure


def at(label: str, path: Path) -> tuple[str, ...]:
    """The line that says where something lies, where it does: a page may be missing, see `jaxpoint.extras`."""
    return (f"{label}: {path}",) if path.exists() else ()


def _paths(value: object) -> Iterator[Path]:
    """All paths in a setting, however deep."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple | list):
        for part in value:
            yield from _paths(part)
    elif is_dataclass(value):
        for part in fields(value):
            yield from _paths(getattr(value, part.name))
