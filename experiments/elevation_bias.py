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
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro
from jaxtyping import Bool, Float
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxpoint.geometry.angles import turned
from jaxpoint.io.bias import write_bias
from jaxpoint.io.pointing_studies import WallPointings, read_schuetz, read_torsalve
from jaxpoint.io.table import write_table
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import LOSS_DEG, Kind, choose, fit, left_out, refit
from jaxpoint.pointing.bias.models import Constant
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.score import bootstrap, errors_deg
from jaxpoint.pointing.bias.solve import offsets
from jaxpoint.pointing.bias.spread import Spread
from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import FAINT, PAGE, camera_colors, style, to_svg
from jaxpoint.report.tables import Table, origin_table
from jaxpoint.runs import MARK, new_run, provenance, write_json

LINES = ("head", "shoulder", "upper-arm", "forearm", "hand")
NOTED = {"head": (4.60, -3.80, 0.79), "shoulder": (19.41, 3.65, 18.29), "upper-arm": (19.78, 12.80, 15.86),
         "forearm": (19.65, 14.98, 15.52), "hand": (19.55, 13.15, 16.16)}  # fmt: skip
FEEDBACKS = ("cursor", "hand", "none")
SOURCE = "pointing_torsalve: optical motion capture, 7 people, 27 targets; line from forearm marker to fingertip"
BINS = 10


@dataclass(frozen=True)
class ElevationBias:
    """Measure the bias of pointing of real people, and what corrections leave of it."""

    data: Annotated[Path, tyro.conf.Positional]
    """Folder of the recordings pointing_torsalve and pointing_schuetz."""
    out: Path = Path("elevation_bias")
    """Folder for table (CSV and Markdown), page and the forearm's bias."""
    triples: int = 200
    """Draws of three personal gestures."""
    loss_deg: float = LOSS_DEG
    """Scale of the Cauchy loss."""
    seed: int = 0
    """Of triples and intervals."""
    force: bool = False
    """Replace an earlier run in `--out`."""


@dataclass(frozen=True)
class Row:
    """One figure: what it is of, what was found, and what the notes or the target say."""

    study: str
    line: str
    model: str
    left_out: str
    figure: str
    value: float
    low: float = np.nan
    high: float = np.nan
    wanted: str = ""


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


