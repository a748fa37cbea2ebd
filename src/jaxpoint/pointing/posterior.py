"""How probable each object is as the one that is meant, and that none is.

For one line the distribution of its direction is its own covariance, origin included, plus the spread of people who
point. `mass` is the share of it on each object. Whoever means an object aims somewhere on it, so the likelihood of a
line is the mean of that distribution over the object: its mass over the solid angle that it fills. Times the prior of
the object (all are alike before the line is seen) this is Bayes' rule; with `prior="size"` large objects are meant as
much more often as they are larger, and the likelihood times the prior is the mass itself. Whoever means nothing points
anywhere: the share of the distribution that no object takes, over half a sphere.

Objects behind others may still be meant: the hidden part of their mass counts `hidden` times as much.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import Ray, normalised
from jaxpoint.pointing.hits import meet
from jaxpoint.pointing.line import PointingLine
from jaxpoint.pointing.lines import over_lines
from jaxpoint.pointing.mass import across, masses, solid_angles
from jaxpoint.pointing.objects import Objects, Shapes

AMBIGUOUS = 3.0
_DIRECTIONS = 24  # by which it is told how much of an object is hidden
_PROBED = 8  # of the likeliest objects it is also asked whether the place nearest to the line is hidden


class Behaviour(eqx.Module):
    """How people's lines lie about what they mean; the defaults are no measurement of anybody."""

    sigma_azimuth: Float[Array, ""] = eqx.field(converter=as_float, default=np.deg2rad(4.0))  # rad, across, level
    sigma_elevation: Float[Array, ""] = eqx.field(converter=as_float, default=np.deg2rad(4.0))  # rad
    freedom: int | None = eqx.field(static=True, default=4)  # of Student's t, even; None: Gaussian
    nothing: Float[Array, ""] = eqx.field(converter=as_float, default=0.1)  # prior that no object is meant
    hidden: Float[Array, ""] = eqx.field(converter=as_float, default=0.3)  # weight of what another object hides
    prior: Literal["equal", "size"] = eqx.field(static=True, default="equal")

    @property
    def spread(self) -> Float[Array, "2 2"]:
        """Covariance to the left and up, rad^2."""
        return jnp.diag(jnp.stack([self.sigma_azimuth, self.sigma_elevation]) ** 2)


class Posterior(eqx.Module):
    """Of each line: probabilities that sum to 1 over the objects and `nothing`."""

    probability: Float[Array, "*batch K"]
    nothing: Float[Array, "*batch"]
    mass: Float[Array, "*batch K"]  # share of the line's distribution on each object, whatever stands before it
    visible: Float[Array, "*batch K"]  # share of that mass that no other object hides, 0..1
    order: Int[Array, "*batch K"]  # objects, likeliest first
    ambiguous: Bool[Array, "*batch"]  # the best two answers, nothing among them, are within a factor of AMBIGUOUS


def posterior(
    lines: PointingLine,
    objects: Objects,
    behaviour: Behaviour | None = None,
    prior: Float[AnyArray, " K"] | None = None,
    evidence: Float[AnyArray, "*#batch K"] | None = None,
) -> Posterior:
    """Probability of each object and of nothing, given where lines point.

    Args:
        lines: any leading axes; unit directions, corrected for bias.
        behaviour: spread of the person who points, and the priors of being hidden and of nothing.
        prior: relative weights of the objects, all alike if left out.
        evidence: likelihood factors of what else is known, as from words.
    """
    behaviour = Behaviour() if behaviour is None else behaviour
    batch = lines.ray.origin.shape[:-1]
    dtype = lines.ray.origin.dtype
    weights = jnp.ones(len(objects), dtype) if prior is None else as_float(prior)
    weights = weights / jnp.sum(weights)
    weights = jnp.broadcast_to(weights if evidence is None else weights * as_float(evidence), (*batch, len(objects)))
    # The covariance as nine rows more: over_lines wants a last axis alone.
    ask = partial(_posterior, objects.shapes, behaviour)
    return over_lines(ask, lines.ray.origin, lines.ray.direction, lines.covariance, weights)


