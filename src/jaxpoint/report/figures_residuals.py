"""Figures of what is left unexplained: detections against reprojections, and residuals every way round."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from jaxpoint.report.style import BAD, FAINT, INK, PAGE, camera_colors, round_number, small_multiples
from jaxpoint.report.summary import BEST, GRID, Summary, cell_means, kept_curve, mean, mean_of_best, px

_RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))  # of lengths of 2-D noise, in its standard deviations
_LEGEND_ROWS = 18  # that stand beside axes
_SCATTER = 30_000  # dots drawn in one cloud; more cannot be told apart


def reprojections(summary: Summary) -> Figure:
    """Detections (rings) against reprojections (crosses), outliers in red: the thesis's figure 25."""
    titles = [
        f"{name}: {px(mean(summary.errors[summary.kept[:, c], c]), 2)}, {summary.rejected[:, c].sum()} rejected"
        for c, name in enumerate(summary.names)
    ]
    figure, axes = small_multiples(titles, summary.sizes)
    dot = 13.0 if len(axes) <= 4 else 6.0
    for camera, ax in enumerate(axes):
        kept, rejected = summary.kept[:, camera], summary.rejected[:, camera]
        observed = summary.pixels[:, camera]
        projected = observed + summary.residuals[:, camera]
        ax.scatter(*observed[kept].T, s=dot, facecolors="none", edgecolors="#3b82d0", linewidths=0.6, rasterized=True)
        ax.scatter(*projected[kept].T, s=0.7 * dot, marker="+", c="#e08214", linewidths=0.6, rasterized=True)
        ax.add_collection(
            LineCollection(
                list(np.stack([observed, projected], 1)[rejected]), colors=BAD, linewidths=0.7, rasterized=True
            )
        )
        ax.scatter(*observed[rejected].T, s=1.2 * dot, marker="x", c=BAD, linewidths=0.9, rasterized=True)
    return figure


def vector_field(summary: Summary) -> Figure:
    """Residuals as magnified arrows, and their mean in every cell of the image in bold."""
    typical = max(float(np.median(summary.errors[summary.kept])) if summary.kept.any() else 1.0, 1e-6)
    zooms = [round_number(0.02 * width / typical) for width in summary.sizes[:, 0]]
    titles = [f"{name}: arrows × {zoom:g}" for name, zoom in zip(summary.names, zooms, strict=True)]
    figure, axes = small_multiples(titles, summary.sizes)
    for camera, ax in enumerate(axes):
        kept = summary.kept[:, camera]
        start, residual = summary.pixels[kept, camera], summary.residuals[kept, camera]
        size = summary.sizes[camera]
        zoom = zooms[camera]
        ax.add_collection(
            LineCollection(
                list(np.stack([start, start + zoom * residual], 1)), colors="#3b82d0", linewidths=0.5, alpha=0.7,
                rasterized=True,
            )
        )  # fmt: skip
        field, count = cell_means(start, residual, size)
        cell = size / np.array(GRID)
        row, column = np.nonzero(count >= 3)
        middle = (np.stack([column, row], 1) + 0.5) * cell
        arrow = zoom * field[row, column]
        ax.quiver(*middle.T, *arrow.T, angles="xy", scale_units="xy", scale=1, color=INK, width=0.006, zorder=3)
    return figure


def error_distribution(summary: Summary) -> Figure:
    """Histogram of the errors beside what pure noise gives, and the error against the image radius."""
    figure = Figure(figsize=(PAGE, 3.5), layout="constrained")
    _histogram(summary, figure.add_subplot(1, 2, 1))
    _against_radius(summary, figure.add_subplot(1, 2, 2))
    return figure


def over_time(summary: Summary) -> Figure:
    """Every error over the recording, running medians of each camera, and marks where observations were rejected."""
    figure = Figure(figsize=(PAGE, 3.3), layout="constrained")
    ax = figure.add_subplot()
    when = summary.frame_ids if summary.times is None else summary.times
    frames, cameras = np.nonzero(summary.kept)
    errors = summary.errors[frames, cameras]
    colors = np.array(camera_colors(len(summary.names)))
    top = _above(1.15, errors, 0.995)
    beyond = errors > top  # the band above belongs to what was rejected
    chosen = _at_most(len(frames), _SCATTER)
    chosen = chosen[~beyond[chosen]]
    ax.scatter(when[frames[chosen]], errors[chosen], s=3, c=colors[cameras[chosen]], alpha=0.3, lw=0, rasterized=True)
    ax.scatter(
        when[frames[beyond]], np.full(beyond.sum(), 0.98 * top), s=12, marker="^", c=colors[cameras[beyond]], lw=0
    )
    for camera, name in enumerate(summary.names):
        seen = summary.kept[:, camera]
        if seen.sum() >= 10:
            middle, median = _binned_median(when[seen].astype(float), summary.errors[seen, camera], bins=60)
            ax.plot(middle, median, color=colors[camera], lw=1.4, label=name)
    frames, cameras = np.nonzero(summary.rejected)
    row = top * (1.04 + 0.035 * cameras)
    ax.scatter(when[frames], row, s=14, marker="|", c=colors[cameras], linewidths=0.8, rasterized=True)
    ax.axhline(top, color=FAINT, lw=0.6)
    ax.annotate(
        "rejected", (0, top), xycoords=("axes fraction", "data"), xytext=(2, -3), textcoords="offset points", va="top"
    )
    ax.set(ylim=(0, top * (1.06 + 0.035 * len(summary.names))), ylabel="error, px")
    ax.set_yticks([tick for tick in ax.get_yticks() if tick <= top])
    ax.set_xlabel("frame" if summary.times is None else "time, s")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=8, fontsize=7.5)
    return figure


