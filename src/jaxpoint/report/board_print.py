"""A calibration board as a page to print at its true size: SVG, or PDF."""

from __future__ import annotations

from pathlib import Path

from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jaxpoint.detection.board.abstract_board import AbstractBoard
from jaxpoint.errors import UsageError
from jaxpoint.io.files import replacing

FOOT_MM, INCH_MM, RULER_MM, TEXT_MM = 12.0, 25.4, 100.0, 3.2


def write_board(path: Path, board: AbstractBoard) -> None:
    """Write the board with a ruler below it, by which a print is checked.

    Raises:
        UsageError: the name ends neither in .svg nor in .pdf.
        OSError: the folder is missing or not writable.
    """
    if path.suffix not in (".svg", ".pdf"):
        raise UsageError(f"A board is written as .svg or .pdf, not as '{path.name}'; choose another --out.")
    with replacing(path) as file:
        if path.suffix == ".svg":
            file.write(svg_of(board).encode("utf-8"))
        else:
            _draw(board).savefig(file, format="pdf", metadata={"CreationDate": None})


def svg_of(board: AbstractBoard) -> str:
    """The page as SVG, one user unit a millimetre."""
    width, height = board.print_size_mm
    whole = height + FOOT_MM
    # One path, so that no hairline shows between parts that touch.
    dark = "".join(f"M{x:.4f} {y:.4f}h{w:.4f}v{h:.4f}h{-w:.4f}z" for x, y, w, h in board.dark_mm())
    ruler, left, y = _ruler(width), min(5.0, 0.05 * width), height + FOOT_MM / 2
    ticks = "".join(f"M{left + x:.4f} {y:.4f}v-2" for x in (0.0, ruler))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{whole:.4f}mm" '
        f'viewBox="0 0 {width:.4f} {whole:.4f}">\n'
        f'<rect width="{width:.4f}" height="{whole:.4f}" fill="#fff"/>\n'
        f'<path d="{dark}" fill="#000" shape-rendering="crispEdges"/>\n'
        f'<path d="M{left:.4f} {y:.4f}h{ruler:.4f}{ticks}" stroke="#000" stroke-width="0.2" fill="none"/>\n'
        f'<text x="{left:.4f}" y="{y + 4:.4f}" font-family="sans-serif" font-size="{TEXT_MM}">'
        f"{_caption(board)}</text>\n"
        "</svg>\n"
    )


def _caption(board: AbstractBoard) -> str:
    return f"{board.spec} · the line is {_ruler(board.print_size_mm[0]):g} mm long: print at 100 %"


def _ruler(width: float) -> float:
    return RULER_MM if width > 1.2 * RULER_MM else 10.0


def _draw(board: AbstractBoard) -> Figure:
    width, height = board.print_size_mm
    whole = height + FOOT_MM
    figure = Figure(figsize=(width / INCH_MM, whole / INCH_MM))
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, width), ylim=(whole, 0))
    ax.set_axis_off()
    parts = [Rectangle((x, y), w, h) for x, y, w, h in board.dark_mm()]
    ax.add_collection(PatchCollection(parts, facecolor="black", edgecolor="none", antialiased=False))
    ruler, left, y = _ruler(width), min(5.0, 0.05 * width), height + FOOT_MM / 2
    ax.plot([left, left, left + ruler, left + ruler], [y - 2, y, y, y - 2], color="black", lw=0.6)
    ax.text(left, y + 4, _caption(board), fontsize=TEXT_MM * 72 / INCH_MM)
    return figure
