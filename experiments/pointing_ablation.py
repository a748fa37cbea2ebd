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
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float, Int
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.progress import track

from elevation_bias import commit
from jaxpoint.config.people import PointingSettings, Uniform
from jaxpoint.io.table import write_table
from jaxpoint.pointing.bias.models import AbstractModel, Constant, ConstantElevation, Polynomial
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.solve import solve
from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import FAINT, INK, PAGE, camera_colors, style, to_svg
from jaxpoint.report.tables import Table, origin_table
from jaxpoint.runs import MARK, new_run, provenance, write_json
from pointing_monte_carlo import FINGER_RADIUS_M, Condition, Noise, Sample, point
from pointing_people import Gestures, Setting, exactly, gestures_of, law

THESIS = {
    "finger, 2 views": (19.4980, 12.7720, 14.1094, 5.8165),
    "forearm, 2 views": (8.0373, 4.8850, 8.4933, 0.8672),
    "forearm, 3 views": (4.8915, 5.9539, 2.9127, 1.0825),
}  # table 2: mean azimuth and elevation, their standard deviations, degrees
THESIS_RATES = {"forearm": 91.0, "finger": 32.0}
TEN = 10  # pointings of the thesis
CORRECTIONS = ("constant elevation", "constant", "polynomial")
LOSS_RAD = float(np.deg2rad(1.5))
FITTED_DRAWS = 2
RESAMPLES = 400
A_PERSON = 300  # pointings of each, from which medians are resampled


@dataclass(frozen=True)
class PointingAblation:
    """Score simulated pointings under many conditions."""

    out: Path = Path("pointing_ablation")
    """Folder for table (CSV and Markdown) and page."""
    rooms: int = 6
    """Rooms, each with its own cameras, objects and people."""
    people: int = 8
    """People a room; every second one is fitted, the others are scored."""
    gestures: int = 10
    """Gestures a person, each at a target of its own."""
    objects: int = 65
    """Objects a room."""
    draws: int = 64
    """Draws of the noise for every gesture."""
    seed: int = 0
    """Of the first room and of the noise."""
    evaluation: Path | None = None
    """What `person_evaluation.py` wrote, for detection rates."""
    speed: bool = False
    """Only measure how many pointings a second are simulated."""
    force: bool = False
    """Replace an earlier run in `--out`."""


@dataclass(frozen=True)
class Row:
    """One condition and its errors in degrees."""

    section: str
    people: str
    line: str
    method: str
    views: str
    correction: str
    varied: str
    value: float
    pixel_px: float
    calibration: float
    outline_mm: float
    slide_mm: float
    pointings: int
    gestures: int
    scored_people: int
    azimuth: float
    azimuth_low: float
    azimuth_high: float
    azimuth_sd: float
    azimuth_abs: float
    azimuth_abs_low: float
    azimuth_abs_high: float
    elevation: float
    elevation_low: float
    elevation_high: float
    elevation_sd: float
    elevation_abs: float
    elevation_abs_low: float
    elevation_abs_high: float
    angle_median: float
    angle_low: float
    angle_high: float
    object_right: float
    object_low: float
    object_high: float


@dataclass(frozen=True)
class Asked:
    """One condition to be scored."""

    section: str
    people: str
    condition: Condition
    correction: str = "none"
    varied: str = ""
    value: float = np.nan
    pixel: float = 1.0
    calibration: float = 1.0
    outline: float = 0.0
    slide: float = 0.0

    @property
    def seen(self) -> Condition:
        return replace(self.condition, noise=Noise.of(self.pixel, self.calibration, self.outline, self.slide))


class Crowds:
    """All kinds of people in the same rooms; drawn when they are first asked for."""

    def __init__(self, options: PointingAblation):
        self.options = options
        self.settings = [Setting.drawn(options.seed + room, options.objects) for room in range(options.rooms)]
        self.laws: dict[str, PointingSettings] = {
            "approximate": law(0.0),
            "accurate": law(1.0),
            "perfect forearm": perfect_forearm(),
        }
        self.drawn: dict[str, list[Gestures]] = {}

    def of(self, people: str) -> list[Gestures]:
        if people not in self.drawn:
            options = self.options
            self.drawn[people] = gestures_of(self.settings, self.laws[people], options.people, options.gestures)
        return self.drawn[people]

    def halves(self, people: str) -> tuple[list[Gestures], list[Gestures]]:
        """Those that are fitted, and those that are scored."""
        rooms = self.of(people)
        return [own.select(own.person % 2 == 0) for own in rooms], [own.select(own.person % 2 == 1) for own in rooms]


