"""A bias from gestures at known targets: the pure function inside of `fit_bias`, for `jit`, `vmap` and `grad`.

Candidates are compared on people left out, and what they leave is parted into people and gestures, all with fixed
shapes: people are numbers, and a gesture of weight 0 is not there.
"""

from __future__ import annotations

from itertools import product
from typing import Literal, TypeVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.pointing.bias.models import AbstractBiasModel, Blend, Constant, ConstantElevation, Polynomial
from jaxpoint.pointing.bias.solve import LEAST_SQUARES, Observed, fit_models
from jaxpoint.pointing.bias.spread import Spread, fit_spread

Kind = Literal["none", "constant-elevation", "constant", "polynomial", "blend"]
KINDS: tuple[Kind, ...] = get_args(Kind)
LOSS_DEG = 1.5
DEGREE = 2
_BETWEEN_FLOOR = np.deg2rad(0.1) ** 2

Model = TypeVar("Model", bound=AbstractBiasModel)


class Learnt(eqx.Module):
    """A bias, and what it leaves on people who took no part."""

    model: AbstractBiasModel  # the average of the chosen candidates, fitted on everybody
    chosen: Bool[Array, " K"]  # candidates that are averaged
    misses: Float[Array, "G 2"]  # rad, to the left and up, on people who took no part; 0 where the weight is
    spread: Spread  # of somebody who was not fitted
    between: Float[Array, "2 2"]  # covariance of people's offsets, rad^2
    within: Spread  # of one person's gestures about their own middle


def learn_bias(
    kind: Kind,
    observed: Observed,
    who: Int[AnyArray, " G"],
    people: int,
    weights: Float[AnyArray, " G"] | None = None,
    loss_rad: Float[AnyArray, ""] | float | None = LOSS_DEG * np.pi / 180,
) -> Learnt:
    """The bias of a kind, with the spread that it leaves on people who were not fitted.

    Derivatives are those of the optimum with the candidates that were chosen.

    Args:
        observed: gestures with targets.
        who: number of each gesture's person, below `people`.
        people: how many numbers there are; some may have no gesture.
        weights: 0 leaves a gesture out; all 1 if left out.
        loss_rad: scale of the Cauchy loss; None: least squares.
    """
    weights = jnp.ones_like(observed.level) if weights is None else as_float(weights)
    who = jnp.where(weights > 0, jnp.asarray(who), people)  # gestures without weight belong to a person of their own
    chosen, model, misses = choose(kind, observed, who, people, weights, loss_rad)
    between, within = part_people(misses, who, people)
    spread = fit_spread(misses, jnp.where(weights > 0, 1.0, 0.0))
    return Learnt(model, chosen, misses, spread, between, within)


def choose(
    kind: Kind,
    observed: Observed,
    who: Int[Array, " G"],
    people: int,
    weights: Float[Array, " G"],
    loss_rad: Float[AnyArray, ""] | float | None,
) -> tuple[Bool[Array, " K"], AbstractBiasModel, Float[Array, "G 2"]]:
    """Candidates of a kind on people left out, each in turn.

    All choices whose loss there exceeds the least by no more than one standard error over people (Breiman et al. 1984)
    are averaged.

    Returns:
        Which candidates are averaged, their average fitted on everybody, and by how much lines so corrected miss on
        people who took no part (rad, to the left and up).
    """
    options = candidates(kind, observed.angles.shape[1])
    rows = jnp.where(jnp.arange(people + 1)[:, None] == who[None], 0.0, weights[None])  # the last row is everybody
    fitted = fit_all(kind, options, observed, rows, loss_rad)
    misses = jax.vmap(jax.vmap(observed.misses))(fitted)
    misses = misses[:, jnp.minimum(who, people), jnp.arange(len(who))]
    misses = jnp.where((weights > 0)[None, :, None], misses, 0.0)
    scale = np.deg2rad(LOSS_DEG) if loss_rad is None else loss_rad
    near = _near_the_best(jnp.log1p(jnp.sum(misses**2, axis=2) / scale**2), who, people)
    everybody = average(jax.tree.map(lambda leaf: leaf[:, people], fitted), near)
    return near, everybody, jnp.sum(jnp.where(near[:, None, None], misses, 0.0), axis=0) / jnp.sum(near)


def _near_the_best(loss: Float[Array, "K G"], who: Int[Array, " G"], people: int) -> Bool[Array, " K"]:
    """Candidates whose mean loss over people is within one standard error of the least."""
    count = _count(who, people)
    there = count > 0
    persons = jnp.sum(there)
    by_person = jax.vmap(lambda row: jax.ops.segment_sum(row, who, people + 1)[:people])(loss)
    by_person = jnp.where(there[None], by_person / jnp.maximum(count, 1)[None], 0.0)
    means = jnp.sum(by_person, axis=1) / persons
    best = jnp.argmin(means)
    apart = jnp.where(there, by_person[best] - means[best], 0.0)
    variance = jnp.sum(apart**2) / jnp.maximum(persons - 1, 1)
    return jax.lax.stop_gradient(means <= means[best] + jnp.sqrt(variance / persons))


