"""`jaxpoint bias fit`: pointings at known targets to a bias."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import Positive, RoomConfig
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    from jaxpoint.pointing.bias.bias import Bias


@dataclass(frozen=True, kw_only=True)
class BiasFit(Options):
    """Learn from pointings at known targets how far lines miss, and write it as a bias.

    jaxpoint bias fit pointings.csv --out bias.toml

    jaxpoint bias fit pointings.csv --lines head hand shoulder --model blend --out bias.toml

    jaxpoint bias fit anna.csv --shared bias.toml --out anna.toml

    The table holds person,gesture,line,origin_x_m,...,direction_x,...,target_x_m,...: one line of one gesture in each
    row. Three people are the least; with --shared a few gestures of one person do.
    """

    pointings: Annotated[Path, tyro.conf.Positional]
    """Table of pointings at known targets (.csv)."""
    model: Literal["constant-elevation", "constant", "polynomial", "blend"] = "constant"
    """The thesis's constant elevation; constant azimuth and elevation; both by the line's elevation; the first line
    drawn towards the others."""
    lines: tuple[str, ...] = ()
    """Kinds of line to use, the one to be turned first; by default those of the table in its order."""
    shared: Path | None = None
    """A bias of many people, on which the offset of the one person of this table is put."""
    loss_deg: Positive = 1.5
    """Misses well beyond this angle are taken for slips and hardly count; a shared bias brings its own measure."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> BiasFit:
        """The command's defaults under a configuration file."""
        return BiasFit(pointings=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write the bias to `--out`."""
        from jaxpoint.io.bias_files import read_bias, write_bias
        from jaxpoint.io.pointing_files import read_pointings
        from jaxpoint.pointing.bias.fit import fit_bias, fit_personal_bias

        out = self.needed_file("bias.toml")
        if self.shared is not None and (self.lines or self.model != "constant"):
            raise UsageError("With --shared, model and lines are those of the shared bias; leave out --model, --lines.")
        pointings, source = read_pointings(self.pointings), self.pointings.name
        if self.shared is not None:
            bias = fit_personal_bias(read_bias(self.shared), pointings, source=source)
        else:
            chosen = pointings.of_lines(self.lines) if self.lines else pointings
            bias = fit_bias(self.model, chosen, loss_deg=self.loss_deg, source=source)
        write_bias(out, bias)
        figures = {"bias": str(out), "lines": list(bias.lines), **asdict(bias.fitted)}
        return Outcome(figures, (*_lines(bias), f"Bias: {out}"))


def _lines(bias: Bias) -> tuple[str, ...]:
    import numpy as np

    from jaxpoint.pointing.bias.models import Constant, ConstantElevation, Personal

    fitted = bias.fitted
    told = [f"{fitted.gestures} gestures at {fitted.targets} targets, {fitted.people} people."]
    match bias.model:
        case ConstantElevation(elevation=elevation):
            told.append(f"The {bias.lines[0]} line points {np.rad2deg(elevation):+.2f} degrees too high.")
        case Constant(offset=offset) | Personal(offset=offset):
            left, up = np.rad2deg(offset)
            than = " than the shared bias says" if isinstance(bias.model, Personal) else ""
            told.append(f"The {bias.lines[0]} line points {left:+.2f} degrees to the left and {up:+.2f} up{than}.")
    if fitted.median_deg is not None:
        told.append(f"Corrected, people left out miss by {fitted.median_deg:.2f} degrees (median).")
    return tuple(told)
