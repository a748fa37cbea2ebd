"""Biases from pointings at known targets, judged on people who took no part."""

from __future__ import annotations

from itertools import product
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.errors import InsufficientDataError
from jaxpoint.pointing.bias.bias import Bias, Fitted
from jaxpoint.pointing.bias.models import AbstractModel, Blend, Constant, ConstantElevation, Personal, Polynomial
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.solve import all_misses, offsets, solve
from jaxpoint.pointing.bias.spread import Spread, fit_spread

Kind = Literal["none", "constant-elevation", "constant", "polynomial", "blend"]
KINDS: tuple[Kind, ...] = get_args(Kind)
LOSS_DEG = 1.5
DEGREE = 2
FEWEST_PEOPLE = 3
MOST_LINES = 7
_BETWEEN_FLOOR = np.deg2rad(0.1) ** 2


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
    pointings = _checked(kind, pointings)
    _, model, misses = choose(kind, pointings, loss_deg)
    between, within = _people(misses, pointings.who)
    median = float(np.rad2deg(np.median(np.hypot(*misses.T))))
    return Bias(
        pointings.lines,
        model,
        fit_spread(misses, np.ones(len(pointings))),
        between,
        within,
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
) -> tuple[Int[np.ndarray, " chosen"], AbstractModel, Float[np.ndarray, "G 2"]]:
    """Candidates of a kind on people left out, each in turn.

    Returns:
        Which candidates are averaged, their average fitted on everybody, and by how much lines so corrected miss on
        people who took no part (rad, to the left and up).
    """
    candidates, people = _candidates(kind, len(pointings.lines)), len(pointings.crowd)
    weights = np.ones((people + 1, len(pointings)))  # the last row is everybody
    weights[pointings.who, np.arange(len(pointings))] = 0.0
    solved = _all(kind, candidates, pointings, weights, loss_deg)
    misses = all_misses(solved, pointings).reshape(len(candidates), people + 1, len(pointings), 2)
    misses = misses[:, pointings.who, np.arange(len(pointings))]
    scale = np.deg2rad(LOSS_DEG if loss_deg is None else loss_deg)
    loss = np.log1p(np.sum(misses**2, axis=2) / scale**2)
    by_person = np.stack([loss[:, pointings.who == person].mean(axis=1) for person in range(people)], axis=1)
    means = by_person.mean(axis=1)
    best = np.argmin(means)
    near = np.flatnonzero(means <= means[best] + by_person[best].std(ddof=1) / np.sqrt(people))
    everybody = _average(jax.tree.map(lambda leaf: leaf[near * (people + 1) + people], solved))
    return near, everybody, misses[near].mean(axis=0)


def refit(
    kind: Kind,
    pointings: Pointings,
    chosen: Int[np.ndarray, " chosen"],
    weights: Float[np.ndarray, "N G"],
    loss_deg: float | None,
) -> AbstractModel:
    """N models, each the average of the chosen candidates fitted under one row of weights."""
    candidates = [_candidates(kind, len(pointings.lines))[i] for i in chosen]
    solved = _all(kind, candidates, pointings, weights, loss_deg)
    return _average(jax.tree.map(lambda leaf: leaf.reshape(len(candidates), len(weights), *leaf.shape[1:]), solved))


def left_out(
    kind: Kind, pointings: Pointings, *, loss_deg: float | None = LOSS_DEG
) -> tuple[Float[np.ndarray, "G 3"], tuple[Bias, ...]]:
    """Every gesture's direction as corrected by a bias that has not seen its person, and these biases, one a person.

    Raises:
        InsufficientDataError: fewer than four people, no targets, or a blend without a second line.
    """
    pointings = _checked(kind, pointings, FEWEST_PEOPLE + 1)
    directions, biases = np.zeros((len(pointings), 3)), []
    for person in range(len(pointings.crowd)):
        own = pointings.who == person
        biases.append(fit_bias(kind, pointings.select(~own), loss_deg=loss_deg))
        directions[own] = biases[-1].correct(pointings.directions[own])
    return directions, tuple(biases)


def _candidates(kind: Kind, lines: int) -> list[AbstractModel]:
    if kind == "blend":
        choices = product((False, True), repeat=lines - 1)
        return [Blend(np.zeros(2), np.zeros((2, lines - 1)), np.array(used, bool)) for used in choices]
    simple = {
        "none": Constant(np.zeros(2)),
        "constant-elevation": ConstantElevation(np.float64(0.0)),
        "constant": Constant(np.zeros(2)),
        "polynomial": Polynomial(np.zeros((2, DEGREE + 1))),
    }
    return [simple[kind]]


def _all(
    kind: Kind,
    candidates: list[AbstractModel],
    pointings: Pointings,
    weights: Float[np.ndarray, "N G"],
    loss_deg: float | None,
) -> AbstractModel:
    """Every candidate fitted under every row of weights, along one leading axis: candidate by candidate."""
    models = jax.tree.map(lambda *leaves: jnp.repeat(jnp.stack(leaves), len(weights), axis=0), *candidates)
    if kind == "none":
        return models
    rows = np.tile(weights, (len(candidates), 1))
    return solve(models, pointings, rows, None if loss_deg is None else float(np.deg2rad(loss_deg)))


def _average(models: AbstractModel) -> AbstractModel:
    """The mean over the leading axis; a line that one blend leaves out has weight 0 there."""
    if not isinstance(models, Blend):
        return jax.tree.map(lambda leaf: leaf[0], models)
    weights = jnp.where(models.used[..., None, :], models.weights, 0.0)
    return Blend(models.offset.mean(axis=0), weights.mean(axis=0), models.used.any(axis=0))


def _checked(kind: Kind, pointings: Pointings, people: int = FEWEST_PEOPLE) -> Pointings:
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


def _people(misses: Float[np.ndarray, "G 2"], who: Int[np.ndarray, " G"]) -> tuple[Float[np.ndarray, "2 2"], Spread]:
    """Covariance of people's offsets (rad^2), and how each one's gestures scatter about the person's own.

    Scatter is told by each gesture against the median of the same person's others, which errs as well: few gestures
    hardly tell a middle. By as much the middles err of which people's covariance is made. Where nobody pointed twice,
    all of the misses are called scatter.
    """
    count = np.bincount(who)
    twice = count[who] > 1
    if not twice.any():
        return _BETWEEN_FLOOR * np.eye(2), fit_spread(misses, np.ones(len(who)))
    others = np.stack([np.median(misses[_others(who, i)], axis=0) for i in np.flatnonzero(twice).tolist()])
    shrink = np.sqrt(1 - 1 / count[who][twice])[:, None]
    within = fit_spread(shrink * (misses[twice] - others), np.ones(len(others)))
    middles = _middles(misses, who)
    by_scatter = np.asarray(within.scale) * np.mean(1 / count)
    size, axes = np.linalg.eigh(middles.T @ middles / len(middles) - by_scatter)
    return (axes * np.maximum(size, _BETWEEN_FLOOR)) @ axes.T, within


def _others(who: Int[np.ndarray, " G"], gesture: int) -> Bool[np.ndarray, " G"]:
    """The other gestures of the same person."""
    return (who == who[gesture]) & (np.arange(len(who)) != gesture)


def _middles(misses: Float[np.ndarray, "G 2"], who: Int[np.ndarray, " G"]) -> Float[np.ndarray, "people 2"]:
    """Each person's median miss."""
    return np.stack([np.median(misses[who == person], axis=0) for person in range(who.max() + 1)])


def _different(pointings: Pointings) -> int:
    assert pointings.targets is not None
    return len(np.unique(pointings.targets.round(6), axis=0))
