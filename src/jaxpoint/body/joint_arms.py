"""Arms from the joints that single views show, triangulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.linalg import block_diag

from jaxpoint.body.arm import AbstractArmPixels, ArmReason, ArmView, PointingArm
from jaxpoint.body.limb_association import stretch
from jaxpoint.body.limb_axis import LimbAxis
from jaxpoint.body.stature import HAND_OF_STATURE, stature
from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.person_evidence import PLACE_OF, AbstractPersonEvidence
from jaxpoint.geometry.arrays import AnyArray
from jaxpoint.triangulation import triangulate

FOREARM_M = (0.15, 0.40)  # a longer or shorter one is a mistaken side
SIDES = ("left", "right")
ARM = ("elbow", "wrist", "index")
GROSS = 0.01  # of the image's width: rms beyond which a joint is left out; beyond half of it, single views are
ROUNDS = 3  # of leaving out one view
_ARM_PLACES = [PLACE_OF[f"{side}_{part}"] for side in SIDES for part in ARM]
_LEAST_M = 1e-6  # of a forearm, by whose length is divided


class JointPixels(AbstractArmPixels):
    """Elbow, wrist and fingertip in each view; the fingertip may be assumed on the forearm's axis."""

    pixels: Float[AnyArray, "3 C 2"]  # px
    used: Bool[AnyArray, "3 C"]
    has_tip: Bool[AnyArray, ""]  # whether the fingertip was triangulated
    hand_m: Float[AnyArray, ""]  # from the wrist to the fingertip where it was not

    def places(
        self, rig: CameraRig, others: Float[AnyArray, "N C 2"], others_seen: Bool[AnyArray, "N C"]
    ) -> tuple[Float[Array, "3 3"], Float[Array, "N 3"]]:
        """Elbow, wrist and tip, and the other points, m."""
        pixels = jnp.concatenate([jnp.asarray(self.pixels), jnp.asarray(others)])
        seen = jnp.concatenate([jnp.asarray(self.used), jnp.asarray(others_seen)])
        points = triangulate(rig, pixels, seen, covariance=False).points
        elbow, wrist, tip = points[:3]
        forearm = wrist - elbow
        ahead = forearm / jnp.maximum(jnp.sqrt(forearm @ forearm), _LEAST_M)
        tip = jnp.where(self.has_tip, tip, wrist + self.hand_m * ahead)
        return jnp.stack([elbow, wrist, tip]), points[3:]


@dataclass(frozen=True)
class SeenArms:
    """Elbow, wrist and fingertip of both arms (J = 6) of R people in single frames, in C views."""

    pixels: Float[np.ndarray, "R J C 2"]  # px
    seen: Bool[np.ndarray, "R J C"]

    @staticmethod
    def of(people: Sequence[Sequence[AbstractPersonEvidence | None]]) -> SeenArms:
        """What every view (inner) shows of the joints of each person (outer)."""
        cameras = len(people[0]) if people else 0
        pixels = np.zeros((len(people), len(_ARM_PLACES), cameras, 2))
        seen = np.zeros(pixels.shape[:3], bool)
        for row, views in enumerate(people):
            for camera, person in enumerate(views):
                joints = None if person is None else person.joints()
                if joints is not None:
                    seen[row, :, camera] = joints.seen[_ARM_PLACES]
                    pixels[row, :, camera] = np.where(seen[row, :, camera, None], joints.pixels[_ARM_PLACES], 0.0)
        return SeenArms(pixels, seen)


def joint_arms(rig: CameraRig, arms: SeenArms, heads: Float[np.ndarray, "R 3"]) -> list[PointingArm | None]:
    """The arm of each person that is stretched out farther; None where no two views have elbow and wrist of one.

    Args:
        rig: the cameras.
        arms: what each view shows.
        heads: centre of each head, m.
    """
    if not arms.seen.any():
        return [None] * len(heads)
    joints = _triangulate_joints(rig, arms)
    found = []
    for row, head in enumerate(heads):
        both = [_arm(rig, joints.of(row, slice(3 * side, 3 * side + 3)), head) for side in range(len(SIDES))]
        found.append(max((arm for arm in both if arm is not None), key=lambda arm: arm.stretch, default=None))
    return found


@dataclass(frozen=True)
class _Joints:
    """Triangulated joints; R frames of people by J joints, and less once some were taken."""

    points: np.ndarray  # (R, J, 3), m
    covariance: np.ndarray  # (R, J, 3, 3), m^2
    valid: np.ndarray  # (R, J)
    rms: np.ndarray  # (R, J), px
    pixels: np.ndarray  # (R, J, C, 2), px
    used: np.ndarray  # (R, J, C)

    def of(self, row: int, joints: slice) -> _Joints:
        """Some joints of one person in one frame."""
        return _Joints(*(getattr(self, one.name)[row, joints] for one in fields(self)))


