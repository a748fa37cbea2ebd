"""In which way a person may be pointing: along eye and fingertip, or with the forearm (thesis 7.1; SPEC 6).

Who points accurately brings the fingertip between eye and target, and the finger lies along that line. Who points
approximately sends the forearm there, and the finger leaves the line from the eye by far. So the angle between both
tells how probable each is, and the answer weighs both; nobody has to say it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.answer.lines import HeldJoints
from jaxpoint.compilation import jit
from jaxpoint.geometry.line import Ray, angle_between
from jaxpoint.pointing.bias.bias import Bias, corrected
from jaxpoint.pointing.joints import Joints, is_left, other_eye
from jaxpoint.pointing.line import KINDS, PointingLine, directions, pointing_lines, weights_of
from jaxpoint.pointing.posterior import Behaviour

AIMING_DEG = 28.0  # between finger and line of sight, where both ways are equally probable
AIMING_WIDTH_DEG = 3.0
SAME_SIDE = 0.7  # of people aim with the eye on the side of the hand that points
SURE_OF_WAY = 0.01  # however clear the angle, the other way keeps this much


@dataclass(frozen=True)
class Correction:
    """What takes a bias off the line of one kind, and how people scatter about it then."""

    kind: str  # of `KINDS`
    apply: Callable[[Mapping[str, PointingLine]], PointingLine]  # from lines of all kinds
    behaviour: Behaviour


@dataclass(frozen=True)
class Hypothesis:
    """One way of pointing, for G gestures."""

    kind: str  # of `KINDS`, or "blend"
    lines: PointingLine  # leading axis G
    weight: Float[np.ndarray, " G"]  # its probability before the objects are looked at
    behaviour: Behaviour
    by_calibration: Float[np.ndarray, "G 3 3"]  # the calibration's part of the direction's covariance


def hypotheses(
    held: HeldJoints,
    kind: str,
    blend: Mapping[str, float] | None = None,
    correction: Correction | None = None,
) -> list[Hypothesis]:
    """The ways of pointing that are weighed: one for a line that was asked for, three for `auto`.

    Args:
        held: joints of G gestures.
        kind: one of `KINDS`, "blend", or "auto".
        blend: weights of a blend.
        correction: of the line of its kind.

    Raises:
        ValueError: weights of a blend that cannot be used.
    """
    count = len(held.moments)
    whole = np.ones(count)
    if kind == "auto":
        aims = _aiming(held.joints)
        mirrored = jax.vmap(other_eye)(held.joints)
        ways: Sequence[tuple[str, Joints, np.ndarray]] = (
            ("eye-fingertip", held.joints, SAME_SIDE * aims),
            ("eye-fingertip", mirrored, (1 - SAME_SIDE) * aims),
            ("forearm", held.joints, 1 - aims),
        )
    else:
        ways = ((kind, held.joints, whole),)
    found = []
    for name, joints, weight in ways:
        chosen = blend or {} if name == "blend" else name
        if correction is not None and correction.kind == name:
            every = {kind: _lines(joints, held.covariance, kind) for kind in KINDS}
            lines, behaviour = _corrected(correction, every, joints), correction.behaviour
        else:
            lines, behaviour = _lines(joints, held.covariance, chosen), behaviour_of(name)
        own = np.asarray(_lines(joints, held.calibration, chosen).direction_covariance)
        found.append(Hypothesis(name, lines, weight, behaviour, own))
    return found


def correction_of(bias: Bias) -> Correction:
    """What a fitted bias takes off, and the scatter that it leaves on people who were not fitted."""
    azimuth, elevation = np.sqrt(np.diag(np.asarray(bias.spread.scale)))
    behaviour = Behaviour(azimuth, elevation, freedom=int(bias.spread.freedom))
    return Correction(bias.lines[0], partial(corrected, bias), behaviour)


def _corrected(correction: Correction, lines: Mapping[str, PointingLine], joints: Joints) -> PointingLine:
    """Biases are those of right arms; a left arm's is its mirror image."""
    own = correction.apply(lines)
    mirrored = _mirrored(correction.apply({kind: _mirrored(line) for kind, line in lines.items()}))
    left = jax.vmap(is_left)(joints)
    return jax.tree.map(lambda a, b: jnp.where(left.reshape(-1, *[1] * (a.ndim - 1)), b, a), own, mirrored)


def _mirrored(line: PointingLine) -> PointingLine:
    """In the plane y = 0."""
    sign = jnp.array([[1.0, -1.0, 1.0]])
    both = jnp.concatenate([sign, sign], axis=1)
    ray = Ray(line.ray.origin * sign, line.ray.direction * sign)
    return PointingLine(ray, line.covariance * both[:, :, None] * both[:, None, :])


def _lines(joints: Joints, covariance: Float[Array, "G 18 18"], kind: str | Mapping[str, float]) -> PointingLine:
    return pointing_lines(joints, covariance, np.tile(weights_of(kind), (len(covariance), 1)))


def behaviour_of(kind: str) -> Behaviour:
    """How people scatter about an uncorrected line: little about the line of sight, much about all others."""
    if kind == "eye-fingertip":
        return Behaviour(np.deg2rad(1.0), np.deg2rad(1.0))
    if kind == "head-hand":
        return Behaviour(np.deg2rad(4.0), np.deg2rad(4.0))
    return Behaviour(np.deg2rad(6.0), np.deg2rad(9.0))


def _aiming(joints: Joints) -> Float[np.ndarray, " G"]:
    """The probability that the finger lies on the line of sight on purpose."""
    apart = np.degrees(np.asarray(_finger_to_sight(joints)))
    share = 1 / (1 + np.exp((apart - AIMING_DEG) / AIMING_WIDTH_DEG))
    return np.clip(share, SURE_OF_WAY, 1 - SURE_OF_WAY)


@jit
def _finger_to_sight(joints: Joints) -> Float[Array, " G"]:
    lines = directions(joints)
    sight = jnp.asarray(joints.tip - joints.head)
    return angle_between(lines[..., 1, :], sight)