class Grid:
    """The study of markers on the arm, 27 targets in a grid."""

    def __init__(self, settings: ElevationBias):
        self.settings = settings
        self.all = read_torsalve(settings.data / "pointing_torsalve").of_lines(LINES)
        assert self.all.targets is not None
        self.targets, number = np.unique(self.all.targets, axis=0, return_inverse=True)
        self.meant = number.ravel()
        self.directions: dict[str, np.ndarray] = {}  # of corrected lines, by model
        self.curves: dict[str, list[tuple[float, float, int]]] = {}

    def rows(self) -> list[Row]:
        rows = [row for line in LINES for row in self._raw(line)]
        for line, noted in (("forearm", "5.25"), ("head", "3.10")):
            own = self.all.of_lines((line,))
            rows.append(self._median(own, plain_means(own), "constant, plain means", "person", noted))
            for kind in ("constant-elevation", "constant", "polynomial"):
                found = self._target_out(kind, own)
                self.directions[f"{line}, {kind}"] = found
                wanted = "<= 4.9" if line == "forearm" and kind == "polynomial" else ""
                rows.append(self._median(own, found, kind, "person, target", wanted))
        blend = self._target_out("blend", self.all)
        self.directions["all lines, blend"] = blend
        rows.append(self._median(self.all, blend, "blend", "person, target", "<= 2.5", "all"))
        right = self._nearest(blend) == self.meant
        interval = bootstrap(right.astype(float), self.all.who, self.settings.seed, np.mean)
        rows.append(self._row("all", "blend", "person, target", "nearest of 27 right, %", 100 * right.mean(),
                              *(100 * x for x in interval), wanted=">= 92"))  # fmt: skip
        rows.append(self._personal(blend))
        judged: tuple[tuple[str, Kind], ...] = (("all", "blend"), ("forearm", "polynomial"))
        for line, kind in judged:
            rows += self._probabilities(line, kind)
        return [*rows, *self._differences()]

    def _differences(self) -> list[Row]:
        """What limits a correction: how one person repeats, and how people differ."""
        own = self.all.of_lines(("head",))
        again = np.zeros((len(own), 2))
        for place in np.unique(np.stack([own.who, self.meant]), axis=1).T:
            same = (own.who == place[0]) & (self.meant == place[1])
            again[same] = np.sqrt(same.sum() / (same.sum() - 1)) * (own.errors[same] - own.errors[same].mean(axis=0))
        miss = np.rad2deg(np.median(np.hypot(again[:, 0] * own.level, again[:, 1])))
        rows = [self._row("head", "none", "", "one person at one target, median about the mean, deg", miss)]
        asked: tuple[tuple[Kind, tuple[str, ...]], ...]
        asked = (("constant", ("forearm",)), ("constant", ("head",)), ("blend", LINES))
        for kind, lines in asked:
            bias = fit(kind, self.all.of_lines(lines), loss_deg=self.settings.loss_deg)
            for side, value in zip(("left", "up"), np.rad2deg(np.sqrt(np.diagonal(bias.between)))):
                line = lines[0] if len(lines) == 1 else "all"
                rows.append(self._row(line, kind, "person", f"people's offsets, {side}, rms, deg", value))
        return rows

    def _raw(self, line: str) -> list[Row]:
        own = self.all.of_lines((line,))
        median, left, high = NOTED[line]
        found = np.rad2deg(own.errors.mean(axis=0))
        return [
            self._median(own, own.directions[:, 0], "none", "", f"{median:.2f}"),
            self._row(line, "none", "", "mean azimuth error (left), deg", found[0], wanted=f"{left:+.2f}"),
            self._row(line, "none", "", "mean elevation error (high), deg", found[1], wanted=f"{high:+.2f}"),
        ]

    def _target_out(self, kind: Kind, own: Pointings) -> np.ndarray:
        """Directions corrected by models that have seen neither the person nor the target."""
        directions = np.zeros((len(own), 3))
        for person in range(len(own.crowd)):
            out = own.who == person
            others = own.select(~out)
            chosen, _, _ = choose(kind, others, self.settings.loss_deg)
            weights = (self.meant[~out][None] != np.arange(len(self.targets))[:, None]).astype(float)
            models = refit(kind, others, chosen, weights, self.settings.loss_deg)
            turns = jax.vmap(lambda model, own=own, out=out: model.turn(own.angles[out]))(models)
            mine = np.asarray(turns)[self.meant[out], np.arange(out.sum())]
            directions[out] = turned(own.directions[out, 0], -mine)
        return directions

    def _personal(self, directions: np.ndarray) -> Row:
        """The blend's directions, turned by what three gestures of the person show."""
        lines = replace(self.all.of_lines(LINES[:1]), directions=directions[:, None])
        errors = np.full((self.settings.triples, len(lines)), np.nan)
        for person in range(len(lines.crowd)):
            out = lines.who == person
            shared = fit("blend", self.all.select(~out), loss_deg=self.settings.loss_deg)
            errors[:, out] = self._triples(lines.select(out), self.meant[out], shared, person)
        return over_triples(np.nanmedian(errors, axis=1), "torsalve", "all", "blend, 3 personal targets",
                            "person, target", "median error, deg", "<= 1.9")  # fmt: skip

    def _triples(self, own: Pointings, meant: np.ndarray, shared: Bias, person: int) -> np.ndarray:
        turns, used = personal_turns(own, meant, shared, self.settings, person)
        errors = np.stack([errors_deg(own, np.asarray(turned(own.directions[:, 0], -turn[None]))) for turn in turns])
        return np.where(used, np.nan, errors)

    def _probabilities(self, line: str, kind: Kind) -> list[Row]:
        own = self.all if line == "all" else self.all.of_lines((line,))
        directions, biases = left_out(kind, own, loss_deg=self.settings.loss_deg)
        chances = np.zeros((len(own), len(self.targets)))
        for person, bias in enumerate(biases):
            out = own.who == person
            chances[out] = probabilities(own.select(out), directions[out], self.targets, bias.spread)
        best, right = chances.max(axis=1), chances.argmax(axis=1) == self.meant
        self.curves[f"{line}, {kind}"] = reliability(best, right)
        draw = np.stack([best, right.astype(float)], axis=1)
        low, high = bootstrap(draw, own.who, self.settings.seed, lambda x: calibration_error(x[:, 0], x[:, 1]))
        sure = (best >= 0.8) & (best < 0.9)
        return [
            self._row(line, kind, "person", "calibration error of the likeliest of 27", calibration_error(best, right),
                      low, high, "<= 0.05"),
            self._row(line, kind, "person", "calibration error over all 27 x 945 probabilities",
                      calibration_error(chances.ravel(), (self.meant[:, None] == np.arange(27)[None]).ravel())),
            self._row(line, kind, "person", f"right of {sure.sum()} given 80-90 %, %",
                      100 * right[sure].mean() if sure.any() else np.nan),
        ]  # fmt: skip

    def _nearest(self, directions: np.ndarray) -> np.ndarray:
        to = unit(self.targets[None] - self.all.origins[:, :1])
        return np.argmax(np.sum(to * directions[:, None], axis=-1), axis=1)

    def _median(self, own: Pointings, directions: np.ndarray, model: str, out: str, wanted: str, line: str = "") -> Row:
        errors = errors_deg(own, directions)
        interval = bootstrap(errors, own.who, self.settings.seed)
        return self._row(line or own.lines[0], model, out, "median error, deg", np.median(errors), *interval, wanted)

    def _row(self, line: str, model: str, out: str, figure: str, value, low=np.nan, high=np.nan, wanted="") -> Row:
        return Row("torsalve", line, model, out, figure, float(value), float(low), float(high), wanted)

    def forearm_bias(self) -> Bias:
        """The forearm's bias of all people: what a session without known targets starts from."""
        return fit("constant", self.all.of_lines(("forearm",)), loss_deg=self.settings.loss_deg, source=SOURCE)

    def figures(self) -> list[tuple[Figure, str]]:
        return [
            (self._draw_misses(), "Where lines point, seen from the fingertip: each dot a gesture, each colour a "
             "person, the target in the middle. Corrected lines are those of people and targets that were not fitted. "
             "A few slips lie outside."),
            (self._draw_reliability(), "Of the answers given with a probability, how many are right. On the diagonal "
             "probabilities are honest; the size of a dot is the number of gestures."),
        ]  # fmt: skip

    def _draw_misses(self) -> Figure:
        shown = {
            "forearm, as it is": ("forearm", self.all.of_lines(("forearm",)).directions[:, 0]),
            "forearm, polynomial": ("forearm", self.directions["forearm, polynomial"]),
            "head, as it is": ("head", self.all.of_lines(("head",)).directions[:, 0]),
            "all lines, blend": ("head", self.directions["all lines, blend"]),
        }
        figure = Figure(figsize=(PAGE, 3.1), layout="constrained")
        for axes, (title, (line, directions)) in zip(figure.subplots(1, 4, sharex=True, sharey=True), shown.items()):
            own = replace(self.all.of_lines((line,)), directions=directions[:, None])
            for person, colour in enumerate(camera_colors(len(own.crowd))):
                left, up = np.rad2deg(own.errors[own.who == person]).T
                axes.plot(-left, up, ".", color=colour, markersize=3, rasterized=True)
            axes.set(title=title, xlim=(-30, 30), ylim=(-30, 30), xlabel="too far right, degrees", aspect="equal")
            axes.plot(0, 0, "+", color="#10202f", markersize=12)
        figure.axes[0].set_ylabel("too high, degrees")
        return figure

    def _draw_reliability(self) -> Figure:
        figure = Figure(figsize=(0.5 * PAGE, 3.2), layout="constrained")
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1)
        for (name, curve), colour in zip(self.curves.items(), camera_colors(2)):
            given, right, count = (np.array(column) for column in zip(*curve))
            axes.plot(given, right, color=colour, linewidth=1)
            axes.scatter(given, right, s=6 + 0.25 * count, color=colour, alpha=0.8, clip_on=False)
            axes.plot([], "o", color=colour, markersize=5, label=name)
        axes.set(xlabel="probability given", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02), title="27 targets")
        axes.legend(loc="upper left")
        return figure


