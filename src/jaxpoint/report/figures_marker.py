"""Figures of a marker in the room: where its tip was, from above and in 3-D, and how high over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from jaxpoint.report.figures_room import clock, plan_view, space_view, time_bar, timed_dots, timed_pieces
from jaxpoint.report.style import FAINT, PAGE, camera_colors

RAY_M = 0.3  # how far a line goes on from the tip, to where the marker points


@dataclass(frozen=True)
class TipTrack:
    """The marker over F frames; zeros where it was not found, or has no direction."""

    times: Float[np.ndarray, " F"]  # s
    found: Bool[np.ndarray, " F"]
    tips: Float[np.ndarray, "F 3"]  # m
    directions: Float[np.ndarray, "F 3"]  # unit, from base to tip
    spread: Float[np.ndarray, " F"]  # m, rms distance of the views' tips from the tip

    def pieces(self) -> tuple[Float[np.ndarray, "N 2 3"], Float[np.ndarray, " N"]]:
        """The way from each frame to the next where both have a tip, and the seconds between."""
        both = self.found[:-1] & self.found[1:]
        seconds = (self.times[:-1] + self.times[1:]) / 2
        return np.stack([self.tips[:-1], self.tips[1:]], axis=1)[both], seconds[both]

    def rays(self) -> Float[np.ndarray, "N 2 3"]:
        """From each tip on along the marker, where it has a direction."""
        ahead = self.found & self.directions.any(axis=1)
        return np.stack([self.tips, self.tips + RAY_M * self.directions], axis=1)[ahead]


def floor_plan(track: TipTrack, cameras: Sequence[str], centers: Float[np.ndarray, "C 3"]) -> Figure:
    """The tips from above, each with a line to where the marker points.

    Args:
        track: of the marker.
        cameras: names.
        centers: of the cameras, m.
    """
    figure, ax = plan_view(track.tips[track.found], cameras, centers)
    for start, end in track.rays()[:, :, :2]:
        ax.plot(*np.stack([start, end]).T, color=FAINT, lw=0.7, zorder=1)
    timed_dots(ax, track.tips[track.found, :2], track.times[track.found], track.times)
    time_bar(figure, track.times, ax=ax, shrink=0.6, pad=0.02, aspect=30)
    return figure


def in_space(track: TipTrack, cameras: Sequence[str], centers: Float[np.ndarray, "C 3"]) -> Figure:
    """The way of the tip in 3-D, broken where it was not found, with its shadow on the floor."""
    figure, ax, floor = space_view(track.tips[track.found], cameras, centers)
    shadow = np.where(np.arange(3) == 2, floor, track.tips[track.found])
    ax.scatter(*shadow.T, s=3, c=FAINT, depthshade=False)
    for start, end in track.rays():
        ax.plot(*np.stack([start, end]).T, color=FAINT, lw=0.6)
    pieces, seconds = track.pieces()
    timed_pieces(ax, pieces, seconds, track.times)
    time_bar(figure, track.times, cax=figure.add_axes((0.93, 0.25, 0.012, 0.5)))
    return figure


def over_time(track: TipTrack) -> Figure:
    """How high the tip is, and how far the views are apart there."""
    figure = Figure(figsize=(PAGE, 4.2), layout="constrained")
    high, apart = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    (color,) = camera_colors(1)
    seconds = track.times[track.found]
    high.plot(seconds, track.tips[track.found, 2], ".", color=color, ms=4)
    high.set(ylabel="height of the tip, m", xlim=clock(track.times))
    apart.plot(seconds, 100 * track.spread[track.found], ".", color=color, ms=4)
    apart.set(xlabel="time, s", ylabel="views apart, cm")
    apart.set_ylim(bottom=0.0)
    return figure
