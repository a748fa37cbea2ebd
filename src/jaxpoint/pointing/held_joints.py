"""Lines of pointing of all gestures of a session, averaged over their holds, with honest covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxpoint.body.following import Following
from jaxpoint.body.joints import Joints, joints_with_covariance
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.held_mean import held_mean
from jaxpoint.pointing.hold_frames import by_calibration, frames_of, middle_frame, pixels_of
from jaxpoint.pointing.holds import Hold

GESTURES = 8  # at once, where there is more than one: a padded size for which programs are compiled


@dataclass(frozen=True)
class HeldJoints:
    """The joints of G gestures, averaged over their holds."""

    joints: Joints  # m, leading axis G
    covariance: Float[Array, "G 18 18"]  # of `Joints.flat`, m^2, the calibration's part included
    calibration: Float[Array, "G 18 18"]  # that part: 0 where the calibration has no covariance
    frames: Int[np.ndarray, " G"]  # of each the one nearest to the mean: the one to be shown


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
        camera_covariance: of the cameras' D = p C parameters in the order of `Camera.perturbed`.
    """
    with jax.enable_x64(True):
        mean, covariance, weights = _held_means(*frames_of(following, holds))
        frames = np.array([middle_frame(hold, own) for hold, own in zip(holds, weights)], int)
        cameras = np.zeros_like(covariance)
        if camera_covariance is not None:
            for i, (hold, frame) in enumerate(zip(holds, frames)):
                by = np.asarray(by_calibration(rig, pixels_of(rig, following, hold, int(frame))))
                cameras[i] = by @ camera_covariance @ by.T
        return HeldJoints(*over_lines(_all_joints, mean, covariance, cameras), frames)


def _held_means(*frames: np.ndarray) -> tuple[np.ndarray, ...]:
    """`held_mean` of any number of holds: of one alone, or of `GESTURES` at once."""
    count = len(frames[0])
    size = 1 if count == 1 else GESTURES
    # A padded gesture repeats the last, so that no program meets one without frames.
    padded = [np.concatenate([part, np.repeat(part[-1:], -count % size, axis=0)]) for part in frames]
    parts = [held_mean(*(part[i : i + size] for part in padded)) for i in range(0, count, size)]
    return tuple(np.concatenate([np.asarray(own) for own in each])[:count] for each in zip(*parts))


@jit
def _all_joints(measured: Array, covariance: Array, cameras: Array) -> tuple[Joints, Array, Array]:
    """Joints, their covariance, and the calibration's part of it, which reaches all joints in the same way."""

    def one(measured: Array, covariance: Array, cameras: Array) -> tuple[Joints, Array, Array]:
        joints, whole = joints_with_covariance(measured, covariance + cameras)
        return joints, whole, whole - joints_with_covariance(measured, covariance)[1]

    return jax.vmap(one)(measured, covariance, cameras)
