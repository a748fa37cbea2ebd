"""An arm in the room, what each view shows of it, and the pixels that it was measured from."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from enum import IntEnum

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.body.arm_features import ArmFeatures
from jaxpoint.body.limb_axis import LimbAxis
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry.arrays import AnyArray


class ArmReason(IntEnum):
    """Why a view is not used for an arm, or FOUND."""

    FOUND = 0
    NO_IMAGE = 1  # no image of this camera in this frame
    NO_PERSON = 2  # no silhouette of the person
    NO_ARM = 3  # no two views agree on an arm
    OUTSIDE = 4  # behind the camera or outside its image
    FORESHORTENED = 5  # the arm points along the line of sight
    HIDDEN = 6  # too few slices with two edges: covered, or merged with what is behind
    DISAGREES = 7  # its middle line does not lie on the common axis


@dataclass(frozen=True)
class ArmView:
    """The arm in one view; zeros where the reason is not FOUND."""

    reason: ArmReason
    tip: Float[np.ndarray, "2"]  # px
    base: Float[np.ndarray, "2"]  # px, the seen part of the arm that is farthest from the tip
    rms_px: float  # distance of what was seen from the common axis
    angle: float  # rad, between the arm and the line of sight


class AbstractArmPixels(eqx.Module):
    """The pixels of C cameras that an arm was made from; hidden ones never matter.

    Arrays stay in numpy where they are: each one that is handed to JAX by itself costs as much as a small program.
    """

    @abc.abstractmethod
    def places(
        self, rig: CameraRig, others: Float[AnyArray, "N C 2"], others_seen: Bool[AnyArray, "N C"]
    ) -> tuple[Float[Array, "3 3"], Float[Array, "N 3"]]:
        """The elbow's and the wrist's end of the forearm and the tip, and N other points, m: as these cameras see them.

        Differentiable in the cameras and in the pixels. Other points are triangulated in the same program.
        """


@dataclass(frozen=True)
class PointingArm:
    """An arm in the room, and what each of C views shows of it."""

    tip: Float[np.ndarray, "3"]  # m
    tip_spread: float  # m, rms distance of the views' rays from the tip
    axis: LimbAxis
    views: tuple[ArmView, ...]
    stretch: float  # m, how far the tip is from the body's upright axis
    pixels: AbstractArmPixels
    features: ArmFeatures | None = None  # by which it was chosen among a person's limbs; None where joints gave it

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit length, towards the tip."""
        return np.asarray(self.axis.direction)

    @property
    def views_used(self) -> int:
        """Number of views that are used."""
        return sum(view.reason == ArmReason.FOUND for view in self.views)
