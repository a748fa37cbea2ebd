"""The room with its cameras, from above and in 3-D, for ways to be drawn into, coloured by time."""

from __future__ import annotations

from collections.abc import Sequence
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

from jaxpoint.report.style import FAINT, INK, PAGE, quiet_axes

_TIME = "viridis"
_MARGIN_M = 0.4


def plan_view(
    places: Float[np.ndarray, "N 3"],
    cameras: Sequence[str],
    centers: Float[np.ndarray, "C 3"],
    room: Float[np.ndarray, "2 3"] | None = None,
) -> tuple[Figure, Axes]:
    """The floor with the cameras, wide enough for all places.

    Args:
        places: that will be drawn, m.
        cameras: names.
        centers: of the cameras, m.
        room: lowest and highest corner of the room, m, drawn where it is known.
    """
    low, high = _bounds(places, centers, room)
    span = high - low
    width = PAGE * 0.78
    figure = Figure(figsize=(PAGE, float(np.clip(width * span[1] / span[0] + 0.5, 3.0, 9.0))), layout="constrained")
    ax = figure.add_subplot()
    if room is not None:
        size = room[1] - room[0]
        ax.add_patch(Rectangle((room[0, 0], room[0, 1]), size[0], size[1], fill=False, ec=INK, lw=1.4))
    for name, center in zip(cameras, centers):
        ax.plot(*center[:2], marker="s", color=INK, ms=7)
        ax.annotate(name, center[:2], xytext=(0, 8), textcoords="offset points", ha="center", weight="bold", fontsize=8)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m", aspect="equal")
    return figure, ax


def space_view(
    places: Float[np.ndarray, "N 3"],
    cameras: Sequence[str],
    centers: Float[np.ndarray, "C 3"],
    room: Float[np.ndarray, "2 3"] | None = None,
) -> tuple[Figure, Axes3D, float]:
    """The same in 3-D, and the height of the floor, m."""
    low, high = _bounds(places, centers, room)
    low[2] = min(0.0, low[2])
    figure = Figure(figsize=(PAGE, 6.2))
    ax = cast(Axes3D, figure.add_axes((0.02, 0.04, 0.84, 0.94), projection="3d", computed_zorder=False))
    ax.scatter(*centers.T, marker="s", s=32, c=INK, depthshade=False)
    for name, (x, y, z) in zip(cameras, centers):
        ax.text(x, y, z + 0.12, name, color=INK, weight="bold", fontsize=8, ha="center")
        ax.plot([x, x], [y, y], [low[2], z], color=FAINT, lw=0.6)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    ax.set_box_aspect(tuple(high - low), zoom=0.95)  # pyright: ignore[reportArgumentType]
    ax.view_init(elev=26, azim=-60)
    quiet_axes(ax)
    return figure, ax, float(low[2])


def timed_dots(
    ax: Axes, places: Float[np.ndarray, "N 2"], seconds: Float[np.ndarray, " N"], times: Float[np.ndarray, " F"]
) -> None:
    """Dots coloured by their second, of a recording with these times."""
    first, last = clock(times)
    ax.scatter(*places.T, c=seconds, s=9, cmap=_TIME, vmin=first, vmax=last, lw=0, rasterized=True, zorder=3)


def timed_pieces(
    ax: Axes3D, pieces: Float[np.ndarray, "N 2 3"], seconds: Float[np.ndarray, " N"], times: Float[np.ndarray, " F"]
) -> None:
    """Pieces of lines coloured by their second."""
    drawn = Line3DCollection(list(pieces), cmap=_TIME, lw=2.6)
    drawn.set_array(seconds)
    drawn.set_clim(*clock(times))
    ax.add_collection3d(drawn)


def time_bar(figure: Figure, times: Float[np.ndarray, " F"], **place) -> None:
    """Which colour is which second."""
    bar = figure.colorbar(ScalarMappable(Normalize(*clock(times)), _TIME), label="time, s", **place)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]


def clock(times: Float[np.ndarray, " F"]) -> tuple[float, float]:
    """First and last moment; never the same."""
    if not len(times):
        return 0.0, 1.0
    return float(times[0]), float(max(times[-1], times[0] + 1e-3))


def _bounds(places: np.ndarray, centers: np.ndarray, room: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates to draw."""
    drawn = np.concatenate([places, centers, *([] if room is None else [room])])
    return drawn.min(axis=0) - _MARGIN_M, drawn.max(axis=0) + _MARGIN_M
