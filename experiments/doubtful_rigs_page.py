"""The page of `doubtful_rigs.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from scipy.stats import binomtest

from doubtful_rigs_scores import (
    OUTCOMES,
    REST,
    SHOWN,
    Record,
    Result,
    Tally,
    excesses,
    inside,
    outcome,
    share,
    squares,
    tallies,
)
from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import FAINT, INK, PAGE, camera_colors, style, to_svg
from jaxpoint.report.tables import Table, origin_table

CURVE = (*np.linspace(0.02, 0.98, 49).tolist(), 0.99)
NAMES = {"focal": "focal lengths", "centre": "centres", "rotation": "rotations"}
CELLS = jinja2.Template(
    """<div class="wide"><table class="origin">
<thead><tr>{% for cell in header %}<th>{{ cell }}</th>{% endfor %}</tr></thead><tbody>
{% for row in rows %}<tr>{% for cell in row %}<{{ "th" if loop.first else "td" }}>{{ cell }}</{{ "th" if loop.first
else "td" }}>{% endfor %}</tr>
{% endfor %}</tbody></table></div>""",
    autoescape=True,
)


def write_study(path: Path, records: list[Record], figures: dict[str, Any], made: dict[str, Any]) -> None:
    """Write the page: what was found, the reliability curve, counts by kind, and every wrong rig called good."""
    with style():
        drawn = [
            (Markup(to_svg(reliability(records))), _curve_caption(figures)),
            (Markup(to_svg(errors_by_sigma(records))), _scatter_caption()),
            (as_html(wrong_table(records)), "Every wrong rig called good, with what is beyond 4 sigma and beyond twice "
             "the control's error, the worst first."),
            (as_html(refusal_table(records)), "Refusals that name another cause than the true one."),
        ]  # fmt: skip
    page = render(
        "study.html.j2",
        kind="experiment",
        title="Is a wrong calibration ever called good?",
        subtitle=f"{len(records)} difficult rigs with known truth",
        sections=[("found", "What was found"), ("pictures", "Reliability"), ("figures", "By kind"),
                  ("provenance", "Provenance")],
        found=sentence(figures),
        figures=drawn,
        rows=kind_table(records),
        provenance=origin_table(made, {}, None),
    )  # fmt: skip
    write_page(path, page)


def sentence(figures: dict[str, Any]) -> str:
    """The figures that are wanted, beside what is wanted."""
    at_95 = figures["inside_95"]
    total = figures["by_kind"].get("all", vars(Tally()))
    return (
        f"Of {figures['rigs']} rigs {figures['wrong_called_good']} wrong ones were called good (wanted: 0). "
        f"Of the {total['determined']} rigs that their data determine {percent(figures['determined_right'])} came out "
        f"right and were called good (wanted: 95 %). {percent(figures['refusals_with_the_true_cause'])} of the "
        f"refusals name the true cause (wanted: 95 %). Regions of 95 % of the rigs called good hold "
        f"{percent(at_95['focal'])} of the focal lengths and {percent(at_95['centre'])} of the centres (wanted: 92 to "
        f"98 %), and {percent(at_95['rotation'])} of the rotations. {total['crashed']} ended in an error that is none "
        f"of jaxpoint's own, and {total['undetermined_good']} were called good though their data do not determine them."
    )


def percent(value: float | None) -> str:
    """A share for people."""
    return "none" if value is None else f"{100 * value:.1f} %"


def reliability(records: list[Record]) -> Figure:
    """Predicted probability against the share inside, and the same magnified from 80 % on."""
    figure = Figure(figsize=(PAGE, 4.6), layout="constrained")
    for axes, low in zip(figure.subplots(1, 2), (0.0, 0.8)):
        axes.set(xlim=(low, 1.0), ylim=(low, 1.005), aspect="equal", xlabel="predicted probability of the region",
                 ylabel="share of cameras inside")  # fmt: skip
        axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1, label="as predicted")
        axes.fill_between([0.945, 0.955], 0.92, 0.98, color=FAINT, alpha=0.5, linewidth=0, label="wanted at 95 %")
        for (quantity, name), colour in zip(NAMES.items(), camera_colors(3)):
            _draw_curve(axes, [record.result for record in records], quantity, name, colour)
        axes.legend(loc="upper left")
    return figure


def _draw_curve(axes, results: list[Result], quantity: str, name: str, colour: str) -> None:
    count = len(squares(results, quantity))
    if not count:
        return
    axes.plot(CURVE, inside(results, quantity, CURVE), color=colour, label=f"{name}, {count}")
    at = inside(results, quantity, (0.95,))[0]
    interval = binomtest(round(at * count), count).proportion_ci(0.95, "wilson")
    axes.errorbar([0.95], [at], [[max(at - interval.low, 0)], [max(interval.high - at, 0)]], color=colour, capsize=3,
                  fmt="o", markersize=4)  # fmt: skip


def _curve_caption(figures: dict[str, Any]) -> str:
    parts = [f"{name} {percent(figures['inside_95'][key])}" for key, name in NAMES.items()]
    plain = [f"{name} {percent(figures['inside_95_of_controls'][key])}" for key, name in NAMES.items()]
    return (
        "Cameras of the rigs called good: how many of the regions that the calibration predicts hold the truth. At "
        f"95 %: {', '.join(parts)}; bars are Wilson intervals of 95 %, as if cameras of one rig were independent. "
        f"Right: the same, magnified. Controls with unknown lenses, for comparison: {', '.join(plain)}."
    )


def errors_by_sigma(records: list[Record]) -> Figure:
    """True against predicted errors of focal lengths and centres, good and refused."""
    figure = Figure(figsize=(PAGE, 4.4), layout="constrained")
    for axes, quantity in zip(figure.subplots(1, 2), ("focal", "centre")):
        axes.set(xscale="log", yscale="log", xlabel="predicted standard deviation, %", ylabel="true error, %")
        axes.set_title({"focal": "Focal lengths", "centre": "Centres, of the rig's extent"}[quantity])
        for colour, name, passed in (("#d6455d", "refused", False), ("#2f7fd1", "called good", True)):
            pairs = _pairs(records, quantity, passed)
            if len(pairs):
                axes.plot(*(100 * pairs.T), ".", color=colour, markersize=4, alpha=0.6, label=f"{name}, {len(pairs)}")
        ends = np.array(axes.get_xlim())
        axes.plot(ends, ends, color=FAINT, linewidth=1)
        axes.plot(ends, 4 * ends, color=INK, linewidth=1, label="4 sigma")
        axes.set_xlim(*ends)
        axes.legend(loc="upper left")
    return figure


def _pairs(records: list[Record], quantity: str, passed: bool) -> np.ndarray:
    """Predicted and true errors (n, 2)."""
    cameras = [camera for record in records if record.result.passed == passed for camera in record.result.cameras]
    if quantity == "focal":
        pairs = [(camera.focal_sigma[1], abs(camera.focal[1])) for camera in cameras]
    else:
        pairs = [(camera.centre_sigma, camera.centre) for camera in cameras]
    return np.array([np.clip(pair, 1e-5, 1e2) for pair in pairs if pair[0] > 0]).reshape(-1, 2)


def _scatter_caption() -> str:
    return (
        "Every delivered camera: its true error over the standard deviation that the calibration predicts. What is "
        "called good must lie below 4 sigma unless the control is as far off."
    )


def kind_table(records: list[Record]) -> Table:
    """Counts by layout and by fault; a rig of two faults counts under both."""
    header = ["kind", "rigs", *OUTCOMES, REST, "crashed", "determined", "of these right", "of these refused",
              "undetermined, called good"]  # fmt: skip
    rows = [
        [name, str(tally.rigs), *(str(tally.outcomes[what]) for what in (*OUTCOMES, REST)), str(tally.crashed),
         str(tally.determined), percent(share(tally.determined_right, tally.determined)),
         str(tally.determined_refused), str(tally.undetermined_good)]
        for name, tally in tallies(records).items() if tally.rigs
    ]  # fmt: skip
    return Table(header, rows)


def wrong_table(records: list[Record]) -> Table:
    """Wrong rigs called good."""
    wrong = [record for record in records if outcome(record) == OUTCOMES[1]]
    rows = [[*_rig_cells(record), "; ".join(map(str, excesses(record)[:SHOWN]))] for record in wrong]
    return Table(["seed", "layout", "faults", "determined", "beyond what is allowed"], rows)


def refusal_table(records: list[Record]) -> Table:
    """Refusals with another cause."""
    chosen = [record for record in records if outcome(record) == OUTCOMES[3]]
    rows = [[*_rig_cells(record), f"{record.result.error}: {record.result.message}"] for record in chosen]
    return Table(["seed", "layout", "faults", "determined", "what was said"], rows)


def _rig_cells(record: Record) -> list[str]:
    turn = "" if record.turn_deg is None else f" {record.turn_deg:.2g} deg"
    faults = "; ".join(map(str, record.faults)) or "none"
    return [str(record.seed), record.kind + turn, faults, "yes" if record.determined.enough else "no"]


def as_html(table: Table) -> Markup:
    """A table as a figure of the page."""
    return Markup(CELLS.render(header=table.header, rows=table.rows or [["none"]]))
