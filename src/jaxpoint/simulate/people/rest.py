"""Arms that do nothing: hanging, on a hip, before the belly, on the lap."""

from __future__ import annotations

from typing import Literal

import numpy as np

from jaxpoint.simulate.people.body_pose import ArmPose
from jaxpoint.simulate.people.rotations import Vector, about, unit
from jaxpoint.simulate.people.simulated_person import Person, Side
from jaxpoint.simulate.people.skeleton import LEFT, middle_joint, sign

Rest = Literal["hanging", "hip", "belly", "lap"]


def resting(person: Person, side: Side, rest: Rest) -> ArmPose:
    """An arm at rest, in the thorax's frame."""
    out = sign(side)
    if rest == "hanging":
        upper = unit(np.array([-0.02, 0.13 * out, -1.0]))
        return ArmPose(
            upper, unit(np.array([0.16, 0.04 * out, -1.0])), unit(np.array([0.2, -0.02 * out, -1.0])), 0.3, 0.0
        )
    height = person.stature_m
    wide, deep = 0.100 * height * person.build, 0.066 * height * person.build
    if rest == "hip":
        wrist = np.array([-0.015, (wide + 0.055) * out, -0.245 * height])
        return _reaching(person, side, wrist, np.array([-0.5, out, 0.0]), np.array([0.55, -0.6 * out, -0.45]), 1.6)
    if rest == "belly":
        wrist = np.array([deep + 0.095, 0.05 * out, -0.215 * height])
        return _reaching(person, side, wrist, np.array([-0.4, 0.6 * out, -1.0]), np.array([0.15, -out, 0.05]), 0.4)
    wrist = np.array([0.19 * height, 0.075 * height * out, -0.205 * height])
    return _reaching(person, side, wrist, np.array([-0.6, 0.5 * out, -0.6]), np.array([1.0, -0.2 * out, -0.25]), 1.4)


def swung(pose: ArmPose, angle: float) -> ArmPose:
    """An arm turned forwards about the shoulder by `angle` (rad), the elbow bent a little on the way."""
    turn, bend = about(LEFT, -angle), about(LEFT, -(angle + 0.6 * max(angle, 0.0) + 0.1 * abs(angle)))
    return ArmPose(turn @ pose.upper, bend @ pose.fore, bend @ pose.hand, pose.roll, pose.pointing)


def _reaching(person, side: Side, wrist: Vector, elbow_side: Vector, hand: Vector, roll: float) -> ArmPose:
    """The wrist at a place of the thorax's frame (origin: base of the neck)."""
    size = person.proportions
    shoulder = np.array([0.0, sign(side) * size.shoulder_half_width, size.shoulder_height - size.neck_height])
    elbow = middle_joint(shoulder, wrist, size.upper_arm, size.forearm, elbow_side)
    return ArmPose(unit(elbow - shoulder), unit(wrist - elbow), unit(hand), roll, 0.0)
