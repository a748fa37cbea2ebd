"""`jaxpoint board`: a calibration board to print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig
from jaxpoint.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Board(Options):
    """Write a calibration board at its true size, as SVG or PDF.

    jaxpoint board charuco:7x5:40mm:30mm:DICT_4X4_50 --out board.pdf

    Print it at 100 %, check the line below it with a ruler, and glue it to something flat and stiff.
    """

    board: Annotated[str, tyro.conf.Positional]
    """chessboard:9x6:25mm (inner corners), charuco:7x5:40mm:30mm:DICT_4X4_50 (squares), aprilgrid:6x6:55mm:0.3 (tags),
    or a TOML file."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> Board:
        """The command's defaults under a configuration file."""
        return Board(board=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write the page."""
        from jaxpoint.detection.board.board_spec import read_board
        from jaxpoint.report.board_print import write_board

        board = read_board(self.board)
        ending = ".svg" if self.out is not None and self.out.suffix == ".svg" else ".pdf"
        if self.out is not None and self.out.suffix not in (".svg", ".pdf"):
            raise UsageError(f"--out must name a file that ends in .svg or .pdf, not '{self.out}'.")
        out = self.needed_file(f"board{ending}")
        write_board(out, board)
        width, height = board.print_size_mm
        figures = {"board": board.spec, "file": str(out), "width_mm": width, "height_mm": height}
        care = (
            (
                "It looks the same turned by 180 degrees, which several cameras cannot tell apart; one side odd and "
                "one even is better.",
            )
            if board.ambiguous
            else ()
        )
        return Outcome(figures, (f"{board.spec}: {width:.0f} x {height:.0f} mm, {out}", *care))