def kept_against_mean(summary: Summary) -> Figure:
    """Mean error against the fraction of observations kept, best first, for each camera and for all."""
    figure = Figure(figsize=(PAGE, 3.6), layout="constrained")
    ax = figure.add_subplot()
    everything = summary.errors[summary.judged]
    top = 0.0
    for camera, (name, color) in enumerate(zip(summary.names, camera_colors(len(summary.names)), strict=True)):
        errors = summary.errors[summary.judged[:, camera], camera]
        fraction, value = _thinned(*kept_curve(errors))
        ax.plot(100 * fraction, value, color=color, lw=1.1, label=name)
        top = max(top, mean_of_best(errors, 0.97))
    fraction, value = _thinned(*kept_curve(everything))
    ax.plot(100 * fraction, value, color=INK, lw=2.2, label="all")
    top = 1.4 * max(top, mean_of_best(everything, 0.97), 1e-3)
    for mark in (BEST, 1.0) if everything.size else ():
        value = mean_of_best(everything, mark)
        ax.axvline(100 * mark, color=FAINT, lw=0.8, ls="--")
        ax.plot(100 * mark, min(value, top), "o" if value <= top else "^", color=INK, ms=5, clip_on=False, zorder=4)
        ax.annotate(
            f"{mark:.0%}: {value:.3f} px", (100 * mark, min(value, top)), xytext=(-7, 6),
            textcoords="offset points", ha="right", weight="bold",
        )  # fmt: skip
    ax.set(xlim=(0, 100.5), ylim=(0, top), xlabel="observations kept, best first, %", ylabel="mean error, px")
    _legend(ax, "upper left", columns=5)
    return figure


def _histogram(summary: Summary, ax: Axes) -> None:
    errors = summary.errors[summary.kept]
    sigma = max(float(np.median(errors)) / _RAYLEIGH_MEDIAN if errors.size else 1.0, 1e-9)
    top = max(5.0 * sigma, float(np.quantile(errors, 0.995)) if errors.size else 0.0)
    edges = np.linspace(0.0, top, 50)
    if errors.size:
        ax.hist(np.minimum(errors, top), edges.tolist(), density=True, color="#3b82d0", alpha=0.35, label="all cameras")
    for camera, color in enumerate(camera_colors(len(summary.names))):
        mine = summary.errors[summary.kept[:, camera], camera]
        if mine.size:
            density, _ = np.histogram(mine, edges, density=True)
            ax.stairs(density, edges, color=color, lw=0.8, alpha=0.9)
    x = np.linspace(0.0, top, 200)
    rayleigh = x / sigma**2 * np.exp(-0.5 * (x / sigma) ** 2)
    ax.plot(x, rayleigh, color=INK, lw=1.6, ls="--", label=f"pure noise, σ = {sigma:.2g} px")
    ax.set(xlim=(0, top), xlabel="error of an observation kept, px", title="How large the errors are")
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.legend()


def _against_radius(summary: Summary, ax: Axes) -> None:
    frames, cameras = np.nonzero(summary.kept)
    colors = np.array(camera_colors(len(summary.names)))
    radius = np.linalg.norm(summary.pixels - summary.center, axis=-1)
    chosen = _at_most(len(frames), _SCATTER)
    f, c = frames[chosen], cameras[chosen]
    ax.scatter(radius[f, c], summary.errors[f, c], s=3, c=colors[c], alpha=0.25, lw=0, rasterized=True)
    for camera, name in enumerate(summary.names):
        mine = summary.kept[:, camera]
        if mine.sum() >= 10:
            middle, median = _binned_median(radius[mine, camera], summary.errors[mine, camera], bins=14)
            ax.plot(middle, median, color=colors[camera], lw=1.6, label=name)
    errors = summary.errors[summary.kept]
    top = _above(1.1, errors, 0.99)
    ax.set(ylim=(0, top), xlim=(0, None), xlabel="distance from the principal point, px", ylabel="error, px")
    ax.set_title("Does the error grow towards the edge?")
    _legend(ax)


def _legend(ax: Axes, loc: Literal["upper left", "upper right"] = "upper right", columns: int = 3) -> None:
    """The legend of what was drawn: inside while it is short, else beside the axes."""
    entries = len(ax.get_legend_handles_labels()[0])
    if 0 < entries <= 8:
        ax.legend(loc=loc, ncols=min(entries, columns)).set_in_layout(False)
    elif entries:
        columns = -(-entries // _LEGEND_ROWS)  # a legend higher than the figure leaves no room for the axes
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7.5, ncols=columns, columnspacing=0.8)


def _above(times: float, errors: np.ndarray, quantile: float) -> float:
    """The end of an axis: so many times a quantile, and never 0, which is where an axis begins."""
    return times * float(np.quantile(errors, quantile)) or 1e-3 if errors.size else 1.0


def _binned_median(x: np.ndarray, y: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Median of y in bins of equal count along x, and the bins' median x."""
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, max(1, min(bins, len(x) // 8)))
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])


def _at_most(count: int, limit: int) -> np.ndarray:
    """Indices evenly drawn from `count`, at most `limit` of them."""
    return np.arange(count) if count <= limit else np.linspace(0, count - 1, limit).astype(int)


def _thinned(x: np.ndarray, y: np.ndarray, limit: int = 300) -> tuple[np.ndarray, np.ndarray]:
    chosen = _at_most(len(x), limit)
    return x[chosen], y[chosen]
