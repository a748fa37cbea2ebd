"""The pictures of `pointing_ablation.py`."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from jaxpoint.report.style import FAINT, INK, PAGE, camera_colors
from pointing_conditions import TEN, THESIS, Crowds, Row
from pointing_monte_carlo import FINGER_RADIUS_M, Condition, Noise, point


def drawn(crowds: Crowds, rows: list[Row]) -> list[tuple[Figure, str]]:
    """Figures 53 and 54 of the thesis in kind, and the sweeps."""
    return [
        (draw_lines(crowds), "The thesis's figure 53 in kind: errors of finger and forearm, two views, drawn as the "
         f"thesis has them. Left pointings of one person who points approximately, {TEN} at most; right all people: "
         "the middle, half and 95 % of the pointings, and the thesis's mean and standard deviation as a black bar."),
        (draw_views(crowds), "The thesis's figure 54 in kind: azimuth errors of the forearm from two and from three "
         "images; the same pointings. People with a perfect forearm show what the images alone do."),
        (draw_sweeps(rows), "Median great-circle error, with intervals over people. Above, people with a perfect "
         "forearm: only the measurement errs. Below, people who point approximately: they err themselves."),
    ]  # fmt: skip


SHOWN = {
    "finger": (Condition("finger", "endpoints", 2), 0.0),
    "forearm": (Condition("thesis", "endpoints", 2), FINGER_RADIUS_M),
    "forearm, 3": (Condition("thesis", "endpoints", 3), FINGER_RADIUS_M),
}


def absolute(crowds: Crowds, people: str, name: str, angle: str) -> tuple[np.ndarray, np.ndarray]:
    """Absolute errors (degrees) of all pointings, and of ten of one person, or fewer, each at a target of its own."""
    condition, outline = SHOWN[name]
    rooms = crowds.of(people)
    sample = point(rooms, replace(condition, noise=Noise.of(outline=outline)), 16, seed=crowds.options.seed)
    errors = np.abs(np.rad2deg(getattr(sample.scored, angle)))
    who = np.concatenate([own.person for own in rooms])
    person = np.argmax(np.bincount(who))
    return errors, np.array([errors[sample.gesture == k][0] for k in np.flatnonzero(who == person)[:TEN]])


def draw_lines(crowds: Crowds) -> Figure:
    figure = Figure(figsize=(PAGE, 3.0), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(2, 1, 2, 1))
    thesis = {"finger": THESIS["finger, 2 views"], "forearm": THESIS["forearm, 2 views"]}
    for k, angle in enumerate(("azimuth", "elevation")):
        found = {name: absolute(crowds, "approximate", name, angle) for name in thesis}
        told = {name: (values[k], values[k + 2]) for name, values in thesis.items()}
        _draw_pair(axes[2 * k], axes[2 * k + 1], found, told)
        axes[2 * k].set_title(f"{angle.capitalize()} error, {len(found['finger'][1])} pointings")
    return figure


def draw_views(crowds: Crowds) -> Figure:
    figure = Figure(figsize=(PAGE, 3.0), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(2, 1, 2, 1))
    thesis = {"forearm": THESIS["forearm, 2 views"], "forearm, 3": THESIS["forearm, 3 views"]}
    for k, people in enumerate(("approximate", "perfect forearm")):
        found = {name: absolute(crowds, people, name, "azimuth") for name in thesis}
        _draw_pair(axes[2 * k], axes[2 * k + 1], found, {name: (v[0], v[2]) for name, v in thesis.items()})
        axes[2 * k].set_title(f"Azimuth error, {people}")
    return figure


LABELS = {"finger": "finger", "forearm": "forearm", "forearm, 3": "3 views"}


def _draw_pair(left: Axes, right: Axes, found: dict, told: dict[str, tuple[float, float]]) -> None:
    """Some pointings as lines, all as boxes, the thesis as bars."""
    names = list(found)
    labels = [LABELS[name] if name != "forearm" or "finger" in found else "2 views" for name in names]
    for k, (name, colour) in enumerate(zip(names, camera_colors(2))):
        errors, ten = found[name]
        left.plot(np.arange(1, len(ten) + 1), ten, "o-", color=colour, markersize=4, linewidth=1.2, label=labels[k])
        low, quarter, middle, three, high = np.quantile(errors, [0.025, 0.25, 0.5, 0.75, 0.975])
        right.plot([k, k], [low, high], color=colour, linewidth=1.2)
        right.plot([k, k], [quarter, three], color=colour, linewidth=9, alpha=0.55, solid_capstyle="butt")
        right.plot(k, middle, "o", color=colour, markersize=5)
        mean, sd = told[name]
        right.errorbar(k + 0.3, mean, sd, fmt="_", color=INK, capsize=3, linewidth=1.2)
    top = 1.25 * max(ten.max() for _, ten in found.values())
    most = max(len(ten) for _, ten in found.values())
    left.set(xlabel="pointing", ylabel="absolute error, degrees", xticks=range(1, most + 1), ylim=(0, top))
    left.legend(loc="upper left", ncols=2)
    right.set(xlim=(-0.5, 1.7), ylim=(0, None), title="All; thesis")
    right.set_xticks([0, 1], labels)


SWEEPS = (
    ("pixel noise", True), ("calibration noise", False), ("length", True), ("sliding ends", False),
    ("bias", False), ("scatter", False), ("distance", False), ("lines", False),
)  # fmt: skip


def draw_sweeps(rows: list[Row]) -> Figure:
    figure = Figure(figsize=(PAGE, 5.6), layout="constrained")
    for axes, (section, logarithmic) in zip(figure.subplots(2, 4).ravel(), SWEEPS):
        own = [row for row in rows if row.section == section]
        if section == "distance":
            own = [row for row in own if row.people == "approximate" and row.correction in ("none", "constant")]
        if section == "lines":
            _draw_bars(axes, rows)
            continue
        if not own:
            axes.set(title=section.capitalize(), xticks=[], yticks=[])
            axes.text(0.5, 0.5, "too few pointings", ha="center", transform=axes.transAxes)
            continue
        series: dict[str, list[Row]] = defaultdict(list)
        for row in own:
            series[_label(row, section)].append(row)
        for (name, some), colour in zip(series.items(), camera_colors(max(len(series), 4))):
            x, y = [row.value for row in some], np.array([row.angle_median for row in some])
            axes.plot(x, y, "o-", color=colour, markersize=3.5, linewidth=1.2, label=name)
            axes.fill_between(x, [row.angle_low for row in some], [row.angle_high for row in some], color=colour,
                              alpha=0.18, linewidth=0)  # fmt: skip
        if logarithmic:
            axes.set(xscale="log", yscale="log")
            axes.set_xticks(sorted({row.value for row in own}), [f"{v:g}" for v in sorted({row.value for row in own})])
            axes.xaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_formatter("{x:g}")
        else:
            axes.set_ylim(0, (1.9 if len(series) > 2 else 1.35) * max(row.angle_high for row in own))
        axes.tick_params(labelsize=7.5)
        axes.set(title=section.capitalize(), xlabel=own[0].varied)
        axes.legend(fontsize=7)
    for axes in figure.axes[::4]:
        axes.set_ylabel("median error, degrees")
    return figure


def _label(row: Row, section: str) -> str:
    if section in ("bias", "scatter", "distance"):
        return "as it is" if row.correction == "none" else "corrected"
    name = "ends" if row.method == "endpoints" else "planes"
    return f"finger {name}, {row.views}" if row.line == "finger" else f"{name}, {row.views} views"


def _draw_bars(axes: Axes, rows: list[Row]) -> None:
    """Each line of people who point approximately or accurately, corrected."""
    lines = ("forearm", "finger", "eye-fingertip", "head-hand", "shoulder-hand")
    for k, (people, colour) in enumerate(zip(("approximate", "accurate"), camera_colors(2))):
        for place, line in enumerate(lines):
            for row in rows:
                if row.section in ("table 2", "lines") and row.people == people and row.line == line:
                    if row.views != "all" or row.correction != "constant":
                        continue
                    middle = row.angle_median
                    around = np.maximum([[middle - row.angle_low], [row.angle_high - middle]], 0)
                    axes.barh(place + 0.4 * k - 0.2, middle, 0.36, color=colour, alpha=0.8, xerr=around,
                              error_kw={"ecolor": FAINT}, label=people if place == 0 else None)  # fmt: skip
    axes.set_yticks(range(len(lines)), lines)
    axes.invert_yaxis()
    axes.set(title="Lines, constant off", xlabel="median error, degrees", xlim=(0, 2.1 * axes.get_xlim()[1]))
    axes.legend(fontsize=7, loc="center right")
