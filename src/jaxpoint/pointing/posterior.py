"""How probable each object is as the one that is meant, and that none is.

The distribution of one line's direction has its own covariance, origin included, plus the spread of people who point.
`mass` is the share of it on each object. A person who means an object aims somewhere on it, so the likelihood of a
line is the mean of that distribution over the object: its mass over the solid angle that it fills. Times the prior of
the object (all are alike before the line is seen) this is Bayes' rule; with `prior="size"` large objects are meant as
much more often as they are larger, and the likelihood times the prior is the mass itself. A person who means nothing
points anywhere: the share of the distribution that no object takes, over half a sphere.

Objects behind others may still be meant: the occluded part of their mass counts `hidden` times as much. People point
nearer to the middle of an object than to its edge: with `aimed` below 1 somewhere on the part of that size about its
middle. Without it a small object before or on a large one takes nearly all lines that pass it (on a table: the book).
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.devices import on_cpu
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.hits import nearest_first
from jaxpoint.pointing.mass import OutlineView, across
from jaxpoint.pointing.objects import Choice, Objects, Shapes
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives

AMBIGUOUS = 3.0
_DIRECTIONS = 16  # sampled, by which the hidden part of an object is estimated
_ROUNDING = 1e-6  # of the largest variance: how far below 0 a variance may be rounded
_TOUCH = 1e-9  # relative distance within which two primitives hide nothing of each other


class Behaviour(eqx.Module):
    """How people's lines scatter about what they mean; the defaults are not measured.

    Fields may carry the leading axes of the lines: a behaviour each.
    """

    sigma_azimuth: Float[Array, "*#batch"] = eqx.field(converter=as_float, default=np.deg2rad(4.0))  # rad, level
    sigma_elevation: Float[Array, "*#batch"] = eqx.field(converter=as_float, default=np.deg2rad(4.0))  # rad
    freedom: int | None = eqx.field(static=True, default=4)  # of Student's t, 1 or more; None: Gaussian
    nothing: Float[Array, "*#batch"] = eqx.field(converter=as_float, default=0.1)  # prior that no object is meant
    hidden: Float[Array, "*#batch"] = eqx.field(converter=as_float, default=0.3)  # weight of what another object hides
    prior: Literal["equal", "size"] = eqx.field(static=True, default="equal")
    aimed: float = eqx.field(static=True, default=1.0)  # of an object's size, about its middle, where people aim; <= 1

    def __check_init__(self) -> None:
        if not 0 < self.aimed <= 1:
            raise ValueError(f"People aim at a share of an object's size, so `aimed` lies in 0..1; it is {self.aimed}.")
        if self.freedom is not None and (self.freedom != int(self.freedom) or self.freedom < 1):
            raise ValueError(
                f"Student's t has 1, 2, 3, ... degrees of freedom here, so `freedom` cannot be {self.freedom:g}; "
                "give a whole number, or None for a Gaussian."
            )

    @property
    def spread(self) -> Float[Array, "2 2"]:
        """Covariance to the left and up, rad^2. No leading axes."""
        return jnp.diag(jnp.stack([self.sigma_azimuth, self.sigma_elevation]) ** 2)


class Posterior(eqx.Module):
    """Of each line: probabilities that sum to 1 over the objects and `nothing`.

    Of an invalid line all values are NaN, `nothing` too, and `ambiguous` is true; see `posterior`.
    """

    probability: Float[Array, "*batch K"]
    nothing: Float[Array, "*batch"]
    mass: Float[Array, "*batch K"]  # share of the line's distribution where people aim, whatever stands before it
    visible: Float[Array, "*batch K"]  # share of that mass that no other object hides, 0..1
    marginal: Float[Array, "*batch"]  # density of the line whatever is meant, 1/sr; with `prior="size"` a share, 0..1
    ambiguous: Bool[Array, "*batch"]  # the best two answers, nothing among them, are within a factor of AMBIGUOUS

    @property
    def order(self) -> Int[Array, "*batch K"]:
        """The objects, likeliest first."""
        return jnp.argsort(-self.probability, axis=-1)


def posterior(
    lines: PointingLine,
    objects: Objects,
    behaviour: Behaviour | None = None,
    prior: Float[AnyArray, " K"] | None = None,
    evidence: Float[AnyArray, "*#batch K"] | None = None,
) -> Posterior:
    """Probability of each object and of nothing, given where lines point.

    Invalid lines yield NaN throughout, and nothing is raised: those with a non-finite value, a direction of length 0 or
    a negative variance. So do lines whose prior or evidence is NaN.

    Args:
        lines: any leading axes; unit directions, corrected for bias.
        behaviour: spread of the person who points, and the priors of being hidden and of nothing; of all lines, or
            with the lines' leading axes.
        prior: relative weights of the objects, all alike if left out.
        evidence: likelihood factors of what else is known, as from words.
    """
    behaviour = Behaviour() if behaviour is None else behaviour
    batch = lines.ray.origin.shape[:-1]
    weights = np.full((*batch, len(objects)), 1 / len(objects), lines.ray.origin.dtype)
    if prior is not None:
        weights = jnp.broadcast_to(as_float(prior) / jnp.sum(as_float(prior)), weights.shape)
    if evidence is not None:
        weights = weights * jnp.broadcast_to(as_float(evidence), weights.shape)
    xp = np if on_cpu(lines, behaviour) else jnp  # for a few lines numpy is quicker, but it lives on the host
    behaviour = jax.tree.map(lambda leaf: _of_each(leaf, batch, xp), behaviour)
    ask = partial(_posterior, objects.shapes)
    return over_lines(ask, lines.ray.origin, lines.ray.direction, lines.covariance, weights, behaviour)


def _of_each(leaf: AnyArray, batch: tuple[int, ...], xp: Any) -> AnyArray:
    """With a line's own in every place; xp is numpy or jax.numpy."""
    return (jnp if isinstance(leaf, Tracer) else xp).broadcast_to(leaf, batch)