@jit
def _posterior(
    shapes: Shapes, behaviour: Behaviour, origin: Array, direction: Array, covariance: Array, weights: Array
):
    def one(origin: Array, direction: Array, covariance: Array, weights: Array) -> Posterior:
        return _of_line(shapes, behaviour, PointingLine(Ray(origin, direction), covariance), weights)

    return jax.vmap(one)(origin, direction, covariance, weights)


def _of_line(shapes: Shapes, behaviour: Behaviour, line: PointingLine, weights: Float[Array, " K"]) -> Posterior:
    count = weights.shape[0]
    by_part = masses(line, shapes, behaviour.spread, behaviour.freedom)
    mass = _by_object(by_part, shapes, count)
    visible = _visible(line, shapes, behaviour, by_part, count)
    shown = mass * (visible + behaviour.hidden * (1 - visible))
    angle = _by_object(solid_angles(line.ray.origin, shapes), shapes, count)
    if behaviour.prior == "size":
        scale = angle * weights
        likelihood = shown * weights / jnp.sum(jnp.where(scale > 0, scale, 0.0))
    else:
        likelihood = weights * shown / jnp.where(angle > 0, angle, 1.0)
    none = jnp.clip(1 - jnp.sum(mass * visible), 0.0, 1.0) / (2 * jnp.pi)
    scores = jnp.concatenate([(1 - behaviour.nothing) * likelihood, (behaviour.nothing * none)[None]])
    total = jnp.sum(scores)
    chances = jnp.where(total > 0, scores / jnp.where(total > 0, total, 1.0), jnp.eye(count + 1)[-1])
    best = jax.lax.top_k(jax.lax.stop_gradient(chances), 2)[0]
    order = jnp.argsort(-jax.lax.stop_gradient(chances[:-1]))
    return Posterior(chances[:-1], chances[-1], mass, visible, order.astype(jnp.int32), best[0] < AMBIGUOUS * best[1])


def _by_object(parts: Float[Array, " F+S"], shapes: Shapes, count: int) -> Float[Array, " K"]:
    return jax.ops.segment_sum(parts, shapes.owner, count)


def _visible(
    line: PointingLine, shapes: Shapes, behaviour: Behaviour, by_part: Array, count: int
) -> Float[Array, " K"]:
    """How much of each object's share of the distribution no other object hides.

    Told by directions drawn evenly from the distribution. An object on which few or none of them fall is also asked at
    the place of its part that is nearest to the line, if it is among the likeliest; else it counts as seen.
    """
    base = across(line.ray.direction)
    covariance = base @ line.direction_covariance @ base.T + behaviour.spread
    drawn = _normal_points() @ jnp.linalg.cholesky(covariance).T.astype(base.dtype)
    drawn = jax.lax.stop_gradient(drawn)
    sample = normalised(line.ray.direction[None] + drawn @ base)
    distance = jax.vmap(lambda towards: meet(shapes, Ray(line.ray.origin, towards))[0])(sample)
    by_object = jax.vmap(lambda row: jax.ops.segment_min(row, shapes.owner, count))(distance)
    first = jnp.min(by_object, axis=1)
    hit = jnp.isfinite(by_object)
    seen = hit & (by_object <= first[:, None])
    hits, sights = jnp.sum(hit, axis=0), jnp.sum(seen, axis=0)
    return jnp.where(hits > 0, sights / jnp.maximum(hits, 1), 1.0)


def _normal_points() -> np.ndarray:
    """Places spread like a standard normal distribution, evenly: a spiral by the golden angle."""
    place = np.arange(_DIRECTIONS)
    radius = np.sqrt(-2 * np.log((place + 0.5) / _DIRECTIONS))
    turn = np.pi * (3 - np.sqrt(5)) * place
    return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
