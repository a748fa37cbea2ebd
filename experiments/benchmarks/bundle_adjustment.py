"""How fast is the adjustment engine beside Ceres and scipy, at the same cost?

Rooms of four sizes (`rooms.py`), with 11 and 15 parameters a camera, and BAL's ladybug: plain least squares from the
same start, no priors, the gauge free. The costs of all solvers are computed first and compared; then the engine and
Ceres run in turn, A B A B, and the ratio of their times is that of neighbours. Ceres runs in the faster of DENSE_SCHUR
and SPARSE_SCHUR, which is decided by a run or two of each. A row is printed as soon as it is there; the table is
written as Markdown and, with every figure, as CSV. See the README for what exactly is timed.

    python experiments/benchmarks/bundle_adjustment.py --sizes S M L BAL --data DATA --out table.md
    python experiments/benchmarks/bundle_adjustment.py --quick

The second is the watch for regressions: small sizes, ratios only, against baseline.json; it ends with 1 if one of them
became much worse.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import statistics
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import ceres_peer
import scipy_peer
import tyro
from bal import read_bal
from ceres_peer import METHODS, CeresRun, Method
from problem import BundleProblem, write_problem
from rooms import SIZES, SizeName, room_problem
from worker import Worker, first_call

from jaxpoint.errors import JaxpointError, UsageError
from jaxpoint.io.files import replacing

CaseName = Literal["S", "M", "L", "XL", "BAL"]
BAL_FILE = Path("bal_ladybug49", "problem-49-7776-pre.txt")
BASELINE = Path(__file__).with_name("baseline.json")
SAME_COST = 1e-6  # relative; beyond it the times of two solvers say nothing
SAME_START = 1e-9  # relative; beyond it they were given different problems
SHORT_S = 10.0
QUICK_REPEATS = 15  # small problems are soon run, and the noise is theirs
WORSE = 1.5  # times the baseline's ratio
BY_SCIPY: tuple[CaseName, ...] = ("S", "M")
BY_CACHE: tuple[CaseName, ...] = ("M",)  # where the first call with kept programs is measured


@dataclass(frozen=True)
class BundleAdjustment:
    """Time the engine beside its peers."""

    sizes: tuple[CaseName, ...] = ("S", "M", "L", "BAL")
    """Which problems; XL takes several GB and minutes."""
    parameters: tuple[Literal[11, 15], ...] = (11, 15)
    """Parameters a camera of the rooms S, M and L; XL has 11, BAL 9."""
    repeats: int = 5
    """Pairs of runs whose times are compared."""
    seed: int = 0
    """Of the rooms."""
    out: Path = Path("bundle_adjustment.md")
    """The table as Markdown; beside it goes the CSV."""
    data: Path | None = None
    """Folder of real recordings, for BAL; the environment variable JAXPOINT_DATA if not given."""
    rtol: float = 1e-8
    """The engine's tolerance; Ceres's function tolerance is 1e-8."""
    devices: int = 2
    """Devices of this machine over which the engine spreads the points; Ceres has as many threads."""
    ceres: bool = True
    """Run the peer Ceres."""
    scipy: bool = True
    """Run the peer scipy, on S and M."""
    quick: bool = False
    """Only compare the ratios of S and M with baseline.json."""
    write_baseline: bool = False
    """With --quick: write that file instead."""


@dataclass(frozen=True)
class Case:
    """One problem and the file that all solvers read."""

    name: CaseName
    problem: BundleProblem
    file: Path


@dataclass(frozen=True)
class Row:
    """One problem. Seconds are medians; what was not run is None."""

    case: CaseName
    parameters: int
    cameras: int
    points: int
    observations: int
    device: str
    engine_s: float
    engine_steps: int
    engine_cost: float  # half the sum of squares, px^2, by the benchmark's own projection
    settled: bool
    first_s: float  # the first call in a fresh process, compilation included
    process_s: float  # from the start of that process to its end
    memory_mb: float  # peak over import, compilation included
    warm_memory_mb: float  # peak over import of later solves
    device_memory_mb: float | None = None
    cached_first_s: float | None = None
    ceres_s: float | None = None
    ceres_method: str | None = None
    ceres_dense_s: float | None = None  # when the method was chosen
    ceres_sparse_s: float | None = None
    ceres_iterations: int | None = None
    ceres_cost: float | None = None
    ceres_memory_mb: float | None = None
    ratio: float | None = None  # engine to Ceres, median of neighbours
    ratio_low: float | None = None
    ratio_high: float | None = None
    difference: float | None = None  # of the engine's cost to Ceres's, relative
    scipy_s: float | None = None
    scipy_evaluations: int | None = None
    scipy_difference: float | None = None  # of scipy's cost to the engine's, relative

    @property
    def name(self) -> str:
        """What the baseline calls it."""
        return f"{self.case}/{self.parameters}"


def main(options: BundleAdjustment) -> None:
    """Run all problems, and write and print the table.

    Raises:
        JaxpointError: a peer is missing or failed, or --quick found a ratio worse.
    """
    if options.quick:
        return quick(options)
    rows = []
    for row in measured(options):
        rows.append(row)
        write(options.out, rows)
    sys.stdout.write("\n" + markdown(rows))


def quick(options: BundleAdjustment) -> None:
    """Compare small problems with the baseline, or write it.

    Raises:
        JaxpointError: a ratio is worse than the baseline allows, or the costs differ.
    """
    repeats = max(options.repeats, QUICK_REPEATS)
    small = replace(options, sizes=("S", "M"), repeats=repeats, ceres=True, scipy=False)
    rows = list(measured(small, cached=False))
    ratios = {row.name: row.ratio for row in rows if row.ratio is not None}
    unlike = [row.name for row in rows if not same_cost(row)]
    if unlike:
        raise JaxpointError(f"The engine's cost differs from Ceres's by more than {SAME_COST:g}: {', '.join(unlike)}.")
    if options.write_baseline:
        with replacing(BASELINE) as file:
            file.write(
                (json.dumps({name: round(ratio, 3) for name, ratio in ratios.items()}, indent=2) + "\n").encode()
            )
        return
    worse = worsened(ratios, json.loads(BASELINE.read_text()))
    if worse:
        raise JaxpointError(f"Slower beside Ceres than {WORSE:g} times the baseline: {'; '.join(worse)}.")
    sys.stdout.write(f"No ratio is worse than {WORSE:g} times the baseline.\n")


def worsened(ratios: dict[str, float], baseline: dict[str, float]) -> list[str]:
    """A phrase for every ratio that is much worse than it was."""
    return [
        f"{name} {ratio:.2f} (was {baseline[name]:.2f})"
        for name, ratio in ratios.items()
        if name in baseline and ratio > WORSE * baseline[name]
    ]


def measured(options: BundleAdjustment, cached: bool = True) -> Iterator[Row]:
    """Rows, printed as they are finished."""
    program = ceres_peer.build() if options.ceres else None
    if "BAL" in options.sizes:
        bal_problem(options.data)  # what is missing is better missed at once
    sys.stdout.write(line(HEADER) + line(["---"] * len(HEADER)))
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(options, Path(folder)):
            row = compared(case, options, program)
            if cached and case.name in BY_CACHE:
                row = replace(row, cached_first_s=cached_first_s(case, options, Path(folder, "programs")))
            sys.stdout.write(line(summary(row)))
            sys.stdout.flush()
            yield row


def cases(options: BundleAdjustment, folder: Path) -> Iterator[Case]:
    """The problems asked for, one at a time."""
    for name in options.sizes:
        for parameters in (9,) if name == "BAL" else (11,) if name == "XL" else options.parameters:
            made = bal_problem(options.data) if name == "BAL" else room(name, parameters, options.seed)
            file = folder / "problem.bin"
            write_problem(file, made)
            yield Case(name, made, file)


def room(name: SizeName, parameters: int, seed: int) -> BundleProblem:
    """A room of a named size."""
    return room_problem(SIZES[name], parameters, seed)


def bal_problem(data: Path | None) -> BundleProblem:
    """BAL's ladybug of 49 cameras.

    Raises:
        UsageError: nobody said where the recordings lie.
    """
    folder = data or os.environ.get("JAXPOINT_DATA")
    if not folder:
        raise UsageError("BAL is read from the folder of recordings: name it with --data or JAXPOINT_DATA.")
    return read_bal(Path(folder) / BAL_FILE)


def compared(case: Case, options: BundleAdjustment, program: Path | None) -> Row:
    """Every solver on one problem: costs first, then times in turn."""
    with Worker(case.file, rtol=options.rtol, devices=options.devices) as engine:
        if program is None:
            warm = [engine.solve() for _ in range(options.repeats)]
            row = engine_row(case, engine.first, warm)
        else:
            trials = tried(case, program)
            method = min(METHODS, key=lambda each: trials[each].solve_s)
            pairs = [(engine.solve(), ceres_peer.run(program, case.file, method)) for _ in range(options.repeats)]
            row = engine_row(case, engine.first, [warm for warm, _ in pairs])
            row = with_ceres(row, trials, method, pairs)
    return with_scipy(row, case) if options.scipy and case.name in BY_SCIPY else row


def tried(case: Case, program: Path) -> dict[Method, CeresRun]:
    """Ceres by both methods; where that is short, the faster of two runs each."""
    once: dict[Method, CeresRun] = {
        method: checked(case, ceres_peer.run(program, case.file, method)) for method in METHODS
    }
    if sum(run.solve_s for run in once.values()) > SHORT_S:
        return once
    again: dict[Method, CeresRun] = {method: ceres_peer.run(program, case.file, method) for method in METHODS}
    return {method: min(once[method], again[method], key=lambda run: run.solve_s) for method in METHODS}


def checked(case: Case, run: CeresRun) -> CeresRun:
    """Ceres's run, if it began where the others do.

    Raises:
        JaxpointError: its first cost is another.
    """
    start = case.problem.cost(case.problem.cameras, case.problem.points)
    if not math.isclose(run.initial_cost, start, rel_tol=SAME_START):
        raise JaxpointError(
            f"Ceres starts at a cost of {run.initial_cost:.9g} and not at {start:.9g}: not one problem."
        )
    return run


def engine_row(case: Case, first: dict[str, Any], warm: list[dict[str, Any]]) -> Row:
    """The engine's own figures."""
    problem = case.problem
    return Row(
        case.name,
        problem.parameters,
        len(problem.cameras),
        len(problem.points),
        problem.observations,
        first["device"],
        engine_s=statistics.median(solve["seconds"] for solve in warm),
        engine_steps=first["steps"],
        engine_cost=first["cost"],
        settled=first["settled"],
        first_s=first["first_s"],
        process_s=first["process_s"],
        memory_mb=first["peak_mb"] - first["imported_mb"],
        warm_memory_mb=max(solve["peak_mb"] for solve in warm) - first["imported_mb"],
        device_memory_mb=first["device_peak_mb"],
    )


