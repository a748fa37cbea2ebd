"""`jaxpoint bias compare`: every model on people that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import check_no_out
from jaxpoint.commands.options import Outcome, SeededOptions
from jaxpoint.config import Positive, RoomConfig

_HEADER = ("model", "median deg", "95 %", "mean deg", "too far left", "too high", "gestures")


@dataclass(frozen=True, kw_only=True)
class BiasCompare(SeededOptions):
    """Score the models of bias on people who were not fitted, one left out at a time.

    jaxpoint bias compare pointings.csv --lines head hand shoulder

    The table is that of bias fit, with four people or more. Intervals are of the median, over people drawn anew. The
    blend is scored where there are two lines or more.
    """

    pointings: Annotated[Path, tyro.conf.Positional]
    """Table of pointings at known targets (.csv)."""
    lines: tuple[str, ...] = ()
    """Kinds of line to use, the one to be turned first; by default those of the table in its order."""
    loss_deg: Positive = 1.5
    """Misses well beyond this angle are taken for slips and hardly count."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> BiasCompare:
        """The command's defaults under a configuration file."""
        return BiasCompare(pointings=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """One row a model."""
        from jaxpoint.io.pointing_files import read_pointings
        from jaxpoint.pointing.bias.fit import KINDS, Kind, left_out
        from jaxpoint.pointing.bias.score import score

        check_no_out(self.out)
        pointings = read_pointings(self.pointings)
        pointings = pointings.of_lines(self.lines) if self.lines else pointings
        line, *others = pointings.lines
        kinds: list[Kind] = [kind for kind in KINDS if kind != "blend" or others]
        scores = {}
        with console.progress() as progress:
            for done, kind in enumerate(kinds):
                progress("models", done, len(kinds))
                directions, _ = left_out(kind, pointings, loss_deg=self.loss_deg)
                scores[kind] = score(pointings, directions, self.seed)
            progress("models", len(kinds), len(kinds))
        rows = [
            (kind, f"{s.median_deg:.2f}", f"{s.low_deg:.2f} to {s.high_deg:.2f}", f"{s.mean_deg:.2f}",
             f"{s.left_deg:+.2f}", f"{s.high_by_deg:+.2f}", s.gestures)
            for kind, s in scores.items()
        ]  # fmt: skip
        figures = {"line": line, "models": {kind: vars(s) for kind, s in scores.items()}}
        title = f"The {line} line, corrected on {len(pointings.crowd)} people left out in turn:"
        return Outcome(figures, (title, *table(_HEADER, rows)))
