"""How probable each object is as the one that is meant, and that none is.

For one line the distribution of its direction is its own covariance, origin included, plus the spread of people who
point. `mass` is the share of it on each object. Whoever means an object aims somewhere on it, so the likelihood of a
line is the mean of that distribution over the object: its mass over the solid angle that it fills. Times the prior of
the object (all are alike before the line is seen) this is Bayes' rule; with `prior="size"` large objects are meant as
much more often as they are larger, and the likelihood times the prior is the mass itself. Whoever means nothing points
anywhere: the share of the distribution that no object takes, over half a sphere.

Objects behind others may still be meant: the hidden part of their mass counts `hidden` times as much. Who means a thing
points nearer to its middle than to its edge: with `aimed` below 1 somewhere on the part of that size about its middle.
Without it a small thing before or on a large one takes nearly all lines that pass it (on a table: the book).
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
from jaxpoint.pointing.hits import Planes, face_fractions, meet, nearest_first, planes_of
from jaxpoint.pointing.line import PointingLine
from jaxpoint.pointing.lines import over_lines
from jaxpoint.pointing.mass import NEAR_M, across, masses, solid_angles
from jaxpoint.pointing.objects import Objects, Shapes, middle_part

AMBIGUOUS = 3.0
_NEAR = 16  # faces that are looked at for one line: the nearest by angle; the others count as missed
_DIRECTIONS = 16  # by which it is told how much of an object is hidden
_ROUNDING = 1e-6  # of the largest variance: how far below 0 one may lie that should be 0
_TOUCH = 1e-9  # relative distance within which two faces hide nothing of each other


class Behaviour(eqx.Module):
    """How people's lines lie about what they mean; the defaults are no measurement of anybody.

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

    Of what is no line all numbers are NaN, that of `nothing` too, and it is `ambiguous`; see `posterior`.
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

    Nothing is raised for what is no line: a number that is not finite, a direction of no length, a negative variance.
    Its result is NaN throughout, and so it is where prior or evidence are NaN.

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

    def one(line: PointingLine, weights: Array, behaviour: Behaviour, index: Array, ahead: Array) -> Posterior:
        few, parts = _chosen(shapes, index, ahead), _chosen(aimed, index, ahead)
        near = jax.tree.map(lambda leaf: leaf[index], planes)
        near = eqx.tree_at(lambda n: n.used, near, near.used & ahead)
        return _of_line(few, parts, near, behaviour, line, weights)

    aimed = shapes if behaviour.aimed == 1 else middle_part(shapes, behaviour.aimed)
    planes = jax.lax.stop_gradient(planes_of(shapes))

    bounds = jax.lax.stop_gradient(jax.vmap(partial(_tangent_bounds, shapes))(origin, direction))
    index, count = nearest_first(bounds, min(_NEAR, bounds.shape[1]))
    ahead = jnp.arange(index.shape[1])[None] < count[:, None]
    return jax.vmap(one)(PointingLine(Ray(origin, direction), covariance), weights, behaviour, index, ahead)


def _tangent_bounds(shapes: Shapes, origin: Float[Array, "3"], direction: Float[Array, "3"]) -> Float[Array, " F"]:
    """Less than the tangent of the angle from a ray to each face, from a sphere around the face; infinite behind."""
    middle = shapes.corner + (shapes.right + shapes.down) / 2
    side2, down2 = jnp.sum(shapes.right**2, axis=1), jnp.sum(shapes.down**2, axis=1)
    radius = jnp.sqrt(side2 + down2 + 2 * jnp.abs(jnp.sum(shapes.right * shapes.down, axis=1))) / 2
    gap = tuple(middle[:, i] - origin[i] for i in range(3))
    along = gap[0] * direction[0] + gap[1] * direction[1] + gap[2] * direction[2]
    across2 = gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2 - along**2
    beside = jnp.maximum(jnp.sqrt(jnp.maximum(across2, 0.0)) - radius, 0.0)
    ahead = (along + radius > NEAR_M) & (side2 > 0)
    # Where a ray passes through many of the spheres, those whose middle is nearest come first.
    order = 1e-6 * across2 / jnp.where(ahead, along + radius, 1.0) ** 2
    return jnp.where(ahead, beside / jnp.where(ahead, along + radius, 1.0) + order, jnp.inf)