def perfect_forearm() -> PointingSettings:
    """The elbow-wrist axis runs exactly along the line from the fingertip to the target, and so does the finger."""
    none = exactly(0.0)
    return law(0.0, elevation_bias_deg=none, azimuth_bias_deg=none, elevation_scatter_deg=0.0,
               azimuth_scatter_deg=0.0, finger_follows=Uniform(1.0, 1.0))  # fmt: skip


def asked(crowds: Crowds) -> Iterator[Asked]:
    """All conditions, section by section."""
    finger, thesis = Condition("finger", "endpoints", 2), Condition("thesis", "endpoints", 2)
    planes, joined = Condition("forearm", "planes"), Condition("forearm", "endpoints")
    for people in ("approximate", "accurate", "perfect forearm"):
        yield Asked("table 2", people, finger)
        for views in (2, 3):
            yield Asked("table 2", people, replace(thesis, views=views), outline=FINGER_RADIUS_M)
        for correction in ("none", *CORRECTIONS):
            yield Asked("table 2", people, planes, correction)
        if people == "perfect forearm":
            yield Asked("table 2", people, thesis)
    for people in ("approximate", "accurate"):
        for line in ("finger", "eye-fingertip", "head-hand", "shoulder-hand"):
            for correction in ("none", "constant"):
                yield Asked("lines", people, Condition(line, "endpoints"), correction)
    perfect = "perfect forearm"
    for value in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0):
        for condition in (finger, replace(joined, views=2), replace(planes, views=2), planes):
            yield Asked("pixel noise", perfect, condition, "none", "pixel noise, px", value, pixel=value)
    for value in (0.0, 1.0, 2.0, 5.0, 10.0, 20.0):
        for condition in (finger, replace(joined, views=2), replace(planes, views=2), planes):
            yield Asked("calibration noise", perfect, condition, "none", "calibration noise, times", value,
                        calibration=value)  # fmt: skip
    for value in (0.05, 0.09, 0.17, 0.26, 0.45, 0.7):
        for condition in (replace(joined, views=2), replace(planes, views=2), planes):
            yield Asked("length", perfect, replace(condition, length_m=value), "none", "length seen, m", value)
    for views in (2, 3, 4):
        for condition in (joined, planes):
            yield Asked("views", perfect, replace(condition, views=views), "none", "views", views)
    for value in (0.0, 0.01, 0.02, 0.04, 0.08):
        for condition in (joined, planes):
            yield Asked("ends", perfect, replace(condition, views=3), "none", "ends slide, m", value, slide=value)
    for value in (0.0, 4.5, 9.0, 15.0):
        people = f"approximate, bias {value:g}"
        crowds.laws[people] = law(0.0, elevation_bias_deg=replace(law(0.0).approximate.elevation_bias_deg, mean=value, low=value - 9, high=value + 11))  # fmt: skip
        for correction in ("none", "constant"):
            yield Asked("bias", people, planes, correction, "people's mean elevation bias, deg", value)
    for value in (0.0, 1.0, 2.0, 3.0):
        people = f"approximate, scatter x {value:g}"
        default = law(0.0).approximate
        crowds.laws[people] = law(0.0, elevation_scatter_deg=value * default.elevation_scatter_deg, azimuth_scatter_deg=value * default.azimuth_scatter_deg)  # fmt: skip
        for correction in ("none", "constant"):
            yield Asked("scatter", people, planes, correction, "scatter, times", value)


def score(crowds: Crowds, one: Asked) -> list[Row]:
    """The row of a condition, and those of its distances where that is the question."""
    fitted, scored = crowds.halves(one.people)
    options = crowds.options
    model = None if one.correction == "none" else correction(fitted, one, options.seed)
    sample = point(scored, one.seen, options.draws, seed=options.seed + 1, model=model)
    rows = [row_of(one, scored, sample, options.seed)]
    if one.section == "table 2" and one.condition.method == "planes":
        away = np.concatenate([own.distance for own in scored])[sample.gesture]
        for low, high in ((1.0, 1.75), (1.75, 2.5), (2.5, 3.25), (3.25, 4.0), (4.0, 5.5)):
            some = (away >= low) & (away < high)
            if some.sum() > TEN * options.draws:
                part = Sample(sample.gesture[some], jax.tree.map(lambda leaf, some=some: leaf[some], sample.scored))
                told = replace(one, section="distance", varied="distance of the target, m", value=away[some].mean())
                rows.append(row_of(told, scored, part, options.seed))
    return rows


