"""How does the time of one iteration grow with points, and with cameras?

Two sweeps over rooms (`rooms.py`), 80 % of all pairs observed, 15 parameters a camera: more and more points before the
same cameras, and more and more cameras that observe as much each (the same points). The engine takes a fixed number of
steps from the start, its stopping rule off, and the fastest of several runs counts. The table has the exponent between
neighbours, the caption that of a straight line through the logarithms of all. The second sweep is also split by a
non-negative fit of a C + b C^2: what the observations cost, of which every camera has as many, and what the pairs of
cameras cost, for which every point leaves a part in the reduced matrix.

    python experiments/benchmarks/growth.py --out growth
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import jax
import numpy as np
import tyro
from engine import solve, task_of
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from rooms import Size, room_problem
from scipy.optimize import nnls

from jaxpoint.io.files import replacing

SHARE = 0.8
PARAMETERS = 15
STEPS = 4


@dataclass(frozen=True)
class Growth:
    """Time one iteration over sizes."""

    points: tuple[int, ...] = (1_000, 2_000, 4_000, 8_000, 16_000, 32_000)
    """The first sweep, before --fixed-cameras."""
    fixed_cameras: int = 8
    """Cameras of the first sweep."""
    cameras: tuple[int, ...] = (4, 8, 16, 32, 64)
    """The second sweep, with --observations of each camera."""
    observations: int = 4_000
    """Observations a camera in the second sweep."""
    repeats: int = 5
    """Timed runs of each size, after one that compiles."""
    seed: int = 0
    """Of the rooms."""
    out: Path = Path("growth")
    """OUT.md and OUT.png."""


@dataclass(frozen=True)
class Row:
    """One size; `exponent` is of the time, from the row before."""

    sweep: str
    cameras: int
    points: int
    observations: int
    step_ms: float
    exponent: float | None


def main(options: Growth) -> None:
    """Run both sweeps, and write the table and the figure."""
    by_points = list(sweep(options, "points", [Size(options.fixed_cameras, count, SHARE) for count in options.points]))
    same = round(options.observations / SHARE)
    by_cameras = list(sweep(options, "cameras", [Size(count, same, SHARE) for count in options.cameras]))
    text = markdown(by_points, by_cameras)
    with replacing(options.out.with_suffix(".md")) as file:
        file.write(text.encode())
    with replacing(options.out.with_suffix(".png")) as file:
        figure(by_points, by_cameras).savefig(file, format="png", dpi=120)
    sys.stdout.write("\n" + text)


def sweep(options: Growth, grown: str, sizes: list[Size]) -> Iterator[Row]:
    """Rows of one sweep, printed as they are finished."""
    before: Row | None = None
    for size in sizes:
        step_ms, observations = timed(size, options)
        row = Row(grown, size.cameras, size.points, observations, step_ms, None)
        if before is not None:
            slope = np.log(row.step_ms / before.step_ms) / np.log(getattr(row, grown) / getattr(before, grown))
            row = Row(grown, size.cameras, size.points, observations, step_ms, float(slope))
        sys.stdout.write(line(cells(row)))
        sys.stdout.flush()
        yield row
        before = row


def timed(size: Size, options: Growth) -> tuple[float, int]:
    """Milliseconds of a step, and the observations of the problem."""
    problem = room_problem(size, PARAMETERS, options.seed)
    task = task_of(problem, rtol=0.0, steps=STEPS)
    solve(task)
    step_ms = [1e3 * seconds / int(end.steps) for end, seconds in (solve(task) for _ in range(options.repeats))]
    return min(step_ms), problem.observations


def exponent(rows: list[Row], grown: str) -> float:
    """Slope of a straight line through the logarithms of all rows."""
    return float(np.polyfit(np.log([getattr(row, grown) for row in rows]), np.log([row.step_ms for row in rows]), 1)[0])


def split(rows: list[Row]) -> np.ndarray:
    """The parts of the time of every row (rows, 2) that grow like C and like C^2."""
    cameras, step_ms = np.array([row.cameras for row in rows], float), np.array([row.step_ms for row in rows])
    powers = cameras[:, None] ** [1, 2]
    weights, _ = nnls(powers / step_ms[:, None], np.ones(len(rows)))
    return powers * weights


def markdown(by_points: list[Row], by_cameras: list[Row]) -> str:
    """The table, the two exponents, and the split."""
    names = [column.name for column in fields(Row)]
    table = "".join(line(row) for row in [names, ["---"] * len(names), *map(cells, by_points + by_cameras)])
    last = split(by_cameras)[-1]
    return (
        f"{table}\nTime of a step grows like points^{exponent(by_points, 'points'):.2f} before the same cameras, and "
        f"like cameras^{exponent(by_cameras, 'cameras'):.2f} at the same observations a camera. Of the time at "
        f"{by_cameras[-1].cameras} cameras {last[1] / last.sum():.0%} grows like C^2 (fit). "
        f"{PARAMETERS} parameters a camera, {jax.devices()[0].device_kind}.\n"
    )


def figure(by_points: list[Row], by_cameras: list[Row]) -> Figure:
    """Both sweeps on logarithmic axes."""
    drawn = Figure(figsize=(10, 4), layout="constrained")
    left, right = drawn.subplots(1, 2)
    for label, part in zip(("like C", "like C^2"), split(by_cameras).T):
        if part.any():
            right.plot([row.cameras for row in by_cameras], part, "--", label=label)
    for axes, rows, grown in ((left, by_points, "points"), (right, by_cameras, "cameras")):
        sizes = [getattr(row, grown) for row in rows]
        axes.plot(sizes, [row.step_ms for row in rows], "o-", label="measured")
        axes.set(xscale="log", yscale="log", xlabel=grown, ylabel="ms a step")
        axes.set_title(f"{grown} to the power {exponent(rows, grown):.2f}")
        axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.legend()
    return drawn


def cells(row: Row) -> list[str]:
    """The row as text."""
    slope = "" if row.exponent is None else f"{row.exponent:.2f}"
    return [row.sweep, str(row.cameras), str(row.points), str(row.observations), f"{row.step_ms:.2f}", slope]


def line(texts: list[str]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(texts)} |\n"


if __name__ == "__main__":
    with jax.enable_x64(True):
        main(tyro.cli(Growth, description=__doc__))
