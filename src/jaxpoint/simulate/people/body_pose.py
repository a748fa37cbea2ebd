"""What is needed to place every bone of a person at one moment."""

from __future__ import annotations

from dataclasses import dataclass

from jaxpoint.simulate.people.rotations import Vector, turned_towards
from jaxpoint.simulate.people.simulated_person import Side


@dataclass(frozen=True)
class ArmPose:
    """Directions of an arm's segments, unit vectors in the thorax's frame (x forwards, y left, z up)."""

    upper: Vector
    fore: Vector
    hand: Vector
    roll: float  # rad; 0 thumb up (of an arm held out), pi/2 palm down
    pointing: float  # 0 a loose hand, 1 the index finger stretched

    def towards(self, other: ArmPose, share: float) -> ArmPose:
        """The pose `share` of the way to another; every segment turns on a great circle, so that no length changes."""
        return ArmPose(
            turned_towards(self.upper, other.upper, share),
            turned_towards(self.fore, other.fore, share),
            turned_towards(self.hand, other.hand, share),
            (1 - share) * self.roll + share * other.roll,
            (1 - share) * self.pointing + share * other.pointing,
        )


@dataclass(frozen=True)
class Foot:
    """Where an ankle is (m, world) and how the foot is turned: yaw, and pitch with the heel up (rad)."""

    ankle: Vector
    yaw: float
    pitch: float = 0.0


@dataclass(frozen=True)
class BodyPose:
    """A whole person at one moment; world metres and radians."""

    pelvis: Vector  # between the hips
    yaw: float  # of the pelvis; 0 looks along world x
    lean: float  # of the trunk, forwards
    twist: float  # of the thorax upon the pelvis, to the left
    gaze: Vector  # the direction of the face, unit, world
    arms: dict[Side, ArmPose]
    feet: dict[Side, Foot]
    raised: dict[Side, float]  # 0..1, how far each shoulder goes with its arm
