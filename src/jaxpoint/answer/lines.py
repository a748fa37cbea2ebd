"""Lines of pointing of all gestures of a session, averaged over their holds, with honest covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxpoint.answer.holds import Hold
from jaxpoint.answer.measured import by_calibration, frames_of, middle_moment, pixels_of
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.person.following import Following
from jaxpoint.pointing.hold import held_mean
from jaxpoint.pointing.joints import Joints, estimated_covariance

GESTURES = 8  # at once: a padded size for which programs are compiled


@dataclass(frozen=True)
class HeldJoints:
    """The joints of G gestures, averaged over their holds."""

    joints: Joints  # m, leading axis G
    covariance: Float[Array, "G 18 18"]  # of `Joints.flat`, m^2, the calibration's part included
    calibration: Float[Array, "G 18 18"]  # that part: 0 where the calibration does not say how wrong it may be
    moments: Int[np.ndarray, " G"]  # of each the one nearest to the mean: the one to be shown


def held_joints(
    rig: CameraRig,
    following: Following,
    holds: Sequence[Hold],
    camera_covariance: Float[np.ndarray, "D D"] | None = None,
) -> HeldJoints:
    """Joints of every hold; computes in float64.

    Args:
        rig: the cameras, m.
        following: the arms.
        holds: G of them, one or more.
        camera_covariance: of the cameras' D = 15 C numbers in the order of `Camera.perturbed`.
    """
    with jax.enable_x64(True):
        values, spread, seen = frames_of(following, holds)
        padded = -len(holds) % GESTURES
        # A padded gesture repeats the last, so that no program meets one without frames.
        values, spread, seen = (
            np.concatenate([part, np.repeat(part[-1:], padded, axis=0)]) for part in (values, spread, seen)
        )
        parts = [
            held_mean(values[i : i + GESTURES], spread[i : i + GESTURES], seen[i : i + GESTURES])
            for i in range(0, len(values), GESTURES)
        ]
        mean, covariance, weights = (
            np.concatenate([np.asarray(part[k]) for part in parts])[: len(holds)] for k in range(3)
        )
        moments = np.array([middle_moment(hold, own) for hold, own in zip(holds, weights)], int)
        cameras = np.zeros_like(covariance)
        if camera_covariance is not None:
            for i, (hold, moment) in enumerate(zip(holds, moments)):
                by = np.asarray(by_calibration(rig, pixels_of(rig, following, hold, int(moment))))
                cameras[i] = by @ camera_covariance @ by.T
        joints, whole = _all_joints(mean, covariance + cameras)
        # What the calibration adds, carried to all joints in the same way.
        return HeldJoints(joints, whole, whole - _all_joints(mean, covariance)[1], moments)


@jit
def _all_joints(measured: Array, covariance: Array) -> tuple[Joints, Array]:
    return jax.vmap(estimated_covariance)(jnp.asarray(measured), jnp.asarray(covariance))