def with_ceres(row: Row, trials: dict[Method, CeresRun], method: Method, pairs: list[tuple[dict, CeresRun]]) -> Row:
    """The row with Ceres's figures and the ratios."""
    ratios = [warm["seconds"] / run.solve_s for warm, run in pairs]
    chosen = trials[method]
    return replace(
        row,
        ceres_s=statistics.median(run.solve_s for _, run in pairs),
        ceres_method=method,
        ceres_dense_s=trials["dense"].solve_s,
        ceres_sparse_s=trials["sparse"].solve_s,
        ceres_iterations=chosen.iterations,
        ceres_cost=chosen.cost,
        ceres_memory_mb=chosen.peak_mb,
        ratio=statistics.median(ratios),
        ratio_low=min(ratios),
        ratio_high=max(ratios),
        difference=row.engine_cost / chosen.cost - 1.0,
    )


def with_scipy(row: Row, case: Case) -> Row:
    """The row with scipy's figures; it runs once."""
    ended = scipy_peer.run(case.problem)
    return replace(
        row,
        scipy_s=ended.seconds,
        scipy_evaluations=ended.evaluations,
        scipy_difference=ended.cost / row.engine_cost - 1.0,
    )


def cached_first_s(case: Case, options: BundleAdjustment, programs: Path) -> float:
    """Seconds of the first call in a fresh process that finds its programs compiled."""
    first_call(case.file, rtol=options.rtol, cache=programs, devices=options.devices)
    return first_call(case.file, rtol=options.rtol, cache=programs, devices=options.devices)["first_s"]