@jit
def _posterior(
    shapes: Shapes,
    origin: Float[Array, "G 3"],
    direction: Float[Array, "G 3"],
    covariance: Float[Array, "G 6 6"],
    weights: Float[Array, "G K"],
    behaviour: Behaviour,
) -> Posterior:
    """Of lines with one leading axis."""

    def one(line: PointingLine, weights: Array, behaviour: Behaviour, choices: list[Choice]) -> Posterior:
        return _of_line(ready.select(choices), aimed.select(choices), behaviour, line, weights)

    aimed = shapes if behaviour.aimed == 1 else shapes.shrink(behaviour.aimed)
    ready = Shapes(tuple(own.precompute() for own in shapes.primitives), shapes.owners)
    choices = [_nearest_primitives(own, origin, direction) for own in shapes.primitives]
    return jax.vmap(one)(PointingLine(Ray(origin, direction), covariance), weights, behaviour, choices)


def _nearest_primitives(
    primitives: AbstractPrimitives, origin: Float[Array, "G 3"], direction: Float[Array, "G 3"]
) -> tuple[Int[Array, "G n"], Bool[Array, "G n"]] | None:
    """Of each line the primitives that are considered, nearest by angle first; the others count as missed."""
    if primitives.most is None:
        return None
    bounds = jax.lax.stop_gradient(jax.vmap(primitives.tangent_bounds)(origin, direction))
    index, count = nearest_first(bounds, min(primitives.most, bounds.shape[1]))
    return index, jnp.arange(index.shape[1])[None] < count[:, None]


