"""Figures of the head track: the way on the floor plan and in space (the thesis's figure 38), and heights over time."""

from __future__ import annotations

from typing import cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axis3d import Axis as Axis3D

from jaxpoint.report.style import FAINT, INK, PAGE, camera_colors
from jaxpoint.tracking.result import HeadTracks

_TIME = "viridis"
_MARGIN_M = 0.4


def floor_plan(
    heads: HeadTracks, centers: Float[np.ndarray, "C 3"], room: Float[np.ndarray, "2 3"] | None = None
) -> Figure:
    """The ways of all heads from above, with the cameras: a band in each person's colour, dots coloured by time.

    Args:
        heads: the tracks.
        centers: of the cameras, m.
        room: lowest and highest corner of the room, m, drawn where it is known.
    """
    low, high = _bounds(heads, centers, room)
    span = high - low
    width = PAGE * 0.78
    figure = Figure(figsize=(PAGE, float(np.clip(width * span[1] / span[0] + 0.5, 3.0, 9.0))), layout="constrained")
    ax = figure.add_subplot()
    if room is not None:
        size = room[1] - room[0]
        ax.add_patch(Rectangle((room[0, 0], room[0, 1]), size[0], size[1], fill=False, ec=INK, lw=1.4))
    for color, (name, place) in zip(camera_colors(len(heads.people)), _ways(heads)):
        line, seconds, measured = place
        ax.plot(*line[:, :2].T, color=color, lw=7, alpha=0.28, solid_capstyle="round")
        _dots(ax, line[measured, :2], seconds[measured], heads.times)
        ax.plot(*line[~measured, :2].T, "o", mfc="none", mec=FAINT, ms=4, mew=0.8)
        _label(ax, line[0, :2], name, color)
    for name, center in zip(heads.cameras, centers):
        ax.plot(*center[:2], marker="s", color=INK, ms=7)
        ax.annotate(name, center[:2], xytext=(0, 8), textcoords="offset points", ha="center", weight="bold", fontsize=8)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m", aspect="equal")
    _time_bar(figure, heads, ax=ax, shrink=0.6, pad=0.02, aspect=30)
    return figure


def in_space(
    heads: HeadTracks, centers: Float[np.ndarray, "C 3"], room: Float[np.ndarray, "2 3"] | None = None
) -> Figure:
    """The ways of all heads in 3-D, coloured by time, with their shadows on the floor in each person's colour."""
    low, high = _bounds(heads, centers, room)
    low[2] = min(0.0, low[2])
    figure = Figure(figsize=(PAGE, 6.2))
    ax = cast(Axes3D, figure.add_axes((0.02, 0.04, 0.84, 0.94), projection="3d", computed_zorder=False))
    for color, (name, (line, seconds, _)) in zip(camera_colors(len(heads.people)), _ways(heads)):
        shadow = np.where(np.arange(3) == 2, low[2], line)
        ax.plot(*shadow.T, color=color, lw=2.5, alpha=0.45)
        pieces = Line3DCollection(list(np.stack([line[:-1], line[1:]], axis=1)), cmap=_TIME, lw=2.6)
        pieces.set_array((seconds[:-1] + seconds[1:]) / 2)
        pieces.set_clim(*_clock(heads))
        ax.add_collection3d(pieces)
        x, y, z = line[0]
        ax.text(x, y, z + 0.08, name, color=color, weight="bold", fontsize=9, ha="center")
    ax.scatter(*centers.T, marker="s", s=32, c=INK, depthshade=False)
    for name, (x, y, z) in zip(heads.cameras, centers):
        ax.text(x, y, z + 0.12, name, color=INK, weight="bold", fontsize=8, ha="center")
        ax.plot([x, x], [y, y], [low[2], z], color=FAINT, lw=0.6)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    ax.set_box_aspect(tuple(high - low), zoom=0.95)  # pyright: ignore[reportArgumentType]
    ax.view_init(elev=26, azim=-60)
    for axis in cast(list[Axis3D], [ax.xaxis, ax.yaxis, ax.zaxis]):
        axis.set_pane_color((0.5, 0.55, 0.6, 0.06))
        axis.line.set_color(FAINT)
    ax.tick_params(labelsize=7)
    ax.locator_params(nbins=6)
    _time_bar(figure, heads, cax=figure.add_axes((0.93, 0.25, 0.012, 0.5)))
    return figure


def heights(heads: HeadTracks) -> Figure:
    """How high each head is over time, with two standard deviations; rings where less than two views saw it."""
    figure = Figure(figsize=(PAGE, 3.2), layout="constrained")
    ax = figure.add_subplot()
    for person, color in enumerate(camera_colors(len(heads.people))):
        there = heads.present[:, person]
        seconds, height = heads.times[there], heads.positions[there, person, 2]
        sigma, measured = heads.sigma[there, person], heads.measured[there, person]
        ax.fill_between(seconds, height - 2 * sigma, height + 2 * sigma, color=color, alpha=0.22, lw=0)
        ax.plot(seconds, height, color=color, lw=1.6, label=f"person {heads.people[person]}")
        ax.plot(seconds[~measured], height[~measured], "o", mfc="none", mec=color, ms=4, mew=0.9)
    ax.set(xlabel="time, s", ylabel="height of the head, m", xlim=_clock(heads))
    if len(heads.people):
        ax.legend(ncols=6, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    return figure


def _ways(heads: HeadTracks) -> list[tuple[str, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Of everybody: the name, places (m), times (s), and whether two views saw it."""
    ways = []
    for person, name in enumerate(heads.people):
        there = heads.present[:, person]
        way = heads.positions[there, person], heads.times[there], heads.measured[there, person]
        ways.append((f"person {name}", way))
    return ways


def _bounds(heads: HeadTracks, centers: np.ndarray, room: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates to draw."""
    places = [heads.positions[heads.present], centers, *([] if room is None else [room])]
    drawn = np.concatenate(places)
    return drawn.min(axis=0) - _MARGIN_M, drawn.max(axis=0) + _MARGIN_M


def _clock(heads: HeadTracks) -> tuple[float, float]:
    """First and last moment; never the same."""
    if not len(heads.times):
        return 0.0, 1.0
    return float(heads.times[0]), float(max(heads.times[-1], heads.times[0] + 1e-3))


def _dots(ax: Axes, places: np.ndarray, seconds: np.ndarray, times: np.ndarray) -> None:
    ax.scatter(*places.T, c=seconds, s=9, cmap=_TIME, vmin=times[0], vmax=times[-1], lw=0, rasterized=True, zorder=3)


def _label(ax: Axes, place: np.ndarray, name: str, color: str) -> None:
    ax.plot(*place, marker="o", mfc="none", mec=color, ms=11, mew=2)
    ax.annotate(
        name,
        (place[0], place[1]),
        xytext=(0, 11),
        textcoords="offset points",
        color=color,
        weight="bold",
        fontsize=9,
        ha="center",
    )


def _time_bar(figure: Figure, heads: HeadTracks, **place) -> None:
    bar = figure.colorbar(ScalarMappable(Normalize(*_clock(heads)), _TIME), label="time, s", **place)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
