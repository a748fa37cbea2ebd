"""Where pelvis and feet are: standing and sitting. Walking is in `gait`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.simulate.people.body_pose import Foot
from jaxpoint.simulate.people.proportions import Proportions
from jaxpoint.simulate.people.rotations import Vector, smooth, yawed
from jaxpoint.simulate.people.simulated_person import Side
from jaxpoint.simulate.people.skeleton import SIDES, sign

STRAIGHT = 0.997  # of the length of a leg: nobody stands with locked knees
SIT_S = 1.6
SIT_LEAN = 0.55  # rad, half way
TOES_OUT = np.deg2rad(8.0)


@dataclass(frozen=True)
class Stance:
    """Pelvis and feet at one moment (m, rad, world), and how the arms go with them."""

    pelvis: Vector
    yaw: float
    lean: float
    feet: dict[Side, Foot]
    swing: float = 0.0  # rad by which the left arm is ahead, the right arm behind


def foot_at(size: Proportions, place: Vector, yaw: float, side: Side) -> Foot:
    """A foot flat on the floor beside a place (its height is not used)."""
    aside = yawed(yaw)[:, 1] * sign(side) * 1.05 * size.hip_half_width
    ankle = np.array([place[0] + aside[0], place[1] + aside[1], size.ankle])
    return Foot(ankle, yaw + sign(side) * TOES_OUT)


def hip_height(size: Proportions, feet: dict[Side, Foot], place: Vector, yaw: float) -> float:
    """The greatest height of the pelvis over a place at which both legs still reach the feet."""
    leg = STRAIGHT * (size.thigh + size.shank)
    heights = []
    for side in SIDES:
        hip = place[:2] + yawed(yaw)[:2, 1] * sign(side) * size.hip_half_width
        away = feet[side].ankle[:2] - hip
        heights.append(feet[side].ankle[2] + np.sqrt(max(leg**2 - away @ away, 0.04)))
    return float(min(heights))


def standing(size: Proportions, place: Vector, yaw: float) -> Stance:
    """On both feet at a place (x, y), looking along yaw."""
    feet: dict[Side, Foot] = {side: foot_at(size, place, yaw, side) for side in SIDES}
    pelvis = np.array([place[0], place[1], hip_height(size, feet, place, yaw)])
    return Stance(pelvis, yaw, 0.03, feet)


def before_seat(size: Proportions, place: Vector, yaw: float) -> Vector:
    """Where one stands to sit down on a seat whose middle is `place`, turned away from it."""
    return np.array([*(place[:2] + (size.thigh - 0.03) * yawed(yaw)[:2, 0]), 0.0])


def sitting(size: Proportions, place: Vector, yaw: float, seat: float) -> Stance:
    """On a seat of height `seat` whose middle is `place`; the feet stand in front of it."""
    ahead = yawed(yaw)[:, 0]
    pelvis = np.array([*(place[:2] - 0.06 * ahead[:2]), seat + 0.055 * size.stature])
    front = before_seat(size, place, yaw)
    feet: dict[Side, Foot] = {side: foot_at(size, front, yaw, side) for side in SIDES}
    return Stance(pelvis, yaw, 0.02, feet)


@dataclass(frozen=True)
class SitDown:
    """From standing before a seat to sitting on it, or up again."""

    start_s: float
    stood: Stance
    sat: Stance
    up: bool = False

    @property
    def end_s(self) -> float:
        return self.start_s + SIT_S

    def stance(self, time: float) -> Stance:
        """The feet stay; the trunk leans forwards on the way."""
        share = smooth((time - self.start_s) / SIT_S)
        share = 1 - share if self.up else share
        lean = (1 - share) * self.stood.lean + share * self.sat.lean + SIT_LEAN * 16 * (share * (1 - share)) ** 2
        pelvis = (1 - share) * self.stood.pelvis + share * self.sat.pelvis
        return Stance(pelvis, self.stood.yaw, lean, self.sat.feet)
