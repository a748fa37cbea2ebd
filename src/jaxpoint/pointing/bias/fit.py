"""Biases from pointings at known targets, scored on people who were left out."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxpoint.compilation import jit
from jaxpoint.errors import InsufficientDataError
from jaxpoint.pointing.bias.bias import Bias, Fitted
from jaxpoint.pointing.bias.learn import KINDS, LOSS_DEG, Kind, Learnt, average, candidates, fit_all, learn_bias
from jaxpoint.pointing.bias.models import AbstractBiasModel, Personal
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.solve import Observed, offsets, pad, power_of_two
from jaxpoint.pointing.bias.spread import Spread

__all__ = ["KINDS", "LOSS_DEG", "Kind", "choose", "fit_bias", "fit_personal_bias", "left_out", "refit"]

FEWEST_PEOPLE = 3
MOST_LINES = 7


def fit_bias(kind: Kind, pointings: Pointings, *, loss_deg: float | None = LOSS_DEG, source: str = "") -> Bias:
    """The bias of a kind, with the spread that it leaves on people who were not fitted.

    A blend may read any of the lines beside the first. Which, is decided on people left out: all choices whose loss
    there exceeds the least by no more than one standard error over people (Breiman et al. 1984) are averaged.

    Args:
        pointings: with targets, of three people or more; all their lines are used by a blend, the first one by others.
        loss_deg: scale of the Cauchy loss; None: least squares.
        source: what the gestures are, for the record.

    Raises:
        InsufficientDataError: fewer than three people, no targets, or a blend without a second line.
    """
    pointings = _check(kind, pointings)
    learnt = _learn(kind, pointings, loss_deg)
    median = float(np.rad2deg(np.median(np.hypot(*np.asarray(learnt.misses)[: len(pointings)].T))))
    return Bias(
        pointings.lines,
        learnt.model,
        learnt.spread,
        learnt.between,
        learnt.within,
        Fitted(source, len(pointings.crowd), len(pointings), _different(pointings), loss_deg, median),
    )


def fit_personal_bias(shared: Bias, pointings: Pointings, *, source: str = "") -> Bias:
    """A shared bias with the offset of one person, from a few known targets.

    Raises:
        InsufficientDataError: no targets, more than one person, a line that the shared bias reads is missing, or nobody
            pointed twice when that was fitted.
    """
    pointings = pointings.of_lines(shared.lines)
    if len(pointings.crowd) > 1:
        raise InsufficientDataError(
            f"A personal bias is one person's, but there are {len(pointings.crowd)} here "
            f"({', '.join(pointings.crowd[:3])}, ...); give a table of one."
        )
    if pointings.targets is None or isinstance(shared.model, Personal):
        what = "is personal already" if isinstance(shared.model, Personal) else "cannot be fitted without targets"
        raise InsufficientDataError(f"The bias {what}; give a shared one and pointings at known targets.")
    if shared.fitted.gestures <= shared.fitted.people:
        raise InsufficientDataError(
            f"The shared bias was fitted on {shared.fitted.gestures} gestures of {shared.fitted.people} people, which "
            "do not show what is a person's own; fit it on people who point twice or more."
        )
    offset = offsets(shared.model, pointings, np.ones((1, len(pointings))), shared.between, shared.within)[0]
    left = left_of_between(shared, len(pointings))
    return Bias(
        shared.lines,
        Personal(shared.model, offset),
        Spread(shared.within.scale + left, shared.within.freedom),
        left,
        shared.within,
        Fitted(source, 1, len(pointings), _different(pointings), shared.fitted.loss_deg, None),
    )


def left_of_between(shared: Bias, gestures: int) -> Float[np.ndarray, "2 2"]:
    """Covariance of a person's offset once some gestures have been seen, rad^2, as if they were Gaussian."""
    between, within = np.asarray(shared.between), np.asarray(shared.within.scale)
    return np.linalg.inv(np.linalg.inv(between) + gestures * np.linalg.inv(within))


def choose(
    kind: Kind, pointings: Pointings, loss_deg: float | None
) -> tuple[Int[np.ndarray, " chosen"], AbstractBiasModel, Float[np.ndarray, "G 2"]]:
    """Candidates of a kind on people left out, each in turn.

    Returns:
        Which candidates are averaged, their average fitted on everybody, and by how much lines so corrected miss on
        people who took no part (rad, to the left and up).
    """
    learnt = _learn(kind, pointings, loss_deg)
    return np.flatnonzero(learnt.chosen), learnt.model, np.asarray(learnt.misses)[: len(pointings)]


def refit(
    kind: Kind,
    pointings: Pointings,
    chosen: Int[np.ndarray, " chosen"],
    weights: Float[np.ndarray, "N G"],
    loss_deg: float | None,
) -> AbstractBiasModel:
    """N models, each the average of the chosen candidates fitted under one row of weights."""
    observed = Observed.of(pointings)
    options = jax.tree.map(lambda leaf: leaf[chosen], candidates(kind, len(pointings.lines)))
    rows = pad(weights.T, len(observed.level)).T
    return average(fit_all(kind, options, observed, jnp.asarray(rows), _radians(loss_deg)), np.ones(len(chosen), bool))


def _learn(kind: Kind, pointings: Pointings, loss_deg: float | None) -> Learnt:
    """`learn_bias` with gestures and people padded, so that few programs are compiled."""
    observed = Observed.of(pointings)
    size, people = len(observed.level), power_of_two(len(pointings.crowd) + 1, 8) - 1
    who, there = pad(pointings.who, size).astype(int), pad(np.ones(len(pointings)), size)
    return _program(kind, observed, who, people, there, _radians(loss_deg))


_program = jit(learn_bias, static_argnames=("kind", "people"))


def _radians(loss_deg: float | None) -> np.float64 | None:
    return None if loss_deg is None else np.float64(np.deg2rad(loss_deg))


def left_out(
    kind: Kind, pointings: Pointings, *, loss_deg: float | None = LOSS_DEG
) -> tuple[Float[np.ndarray, "G 3"], tuple[Bias, ...]]:
    """Every gesture's direction as corrected by a bias that has not seen its person, and these biases, one a person.

    Raises:
        InsufficientDataError: fewer than four people, no targets, or a blend without a second line.
    """
    pointings = _check(kind, pointings, FEWEST_PEOPLE + 1)
    directions, biases = np.zeros((len(pointings), 3)), []
    for person in range(len(pointings.crowd)):
        own = pointings.who == person
        biases.append(fit_bias(kind, pointings.select(~own), loss_deg=loss_deg))
        directions[own] = biases[-1].correct(pointings.directions[own])
    return directions, tuple(biases)


def _check(kind: Kind, pointings: Pointings, people: int = FEWEST_PEOPLE) -> Pointings:
    """The pointings, with the lines that the kind reads."""
    if pointings.targets is None:
        raise InsufficientDataError("A bias cannot be fitted without targets; give target_x_m, target_y_m, target_z_m.")
    if len(pointings.crowd) < people:
        raise InsufficientDataError(
            f"Pointings of {len(pointings.crowd)} people do not show how people differ; at least {people} are needed."
        )
    if kind != "blend":
        return pointings.of_lines(pointings.lines[:1])
    if not 2 <= len(pointings.lines) <= MOST_LINES:
        raise InsufficientDataError(
            f"A blend needs 2 to {MOST_LINES} lines a gesture, but these have {len(pointings.lines)} "
            f"({', '.join(pointings.lines)})."
        )
    return pointings


def _different(pointings: Pointings) -> int:
    assert pointings.targets is not None
    return len(np.unique(pointings.targets.round(6), axis=0))
