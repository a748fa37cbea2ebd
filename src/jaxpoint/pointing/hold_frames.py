"""The arm of a hold as numbers: head, forearm and tip of every frame, and what the calibration's error does to them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.body.arm import AbstractArmPixels, PointingArm
from jaxpoint.body.following import Following
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import CPU_OPTIONS, jit
from jaxpoint.geometry.arrays import AnyArray
from jaxpoint.pointing.holds import Hold

NUMBERS = 12  # coordinates of head, of the forearm's axis at elbow and wrist, and of the tip
TIP_SIGMA_M = 0.006  # of a fingertip, however well the views agree: three of four are nearer to it
FRAMES = 64  # of a hold that are used, at most; holds are padded to this,
FEW = 16  # or to this, where none is longer
_FAR_FIRST = np.ix_(np.r_[3:6, 0:3], np.r_[3:6, 0:3])  # of near and far
# Quick to compile, and half as slow to run as with none of XLA's optimisations.
_OPTIONS = {**CPU_OPTIONS, "xla_backend_optimization_level": 1}


class HoldPixels(eqx.Module):
    """What C cameras saw of one arm and its head in one frame; hidden pixels never matter."""

    arm: AbstractArmPixels
    head: Float[AnyArray, "C 2"]  # px
    head_seen: Bool[AnyArray, " C"]


def arm_numbers(rig: CameraRig, seen: HoldPixels) -> Float[Array, "12"]:
    """Head, elbow's and wrist's end of the forearm's axis, and tip, m: as these cameras see these pixels.

    Differentiable in the cameras and in the pixels.
    """
    arm, head = seen.arm.places(rig, seen.head[None], seen.head_seen[None])
    return jnp.concatenate([head, arm]).ravel()


@partial(jit, options=_OPTIONS)
def by_calibration(rig: CameraRig, seen: HoldPixels) -> Float[Array, "12 D"]:
    """How `arm_numbers` changes with the cameras' D = p C parameters, in the order of `Camera.perturbed`."""

    def moved(changes: Array) -> Array:
        cameras = jax.vmap(Camera.perturbed)(rig.cameras, changes.reshape(len(rig), -1))
        return arm_numbers(CameraRig(cameras, rig.image_sizes, rig.names, rig.reach), seen)

    return jax.jacrev(moved)(jnp.zeros(len(rig) * rig.camera_size, rig.cameras.focal.dtype))


def frames_of(
    following: Following, holds: Sequence[Hold]
) -> tuple[Float[np.ndarray, "G F 12"], Float[np.ndarray, "G F 12 12"], Bool[np.ndarray, "G F"]]:
    """Head, elbow, wrist and tip (m) of every frame of G holds, with the covariance of measuring; padded.

    Of a longer hold `FRAMES` frames spread over it are taken.
    """
    size = FEW if max(len(hold.frames) for hold in holds) <= FEW else FRAMES
    values = np.zeros((len(holds), size, NUMBERS))
    covariance = np.zeros((len(holds), size, NUMBERS, NUMBERS))
    seen = np.zeros((len(holds), size), bool)
    heads = following.tracking.heads
    for i, hold in enumerate(holds):
        frames = hold.frames[_spread(len(hold.frames))]
        arms = [arm_at(following, hold, int(frame)) for frame in frames]
        head, sigma = heads.positions[frames, hold.person], heads.sigma[frames, hold.person]
        rest = [np.concatenate([arm.axis.far, arm.axis.near, arm.tip]) for arm in arms]
        values[i, : len(arms)] = np.concatenate([head, rest], axis=1)
        covariance[i, : len(arms)] = _covariances(arms, sigma)
        seen[i, : len(arms)] = True
    return values, covariance, seen


def arm_at(following: Following, hold: Hold, frame: int) -> PointingArm:
    """The arm that was measured in a frame of a hold."""
    arm = following.arms[frame, hold.person]
    assert arm is not None, "a hold has only frames with an arm"
    return arm


def middle_frame(hold: Hold, weights: Float[np.ndarray, " F"]) -> int:
    """The frame of a hold that lies nearest to its mean: the one to be shown."""
    chosen = _spread(len(hold.frames))
    return int(hold.frames[chosen][np.argmax(weights[: len(chosen)])])


def pixels_of(rig: CameraRig, following: Following, hold: Hold, frame: int) -> HoldPixels:
    """What all cameras saw of the arm in one frame of a hold."""
    head = following.tracking.heads.positions[frame, hold.person]
    head_seen = following.sightings[frame, hold.person] >= 0
    if head_seen.sum() < 2:
        head_seen = np.asarray(rig.depth(head)) > 0
    return HoldPixels(arm_at(following, hold, frame).pixels, np.asarray(rig.project(head)), head_seen)


def _spread(count: int) -> Int[np.ndarray, " some"]:
    """Which of the frames of a hold are used: `FRAMES` at most, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(FRAMES, count)).astype(int))


def _covariances(arms: Sequence[PointingArm], head_sigma: Float[np.ndarray, " F"]) -> Float[np.ndarray, "F 12 12"]:
    """Of each frame: the head's from its track, the axis's from its fit, the tip's from how far its views disagree."""
    covariance = np.zeros((len(arms), NUMBERS, NUMBERS))
    tip_sigma = np.maximum([arm.tip_spread for arm in arms], TIP_SIGMA_M)
    covariance[:, :3, :3] = head_sigma[:, None, None] ** 2 * np.eye(3)
    covariance[:, 3:9, 3:9] = np.array([arm.axis.ends_covariance for arm in arms])[:, *_FAR_FIRST]
    covariance[:, 9:, 9:] = tip_sigma[:, None, None] ** 2 * np.eye(3)
    return covariance
