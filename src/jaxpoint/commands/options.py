"""What every command takes, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field
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

    def needed_file(self, example: str) -> Path:
        """`--out`, where it is one new file.

        Raises:
            UsageError: it was not given, ends otherwise than the example, exists (without `--force`), or its folder
                does not.
        """
        out, ending = self.needed_out(example), Path(example).suffix
        if out.suffix != ending:
            raise UsageError(f"--out must name a file that ends in {ending}, not '{out}'.")
        if out.exists() and not (self.force and out.is_file()):
            raise UsageError(f"'{out}' exists; choose another --out, or replace it by --force.")
        if not out.absolute().parent.is_dir():
            raise UsageError(f"There is no folder '{out.parent}'; make it, or choose another --out.")
        return out


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