def correction(fitted: Sequence[Gestures], one: Asked, seed: int) -> AbstractModel:
    """A bias fitted by Levenberg-Marquardt on pointings of people who are not scored."""
    sample = point(fitted, one.seen, FITTED_DRAWS, seed=seed)
    target = np.concatenate([own.target for own in fitted])[sample.gesture]
    who = np.concatenate([own.person for own in fitted])[sample.gesture]
    pointings = Pointings(
        tuple(map(str, range(len(target)))),
        tuple(map(str, who)),
        (one.condition.line,),
        sample.scored.origin[:, None],
        sample.scored.direction[:, None],
        target,
    )
    starts = ConstantElevation(np.zeros(1)), Constant(np.zeros((1, 2))), Polynomial(np.zeros((1, 2, 3)))
    start = dict(zip(CORRECTIONS, starts))[one.correction]
    found = solve(start, pointings, np.ones((1, len(pointings))), LOSS_RAD)
    model = jax.tree.map(lambda leaf: leaf[0], found)
    # One program for both constants.
    return Constant(jnp.stack([0.0, model.elevation])) if isinstance(model, ConstantElevation) else model


def row_of(one: Asked, rooms: Sequence[Gestures], sample: Sample, seed: int) -> Row:
    who = np.concatenate([own.person for own in rooms])[sample.gesture]
    azimuth, elevation, angle = (
        np.rad2deg(getattr(sample.scored, name)) for name in ("azimuth", "elevation", "angle")
    )
    found: dict[str, float] = {}
    means = {"azimuth": azimuth, "azimuth_abs": abs(azimuth), "elevation": elevation, "elevation_abs": abs(elevation)}
    for name, values in means.items():
        found |= dict(zip((name, f"{name}_low", f"{name}_high"), mean_of(values, who, seed)))
    found |= dict(zip(("angle_median", "angle_low", "angle_high"), median_of(angle, who, seed)))
    found |= dict(zip(("object_right", "object_low", "object_high"), mean_of(100.0 * sample.scored.right, who, seed)))
    views = "all" if one.condition.views is None else str(one.condition.views)
    return Row(
        one.section, one.people, one.condition.line, one.condition.method, views, one.correction, one.varied,
        float(one.value), one.pixel, one.calibration, 1e3 * one.outline, 1e3 * one.slide, len(who),
        len(np.unique(sample.gesture)), len(np.unique(who)),
        azimuth_sd=float(azimuth.std(ddof=1)), elevation_sd=float(elevation.std(ddof=1)), **found,
    )  # fmt: skip


def mean_of(values: np.ndarray, who: np.ndarray, seed: int) -> tuple[float, float, float]:
    """Mean, and its interval over people drawn anew."""
    crowd, number = np.unique(who, return_inverse=True)
    sums, counts = np.bincount(number, values), np.bincount(number)
    drawn = np.random.default_rng(seed).integers(len(crowd), size=(RESAMPLES, len(crowd)))
    low, high = np.quantile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), [0.025, 0.975])
    return float(values.mean()), float(low), float(high)


def median_of(values: np.ndarray, who: np.ndarray, seed: int) -> tuple[float, float, float]:
    """Median, and its interval over people drawn anew, of whom some pointings each are taken."""
    rng = np.random.default_rng(seed)
    own = np.stack([rng.choice(values[who == person], A_PERSON) for person in np.unique(who)])
    drawn = rng.integers(len(own), size=(RESAMPLES, len(own)))
    low, high = np.quantile([np.median(own[people]) for people in drawn], [0.025, 0.975])
    return float(np.median(values)), float(low), float(high)


@dataclass(frozen=True)
class Ten:
    """What ten pointings of one person, one draw each, say about the elevation."""

    people: str
    rule: str
    mean: float  # deg, of all sets
    sd: float  # median over sets of the standard deviation within one
    as_constant: float  # %, sets whose standard deviation is at most the thesis's


