"""The conditions of `pointing_ablation.py`, the people they are asked of, and their errors with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxpoint.config.people import PointingSettings, Uniform
from jaxpoint.pointing.bias.models import AbstractBiasModel, Constant, ConstantElevation, Polynomial
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.solve import solve
from pointing_monte_carlo import FINGER_RADIUS_M, Condition, Noise, Sample, point
from pointing_people import Gestures, Setting, exactly, gestures_of, law

THESIS = {
    "finger, 2 views": (19.4980, 12.7720, 14.1094, 5.8165),
    "forearm, 2 views": (8.0373, 4.8850, 8.4933, 0.8672),
    "forearm, 3 views": (4.8915, 5.9539, 2.9127, 1.0825),
}  # table 2: mean azimuth and elevation, their standard deviations, degrees
TEN = 10  # pointings of the thesis
CORRECTIONS = ("constant elevation", "constant", "polynomial")
LOSS_RAD = float(np.deg2rad(1.5))
FITTED_DRAWS = 2
RESAMPLES = 400
A_PERSON = 300  # pointings of each, from which medians are resampled


@dataclass(frozen=True)
class Extent:
    """How much is simulated."""

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

    def __init__(self, options: Extent):
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
        """Those that are fitted, and those that are scored.

        Raises:
            SystemExit: nobody is left on one side, since only what three cameras see counts.
        """
        rooms = self.of(people)
        fitted, scored = ([own.select(own.person % 2 == half) for own in rooms] for half in (0, 1))
        counts = [sum(map(len, half)) for half in (fitted, scored)]
        if not all(counts):
            raise SystemExit(
                f"Three cameras see {counts[0]} gestures to be fitted and {counts[1]} to be scored ('{people}'); ask "
                "for more --gestures, --people or --rooms."
            )
        return fitted, scored


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
            seen = replace(condition, views=3)
            yield Asked("sliding ends", perfect, seen, "none", "ends slide, m", value, slide=value)
    default = law(0.0).approximate
    for value in (0.0, 4.5, 9.0, 15.0):
        people = f"approximate, bias {value:g}"
        bias = replace(default.elevation_bias_deg, mean=value, low=value - 9, high=value + 11)
        crowds.laws[people] = law(0.0, elevation_bias_deg=bias)
        for correction in ("none", "constant"):
            yield Asked("bias", people, planes, correction, "people's mean elevation bias, deg", value)
    for value in (0.0, 1.0, 2.0, 3.0):
        people = f"approximate, scatter x {value:g}"
        up, aside = value * default.elevation_scatter_deg, value * default.azimuth_scatter_deg
        crowds.laws[people] = law(0.0, elevation_scatter_deg=up, azimuth_scatter_deg=aside)
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


def correction(fitted: Sequence[Gestures], one: Asked, seed: int) -> AbstractBiasModel:
    """A bias fitted by Levenberg-Marquardt on pointings of people who are not scored."""
    sample = point(fitted, one.seen, FITTED_DRAWS, seed=seed)
    target = np.concatenate([own.target for own in fitted])[sample.gesture]
    who = np.concatenate([own.person for own in fitted])[sample.gesture]
    pointings = Pointings(
        tuple(map(str, range(len(target)))),
        tuple(map(str, who)),
        (one.condition.line,),
        np.asarray(sample.scored.origin)[:, None],
        np.asarray(sample.scored.direction)[:, None],
        target,
    )
    starts = ConstantElevation(np.zeros(1)), Constant(np.zeros((1, 2))), Polynomial(np.zeros((1, 2, 3)))
    start = starts[CORRECTIONS.index(one.correction)]
    found = solve(start, pointings, np.ones((1, len(pointings))), LOSS_RAD)
    model = jax.tree.map(lambda leaf: leaf[0], found)
    # One program for both constants.
    return Constant(jnp.stack([0.0, model.elevation])) if isinstance(model, ConstantElevation) else model


def row_of(one: Asked, rooms: Sequence[Gestures], sample: Sample, seed: int) -> Row:
    who = np.concatenate([own.person for own in rooms])[sample.gesture]
    azimuth, elevation, angle = (np.rad2deg(getattr(sample.scored, name)) for name in ("azimuth", "elevation", "angle"))
    found: dict[str, float] = {}
    means = {"azimuth": azimuth, "azimuth_abs": abs(azimuth), "elevation": elevation, "elevation_abs": abs(elevation)}
    for name, values in means.items():
        found |= dict(zip((name, f"{name}_low", f"{name}_high"), mean_of(values, who, seed)))
    found |= dict(zip(("angle_median", "angle_low", "angle_high"), median_of(angle, who, seed)))
    found |= dict(
        zip(("object_right", "object_low", "object_high"), mean_of(100.0 * np.asarray(sample.scored.right), who, seed))
    )
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
