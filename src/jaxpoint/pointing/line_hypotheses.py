"""How a person may be pointing: along eye and fingertip, or with the forearm (thesis 7.1).

People who point accurately bring the fingertip between eye and target, and the finger lies along that line. People who
point approximately send the forearm there, and the finger leaves the line from the eye by far. So the angle between
both shows how probable each is, and the answer weighs both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.body.joints import Joints, other_eye
from jaxpoint.compilation import jit
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.line import angle_between
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.corrected_lines import corrected_lines
from jaxpoint.pointing.bias.models import AbstractBiasModel
from jaxpoint.pointing.bias.spread import Spread
from jaxpoint.pointing.held_joints import HeldJoints
from jaxpoint.pointing.pointing_line import KINDS, LineKind, PointingLine, directions, pointing_lines, weights_of
from jaxpoint.pointing.posterior import Behaviour

AIMING_DEG = 28.0  # between finger and line of sight, where both hypotheses are equally probable
AIMING_WIDTH_DEG = 3.0
SAME_SIDE = 0.7  # of people aim with the eye on the side of the hand that points
AIMED = 0.5  # of a thing's size, about its middle, where people aim (`experiments/pointing_reliability.py`)
LEAST_WEIGHT = 0.01  # however clear the angle, the other hypothesis keeps this much


class People(eqx.Module):
    """How people differ: each misses by an offset of their own, and scatters about it."""

    between: Float[Array, "2 2"]  # covariance of people's offsets, to the left of a right arm and up, rad^2
    within: Behaviour  # of one person's gestures about the person's own offset


class Correction(eqx.Module):
    """What takes a bias off the line of one kind, and how people scatter about it then."""

    lines: tuple[LineKind, ...] = eqx.field(static=True)  # that the model reads; the first is the one that is turned
    model: AbstractBiasModel
    behaviour: Behaviour  # of somebody who was not fitted
    people: People | None  # None: where everybody pointed once, what is a person's own cannot be known

    @property
    def kind(self) -> LineKind:
        """Of the line that is corrected."""
        return self.lines[0]


@dataclass(frozen=True)
class LineHypothesis:
    """One hypothesis of pointing, for G gestures."""

    kind: str  # of `KINDS`, or "blend"
    lines: PointingLine  # leading axis G
    weight: Float[np.ndarray, " G"]  # its probability before the objects are looked at
    behaviour: Behaviour
    by_calibration: Float[np.ndarray, "G 3 3"]  # the calibration's part of the direction's covariance
    aims: bool = False  # with one of the two eyes that are weighed
    people: People | None = None  # how people differ in it, where that can be learnt
    offset: Float[np.ndarray, "G 2"] | None = None  # rad, to the left of a right arm and up: learnt and taken off


def line_hypotheses(
    held: HeldJoints,
    kind: str,
    blend: Mapping[str, float] | None = None,
    correction: Correction | None = None,
) -> list[LineHypothesis]:
    """The hypotheses of pointing that are weighed: one for a line that was asked for, three for `auto`.

    Args:
        held: joints of G gestures.
        kind: one of `KINDS`, "blend", or "auto".
        blend: weights of a blend.
        correction: of the line of its kind.

    Raises:
        ValueError: weights of a blend that cannot be used.
    """
    chosen = weights_of(blend or {} if kind == "blend" else "forearm" if kind == "auto" else kind)
    draw = partial(_all_hypotheses, kind, chosen, correction)
    found = over_lines(draw, held.joints, held.covariance, held.calibration)
    return [
        LineHypothesis(
            name,
            lines,
            np.asarray(weight),
            _behaviour(name, correction),
            np.asarray(own),
            _aims(kind, name),
            people_of(name) if correction is None or correction.kind != name else correction.people,
        )
        for name, (lines, own, weight) in zip(_names(kind), found, strict=True)
    ]


def _names(kind: str) -> tuple[str, ...]:
    return ("eye-fingertip", "eye-fingertip", "forearm") if kind == "auto" else (kind,)


def _aims(kind: str, name: str) -> bool:
    return kind == "auto" and name == "eye-fingertip"


def _behaviour(name: str, correction: Correction | None) -> Behaviour:
    return behaviour_of(name) if correction is None or correction.kind != name else correction.behaviour


@partial(jit, static_argnames="kind")
def _all_hypotheses(
    kind: str,
    chosen: Float[Array, "5"],
    correction: Correction | None,
    joints: Joints,
    covariance: Float[Array, "G 18 18"],
    calibration: Float[Array, "G 18 18"],
) -> tuple[tuple[PointingLine, Float[Array, "G 3 3"], Float[Array, " G"]], ...]:
    """Of each hypothesis lines, the calibration's part of the directions' covariance, and weight: one program."""

    def hypothesis(name: str, joints: Joints, weight: Array):
        weights = chosen if name == kind else jnp.asarray(weights_of(name))
        every = jnp.broadcast_to(weights, (len(covariance), len(KINDS)))

        def lines(covariance: Array) -> PointingLine:
            if correction is None or correction.kind != name:
                return pointing_lines(joints, covariance, every)
            return corrected_lines(correction.lines, correction.model, joints, covariance)

        return lines(covariance), lines(calibration).direction_covariance, weight

    if kind != "auto":
        return (hypothesis(kind, joints, jnp.ones(len(covariance))),)
    aims = _aiming(joints)
    return (
        hypothesis("eye-fingertip", joints, SAME_SIDE * aims),
        hypothesis("eye-fingertip", jax.vmap(other_eye)(joints), (1 - SAME_SIDE) * aims),
        hypothesis("forearm", joints, 1 - aims),
    )


def correction_of(bias: Bias) -> Correction:
    """What a fitted bias takes off, and the scatter that it leaves on people who were not fitted.

    Raises:
        InsufficientDataError: the bias reads a line that is none of `KINDS`.
    """
    missing = [kind for kind in bias.lines if kind not in KINDS]
    if missing:
        raise InsufficientDataError(
            f"The bias reads the line '{missing[0]}', but there are only {', '.join(KINDS)}; fit one that reads those."
        )
    people = None
    if bias.fitted.gestures > bias.fitted.people:
        people = People(bias.between, _behaviour_about(bias.within))
    lines = cast("tuple[LineKind, ...]", bias.lines)
    return Correction(lines, bias.model, _behaviour_about(bias.spread), people)


def _behaviour_about(spread: Spread) -> Behaviour:
    """How lines lie about what is meant, by a fitted scatter."""
    azimuth, elevation = np.sqrt(np.diag(np.asarray(spread.scale)))
    return Behaviour(azimuth, elevation, freedom=int(spread.freedom), aimed=AIMED)


def behaviour_of(kind: str) -> Behaviour:
    """How people scatter about an uncorrected line: little about the line of sight, much about all others."""
    return _scatter(kind, jnp.result_type(float))


@cache
def _scatter(kind: str, precision: np.dtype) -> Behaviour:
    """Made once in each precision: to hand its numbers to JAX takes longer than to use them."""
    if kind == "eye-fingertip":
        return Behaviour(np.deg2rad(1.0), np.deg2rad(1.0), aimed=AIMED)
    if kind == "head-hand":
        return Behaviour(np.deg2rad(4.0), np.deg2rad(4.0), aimed=AIMED)
    return Behaviour(np.deg2rad(6.0), np.deg2rad(9.0), aimed=AIMED)


def people_of(kind: str) -> People | None:
    """How people differ in an uncorrected line; no measurement of anybody. None for the line of sight: it has no bias.

    Together with the scatter about it this is `behaviour_of`.
    """
    return _differences(kind, jnp.result_type(float))


@cache
def _differences(kind: str, precision: np.dtype) -> People | None:
    if kind == "eye-fingertip":
        return None
    own = np.deg2rad([3.5, 3.5] if kind == "head-hand" else [5.5, 8.7])
    scatter = np.deg2rad(2.0 if kind == "head-hand" else 2.4)
    return People(jnp.diag(jnp.asarray(own, precision) ** 2), Behaviour(scatter, scatter, aimed=AIMED))


def _aiming(joints: Joints) -> Float[Array, " G"]:
    """The probability that the finger lies on the line of sight on purpose."""
    sight = joints.tip - joints.head
    apart = jnp.degrees(angle_between(directions(joints)[..., KINDS.index("finger"), :], sight))
    share = jax.nn.sigmoid((AIMING_DEG - apart) / AIMING_WIDTH_DEG)
    return jnp.clip(share, LEAST_WEIGHT, 1 - LEAST_WEIGHT)