def _of_line(
    shapes: Shapes, aimed: Shapes, behaviour: Behaviour, line: PointingLine, weights: Float[Array, " K"]
) -> Posterior:
    def by_object(parts: Float[Array, " P"]) -> Float[Array, " K"]:
        return jax.ops.segment_sum(parts, shapes.owner, weights.shape[0])

    view = OutlineView.of(line, behaviour.spread, behaviour.freedom)
    parts = aimed.each(lambda own: own.masses(view))
    seen = _visible(line, shapes, behaviour)
    angles = aimed.each(lambda own: own.solid_angles(line.ray.origin))
    mass, shown, angle = by_object(parts), by_object(parts * seen), by_object(angles)
    counted = shown + behaviour.hidden * (mass - shown)
    none = jnp.clip(1 - jnp.sum(shown), 0.0, 1.0) / (2 * jnp.pi)
    if behaviour.prior == "equal":
        counted = counted / jnp.where(angle > 0, angle, 1.0)
    else:
        none = none * 2 * jnp.pi
    scores, nothing = (1 - behaviour.nothing) * weights * counted, behaviour.nothing * none
    total = jnp.sum(scores) + nothing
    safe = jnp.where(total > 0, total, 1.0)
    chance = scores / safe
    rest = jnp.where(total > 0, nothing / safe, 1.0)
    best = jnp.argmax(chance)
    second = jnp.max(jnp.where(jnp.arange(len(chance)) == best, 0.0, chance))
    first = jnp.max(chance)
    ambiguous = jnp.maximum(first, rest) < AMBIGUOUS * jnp.maximum(jnp.minimum(first, rest), second)
    visible = jnp.where(mass > 0, shown / jnp.where(mass > 0, mass, 1.0), 1.0)
    sound = _is_valid(line) & ~jnp.isnan(total)
    chance, rest, mass, visible, total = (
        jnp.where(sound, found, jnp.nan) for found in (chance, rest, mass, visible, total)
    )
    return Posterior(chance, rest, mass, visible, total, ~sound | ambiguous)


def _is_valid(line: PointingLine) -> Bool[Array, ""]:
    """Whether all its values are finite, it has a direction, and no variance is negative beyond rounding."""
    variance = jnp.diagonal(line.covariance)
    least = -_ROUNDING * jnp.max(jnp.abs(variance))
    finite = jax.tree.reduce(jnp.logical_and, jax.tree.map(lambda leaf: jnp.all(jnp.isfinite(leaf)), line))
    return finite & jnp.any(line.ray.direction != 0) & jnp.all(variance >= least)


def _visible(line: PointingLine, shapes: Shapes, behaviour: Behaviour) -> Float[Array, " P"]:
    """How much of each primitive's share of the distribution no other one hides, 0..1.

    Estimated by directions spread evenly like the distribution, and one more to the place of the primitive that is
    nearest to the line, so that small and far ones are sampled too.
    """
    line, shapes, behaviour = jax.lax.stop_gradient((line, shapes, behaviour))
    base = across(line.ray.direction)
    scale = jnp.linalg.norm(base @ line.direction_covariance @ base.T + behaviour.spread) ** 0.5
    left, up = scale * jnp.asarray(_normal_points().T, base.dtype)
    spread = tuple(line.ray.direction[i] + left * base[0, i] + up * base[1, i] for i in range(3))
    own_places = shapes.each(lambda own: own.nearest_places(line.ray))
    towards = _unit(*(jnp.concatenate(pair) for pair in zip(spread, own_places)))

    def meet(x: Array, y: Array, z: Array) -> Array:
        return shapes.each(lambda own: own.meet(Ray(line.ray.origin, jnp.stack([x, y, z])))[0])

    distance = jax.vmap(meet)(*towards)
    hit = jnp.isfinite(distance)
    seen = hit & (distance <= (1 + _TOUCH) * jnp.min(distance, axis=1, keepdims=True))
    # A direction to the place of a primitive counts for that one alone.
    own = jnp.concatenate([jnp.ones((len(left), distance.shape[1])), jnp.eye(distance.shape[1])])
    hits, sights = jnp.sum(own * hit, axis=0), jnp.sum(own * seen, axis=0)
    return jnp.where(hits > 0, sights / jnp.maximum(hits, 1), 1.0)


def _unit(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Directions by component: sums of few terms fuse."""
    square = x**2 + y**2 + z**2
    shrink = jax.lax.rsqrt(jnp.where(square > 0, square, 1.0))
    return x * shrink, y * shrink, z * shrink


def _normal_points() -> np.ndarray:
    """Places spread like a standard normal distribution, evenly: a spiral by the golden angle."""
    place = np.arange(_DIRECTIONS)
    radius = np.sqrt(-2 * np.log((place + 0.5) / _DIRECTIONS))
    turn = np.pi * (3 - np.sqrt(5)) * place
    return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
