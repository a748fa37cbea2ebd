"""The figures of `pointing_torsalve`: markers on the arms of seven people, 27 targets in a grid."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
from matplotlib.figure import Figure

from elevation_study import (
    ElevationBias,
    Row,
    calibration_error,
    over_triples,
    personal_turns,
    plain_means,
    probabilities,
    reliability,
    unit,
)
from jaxpoint.geometry.angles import turn_directions
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import Kind, choose, fit_bias, left_out, refit
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.score import bootstrap, errors_deg
from jaxpoint.report.style import FAINT, PAGE, camera_colors
from pointing_studies import read_torsalve

LINES = ("head", "shoulder", "upper-arm", "forearm", "hand")
NOTED = {"head": (4.60, -3.80, 0.79), "shoulder": (19.41, 3.65, 18.29), "upper-arm": (19.78, 12.80, 15.86),
         "forearm": (19.65, 14.98, 15.52), "hand": (19.55, 13.15, 16.16)}  # fmt: skip
SOURCE = "pointing_torsalve: optical motion capture, 7 people, 27 targets; line from forearm marker to fingertip"


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
            bias = fit_bias(kind, self.all.of_lines(lines), loss_deg=self.settings.loss_deg)
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
            directions[out] = turn_directions(own.directions[out, 0], -mine)
        return directions

    def _personal(self, directions: np.ndarray) -> Row:
        """The blend's directions, turned by what three gestures of the person show."""
        lines = replace(self.all.of_lines(LINES[:1]), directions=directions[:, None])
        errors = np.full((self.settings.triples, len(lines)), np.nan)
        for person in range(len(lines.crowd)):
            out = lines.who == person
            shared = fit_bias("blend", self.all.select(~out), loss_deg=self.settings.loss_deg)
            errors[:, out] = self._triples(lines.select(out), self.meant[out], shared, person)
        return over_triples(np.nanmedian(errors, axis=1), "torsalve", "all", "blend, 3 personal targets",
                            "person, target", "median error, deg", "<= 1.9")  # fmt: skip

    def _triples(self, own: Pointings, meant: np.ndarray, shared: Bias, person: int) -> np.ndarray:
        turns, used = personal_turns(own, meant, shared, self.settings, person)
        errors = np.stack(
            [errors_deg(own, np.asarray(turn_directions(own.directions[:, 0], -turn[None]))) for turn in turns]
        )
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
        return fit_bias("constant", self.all.of_lines(("forearm",)), loss_deg=self.settings.loss_deg, source=SOURCE)

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
