"""What makes pointing miss: finger or forearm, two views or all, ends or planes, noise, or the people themselves?

Simulated people in furnished rooms of 65 objects point; no image is drawn. Their joints are projected into the cameras
that see them, pixels and calibration are disturbed, ends are triangulated (or the planes of a limb's axis meet), a line
is drawn, corrected by a bias that was fitted on other people, and brought to the objects: the batched Monte Carlo of
`pointing_monte_carlo.py`. Half of the people are fitted, the other half is scored, with and without correction.

Four kinds of people: `approximate` and `accurate` are the simulator's laws with their defaults (`configs/people.toml`
explains them); `perfect forearm` have a forearm that points exactly at the target, so that all that is left is
measured; `approximate, ...` differ in one number. Lines: `thesis` joins the fingertip on the upper outline with the
centroid of forearm and hand (7.2.2), ends as seen in each view; the other lines join joints.

Errors are estimated minus true in degrees, true being the line from fingertip to target. Intervals are 95 % over people
drawn anew. A standard deviation is that of the signed errors.

    python experiments/pointing_ablation.py --out pointing_ablation
    python experiments/pointing_ablation.py --speed

With `--evaluation FOLDER`, a folder that `person_evaluation.py` wrote, detection rates from pixels stand beside the
thesis's.
"""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections import defaultdict
from dataclasses import dataclass, fields
from math import comb
from pathlib import Path

import jax
import numpy as np
import tyro
from markupsafe import Markup
from rich.progress import track

from elevation_bias import commit
from jaxpoint.io.table import write_table
from jaxpoint.pointing.bias.models import Constant
from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import style, to_svg
from jaxpoint.report.tables import Table, origin_table
from jaxpoint.runs import MARK, new_run, provenance, write_json
from person_evaluation import USABLE
from pointing_conditions import THESIS, Crowds, Extent, Row, Ten, asked, score, tens
from pointing_monte_carlo import Condition, point
from pointing_pictures import drawn

METHODS = {
    "default": ("forearm, default method", 91.0),
    "thesis": ("forearm, thesis's method", 91.0),
    "thesis_finger": ("finger, thesis's method, people with a cap", 32.0),
}  # and the thesis's detection rates, %


SPEED_PART = 2048


@dataclass(frozen=True)
class PointingAblation(Extent):
    """Score simulated pointings under many conditions."""

    out: Path = Path("pointing_ablation")
    """Folder for table (CSV and Markdown) and page."""
    evaluation: Path | None = None
    """What `person_evaluation.py` wrote, for detection rates."""
    speed: bool = False
    """Only measure how many pointings a second are simulated."""
    force: bool = False
    """Replace an earlier run in `--out`."""


def main(options: PointingAblation) -> list[Row]:
    """Score all conditions, write everything: the table first, which costs most.

    Raises:
        SystemExit: too little is asked for to fit some people and score others.
    """
    check(options)
    crowds = Crowds(options)
    rows = [row for one in track(list(asked(crowds)), "conditions") for row in score(crowds, one)]
    constants = tens(crowds)
    rates = detection_rates(options.evaluation) if options.evaluation else {}
    with new_run(options.out, options.force) as folder:
        command = shlex.join(["python", "experiments/pointing_ablation.py", *sys.argv[1:]])
        made = provenance(command, [], options.seed) | {"commit": commit()}
        write_json(folder / MARK, made)
        write_rows(folder / "table.csv", rows, options)
        (folder / "table.md").write_text(markdown(rows, constants, rates, options), encoding="utf-8")
    with style():
        figures = [(Markup(to_svg(figure)), caption) for figure, caption in drawn(crowds, rows)]
    write_page(options.out / "report.html", page(rows, constants, rates, figures, made))
    return rows