def candidates(kind: Kind, lines: int) -> AbstractBiasModel:
    """Where fits start, with a leading axis K: of a blend, every choice of lines beside the first."""
    if kind == "blend":
        used = np.array(list(product((False, True), repeat=lines - 1)))
        return Blend(np.zeros((len(used), 2)), np.zeros((len(used), 2, lines - 1)), used)
    simple = {
        "none": Constant(np.zeros((1, 2))),
        "constant-elevation": ConstantElevation(np.zeros(1)),
        "constant": Constant(np.zeros((1, 2))),
        "polynomial": Polynomial(np.zeros((1, 2, DEGREE + 1))),
    }
    return simple[kind]


def fit_all(
    kind: Kind,
    options: Model,
    observed: Observed,
    weights: Float[Array, "N G"],
    loss_rad: Float[AnyArray, ""] | float | None,
) -> Model:
    """Every candidate fitted under every row of weights: leading axes K, N."""
    shape = jax.tree.leaves(options)[0].shape[0], len(weights)
    models = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:, None], (*shape, *leaf.shape[1:])), options)
    if kind == "none":
        return models
    loss = jnp.asarray(LEAST_SQUARES if loss_rad is None else loss_rad, observed.level.dtype)
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), models)
    found = fit_models(flat, observed, jnp.tile(weights, (shape[0], 1)), loss)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), found)


def average(models: AbstractBiasModel, chosen: Bool[AnyArray, " K"]) -> AbstractBiasModel:
    """The mean of the chosen ones over the leading axis; a line that one blend leaves out has weight 0 there."""
    if not isinstance(models, Blend):
        return jax.tree.map(lambda leaf: leaf[0], models)

    def mean(leaf: Array) -> Array:
        shares = jnp.asarray(chosen, leaf.dtype).reshape(-1, *[1] * (leaf.ndim - 1))
        return jnp.sum(leaf * shares, axis=0) / jnp.sum(shares)

    weights = jnp.where(models.used[..., None, :], models.weights, 0.0)
    taken = models.used & jnp.reshape(jnp.asarray(chosen), (-1, *[1] * (models.used.ndim - 1)))
    return Blend(mean(models.offset), mean(weights), taken.any(axis=0))


def part_people(
    misses: Float[AnyArray, "G 2"], who: Int[AnyArray, " G"], people: int
) -> tuple[Float[Array, "2 2"], Spread]:
    """Covariance of people's offsets (rad^2), and how each one's gestures scatter about the person's own.

    Scatter is estimated from each gesture against the median of the same person's others. That median has an error too,
    as few gestures hardly determine it, and so have the medians from which the covariance of people is made. Where
    nobody pointed twice, all of the misses are called scatter.

    Args:
        who: a number that is not below `people` leaves a gesture out.
    """
    misses, who = as_float(misses), jnp.asarray(who)
    count = jnp.concatenate([_count(who, people), jnp.zeros(1, int)])[jnp.minimum(who, people)]
    twice, there = count > 1, count > 0
    middles, others = _medians(misses, who, people)
    shrink = jnp.sqrt(1 - 1 / jnp.maximum(count, 2))[:, None]
    apart = jnp.where(twice[:, None], shrink * (misses - others), jnp.where(there[:, None], misses, 0.0))
    some = twice.any()
    within = fit_spread(apart, jnp.where(jnp.where(some, twice, there), 1.0, 0.0))
    sizes = _count(who, people)
    persons = jnp.maximum(jnp.sum(sizes > 0), 1)
    by_scatter = within.scale * jnp.sum(jnp.where(sizes > 0, 1 / jnp.maximum(sizes, 1), 0.0)) / persons
    size, axes = jnp.linalg.eigh(middles.T @ middles / persons - by_scatter)
    between = (axes * jnp.maximum(size, _BETWEEN_FLOOR)[None]) @ axes.T
    return jnp.where(some, between, _BETWEEN_FLOOR * jnp.eye(2, dtype=between.dtype)), within


def _count(who: Int[Array, " G"], people: int) -> Int[Array, " people"]:
    """Gestures of each person."""
    return jnp.bincount(who, length=people + 1)[:people]


def _medians(
    misses: Float[Array, "G 2"], who: Int[Array, " G"], people: int
) -> tuple[Float[Array, "people 2"], Float[Array, "G 2"]]:
    """Each person's median miss (0 without a gesture), and for each gesture that of the same person's others."""
    sizes = jnp.bincount(who, length=people + 1)
    first = jnp.cumsum(sizes) - sizes

    def of_one(values: Float[Array, " G"]) -> tuple[Float[Array, " people"], Float[Array, " G"]]:
        order = jnp.lexsort((values, who))
        ranked = values[order]
        rank = jnp.zeros_like(who).at[order].set(jnp.arange(len(who))) - first[who]
        last = len(who) - 1

        def at(place: Int[Array, "..."], start: Int[Array, "..."]) -> Float[Array, "..."]:
            return ranked[jnp.clip(start + place, 0, last)]

        low, high = (sizes - 1) // 2, sizes // 2
        middles = jnp.where(sizes > 0, (at(low, first) + at(high, first)) / 2, 0.0)[:people]
        low, high = (sizes[who] - 2) // 2, (sizes[who] - 1) // 2  # among the others, of which one comes before or after
        one, other = (at(place + (place >= rank), first[who]) for place in (low, high))
        return middles, (one + other) / 2

    return jax.vmap(of_one, in_axes=1, out_axes=1)(misses)
