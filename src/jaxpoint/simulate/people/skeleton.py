"""From a pose to bones and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.simulate.people.body import Frames
from jaxpoint.simulate.people.body_pose import ArmPose, BodyPose, Foot
from jaxpoint.simulate.people.bones import BONES
from jaxpoint.simulate.people.hand import NEAR, finger_frames
from jaxpoint.simulate.people.proportions import Proportions
from jaxpoint.simulate.people.rotations import UP, Matrix, Vector, about, between, frame_along, unit, wrapped, yawed
from jaxpoint.simulate.people.simulated_person import Person, Side
from jaxpoint.simulate.people.trunk import eyes

SIDES: tuple[Side, Side] = ("left", "right")
FORWARD, LEFT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
HEAD_YAW, HEAD_PITCH = np.deg2rad(70.0), np.deg2rad(50.0)  # the eyes do the rest
# A raised arm takes its shoulder with it, forwards and up, over stature.
SHOULDER_RAISE = np.array([0.008, 0.0, 0.006])


@dataclass(frozen=True)
class Skeleton:
    """Bones for the surface, and the joints of `truth/joints.csv` (m, world)."""

    frames: Frames
    joints: dict[str, Vector]


def sign(side: Side) -> float:
    """+1 on the left, where y is positive, -1 on the right."""
    return 1.0 if side == "left" else -1.0


def place(person: Person, pose: BodyPose) -> Skeleton:
    """Every bone and joint of a person in a pose."""
    size = person.proportions
    bones: dict[str, tuple[Matrix, Vector]] = {}
    pelvis = yawed(pose.yaw)
    thorax, neck = thorax_frame(size, pose)
    bones["pelvis"], bones["thorax"] = (pelvis, pose.pelvis), (thorax, neck)
    joints = {"pelvis": pose.pelvis, "neck": neck}
    _place_head(person, pose, bones, joints)
    for side in SIDES:
        shoulder = shoulder_of(size, thorax, neck, side, pose.raised[side])
        _place_arm(size, side, pose.arms[side], thorax, shoulder, bones, joints)
        _place_leg(size, side, pose.feet[side], pelvis, pose.pelvis, bones, joints)
    rotation = np.stack([bones[name][0] for name in BONES])
    return Skeleton(Frames(rotation, np.stack([bones[name][1] for name in BONES])), joints)


def thorax_frame(size: Proportions, pose: BodyPose) -> tuple[Matrix, Vector]:
    """Rotation and origin (base of the neck) of the thorax, which leans and turns at the waist."""
    turn = yawed(pose.yaw) @ about(LEFT, pose.lean) @ yawed(pose.twist)
    waist = pose.pelvis + UP * (size.waist_height - size.hip_height)
    return turn, waist + turn[:, 2] * (size.neck_height - size.waist_height)


def shoulder_of(size: Proportions, thorax: Matrix, neck: Vector, side: Side, raised: float) -> Vector:
    """Centre of a shoulder joint."""
    local = np.array([0.0, sign(side) * size.shoulder_half_width, size.shoulder_height - size.neck_height])
    return neck + thorax @ (local + raised * SHOULDER_RAISE * size.stature)


def head_frame(size: Proportions, thorax: Matrix, neck: Vector, gaze: Vector) -> tuple[Matrix, Vector, Vector]:
    """Rotation and centre of a head that looks along `gaze` as far as the neck lets it, and where it turns."""
    joint = neck + thorax @ np.array([0.010 * size.stature, 0.0, size.skull_height - size.neck_height])
    ahead = np.arctan2(thorax[1, 0], thorax[0, 0])
    yaw = ahead + np.clip(wrapped(np.arctan2(gaze[1], gaze[0]) - ahead), -HEAD_YAW, HEAD_YAW)
    pitch = np.clip(np.arctan2(gaze[2], np.hypot(gaze[0], gaze[1])), -HEAD_PITCH, HEAD_PITCH)
    turn = yawed(yaw) @ about(LEFT, -pitch)
    up = np.array([0.012 * size.stature, 0.0, size.head_height - size.skull_height])
    return turn, joint + turn @ up, joint


def hand_frame(thorax: Matrix, side: Side, hand: Vector, roll: float) -> Matrix:
    """Rotation of a hand (see `hand`) whose knuckles lie in direction `hand` of the thorax's frame."""
    return thorax @ between(-UP, hand) @ _hanging(side) @ about(UP, sign(side) * roll)


def middle_joint(start: Vector, end: Vector, first: float, second: float, towards: Vector) -> Vector:
    """Elbow or knee between two joints, bent to the side `towards`; an end out of reach straightens the limb."""
    span = end - start
    reach = np.sqrt(span @ span)
    along = span / reach
    bent = frame_along(along, towards)[:, 0]
    held = min(reach, first + second)
    ahead = (first**2 - second**2 + held**2) / (2 * held)
    return start + ahead * along + np.sqrt(max(first**2 - ahead**2, 0.0)) * bent


def _hanging(side: Side) -> Matrix:
    """The frame of a hand that hangs: palm to the thigh, thumb forwards."""
    palm = np.array([0.0, -sign(side), 0.0])
    return np.stack([palm, np.cross(-UP, palm), -UP], axis=1)


def _place_head(person, pose, bones, joints) -> None:
    size = person.proportions
    thorax, neck = bones["thorax"]
    turn, centre, joint = head_frame(size, thorax, neck, pose.gaze)
    bones["head"] = turn, centre
    bones["neck"] = frame_along(unit(joint - neck), thorax[:, 0]), neck
    joints["head"] = centre
    for name, eye in eyes(person).items():
        joints[name] = centre + turn @ eye


def _place_arm(size, side: Side, arm: ArmPose, thorax, shoulder, bones, joints) -> None:
    upper, fore = thorax @ arm.upper, thorax @ arm.fore
    elbow = shoulder + size.upper_arm * upper
    wrist = elbow + size.forearm * fore
    hand = hand_frame(thorax, side, arm.hand, arm.roll)
    bones[f"{side}_upper_arm"] = thorax @ between(-UP, arm.upper) @ _hanging(side), shoulder
    bones[f"{side}_forearm"] = frame_along(fore, hand[:, 0]), elbow
    bones[f"{side}_hand"] = hand, wrist
    for name, (turn, origin) in finger_frames(size, side, arm.pointing).items():
        bones[f"{side}_{name}"] = hand @ turn, wrist + hand @ origin
    far, start = bones[f"{side}_index_far"]
    tip = start + far[:, 2] * ((1 - NEAR) * size.index)
    joints |= {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": wrist, f"{side}_tip": tip}


def _place_leg(size, side: Side, foot: Foot, pelvis, middle, bones, joints) -> None:
    hip = middle + pelvis @ (LEFT * sign(side) * size.hip_half_width)
    ahead = unit(pelvis[:, 0] + yawed(foot.yaw)[:, 0])
    knee = middle_joint(hip, foot.ankle, size.thigh, size.shank, ahead)
    ankle = knee + size.shank * unit(foot.ankle - knee)
    straight = np.stack([ahead, np.cross(-UP, ahead), -UP], axis=1)
    bones[f"{side}_thigh"] = between(-UP, unit(knee - hip)) @ straight, hip
    bones[f"{side}_shank"] = between(-UP, unit(ankle - knee)) @ straight, knee
    toes = np.stack([UP, -LEFT, FORWARD], axis=1)
    bones[f"{side}_foot"] = yawed(foot.yaw) @ about(LEFT, foot.pitch) @ toes, ankle
    joints |= {f"{side}_knee": knee, f"{side}_ankle": ankle}