def check(options: PointingAblation) -> None:
    """Refuse an extent in which there is nothing to score.

    Raises:
        SystemExit: a number below its least, or one person alone.
    """
    for name in ("rooms", "people", "gestures", "objects", "draws"):
        if getattr(options, name) < 1:
            raise SystemExit(f"--{name} is {getattr(options, name)}; it must be 1 at least.")
    if options.rooms * options.people < 2:
        raise SystemExit("1 person in all cannot be fitted and scored too; ask for more --people or --rooms.")


def measure_speed(options: PointingAblation) -> None:
    """Print pointings a second of single conditions, compiled: by the clock and by the processors' own time."""
    check(options)
    rooms = Crowds(options).of("approximate")
    wanted = {
        "forearm planes, 2 views": Condition("forearm", "planes", 2),
        "forearm ends, 2 views": Condition("forearm", "endpoints", 2),
        "finger ends, 2 views": Condition("finger", "endpoints", 2),
        "forearm planes, all views": Condition("forearm", "planes"),
    }
    model = Constant(np.deg2rad([5.0, 9.0]))
    for name, condition in wanted.items():
        fastest, least, count = np.inf, np.inf, 0
        for repeat in range(4):
            began, own = time.perf_counter(), time.process_time()
            draws = 16 if repeat == 0 else 2048
            count = len(point(rooms, condition, draws, seed=repeat, model=model, size=SPEED_PART).gesture)
            if repeat:
                fastest = min(fastest, time.perf_counter() - began)
                least = min(least, time.process_time() - own)
        sys.stdout.write(
            f"{name}: {count / fastest:,.0f} pointings a second, {count / least:,.0f} a processor second "
            f"({count:,} pointings, {options.objects} objects, float64)\n"
        )


@dataclass(frozen=True)
class Rate:
    """How often a region was found in two views, from pixels."""

    pairs: float  # %, of two cameras that both see the arm well, how often both are right: the thesis's two images
    pair_count: int
    gestures: float  # %, gestures with two or more right views in at least half of their frames
    gesture_count: int


def detection_rates(folder: Path) -> dict[str, Rate]:
    """By method: `default`, `thesis`, and `thesis_finger` of people with a coloured cap.

    Raises:
        SystemExit: the folder holds no scores.
    """
    files = sorted(folder.glob("seed_*.json"))
    if not files:
        raise SystemExit(f"{folder} holds 0 files seed_*.json; let person_evaluation.py write there first.")
    views = [view for file in files for view in json.loads(file.read_text())["views"]]
    return {name: _rate([view for view in views if view[name] != "no_cap"], name) for name in METHODS}


def _rate(views: list[dict], name: str) -> Rate:
    gestures: dict[tuple, dict[int, list[tuple[bool, bool]]]] = defaultdict(lambda: defaultdict(list))
    for view in views:
        usable = view["visible"] >= USABLE[0] and view["angle_deg"] > USABLE[1]
        gestures[view["seed"], view["gesture"]][view["frame"]].append((view[name] == "right", usable))
    both, pairs, found = 0, 0, []
    for frames in gestures.values():
        found.append(np.mean([sum(right for right, _ in frame) >= 2 for frame in frames.values()]) >= 0.5)
        for frame in frames.values():
            right = [right for right, usable in frame if usable]
            both, pairs = both + comb(sum(right), 2), pairs + comb(len(right), 2)
    return Rate(100 * both / max(pairs, 1), pairs, 100 * float(np.mean(found)) if found else np.nan, len(found))


def write_rows(path: Path, rows: list[Row], options: PointingAblation) -> None:
    """Every row with what it was made with."""
    columns: dict[str, list] = {field.name: [getattr(row, field.name) for row in rows] for field in fields(Row)}
    asked_for = {"people_a_room": options.people, "gestures_a_person": options.gestures, "commit": commit()}
    same = {name: getattr(options, name) for name in ("rooms", "objects", "draws", "seed")} | asked_for
    write_table(path, columns | {name: [value] * len(rows) for name, value in same.items()})


