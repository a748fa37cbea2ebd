"""Figures of the lenses: how each one bends, and which part of its image the light visited."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.figure import Figure

from jaxpoint.report.style import BAD, FAINT, INK, PAGE, SEQUENTIAL, camera_colors, small_multiples
from jaxpoint.report.summary import GRID, Lens, image_coverage


def distortion_curves(names: tuple[str, ...], lens: Lens) -> Figure:
    """How far each lens moves a point, against its distance from the principal point: the thesis's figure 26.

    Solid as far as the light was seen, dashed beyond up to the image corner (a dot); a cross where the polynomial stops
    growing, beyond which it means nothing.
    """
    figure = Figure(figsize=(PAGE, 3.6), layout="constrained")
    ax = figure.add_subplot()
    for camera, color in enumerate(camera_colors(len(names))):
        radius, moved = lens.radius[camera], lens.displacement[camera]
        turning, corner, farthest = lens.turning[camera], lens.corner[camera], lens.farthest[camera]
        reach = min(corner, turning)
        seen, beyond = radius <= min(farthest, reach), (radius >= min(farthest, reach)) & (radius <= reach)
        ax.plot(radius[seen], moved[seen], color=color, lw=1.8, label=names[camera])
        ax.plot(radius[beyond], moved[beyond], color=color, lw=1.2, ls="--")
        if turning <= corner:
            ax.plot(turning, np.interp(turning, radius, moved), "X", color=BAD, ms=8, mec="none", zorder=4)
        else:
            ax.plot(corner, np.interp(corner, radius, moved), "o", color=color, ms=5, zorder=4)
    ax.axhline(0.0, color=FAINT, lw=0.8)
    ax.set(xlim=(0, None), xlabel="distance from the principal point without the lens, px")
    ax.set_ylabel("moved outwards by the lens, px")
    ax.legend(ncols=max(1, min(len(names), 6)))
    return figure


def coverage_maps(
    names: tuple[str, ...],
    pixels: Float[np.ndarray, "F C 2"],
    visible: Bool[np.ndarray, "F C"],
    sizes: Int[np.ndarray, "C 2"],
) -> Figure:
    """How often the light visited each cell of an 8 x 6 grid of each image; cells it never visited are hatched red."""
    columns = 2 if len(names) <= 2 else 3 if len(names) == 3 else 4
    counts = image_coverage(pixels, visible, sizes)
    titles = [f"{name}: {np.mean(count > 0):.0%} of its cells" for name, count in zip(names, counts, strict=True)]
    figure, axes = small_multiples(titles, sizes, columns, ticks=False)
    small = len(names) > 3
    for camera, ax in enumerate(axes):
        width, height = sizes[camera]
        x, y = np.linspace(-0.5, width - 0.5, GRID[0] + 1), np.linspace(-0.5, height - 0.5, GRID[1] + 1)
        count = counts[camera]
        top = max(float(np.quantile(count[count > 0], 0.9)) if (count > 0).any() else 1.0, 1.0)
        ax.pcolormesh(x, y, count, cmap=SEQUENTIAL, vmin=0, vmax=top, edgecolors=FAINT, linewidth=0.3)
        empty = np.ma.masked_where(count > 0, np.ones_like(count))
        ax.pcolor(x, y, empty, hatch="////", facecolor="none", edgecolor=BAD, alpha=0.0 if count.all() else 1.0, lw=0)
        for row, column in np.argwhere(count > 0):
            middle = ((x[column] + x[column + 1]) / 2, (y[row] + y[row + 1]) / 2)
            ax.text(*middle, str(count[row, column]), ha="center", va="center", fontsize=5.5 if small else 8, color=INK)
    return figure