class Wall:
    """The study of eye over fingertip, nine targets on a wall of a room of known planes."""

    WALLS = ((0, 2.0), (0, -2.0), (1, 2.0), (2, 0.0))  # axis and place, m: side walls, the wall pointed at, the floor

    def __init__(self, settings: ElevationBias):
        self.settings = settings
        self.read: WallPointings = read_schuetz(settings.data / "pointing_schuetz")
        self.own = self.read.pointings
        assert self.own.targets is not None
        self.targets, number = np.unique(self.own.targets, axis=0, return_inverse=True)
        self.meant = number.ravel()
        self.feedback = np.array(self.read.feedback)
        self.shares: dict[str, list[float]] = {}

    def rows(self) -> list[Row]:
        raw = self.own.directions[:, 0]
        hits, surface = self._hits(raw)
        apart = np.linalg.norm(hits - self.read.hits, axis=1)
        recorded = np.array([np.argmin([abs(hit[axis] - at) for axis, at in self.WALLS]) for hit in self.read.hits])
        gap = np.linalg.norm(self.read.hits - self.own.targets, axis=1)
        rows = [
            self._row("none", "", "hit within 1 mm of the recorded, %", 100 * np.mean(apart < 1e-3), wanted="95.8"),
            self._row("none", "", "surface right, %", 100 * np.mean(surface == recorded), wanted="100"),
            self._row("none", "", "recorded hit to target, median, m", np.median(gap), wanted="0.263"),
            self._row("none", "", "median error, deg", np.median(errors_deg(self.own, raw)), wanted="4.72"),
        ]
        rows += self._nearest_rows("none", raw, "", ("95.3", "100", "97.0", "88.9"))
        shared: tuple[Bias, ...] = ()
        for kind in ("constant-elevation", "constant", "polynomial"):
            directions, biases = left_out(kind, self.own, loss_deg=self.settings.loss_deg)
            wanted = ("", "", "", "") if kind == "constant-elevation" else (">= 97.0", "", "", ">= 90.5")
            rows += self._nearest_rows(kind, directions, "person", wanted)
            if kind == "constant":
                shared = biases
        return [*rows, *self._personal(shared)]

    def _hits(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where lines end on the room, m, and on which of `WALLS`."""
        origins = self.own.origins[:, 0]
        with np.errstate(divide="ignore"):
            away = np.stack([(at - origins[:, axis]) / directions[:, axis] for axis, at in self.WALLS], axis=1)
        away = np.where(away > 0, away, np.inf)
        surface = np.argmin(away, axis=1)
        return origins + away[np.arange(len(away)), surface][:, None] * directions, surface

    def _right(self, directions: np.ndarray) -> Bool[np.ndarray, " G"]:
        """Whether the target nearest to where the line ends is the one meant."""
        hits, _ = self._hits(directions)
        return np.argmin(np.linalg.norm(self.targets[None] - hits[:, None], axis=-1), axis=1) == self.meant

    def _nearest_rows(self, model: str, directions: np.ndarray, out: str, wanted: tuple[str, ...]) -> list[Row]:
        right = self._right(directions)
        rows = []
        for name, told in zip(("all", *FEEDBACKS), wanted):
            some = np.ones(len(right), bool) if name == "all" else self.feedback == name
            low, high = bootstrap(right[some].astype(float), self.own.who[some], self.settings.seed, np.mean)
            rows.append(self._row(model, out, f"nearest of 9 right, {name}, %", 100 * right[some].mean(), 100 * low,
                                  100 * high, told))  # fmt: skip
        self.shares[model] = [row.value for row in rows]
        return rows

    def _personal(self, shared: tuple[Bias, ...]) -> list[Row]:
        """Corrected on other people, and by three gestures of the person under the same feedback."""
        right = np.full((self.settings.triples, len(self.own)), np.nan)
        for person, bias in enumerate(shared):
            for feedback in FEEDBACKS:
                some = (self.own.who == person) & (self.feedback == feedback)
                own = self.own.select(some)
                straight = replace(own, directions=np.asarray(bias.correct(own.directions))[:, None])
                number = 3 * person + FEEDBACKS.index(feedback)
                turns, used = personal_turns(straight, self.meant[some], bias, self.settings, number)
                directions = np.tile([0.0, 1.0, 0.0], (len(self.own), 1))
                for k, turn in enumerate(turns):
                    directions[some] = turned(straight.directions[:, 0], -turn[None])
                    right[k, some] = np.where(used[k], np.nan, self._right(directions)[some])
        rows = []
        for name, told in zip(("all", *FEEDBACKS), (">= 98.3", "", "", ">= 95")):
            some = np.ones(len(self.own), bool) if name == "all" else self.feedback == name
            share = 100 * np.nanmean(right[:, some], axis=1)
            rows.append(over_triples(share, "schuetz", "eye-fingertip", "constant, 3 personal targets", "person",
                                     f"nearest of 9 right, {name}, %", told))  # fmt: skip
        self.shares["constant, 3 personal targets"] = [row.value for row in rows]
        return rows

    def _row(self, model: str, out: str, figure: str, value, low=np.nan, high=np.nan, wanted="") -> Row:
        return Row("schuetz", "eye-fingertip", model, out, figure, float(value), float(low), float(high), wanted)

    def figures(self) -> list[tuple[Figure, str]]:
        figure = Figure(figsize=(0.7 * PAGE, 2.8), layout="constrained")
        axes: Axes = figure.subplots()
        shown = ("none", "constant", "constant, 3 personal targets")
        for k, (name, colour) in enumerate(zip(shown, camera_colors(3))):
            place = np.arange(4) + 0.12 * (k - 1)
            axes.plot(place, self.shares[name], "o", color=colour, markersize=8, label=name if k else "as it is")
        axes.set(ylim=(85, 101), ylabel="nearest of 9 right, %", title="Wall of nine targets, people left out")
        axes.set_xticks(np.arange(4), ["all", *(f"feedback: {name}" for name in FEEDBACKS)])
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
        return [(figure, "How often the target nearest to where the line ends is the one meant. With a cursor people "
                 "steer what they see; without feedback they err as people do.")]  # fmt: skip


def plain_means(own: Pointings) -> np.ndarray:
    """Directions turned back by the mean errors of the other people, as the data's notes have it."""
    turns = np.stack([own.errors[own.who != person].mean(axis=0) for person in range(len(own.crowd))])[own.who]
    return np.asarray(turned(own.directions[:, 0], -turns))


def personal_turns(
    own: Pointings, meant: np.ndarray, shared: Bias, settings: ElevationBias, number: int
) -> tuple[Float[np.ndarray, "triples 2"], Bool[np.ndarray, "triples G"]]:
    """By how much one person's corrected lines are still to be turned back, from three gestures; which these were.

    Args:
        own: one person's lines, corrected by the shared bias already.
        meant: number of each gesture's target.
        shared: what is known of other people's offsets.
        number: of the person; people draw different triples.
    """
    draw = np.random.default_rng([settings.seed, number])
    used = np.zeros((settings.triples, len(own)), bool)
    for row in used:
        for target in draw.choice(np.unique(meant), 3, replace=False):
            row[draw.choice(np.flatnonzero(meant == target))] = True
    found = offsets(Constant(np.zeros(2)), own, used.astype(float), shared.between, shared.within)
    return found, used


def over_triples(values: np.ndarray, study: str, line: str, model: str, out: str, figure: str, wanted: str) -> Row:
    """Mean and 10-90 % range of a figure over triples."""
    low, high = np.quantile(values, [0.1, 0.9])
    return Row(study, line, model, out, figure, float(values.mean()), float(low), float(high), wanted)


def probabilities(own: Pointings, directions: np.ndarray, targets: np.ndarray, spread: Spread) -> np.ndarray:
    """Of each of K targets, (G, K), all alike before the line is seen."""
    likelihoods = []
    for target in targets:
        asked = replace(own, directions=np.repeat(directions[:, None], len(own.lines), axis=1),
                        targets=np.tile(target, (len(own), 1)))  # fmt: skip
        misses = asked.errors * np.stack([asked.level, np.ones(len(own))], axis=1)
        likelihoods.append(np.asarray(spread.log_density(misses)))
    scores = np.exp(np.array(likelihoods).T - np.max(likelihoods, axis=0)[:, None])
    return scores / scores.sum(axis=1, keepdims=True)


def reliability(given: np.ndarray, right: np.ndarray) -> list[tuple[float, float, int]]:
    """Mean probability, share right and number of each tenth that holds any."""
    tenth = np.minimum((given * BINS).astype(int), BINS - 1)
    return [(float(given[tenth == k].mean()), float(right[tenth == k].mean()), int((tenth == k).sum()))
            for k in range(BINS) if (tenth == k).any()]  # fmt: skip


def calibration_error(given: np.ndarray, right: np.ndarray) -> float:
    """Expected calibration error over tenths (Guo et al. 2017)."""
    return sum(count * abs(mean - share) for mean, share, count in reliability(given, right)) / len(given)


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


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


if __name__ == "__main__":
    settings = tyro.cli(ElevationBias, description=__doc__)
    for row in main(settings):
        print(asdict(row))
    print(f"Table and page: {settings.out}")