RULES = (
    ("approximate", "forearm, planes, all views", Condition("forearm", "planes"), 0.0),
    ("approximate", "thesis's ends, 2 views", Condition("thesis", "endpoints", 2), FINGER_RADIUS_M),
    ("accurate", "forearm, planes, all views", Condition("forearm", "planes"), 0.0),
    ("accurate", "thesis's ends, 2 views", Condition("thesis", "endpoints", 2), FINGER_RADIUS_M),
    ("perfect forearm", "forearm, planes, all views", Condition("forearm", "planes"), 0.0),
    ("perfect forearm", "thesis's ends, 2 views", Condition("thesis", "endpoints", 2), FINGER_RADIUS_M),
)


def tens(crowds: Crowds) -> list[Ten]:
    """Is a nearly constant elevation error what people make, or what the rule for the ends does?"""
    found = []
    rng = np.random.default_rng(crowds.options.seed)
    for people, rule, condition, outline in RULES:
        rooms = crowds.of(people)
        sample = point(rooms, replace(condition, noise=Noise.of(outline=outline)), crowds.options.draws)
        who = np.concatenate([own.person for own in rooms])[sample.gesture]
        spreads, means = [], []
        for person in np.unique(who):
            own = np.rad2deg(sample.scored.elevation[who == person])
            drawn = rng.choice(own, (RESAMPLES, TEN))
            spreads.append(drawn.std(axis=1, ddof=1))
            means.append(drawn.mean(axis=1))
        spread = np.concatenate(spreads)
        few = 100 * float(np.mean(spread <= THESIS["forearm, 2 views"][3]))
        found.append(Ten(people, rule, float(np.mean(means)), float(np.median(spread)), few))
    return found


def detection_rates(folder: Path) -> dict[str, tuple[float, int]]:
    """Gestures with two or more right views in at least half of their frames, %, and of how many, from pixels.

    Raises:
        SystemExit: the folder holds no scores.
    """
    files = sorted(folder.glob("seed_*.json"))
    if not files:
        raise SystemExit(f"{folder} holds 0 files seed_*.json; let person_evaluation.py write there first.")
    right: dict[str, dict[tuple[int, int], dict[int, int]]] = {name: {} for name in ("default", "thesis", "thesis_finger")}
    for file in files:
        for view in json.loads(file.read_text())["views"]:
            for name, gestures in right.items():
                if view[name] != "no_cap":
                    frames = gestures.setdefault((view["seed"], view["gesture"]), defaultdict(int))
                    frames[view["frame"]] += view[name] == "right"
    rates = {}
    for name, gestures in right.items():
        found = [np.mean([count >= 2 for count in frames.values()]) >= 0.5 for frames in gestures.values()]
        rates[name] = (100 * float(np.mean(found)), len(found)) if found else (np.nan, 0)
    return rates


def measure_speed(options: PointingAblation) -> None:
    """Print pointings a second of single conditions, compiled: by the clock and by the processors' own time."""
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


SPEED_PART = 2048


def main(options: PointingAblation) -> list[Row]:
    """Score all conditions, write everything."""
    crowds = Crowds(options)
    rows = [row for one in track(list(asked(crowds)), "conditions") for row in score(crowds, one)]
    constants = tens(crowds)
    rates = detection_rates(options.evaluation) if options.evaluation else {}
    with new_run(options.out, options.force) as folder:
        command = shlex.join(["python", "experiments/pointing_ablation.py", *sys.argv[1:]])
        made = provenance(command, [], options.seed) | {"commit": commit()}
        write_json(folder / MARK, made)
        write_rows(folder / "table.csv", rows, options)
        (folder / "table.md").write_text(markdown(rows, constants, rates), encoding="utf-8")
        with style():
            figures = [(Markup(to_svg(figure)), caption) for figure, caption in drawn(crowds, rows)]
        write_page(folder / "report.html", page(rows, constants, rates, figures, made))
    return rows


def write_rows(path: Path, rows: list[Row], options: PointingAblation) -> None:
    """Every row with what it was made with."""
    columns: dict[str, list] = {field.name: [getattr(row, field.name) for row in rows] for field in fields(Row)}
    same = {name: getattr(options, name) for name in ("rooms", "objects", "draws", "seed")} | {"commit": commit()}
    write_table(path, columns | {name: [value] * len(rows) for name, value in same.items()})