def same_cost(row: Row) -> bool:
    """Whether the engine ended as low as Ceres, or lower."""
    return row.difference is None or row.difference <= SAME_COST


HEADER = [
    "problem",
    "p",
    "observations",
    "engine s",
    "steps",
    "Ceres s",
    "iterations",
    "ratio (lowest, highest)",
    "cost to Ceres's",
    "engine MB over import (warm)",
    "Ceres MB",
    "first call s",
    "with cache s",
    "scipy s",
    "scipy cost to engine's",
]


def summary(row: Row) -> list[str]:
    """The row of the Markdown table."""
    ratio = "" if row.ratio is None else f"{row.ratio:.2f} ({row.ratio_low:.2f}, {row.ratio_high:.2f})"
    unlike = "" if same_cost(row) else " **differs**"
    steps = f"{row.engine_steps}" if row.settled else f"{row.engine_steps} (not settled)"
    return [
        row.case,
        str(row.parameters),
        str(row.observations),
        f"{row.engine_s:.3f}",
        steps,
        "" if row.ceres_s is None else f"{row.ceres_s:.3f} {row.ceres_method}",
        "" if row.ceres_iterations is None else str(row.ceres_iterations),
        ratio,
        "" if row.difference is None else f"{row.difference:+.1e}{unlike}",
        f"{row.memory_mb:.0f} ({row.warm_memory_mb:.0f})",
        _figure(row.ceres_memory_mb, ".0f"),
        f"{row.first_s:.1f}",
        _figure(row.cached_first_s, ".1f"),
        _figure(row.scipy_s, ".1f"),
        _figure(row.scipy_difference, "+.1e"),
    ]


def _figure(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def line(cells: list[str]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(cells)} |\n"


def markdown(rows: list[Row]) -> str:
    """The table, and what it ran on."""
    devices = ", ".join(sorted({row.device for row in rows}))
    table = "".join(line(cells) for cells in [HEADER, ["---"] * len(HEADER), *map(summary, rows)])
    return f"{table}\nEngine on {devices}, {os.cpu_count()} cores; Ceres with {ceres_peer.THREADS} threads.\n"


def write(out: Path, rows: list[Row]) -> None:
    """The table as Markdown, and every figure as CSV beside it; each replaced at once."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [column.name for column in fields(Row)])
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    for path, content in ((out, markdown(rows)), (out.with_suffix(".csv"), text.getvalue())):
        with replacing(path) as file:
            file.write(content.encode())


if __name__ == "__main__":
    try:
        main(tyro.cli(BundleAdjustment, description=__doc__))
    except JaxpointError as error:
        sys.stderr.write(f"bundle_adjustment: {error}\n")
        sys.exit(error.exit_code)
