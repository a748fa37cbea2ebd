"""Figures of the head track: the way on the floor plan and in space (the thesis's figure 38), and heights over time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxpoint.body.tracking.head_tracks import HeadTracks
from jaxpoint.report.figures_room import clock, plan_view, space_view, time_bar, timed_dots, timed_pieces
from jaxpoint.report.style import FAINT, PAGE, camera_colors


def floor_plan(
    heads: HeadTracks, centers: Float[np.ndarray, "C 3"], room: Float[np.ndarray, "2 3"] | None = None
) -> Figure:
    """The ways of all heads from above, with the cameras: a band in each person's colour, dots coloured by time.

    Args:
        heads: the tracks.
        centers: of the cameras, m.
        room: lowest and highest corner of the room, m, drawn where it is known.
    """
    figure, ax = plan_view(heads.positions[heads.present], heads.cameras, centers, room)
    for color, (name, place) in zip(camera_colors(len(heads.people)), _ways(heads)):
        line, seconds, measured = place
        ax.plot(*line[:, :2].T, color=color, lw=7, alpha=0.28, solid_capstyle="round")
        timed_dots(ax, line[measured, :2], seconds[measured], heads.times)
        ax.plot(*line[~measured, :2].T, "o", mfc="none", mec=FAINT, ms=4, mew=0.8)
        _label(ax, line[0, :2], name, color)
    time_bar(figure, heads.times, ax=ax, shrink=0.6, pad=0.02, aspect=30)
    return figure


def in_space(
    heads: HeadTracks, centers: Float[np.ndarray, "C 3"], room: Float[np.ndarray, "2 3"] | None = None
) -> Figure:
    """The ways of all heads in 3-D, coloured by time, with their shadows on the floor in each person's colour."""
    figure, ax, floor = space_view(heads.positions[heads.present], heads.cameras, centers, room)
    for color, (name, (line, seconds, _)) in zip(camera_colors(len(heads.people)), _ways(heads)):
        shadow = np.where(np.arange(3) == 2, floor, line)
        ax.plot(*shadow.T, color=color, lw=2.5, alpha=0.45)
        timed_pieces(ax, np.stack([line[:-1], line[1:]], axis=1), (seconds[:-1] + seconds[1:]) / 2, heads.times)
        x, y, z = line[0]
        ax.text(x, y, z + 0.08, name, color=color, weight="bold", fontsize=9, ha="center")
    time_bar(figure, heads.times, cax=figure.add_axes((0.93, 0.25, 0.012, 0.5)))
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
    ax.set(xlabel="time, s", ylabel="height of the head, m", xlim=clock(heads.times))
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