def _chosen(shapes: Shapes, index: Int[Array, " N"], ahead: Bool[Array, " N"]) -> Shapes:
    """Some of the faces, and all spheres; a face that is not meant has no size."""
    faces = shapes.corner.shape[0]
    return Shapes(
        shapes.corner[index],
        jnp.where(ahead[:, None], shapes.right[index], 0.0),
        jnp.where(ahead[:, None], shapes.down[index], 0.0),
        shapes.solid[index],
        shapes.center,
        shapes.radius,
        jnp.concatenate([shapes.owner[:faces][index], shapes.owner[faces:]]),
    )


def _of_line(
    shapes: Shapes, aimed: Shapes, planes: Planes, behaviour: Behaviour, line: PointingLine, weights: Float[Array, " K"]
) -> Posterior:
    def by_object(parts: Float[Array, " parts"]) -> Float[Array, " K"]:
        return jax.ops.segment_sum(parts, shapes.owner, weights.shape[0])

    parts = masses(line, aimed, behaviour.spread, behaviour.freedom)
    seen = _visible(line, shapes, planes, behaviour)
    angles = solid_angles(line.ray.origin, aimed)
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
    sound = _is_line(line) & ~jnp.isnan(total)
    chance, rest, mass, visible, total = (
        jnp.where(sound, found, jnp.nan) for found in (chance, rest, mass, visible, total)
    )
    return Posterior(chance, rest, mass, visible, total, ~sound | ambiguous)


def _is_line(line: PointingLine) -> Bool[Array, ""]:
    """Whether all its numbers are finite, it has a direction, and no variance is negative beyond rounding."""
    variance = jnp.diagonal(line.covariance)
    least = -_ROUNDING * jnp.max(jnp.abs(variance))
    finite = jax.tree.reduce(jnp.logical_and, jax.tree.map(lambda leaf: jnp.all(jnp.isfinite(leaf)), line))
    return finite & jnp.any(line.ray.direction != 0) & jnp.all(variance >= least)


def _visible(line: PointingLine, shapes: Shapes, planes: Planes, behaviour: Behaviour) -> Float[Array, " parts"]:
    """How much of each part's share of the distribution no other part hides, 0..1.

    Told by directions spread evenly like the distribution, and one more to the place of the part that is nearest to the
    line in its plane, so that small and far ones are asked too.
    """
    line, shapes, behaviour = jax.lax.stop_gradient((line, shapes, behaviour))
    base = across(line.ray.direction)
    scale = jnp.linalg.norm(base @ line.direction_covariance @ base.T + behaviour.spread) ** 0.5
    left, up = scale * jnp.asarray(_normal_points().T, base.dtype)
    drawn = tuple(line.ray.direction[i] + left * base[0, i] + up * base[1, i] for i in range(3))
    towards = _unit(*(jnp.concatenate(pair) for pair in zip(drawn, _nearest_places(line.ray, shapes, planes))))
    distance = jax.vmap(lambda *d: meet(shapes, Ray(line.ray.origin, jnp.stack(d)), planes)[0])(*towards)
    hit = jnp.isfinite(distance)
    seen = hit & (distance <= (1 + _TOUCH) * jnp.min(distance, axis=1, keepdims=True))
    # Of the directions to places of parts, each tells of its own part alone.
    own = jnp.concatenate([jnp.ones((len(left), distance.shape[1])), jnp.eye(distance.shape[1])])
    hits, sights = jnp.sum(own * hit, axis=0), jnp.sum(own * seen, axis=0)
    return jnp.where(hits > 0, sights / jnp.maximum(hits, 1), 1.0)


def _unit(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Directions by component: sums of few terms fuse."""
    square = x**2 + y**2 + z**2
    shrink = jax.lax.rsqrt(jnp.where(square > 0, square, 1.0))
    return x * shrink, y * shrink, z * shrink


def _nearest_places(ray: Ray, shapes: Shapes, planes: Planes) -> tuple[Float[Array, " parts"], ...]:
    """From the origin to where the ray meets each part's plane, held within the part, or to its middle: x, y and z."""
    _, u, v, ahead, _ = face_fractions(planes, ray)
    u, v = (jnp.where(ahead, jnp.clip(part, 0.02, 0.98), 0.5) for part in (u, v))
    on_faces = (shapes.corner[:, i] + u * shapes.right[:, i] + v * shapes.down[:, i] for i in range(3))
    return tuple(jnp.concatenate([on, shapes.center[:, i]]) - ray.origin[i] for i, on in enumerate(on_faces))


def _normal_points() -> np.ndarray:
    """Places spread like a standard normal distribution, evenly: a spiral by the golden angle."""
    place = np.arange(_DIRECTIONS)
    radius = np.sqrt(-2 * np.log((place + 0.5) / _DIRECTIONS))
    turn = np.pi * (3 - np.sqrt(5)) * place
    return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
