"""`jaxpoint bias apply`: lines of pointing, corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig


@dataclass(frozen=True, kw_only=True)
class BiasApply(Options):
    """Turn lines of pointing back by what people usually err.

    jaxpoint bias apply lines.csv --bias bias.toml --out corrected.csv

    The table is that of bias fit; targets may be missing. Out comes the line that the bias turns, one row a gesture.
    """

    pointings: Annotated[Path, tyro.conf.Positional]
    """Table of lines of pointing (.csv)."""
    bias: Path
    """The bias, as bias fit writes it."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> BiasApply:
        """The command's defaults under a configuration file."""
        return BiasApply(pointings=tyro.MISSING, bias=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write the corrected lines to `--out`."""
        import numpy as np

        from jaxpoint.io.bias_files import read_bias
        from jaxpoint.io.pointing_files import read_pointings, write_pointings

        out = self.needed_file("corrected.csv")
        bias = read_bias(self.bias)
        pointings = read_pointings(self.pointings).of_lines(bias.lines)
        directions = np.asarray(bias.correct(pointings.directions))
        first = pointings.of_lines(bias.lines[:1])
        write_pointings(out, replace(first, directions=directions[:, None]))
        told = f"{len(pointings)} lines of the kind {bias.lines[0]} corrected: {out}"
        return Outcome({"lines": str(out), "kind": bias.lines[0], "gestures": len(pointings)}, (told,))
