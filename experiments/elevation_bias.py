"""How far do people's lines of pointing miss what they mean, and how much of that can be taken back?

Two studies of real people: `pointing_torsalve` (7 people, 945 gestures at 27 targets in a grid, a marker on each part
of the arm) and `pointing_schuetz` (12 people, 1,296 gestures at 9 targets on a wall, eye over fingertip). Every figure
of a model is on people who were not fitted ("person"), or on people and targets that were not ("person, target").
Which lines a blend reads is decided inside the training people; no model knows where the room's axes lie or which
target is meant. "Constant, plain means" is what the data's own notes give; all other models are fitted by Levenberg-
Marquardt with a Cauchy loss of 1.5 degrees, which takes gestures at a wrong target for what they are.

A personal offset is learnt from three gestures of a person at three targets (with the wall: under the same feedback),
drawn 200 times; these gestures are never scored. Probabilities are those of a directional Student's t about the
corrected line, whose spread is learnt from the training people, each left out in turn.

Intervals are 95 % over people drawn anew, 10-90 % over triples for personal offsets.

    python experiments/elevation_bias.py DATA --out elevation_bias

DATA holds both studies. Also writes `forearm_bias.toml`, fitted on all people, which is `configs/forearm_bias.toml`.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path

import jax
import numpy as np
import tyro
from markupsafe import Markup

from elevation_grid import Grid
from elevation_study import ElevationBias, Row
from elevation_wall import Wall
from jaxpoint.io.bias_files import write_bias
from jaxpoint.io.table import write_table
from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import style, to_svg
from jaxpoint.report.tables import Table, origin_table
from jaxpoint.runs import MARK, new_run, provenance, write_json


def main(settings: ElevationBias) -> list[Row]:
    """Measure, and write everything."""
    with jax.enable_x64(True):
        grid, wall = Grid(settings), Wall(settings)
        rows = [*grid.rows(), *wall.rows()]
        with new_run(settings.out, settings.force) as folder:
            command = shlex.join(["python", "experiments/elevation_bias.py", *sys.argv[1:]])
            studies = [settings.data / "pointing_torsalve", settings.data / "pointing_schuetz"]
            made = provenance(command, studies, settings.seed) | {"commit": commit()}
            write_json(folder / MARK, made)
            write_rows(folder, rows, settings)
            write_bias(folder / "forearm_bias.toml", grid.forearm_bias())
            with style():
                figures = [(Markup(to_svg(figure)), caption) for figure, caption in (*grid.figures(), *wall.figures())]
            write_page(folder / "report.html", page(rows, figures, made))
    return rows


def write_rows(folder: Path, rows: list[Row], settings: ElevationBias) -> None:
    """`table.csv`, whose rows say what they were made with, and `table.md`."""
    columns: dict[str, list] = {field.name: [getattr(row, field.name) for row in rows] for field in fields(Row)}
    same = {"loss_deg": settings.loss_deg, "triples": settings.triples, "seed": settings.seed, "commit": commit()}
    write_table(folder / "table.csv", columns | {name: [value] * len(rows) for name, value in same.items()})
    shown = text_table(rows)
    lines = [shown.header, ["---"] * len(shown.header), *shown.rows]
    (folder / "table.md").write_text("".join(f"| {' | '.join(line)} |\n" for line in lines), encoding="utf-8")


def text_table(rows: list[Row]) -> Table:
    """Rows as they are read."""
    header = ["study", "line", "model", "left out", "figure", "found", "interval", "noted or wanted"]
    cells = []
    for row in rows:
        digits = 3 if "calibration" in row.figure or ", m" in row.figure else 1 if row.figure.endswith("%") else 2
        sign = "+" if row.figure.startswith("mean") else ""
        interval = "" if np.isnan(row.low) else f"{row.low:.{digits}f} to {row.high:.{digits}f}"
        found = f"{row.value:{sign}.{digits}f}"
        cells.append([row.study, row.line, row.model, row.left_out, row.figure, found, interval, row.wanted])
    return Table(header, cells)


def page(rows: list[Row], figures: list[tuple[Markup, str]], made: dict) -> str:
    """The page of plots and the table."""
    found = {(row.line, row.model, row.left_out, row.figure): row.value for row in rows}
    median, out = "median error, deg", "person, target"
    sentence = (
        f"The forearm's line misses by {found['forearm', 'none', '', median]:.1f} degrees in the median, most of it "
        f"too high and to the left: an error of people and of where the marker sits. Corrected by what other people "
        f"do at other targets {found['forearm', 'polynomial', out, median]:.1f} degrees are left; with the lines of "
        f"head, shoulder, upper arm and hand as well {found['all', 'blend', out, median]:.1f}, and with three known "
        f"targets of the person {found['all', 'blend, 3 personal targets', out, median]:.1f}."
    )
    return render(
        "study.html.j2",
        kind="experiment",
        title="How far people point beside what they mean",
        subtitle="Two studies of real people; every correction on people who were not fitted",
        sections=[("found", "What was found"), ("pictures", "In pictures"), ("figures", "All figures"),
                  ("provenance", "Provenance")],
        found=sentence,
        figures=figures,
        rows=text_table(rows),
        provenance=origin_table(made, {}, None),
    )  # fmt: skip


def commit() -> str:
    """The commit that the figures were made with, marked where files differ from it."""
    git: Callable[..., str] = lambda *words: subprocess.run(  # noqa: E731
        ["git", *words], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    ).stdout.strip()
    return (git("rev-parse", "--short", "HEAD") or "unknown") + ("+" if git("status", "--porcelain", "-uno") else "")


if __name__ == "__main__":
    settings = tyro.cli(ElevationBias, description=__doc__)
    for row in main(settings):
        print(asdict(row))
    print(f"Table and page: {settings.out}")