def markdown(rows: list[Row], constants: list[Ten], rates: dict[str, Rate], options: PointingAblation) -> str:
    """The thesis's table 2, what ten pointings say, detection rates, and all conditions."""
    most = max((row for row in rows), key=lambda row: row.pointings)
    told = (
        f"Up to {most.pointings:,} pointings a row, {most.gestures} gestures of {most.scored_people} people, "
        f"{options.draws} draws each; 1 px and 1 x calibration noise unless varied. Seed {options.seed}, "
        f"commit {commit()}.\n"
    )
    parts = [as_markdown(thesis_table(rows)), as_markdown(constant_table(constants))]
    parts += [as_markdown(rate_table(rates))] if rates else []
    return "\n".join([told, *parts, as_markdown(all_rows(rows))])


def as_markdown(table: Table) -> str:
    return "".join(f"| {' | '.join(line)} |\n" for line in [table.header, ["---"] * len(table.header), *table.rows])


def thesis_table(rows: list[Row]) -> Table:
    """Table 2 in kind: signed mean and deviation, mean absolute error and half its interval; the thesis above."""
    header = ["people and line", "azimuth", "absolute", "elevation", "absolute", "object, %"]
    cells = [
        [f"thesis: {name}", f"{azimuth:.3f} (sd {azimuth_sd:.3f})", "",
         f"{elevation:.3f} (sd {elevation_sd:.3f})", "", ""]
        for name, (azimuth, elevation, azimuth_sd, elevation_sd) in THESIS.items()
    ]  # fmt: skip
    for row in (row for row in rows if row.section == "table 2"):
        cells.append([
            f"{row.people}: {described(row)}".replace("forearm, ", "").replace("constant elevation", "elevation"),
            f"{row.azimuth:+.2f} (sd {row.azimuth_sd:.2f})",
            f"{row.azimuth_abs:.2f} ± {(row.azimuth_abs_high - row.azimuth_abs_low) / 2:.2f}",
            f"{row.elevation:+.2f} (sd {row.elevation_sd:.2f})",
            f"{row.elevation_abs:.2f} ± {(row.elevation_abs_high - row.elevation_abs_low) / 2:.2f}",
            f"{row.object_right:.0f}",
        ])  # fmt: skip
    return Table(header, cells)


def constant_table(constants: list[Ten]) -> Table:
    """What ten pointings of one person say about a constant."""
    header = ["people", "line", "mean elevation error", "sd of ten, median", "tens with sd <= 0.867, %"]
    return Table(header, [[one.people, one.rule, f"{one.mean:+.2f}", f"{one.sd:.2f}", f"{one.as_constant:.1f}"]
                          for one in constants])  # fmt: skip


def rate_table(rates: dict[str, Rate]) -> Table:
    """Detection rates from pixels beside the thesis's."""
    header = [
        "right regions, from pixels",
        "both of two good views, %",
        "pairs",
        "two or more of all, %",
        "gestures",
        "thesis, %",
    ]
    return Table(header, [
        [METHODS[name][0], f"{rate.pairs:.1f}", str(rate.pair_count), f"{rate.gestures:.1f}", str(rate.gesture_count),
         f"{METHODS[name][1]:.0f}"]
        for name, rate in rates.items()
    ])  # fmt: skip


def all_rows(rows: list[Row]) -> Table:
    """Every condition, shortly."""
    header = ["section", "people", "line", "varied", "azimuth", "elevation", "angle, median", "object right, %"]
    return Table(header, [
        [row.section, row.people, described(row), f"{row.varied}: {row.value:g}" if row.varied else "",
         f"{row.azimuth:+.2f} (sd {row.azimuth_sd:.2f})", f"{row.elevation:+.2f} (sd {row.elevation_sd:.2f})",
         f"{row.angle_median:.2f} ({row.angle_low:.2f} to {row.angle_high:.2f})",
         f"{row.object_right:.0f} ({row.object_low:.0f} to {row.object_high:.0f})"]
        for row in rows
    ])  # fmt: skip


