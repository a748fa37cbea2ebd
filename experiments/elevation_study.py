"""What the two studies of pointing share: the settings, a figure, and how lines and probabilities are scored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Bool, Float

from jaxpoint.geometry.angles import turn_directions
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import LOSS_DEG
from jaxpoint.pointing.bias.models import Constant
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.solve import offsets
from jaxpoint.pointing.bias.spread import Spread

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


def plain_means(own: Pointings) -> np.ndarray:
    """Directions turned back by the mean errors of the other people, as the data's notes have it."""
    turns = np.stack([own.errors[own.who != person].mean(axis=0) for person in range(len(own.crowd))])[own.who]
    return np.asarray(turn_directions(own.directions[:, 0], -turns))


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


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
