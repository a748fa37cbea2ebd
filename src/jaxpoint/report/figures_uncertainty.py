"""The report's section on accuracy: maps of the expected error over the room, and the words and table beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jaxpoint.calibration.result import Calibration
from jaxpoint.report.accuracy import Accuracy, ErrorMap, camera_table, frame_note, sentence
from jaxpoint.report.style import BAD, FAINT, INK, PAGE, camera_colors, short_names, to_svg
from jaxpoint.report.summary import Summary

_STEPS = 8  # of the colour scale, at most
_COARSE, _FINE = (1, 2, 5), (1, 1.5, 2, 3, 5, 7)
_NARROW = 10.0  # the fine steps where the errors differ by less than so many times


def accuracy_section(calibration: Calibration, summary: Summary, found: Accuracy | None) -> dict[str, Any] | None:
    """What the template shows; None where nothing is known of the accuracy, `missing` where it is known why."""
    cameras = camera_table(calibration, summary)
    if cameras is None:
        return {"missing": calibration.undetermined, "cameras": None} if calibration.undetermined else None
    if found is None:
        return {"missing": "two cameras nowhere see the same place of the light's volume.", "cameras": cameras}
    return {
        "missing": "",
        "cameras": cameras,
        "sentence": sentence(found),
        "frame": frame_note(found),
        "maps": Markup(to_svg(error_maps(found, short_names(summary.names)))),
    }


def error_maps(accuracy: Accuracy, names: tuple[str, ...]) -> Figure:
    """The expected error on two planes, on one scale of round steps, with the cameras above them.

    Hatched red where fewer than two cameras see; grey where they do, but nearly along one line of sight.
    """
    levels = error_levels(accuracy)
    norm = BoundaryNorm(levels, 256, extend="both")
    plane = accuracy.planes[0]
    shape = np.ptp(plane.y) / np.ptp(plane.x)
    # Placed by hand, in inches: an automatic layout takes longer than the drawing.
    left, gap, right, below, above = 0.5, 0.6, 1.0, 0.75, 0.3
    width = (PAGE - left - gap - right) / 2
    height = float(np.clip(width * shape, 1.8, 7.0))
    tall = below + height + above
    figure = Figure(figsize=(PAGE, tall))
    for index, plane in enumerate(accuracy.planes):
        at = (left + index * (width + gap)) / PAGE, below / tall, width / PAGE, height / tall
        drawn = _map(figure.add_axes(at), plane, levels, norm, accuracy, names)
    beside = figure.add_axes(((PAGE - right + 0.15) / PAGE, below / tall, 0.12 / PAGE, height / tall))
    bar = figure.colorbar(drawn, cax=beside, label=f"expected error, {accuracy.unit.split()[0]}", ticks=levels)
    bar.ax.set_yticklabels([f"{level:g}" for level in levels])
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    hatched = Patch(facecolor="none", edgecolor=BAD, hatch="////", lw=0, label="fewer than two cameras see it")
    figure.legend(handles=[hatched], loc="lower left")
    return figure


def error_levels(accuracy: Accuracy) -> list[float]:
    """Round numbers from below the smallest error on; what is more than the last is drawn as the last colour."""
    known = np.concatenate([plane.error[np.isfinite(plane.error)] for plane in accuracy.planes])
    low, top = np.quantile(known, [0.0, 0.97]).tolist() if known.size else (accuracy.mean, accuracy.mean)
    low = max(low, 1e-9)  # errors of 0, as of cameras that are held, have no power of ten
    steps = _FINE if top < _NARROW * low else _COARSE
    power = 10.0 ** np.floor(np.log10(low))
    ladder = np.array([power * 10**decade * step for decade in range(_STEPS) for step in steps])
    first = int(np.searchsorted(ladder, low, side="right")) - 1
    last = int(np.clip(np.searchsorted(ladder, top), first + 2, first + _STEPS))
    return [float(f"{level:.6g}") for level in ladder[first : last + 1]]


def _map(
    ax: Axes, plane: ErrorMap, levels: list[float], norm: BoundaryNorm, accuracy: Accuracy, names: tuple[str, ...]
):
    known = np.isfinite(plane.error)
    error = np.ma.masked_where(~known, plane.error)
    drawn = ax.pcolormesh(
        plane.x, plane.y, error, cmap=colormaps["viridis_r"], norm=norm, shading="nearest", rasterized=True
    )
    if known.any():
        lines = ax.contour(plane.x, plane.y, error, levels=levels, colors="white", linewidths=0.8)
        ax.clabel(lines, fmt="%g", fontsize=7.5)
    few = plane.views < 2
    nearly = ~known & ~few
    ax.contourf(plane.x, plane.y, nearly.astype(float), levels=[0.5, 1.5], colors=[FAINT])
    if few.any():
        hatch = ax.contourf(plane.x, plane.y, few.astype(float), levels=[0.5, 1.5], colors="none", hatches=["////"])
        hatch.set(edgecolor=BAD, linewidth=0.0)
    for color, name, center in zip(camera_colors(len(names)), names, accuracy.scene.centers, strict=True):
        ax.plot(*center[:2], "o", ms=7, mfc=color, mec=INK, mew=0.8)
        ax.annotate(
            name, center[:2], xytext=(0, 7), textcoords="offset points", ha="center", weight="bold", fontsize=8,
            color=INK, annotation_clip=True,
        )  # fmt: skip
    unit = "m" if accuracy.scene.unit == "m" else "solver's unit"
    ax.set(title=plane.title, xlabel=f"x, {unit}", ylabel=f"y, {unit}", aspect="equal")
    ax.grid(False)
    return drawn
