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