def _triangulate_joints(rig: CameraRig, arms: SeenArms) -> _Joints:
    """Joints in the room; a view that is grossly off, as of a mistaken side, is left out."""
    gross = GROSS * float(np.asarray(rig.image_sizes)[:, 0].max())
    pixels, used = arms.pixels, arms.seen.copy()
    solved = triangulate(rig, pixels, used)
    others = ~np.eye(used.shape[-1], dtype=bool)  # without each view in turn
    for _ in range(ROUNDS):
        suspect = (np.asarray(solved.rms) > gross / 2) & (used.sum(axis=-1) > 2)
        if not suspect.any():
            break
        fewer = used[suspect][:, None] & others
        rms = np.asarray(triangulate(rig, np.repeat(pixels[suspect][:, None], len(others), 1), fewer).rms)
        rms = np.where(used[suspect], rms, np.inf)  # leaving out what is not used changes nothing
        used[suspect] = np.take_along_axis(fewer, rms.argmin(axis=1)[:, None, None], 1)[:, 0]
        solved = triangulate(rig, pixels, used)
    valid = np.asarray(solved.valid) & (np.asarray(solved.rms) <= gross)
    return _Joints(
        np.asarray(solved.points), np.asarray(solved.covariance), valid, np.asarray(solved.rms), pixels, used
    )


def _arm(rig: CameraRig, joints: _Joints, head: Float[np.ndarray, "3"]) -> PointingArm | None:
    """One arm from its elbow, wrist and fingertip; None where there are no two views of both elbow and wrist.

    Elbow and wrist may each be seen by two views that are not the same: no view has the whole forearm then.
    """
    elbow, wrist, tip = joints.points
    length = float(np.linalg.norm(wrist - elbow))
    counted = joints.used[0] & joints.used[1]
    if not joints.valid[:2].all() or counted.sum() < 2 or not FOREARM_M[0] < length < FOREARM_M[1]:
        return None
    direction = (wrist - elbow) / length
    has_tip, hand_m = bool(joints.valid[2]), HAND_OF_STATURE * stature(head)
    tip = tip if has_tip else wrist + hand_m * direction
    covariance = joints.covariance * np.maximum(1.0, joints.rms)[:, None, None] ** 2
    axis = _axis(joints, direction, length, covariance, counted)
    own = np.logical_and(joints.used[2], has_tip)
    tips = np.where(own[:, None], joints.pixels[2], np.asarray(rig.project(tip)))
    views = tuple(_arm_view(rig, camera, joints, bool(counted[camera]), tips[camera]) for camera in range(len(rig)))
    spread = float(np.sqrt(np.trace(covariance[2]) / 3)) if has_tip else 0.0
    source = [0, 1, 2 if has_tip else 1]  # the wrist stands in for a fingertip that is missing: nothing becomes NaN
    pixels = JointPixels(joints.pixels[source], joints.used[source], np.array(has_tip), np.array(hand_m))
    return PointingArm(tip, spread, axis, views, stretch(tip, head), pixels)


def _axis(joints: _Joints, direction: np.ndarray, length: float, covariance: np.ndarray, counted: np.ndarray):
    """The forearm's axis from its wrist to its elbow."""
    across = (np.eye(3) - np.outer(direction, direction)) / length
    of_direction = across @ (covariance[0] + covariance[1]) @ across.T
    axis = LimbAxis(
        *(jnp.asarray(part) for part in (joints.points[1], joints.points[0], direction, of_direction)),
        ends_covariance=jnp.asarray(block_diag(covariance[1], covariance[0])),
        rms=jnp.asarray(joints.rms[:2].max()),
        slices=jnp.asarray(counted, dtype=float),
    )
    return jax.tree.map(np.asarray, axis)


def _arm_view(rig: CameraRig, camera: int, joints: _Joints, counted: bool, tip: np.ndarray) -> ArmView:
    elbow, wrist = joints.points[:2]
    sight = (elbow + wrist) / 2 - np.asarray(rig.positions)[camera]
    cosine = abs(float(sight @ (wrist - elbow))) / float(np.linalg.norm(sight) * np.linalg.norm(wrist - elbow))
    angle = float(np.arccos(min(1.0, cosine)))
    if not counted:
        return ArmView(ArmReason.NO_ARM, np.zeros(2), np.zeros(2), 0.0, angle)
    return ArmView(ArmReason.FOUND, tip, joints.pixels[0, camera], float(joints.rms[:2].max()), angle)
