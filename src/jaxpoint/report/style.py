"""How the figures look, and how they become text inside an HTML page.

Figures are drawn with matplotlib's object interface (no pyplot, no global figure) and become inline SVG whose ink is
the page's own: the colours `INK` and `FAINT` turn into CSS variables, so figures are readable on light and dark paper.
Dense scatters are rasterised inside the SVG, which keeps a page of 100,000 dots small.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib import colors
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.axis3d import Axis as Axis3D
from PIL import Image

INK = "#10202f"
FAINT = "#90a0af"
BAD = "#d6455d"
SEQUENTIAL = colors.LinearSegmentedColormap.from_list("light_blue", ["#2f7fd100", "#2f7fd1"])
_HUES = ("#3b82d0", "#e08214", "#2aa36b", "#c4509b", "#8b6fd8", "#b59410", "#1aa5b8", "#d4574a")
_RASTER_DPI = 144
_NO_METADATA = {"Date": None, "Creator": None}
PAGE = 10.6  # width of a figure, inches
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "jaxpoint",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.5,
    "grid.alpha": 0.45,
    "grid.color": FAINT,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color"), INK),
    "axes.edgecolor": FAINT,
}
_TIDY = (
    (r"(?s)<metadata>.*?</metadata>", ""),
    (r"(?s)<defs>\s*<style.*?</style>\s*</defs>", ""),  # a style inside inline SVG would hold for the whole page
    (r'<svg [^>]*(viewBox="0 0 ([\d.]+) [\d.]+")[^>]*>', r'<svg class="figure" style="max-width: \2pt" \1>'),
    (r'<g id="[\w.]+_\d+">', "<g>"),  # these numbers repeat from figure to figure
    (r" xlink:href=", " href="),
    (r" font-family: [^;\"]*;", ""),
    (r' transform="rotate\(-0 [^"]*"', ""),
    (r"(\d\.\d{3})\d+(?=[^<>]*>)", r"\1"),  # of coordinates, not of what is written
    (r"\s*\n\s*", "\n"),
)


@contextmanager
def style() -> Iterator[None]:
    """The report's matplotlib settings, undone afterwards."""
    with mpl.rc_context(_STYLE):
        yield


def camera_colors(cameras: int) -> list[str]:
    """One colour for each of `cameras` cameras, told apart on light and on dark paper."""
    if cameras <= len(_HUES):
        return list(_HUES[:cameras])
    wheel = np.stack([np.arange(cameras) / cameras, np.full(cameras, 0.55), np.tile([0.8, 0.58], cameras)[:cameras]], 1)
    return [colors.to_hex(color) for color in colors.hsv_to_rgb(wheel)]


def short_names(names: Sequence[str], length: int = 14) -> tuple[str, ...]:
    """The names cut to what fits into a figure: first what they have in common, then their middles."""
    if max(map(len, names)) <= length:
        return tuple(names)
    same = [len(set(letters)) == 1 for letters in zip(*names, strict=False)]
    common = max(0, (same.index(False) if False in same else len(same)) - 6)
    cut = [f"…{name[common:]}" if common > 1 else name for name in names]
    cut = [name if len(name) <= length else f"{name[: length - 7]}…{name[-6:]}" for name in cut]
    return tuple(cut) if len(set(cut)) == len(cut) else tuple(names)


ALONE = 0.62  # of the page's width: a single camera's picture


def small_multiples(
    titles: Sequence[str], sizes: np.ndarray, columns: int = 0, ticks: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure with one set of axes for each camera, shaped like its images (C, 2), y downwards.

    Returns:
        The figure and its axes, in camera order.
    """
    cameras = len(titles)
    columns = min(columns or (2 if cameras <= 4 else 3 if cameras <= 9 else 4), cameras)
    rows = -(-cameras // columns)
    # Placed by hand, in inches: an automatic layout takes longer than the drawing.
    left, right, above, below = (0.42, 0.08, 0.3, 0.26) if ticks else (0.06, 0.06, 0.26, 0.04)
    page = PAGE if cameras > 1 else ALONE * PAGE
    width = page / columns - left - right
    height = width * float(np.max(sizes[:, 1] / sizes[:, 0]))
    tall = rows * (above + height + below)
    figure = Figure(figsize=(page, tall))
    axes = []
    for index in range(cameras):
        row, column = divmod(index, columns)
        x = column * (left + width + right) + left
        y = tall - row * (above + height + below) - above - height
        axes.append(figure.add_axes((x / page, y / tall, width / page, height / tall)))
    for ax, title, (w, h) in zip(axes, titles, sizes, strict=True):
        ax.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), aspect="equal")
        ax.grid(False)
        ax.spines[:].set_visible(True)
        ax.tick_params(labelsize=7)
        ax.set_title(title, fontsize=9.5 if columns <= 2 else 8.0)
        ax.locator_params(nbins=5)
        if not ticks:
            ax.set(xticks=[], yticks=[])
    return figure, axes


def quiet_axes(ax: Axes3D) -> None:
    """Faint walls and lines, few and small numbers."""
    for axis in cast(list[Axis3D], [ax.xaxis, ax.yaxis, ax.zaxis]):
        axis.set_pane_color((0.5, 0.55, 0.6, 0.06))
        axis.line.set_color(FAINT)
    ax.tick_params(labelsize=7)
    ax.locator_params(nbins=6)


def to_svg(figure: Figure) -> str:
    """The figure as an inline `<svg>` element that scales with the page and takes the page's colours."""
    buffer = io.StringIO()
    # Axes in 3-D leave wide margins or run over them; everything else fills its page already.
    trim = "tight" if any(ax.name == "3d" for ax in figure.axes) else None
    with style():
        figure.savefig(buffer, format="svg", dpi=_RASTER_DPI, bbox_inches=trim, pad_inches=0.05, metadata=_NO_METADATA)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    for pattern, by in _TIDY:
        text = re.sub(pattern, by, text)
    return text.replace(INK, "var(--ink)").replace(FAINT, "var(--faint)").strip()


def to_data_uri(image: np.ndarray) -> str:
    """An RGB or grey image (H, W, 3) or (H, W), values 0..255, as a JPEG data URI."""
    buffer = io.BytesIO()
    Image.fromarray(np.clip(np.asarray(image), 0, 255).astype(np.uint8)).save(buffer, "JPEG", quality=90, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def round_number(value: float) -> float:
    """The nearest of 1, 2, 5, 10, 20, ... not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