def markdown(rows: list[Row], constants: list[Ten], rates: dict[str, tuple[float, int]]) -> str:
    """The thesis's table 2, what ten pointings say, detection rates, and all conditions."""
    parts = [as_markdown(thesis_table(rows)), as_markdown(constant_table(constants))]
    parts += [as_markdown(rate_table(rates))] if rates else []
    return "\n".join([*parts, as_markdown(all_rows(rows))])


def as_markdown(table: Table) -> str:
    return "".join(f"| {' | '.join(line)} |\n" for line in [table.header, ["---"] * len(table.header), *table.rows])


def thesis_table(rows: list[Row]) -> Table:
    """Table 2 in kind: signed mean, interval and deviation, and mean absolute error, beside what the thesis prints."""
    header = ["people, line", "azimuth, signed", "sd", "absolute", "elevation, signed", "sd", "absolute", "pointings"]
    cells = [
        [f"thesis: {name}", f"{azimuth:.2f} (which is not said)", f"{azimuth_sd:.2f}", "", f"{elevation:.2f}",
         f"{elevation_sd:.2f}", "", str(TEN)]
        for name, (azimuth, elevation, azimuth_sd, elevation_sd) in THESIS.items()
    ]  # fmt: skip
    for row in (row for row in rows if row.section == "table 2"):
        cells.append([
            f"{row.people}: {described(row)}",
            f"{row.azimuth:+.2f} ({row.azimuth_low:+.2f} to {row.azimuth_high:+.2f})",
            f"{row.azimuth_sd:.2f}",
            f"{row.azimuth_abs:.2f} ({row.azimuth_abs_low:.2f} to {row.azimuth_abs_high:.2f})",
            f"{row.elevation:+.2f} ({row.elevation_low:+.2f} to {row.elevation_high:+.2f})",
            f"{row.elevation_sd:.2f}",
            f"{row.elevation_abs:.2f} ({row.elevation_abs_low:.2f} to {row.elevation_abs_high:.2f})",
            f"{row.pointings:,}",
        ])  # fmt: skip
    return Table(header, cells)


def constant_table(constants: list[Ten]) -> Table:
    """What ten pointings of one person say about a constant."""
    header = ["people", "line", "mean elevation error", "sd of ten, median", "tens with sd <= 0.867, %"]
    return Table(header, [[one.people, one.rule, f"{one.mean:+.2f}", f"{one.sd:.2f}", f"{one.as_constant:.1f}"]
                          for one in constants])  # fmt: skip


def rate_table(rates: dict[str, tuple[float, int]]) -> Table:
    """Detection rates from pixels beside the thesis's."""
    names = {"default": ("forearm, default method", THESIS_RATES["forearm"]),
             "thesis": ("forearm, thesis's method", THESIS_RATES["forearm"]),
             "thesis_finger": ("finger, thesis's method, people with a cap", THESIS_RATES["finger"])}  # fmt: skip
    cells = [[label, f"{rates[name][0]:.1f}", str(rates[name][1]), f"{told:.0f}"] for name, (label, told) in names.items()]
    return Table(["two views or more right, from pixels", "found, %", "gestures", "thesis, %"], cells)


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
    name = {"thesis": "forearm, thesis's ends"}.get(row.line, f"{row.line}, {row.method}")
    if row.line == "thesis" and row.outline_mm == 0:
        name += " on the axis"
    return f"{name}, {row.views} views" + ("" if row.correction == "none" else f", {row.correction} taken off")


def drawn(crowds: Crowds, rows: list[Row]) -> list[tuple[Figure, str]]:
    """Figures 53 and 54 of the thesis in kind, and the sweeps."""
    return [
        (draw_lines(crowds), "The thesis's figure 53 in kind: errors of finger and forearm, two views, drawn as the "
         "thesis has them. Left ten pointings of one person who points approximately, right all people: the middle, "
         "half and 95 % of the pointings, and the thesis's mean and standard deviation as a black bar."),
        (draw_views(crowds), "The thesis's figure 54 in kind: azimuth errors of the forearm from two and from three "
         "images; the same pointings. People with a perfect forearm show what the images alone do."),
        (draw_sweeps(rows), "Median great-circle error, with intervals over people. Above, people with a perfect "
         "forearm: only the measurement errs. Below, people who point approximately: they err themselves."),
    ]  # fmt: skip


