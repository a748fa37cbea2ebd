"""The joints that lines of pointing are drawn through, and where they are estimated when nothing shows them."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.body.stature import HEAD_M, SMALLEST_M, TALLEST_M
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import normalise

EYE_AHEAD = 0.047  # of the stature, from the middle of the head to the eyes: 8 cm of a head that is 20 cm long
EYE_ASIDE_M = 0.032  # half the distance between the eyes
EYE_SIGMA_M = 0.006  # of an eye whose side is known
SHOULDER_HEIGHT = 0.818  # of the stature (Drillis & Contini 1966)
SHOULDER_ASIDE = 0.129  # of the stature, from the body's axis (the same)
SHOULDER_SIGMA_M = 0.04  # per coordinate: its play, and the trunk's turn
COUNT = 6
_SIDE_M = 0.01  # an elbow so far aside of the plane through head and tip is surely on its arm's side


class Joints(eqx.Module):
    """Places on a person who points; the names are those of a line's ends. Fields may carry leading axes."""

    head: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m, its middle
    eye: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m, the one that aims
    shoulder: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m, of the pointing arm, as all that follow
    elbow: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m, or a place of the forearm's axis before it
    wrist: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m, or a place of that axis behind it
    tip: Float[Array, "*batch 3"] = eqx.field(converter=as_float)  # m, of the finger

    @property
    def flat(self) -> Float[Array, "*batch 18"]:
        """All coordinates, in the order of the fields: that of covariances."""
        return jnp.concatenate([self.head, self.eye, self.shoulder, self.elbow, self.wrist, self.tip], axis=-1)

    @staticmethod
    def of_flat(flat: Float[AnyArray, "*batch 18"]) -> Joints:
        """The joints whose `flat` this is."""
        return Joints(*(as_float(flat)[..., 3 * i : 3 * i + 3] for i in range(COUNT)))


def estimate_joints(
    head: Float[AnyArray, "3"], elbow: Float[AnyArray, "3"], wrist: Float[AnyArray, "3"], tip: Float[AnyArray, "3"]
) -> Joints:
    """All joints of a person by head, forearm and tip (m): the eye and the shoulder are estimated.

    The head looks at the hand, and the trunk faces it. The elbow shows which arm it is: it stands out to its own side.
    The eye is the one on that side (`other_eye` gives the other). The shoulder hangs as far under the head as that of a
    standing person of this height; of a seated person it is about the same, since the trunk is.
    """
    head, elbow, wrist, tip = as_float(head), as_float(elbow), as_float(wrist), as_float(tip)
    stature = jnp.clip(head[2] + HEAD_M / 2, SMALLEST_M, TALLEST_M)
    gaze, left = normalise(tip - head), _left(head, tip)
    aside = left @ (elbow - head)
    side = aside / jnp.sqrt(aside**2 + _SIDE_M**2) * left
    eye = head + EYE_AHEAD * stature * gaze + EYE_ASIDE_M * side
    below = (1.0 - SHOULDER_HEIGHT) * stature - HEAD_M / 2
    shoulder = head + SHOULDER_ASIDE * stature * side - below * jnp.array([0.0, 0.0, 1.0], head.dtype)
    return Joints(head, eye, shoulder, elbow, wrist, tip)


def other_eye(joints: Joints) -> Joints:
    """The same with the eye mirrored in the upright plane through head and tip. No leading axes."""
    left = _left(joints.head, joints.tip)
    mirrored = joints.eye - 2.0 * (left @ (joints.eye - joints.head)) * left
    return Joints(joints.head, mirrored, joints.shoulder, joints.elbow, joints.wrist, joints.tip)


def is_left(joints: Joints) -> Bool[Array, ""]:
    """Whether the pointing arm is the left one: its eye and shoulder lie to the left of the gaze. No leading axes."""
    return _left(joints.head, joints.tip) @ (joints.shoulder - joints.head) > 0


def _left(head: Array, tip: Array) -> Array:
    """Unit, level, to the left of a person who looks from the head at the tip."""
    gaze = tip - head
    return normalise(jnp.stack([-gaze[1], gaze[0], jnp.zeros_like(gaze[0])]))


def joints_with_covariance(
    measured: Float[AnyArray, "12"], covariance: Float[AnyArray, "12 12"]
) -> tuple[Joints, Float[Array, "18 18"]]:
    """Joints from head, elbow, wrist and tip (m) with their covariance (m^2), and that of all joints.

    Eye and shoulder add what their estimates miss by.
    """
    measured, covariance = as_float(measured), as_float(covariance)

    def joints(flat: Array) -> Array:
        return estimate_joints(*(flat[3 * i : 3 * i + 3] for i in range(4))).flat

    by_measured = jax.jacfwd(joints)(measured)
    own = jnp.repeat(jnp.array([0.0, EYE_SIGMA_M, SHOULDER_SIGMA_M, 0.0, 0.0, 0.0], measured.dtype) ** 2, 3)
    return Joints.of_flat(joints(measured)), by_measured @ covariance @ by_measured.T + jnp.diag(own)
