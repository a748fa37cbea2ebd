"""The figures of `pointing_schuetz`: eye over fingertip, nine targets on a wall, twelve people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from elevation_study import ElevationBias, Row, over_triples, personal_turns
from jaxpoint.geometry.angles import turn_directions
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import left_out
from jaxpoint.pointing.bias.score import bootstrap, errors_deg
from jaxpoint.report.style import PAGE, camera_colors
from pointing_studies import WallPointings, read_schuetz

FEEDBACKS = ("cursor", "hand", "none")


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
                    directions[some] = turn_directions(straight.directions[:, 0], -turn[None])
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