@cache
def shown_conditions() -> dict[str, tuple[Condition, float]]:
    return {
        "finger": (Condition("finger", "endpoints", 2), 0.0),
        "forearm": (Condition("thesis", "endpoints", 2), FINGER_RADIUS_M),
        "forearm, 3": (Condition("thesis", "endpoints", 3), FINGER_RADIUS_M),
    }


def absolute(crowds: Crowds, people: str, name: str, angle: str) -> tuple[np.ndarray, np.ndarray]:
    """Absolute errors (degrees) of all pointings, and of ten of one person at ten targets."""
    condition, outline = shown_conditions()[name]
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
        axes[2 * k].set_title(f"{angle.capitalize()} error, ten pointings")
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
    """Ten pointings as lines, all as boxes, the thesis as bars."""
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
    left.set(xlabel="pointing", ylabel="absolute error, degrees", xticks=range(1, TEN + 1), ylim=(0, None))
    left.legend(loc="upper left", ncols=2)
    right.set(xlim=(-0.5, 1.7), ylim=(0, None), title="All; thesis")
    right.set_xticks([0, 1], labels)


SWEEPS = (
    ("pixel noise", True), ("calibration noise", False), ("length", True), ("ends", False),
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
            axes.xaxis.set_minor_locator(_no_ticks())
            axes.yaxis.set_major_formatter("{x:g}")
        else:
            axes.set_ylim(0, None)
        axes.set(title=section.capitalize(), xlabel=own[0].varied if own else "")
        axes.legend(fontsize=7)
    for axes in figure.axes[::4]:
        axes.set_ylabel("median error, degrees")
    return figure


def _no_ticks():
    from matplotlib.ticker import NullLocator

    return NullLocator()


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
                    axes.barh(place + 0.4 * k - 0.2, row.angle_median, 0.36, color=colour, alpha=0.8,
                              xerr=[[max(row.angle_median - row.angle_low, 0)], [max(row.angle_high - row.angle_median, 0)]],
                              error_kw={"ecolor": FAINT}, label=people if place == 0 else None)  # fmt: skip
    axes.set_yticks(range(len(lines)), lines)
    axes.invert_yaxis()
    axes.set(title="Lines, all views, constant off", xlabel="median error, degrees")
    axes.legend(fontsize=7)


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


def sentence(rows: list[Row], constants: list[Ten], rates: dict[str, tuple[float, int]]) -> str:
    """What came out, in words."""
    found = {(row.people, row.line, row.views, row.correction): row for row in rows if row.section == "table 2"}
    two = found["approximate", "thesis", "2", "none"]
    finger = found["approximate", "finger", "2", "none"]
    raw, off = (found["approximate", "forearm", "all", name] for name in ("none", "constant"))
    ten = {(one.people, one.rule.split(",")[0]): one for one in constants}
    perfect, human = ten["perfect forearm", "thesis's ends"], ten["approximate", "forearm"]
    told = (
        f"Finger, two views: mean absolute error {finger.azimuth_abs:.1f} degrees in azimuth and "
        f"{finger.elevation_abs:.1f} in elevation; forearm by the thesis's ends {two.azimuth_abs:.1f} and "
        f"{two.elevation_abs:.1f}. The planes of all views miss by {raw.angle_median:.1f} degrees in the median, "
        f"{off.angle_median:.1f} with a constant of other people taken off. People whose forearms point perfectly seem "
        f"{perfect.mean:+.1f} degrees too high by the thesis's ends and {perfect.as_constant:.0f} % of their tens show a "
        f"standard deviation of 0.867 or less; people who point approximately {human.as_constant:.0f} %."
    )
    if rates:
        told += (
            f" From pixels {rates['default'][0]:.0f} % of the gestures had the forearm in two views or more (thesis's "
            f"method {rates['thesis'][0]:.0f} %), the finger {rates['thesis_finger'][0]:.0f} % of those with a cap."
        )
    return told


if __name__ == "__main__":
    chosen = tyro.cli(PointingAblation, description=__doc__)
    with jax.enable_x64(True):
        if chosen.speed:
            measure_speed(chosen)
        else:
            print(json.dumps(asdict(main(chosen)[0]), indent=1))
            print(f"Table and page: {chosen.out}")
