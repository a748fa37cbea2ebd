"""By how much a person's own line misses what is meant, learnt from what the lines of all gestures meet.

People who point with the forearm miss by much, but by nearly the same each time. So of all offsets that people have,
those count under which the lines of a person's gestures meet things that can be meant; what was meant need not be
known. A person who points once is treated as anybody.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.geometry.angles import turn_directions
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.line_hypotheses import LineHypothesis, People
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import Behaviour

REACH = 6.0  # standard deviations of people, up to which offsets are tried
FREEDOM = 4.0  # of Student's t, by which people's offsets are distributed: some people are unlike all others
STEP = 0.8  # standard deviations of one person's gestures, from one offset to the next
MOST_STEPS = 20  # to each side
LEAST = 1e-3  # of the middle's prior, below which an offset is not tried

# Lines with axes O g, a behaviour, and the numbers of the g gestures, to probabilities (O g answers) and densities.
Ask = Callable[[PointingLine, Behaviour, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Offsets:
    """Offsets that people may have, and how probable each is before a gesture is seen."""

    angles: Float[np.ndarray, "O 2"]  # rad, to the left of a right arm and up
    prior: Float[np.ndarray, " O"]

    @staticmethod
    def of(people: People) -> Offsets:
        """Student's t about the shared bias, on a grid that is as fine as one person's scatter."""
        covariance = np.asarray(people.between)
        between = np.sqrt(np.diag(covariance))
        within = np.array([np.asarray(people.within.sigma_azimuth), np.asarray(people.within.sigma_elevation)])
        steps = np.clip(np.ceil(REACH * between / (STEP * within)), 1, MOST_STEPS).astype(int)
        sides = [np.linspace(-REACH, REACH, 2 * count + 1) * sigma for count, sigma in zip(steps, between, strict=True)]
        angles = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        squared = np.einsum("oi,ij,oj->o", angles, np.linalg.inv(covariance), angles)
        prior = (1 + squared / FREEDOM) ** (-(FREEDOM + 2) / 2)
        kept = prior > LEAST
        return Offsets(angles[kept], prior[kept] / prior[kept].sum())


def turned_lines(
    lines: PointingLine, offsets: Float[np.ndarray, "... G 2"], mirrored: Bool[np.ndarray, " G"]
) -> PointingLine:
    """Lines without the offsets; a left arm's is the mirror image. The covariance is that of the line before."""
    signs = np.where(mirrored[:, None], [-1.0, 1.0], 1.0)
    shape = offsets.shape[:-1]
    origin, direction = (np.broadcast_to(part, (*shape, 3)) for part in (lines.ray.origin, lines.ray.direction))
    covariance = np.broadcast_to(lines.covariance, (*shape, 6, 6))
    return PointingLine(Ray(origin, np.asarray(turn_directions(direction, -signs * offsets))), covariance)


@dataclass(frozen=True)
class PersonalOffset:
    """What a person's gestures make of one hypothesis of pointing, for people who point more than once."""

    gestures: Int[np.ndarray, " g"]  # their numbers
    offset: Float[np.ndarray, "g 2"]  # rad, to the left of a right arm and up: mean over all of them
    probability: Float[np.ndarray, "g answers"]
    marginal: Float[np.ndarray, " g"]  # density of the line whatever is meant


def learnt_offsets(
    hypothesis: LineHypothesis,
    others: Float[np.ndarray, " G"],
    wrong: Float[np.ndarray, " G"],
    people: Sequence[int],
    mirrored: Bool[np.ndarray, " G"],
    ask: Ask,
) -> PersonalOffset | None:
    """One hypothesis of pointing once each person's offset has been learnt from that person's gestures.

    Bayes' rule on a grid: prior of an offset times, over the other gestures, the density of each under it, whether it
    was made by this hypothesis or by another, or its arm was another limb; times the gesture's own density by this
    hypothesis.

    Args:
        hypothesis: how people differ in it is known.
        others: density of each gesture by all other hypotheses, times their weights, 1/sr.
        wrong: probability that the arm of each gesture is another limb, or none.
        people: who makes each gesture.
        mirrored: left arms.
        ask: probabilities and densities of lines of some gestures, under one behaviour.

    Returns:
        None where nobody points twice, or where it is not known how people differ.
    """
    _, who, count = np.unique(people, return_inverse=True, return_counts=True)
    gestures = np.flatnonzero(count[who] > 1)
    if hypothesis.people is None or not len(gestures):
        return None
    grid, who = Offsets.of(hypothesis.people), who[gestures]
    lines = jax.tree.map(lambda leaf: np.asarray(leaf)[gestures], hypothesis.lines)
    tried = np.broadcast_to(grid.angles[:, None], (len(grid.angles), len(gestures), 2))
    found, marginal = ask(turned_lines(lines, tried, mirrored[gestures]), hypothesis.people.within, gestures)
    density = others[gestures] + hypothesis.weight[gestures] * marginal
    seen = np.log((1 - wrong[gestures]) * density + wrong[gestures] / (4 * np.pi))
    total = np.zeros((len(grid.prior), len(count)))
    np.add.at(total.T, who, seen.T)
    before = _shares(np.log(grid.prior)[:, None] + total[:, who] - seen)
    joint = before * marginal
    own = joint.sum(axis=0)
    share = joint / np.where(own > 0, own, 1.0)
    found = np.einsum("og,oga->ga", share, found)
    return PersonalOffset(gestures, share.T @ grid.angles, found, own)


def _shares(log_weights: Float[np.ndarray, "O g"]) -> Float[np.ndarray, "O g"]:
    """Weights that sum to 1 over the offsets."""
    weights = np.exp(log_weights - log_weights.max(axis=0))
    return weights / weights.sum(axis=0)
