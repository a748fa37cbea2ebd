"""How well corrected lines meet their targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.geometry.angles import azimuth_elevation, wrap_angle
from jaxpoint.geometry.line import angle_between
from jaxpoint.pointing.bias.pointings import Pointings

_DRAWS = 2000


@dataclass(frozen=True)
class Score:
    """Great-circle errors of G gestures, degrees; the interval holds 95 % of the medians of people drawn anew."""

    median_deg: float
    low_deg: float
    high_deg: float
    mean_deg: float
    left_deg: float  # mean signed error of the azimuth
    high_by_deg: float  # of the elevation
    gestures: int


def errors_deg(pointings: Pointings, directions: Float[np.ndarray, "G 3"]) -> Float[np.ndarray, " G"]:
    """Angles between directions and targets, seen from the first line's origin."""
    return np.rad2deg(np.asarray(angle_between(directions, pointings.to_targets)))


def score(pointings: Pointings, directions: Float[np.ndarray, "G 3"], seed: int = 0) -> Score:
    """Errors of the first line, once it has these directions."""
    errors = errors_deg(pointings, directions)
    low, high = bootstrap(errors, pointings.who, seed)
    off = np.asarray(azimuth_elevation(directions) - azimuth_elevation(pointings.to_targets))
    left = np.rad2deg(np.asarray(wrap_angle(off[:, 0])).mean())
    return Score(
        float(np.median(errors)), low, high, float(errors.mean()), float(left), float(np.rad2deg(off[:, 1].mean())),
        len(errors),
    )  # fmt: skip


def bootstrap(
    values: Float[np.ndarray, " G"], who: np.ndarray, seed: int = 0, statistic=np.median
) -> tuple[float, float]:
    """95 % interval of a statistic over people drawn anew, with all their gestures: people, not gestures, are few."""
    draw = np.random.default_rng(seed)
    by_person = [values[who == person] for person in range(who.max() + 1)]
    drawn = draw.integers(len(by_person), size=(_DRAWS, len(by_person)))
    found = [statistic(np.concatenate([by_person[i] for i in people])) for people in drawn]
    low, high = np.quantile(found, [0.025, 0.975])
    return float(low), float(high)