def described(row: Row) -> str:
    """Line, views and correction in words."""
    method = {"endpoints": "ends"}.get(row.method, row.method)
    name = {"thesis": "forearm, thesis's ends"}.get(row.line, f"{row.line}, {method}")
    if row.line == "thesis" and row.outline_mm == 0:
        name += " on the axis"
    return f"{name}, {row.views} views" + ("" if row.correction == "none" else f", {row.correction} off")


def page(rows: list[Row], constants: list[Ten], rates: dict, figures: list[tuple[Markup, str]], made: dict) -> str:
    """The page of plots and tables."""
    return render(
        "study.html.j2",
        kind="experiment",
        title="What makes pointing miss",
        subtitle="A batched Monte Carlo of people, pixels and calibrations; every correction on people not fitted",
        sections=[("found", "What was found"), ("pictures", "In pictures"), ("figures", "All figures"),
                  ("provenance", "Provenance")],
        found=sentence(rows, constants, rates),
        figures=figures,
        rows=thesis_table(rows),
        provenance=origin_table(made, {}, None),
    )  # fmt: skip


def sentence(rows: list[Row], constants: list[Ten], rates: dict[str, Rate]) -> str:
    """What came out, in words."""
    found = {(row.people, row.line, row.views, row.correction): row for row in rows if row.section == "table 2"}
    two = found["approximate", "thesis", "2", "none"]
    finger = found["approximate", "finger", "2", "none"]
    raw, off = (found["approximate", "forearm", "all", name] for name in ("none", "constant"))
    ten = {(one.people, one.rule.split(",")[0]): one for one in constants}
    perfect, plain = ten["perfect forearm", "thesis's ends"], ten["perfect forearm", "forearm"]
    human = ten["approximate", "forearm"]
    told = (
        f"Finger, two views: mean absolute error {finger.azimuth_abs:.1f} degrees in azimuth and "
        f"{finger.elevation_abs:.1f} in elevation; forearm by the thesis's ends {two.azimuth_abs:.1f} and "
        f"{two.elevation_abs:.1f}. The planes of all views miss by {raw.angle_median:.1f} degrees in the median, "
        f"{off.angle_median:.1f} with a constant of other people taken off. {finger_noise(rows)}People whose forearms "
        f"point perfectly seem {perfect.mean:+.1f} degrees too high by the thesis's ends. Ten pointings of one person "
        f"whose elevations spread by no more than the thesis's 0.867 degrees are {human.as_constant:.0f} % of the tens "
        f"of people who point approximately, {perfect.as_constant:.0f} % of perfect ones seen by the thesis's ends, "
        f"and {plain.as_constant:.0f} % of perfect ones seen by planes."
    )
    if rates:
        default, thesis, cap = (rates[name].pairs for name in METHODS)
        told += (
            f" From pixels, of two views that show the arm well both had the forearm right in {default:.0f} % "
            f"(thesis's method {thesis:.0f} %; the thesis says 91), the finger with its cap in {cap:.0f} % (32)."
        )
    return told


def finger_noise(rows: list[Row]) -> str:
    """At which noise of the pixels the finger errs as the thesis has it, people apart."""
    own = [row for row in rows if row.section == "pixel noise" and row.line == "finger"]
    noise, azimuth = [row.value for row in own], [row.azimuth_abs for row in own]
    wanted = THESIS["finger, 2 views"][0]
    if not azimuth[0] < wanted < azimuth[-1]:
        return ""
    at = np.interp(wanted, azimuth, noise)
    return f"The finger's 19.5 degrees of the thesis would need ends that are {at:.1f} px off. "


if __name__ == "__main__":
    chosen = tyro.cli(PointingAblation, description=__doc__)
    with jax.enable_x64(True):
        if chosen.speed:
            measure_speed(chosen)
        else:
            main(chosen)
            sys.stdout.write(
                f"{(chosen.out / 'table.md').read_text(encoding='utf-8')}\nPage: {chosen.out}/report.html\n"
            )
