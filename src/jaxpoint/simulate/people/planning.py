"""From a target to a gesture that this body can make here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxpoint.config.people import PeopleSettings, PointingSettings
from jaxpoint.simulate.people.actor import AHEAD, gaze_at, pose_of
from jaxpoint.simulate.people.behaviour import Habit, PointingBody, aim, draw_habit, draw_trial
from jaxpoint.simulate.people.body_pose import ArmPose, BodyPose
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gesture import Gesture, draw_times, draw_tremor
from jaxpoint.simulate.people.line_of_sight import Corners, is_hidden, seen_place
from jaxpoint.simulate.people.rest import resting
from jaxpoint.simulate.people.rotations import Vector, wrapped, yawed
from jaxpoint.simulate.people.simulated_person import Person, Side, draw_person
from jaxpoint.simulate.people.skeleton import SIDES, head_frame, place, shoulder_of, thorax_frame
from jaxpoint.simulate.people.stance import Stance
from jaxpoint.simulate.people.trunk import eyes

TWIST_SHARE, TWIST_MOST = 0.5, np.deg2rad(30.0)  # the trunk turns half of the way to the target
ACROSS, OUTWARDS = np.deg2rad(60.0), np.deg2rad(100.0)  # how far from straight ahead an arm points
STEEPEST = np.deg2rad(65.0)
NEAREST_M = 1.2  # from the shoulder; what is nearer is touched, not pointed at
WALL_M = 0.03
BEFORE_CHEST = 0.11  # of stature: how far before the spine a pointing wrist is at least


@dataclass(frozen=True)
class PointingTarget:
    """What a gesture points at."""

    name: str
    place: Vector  # m, the middle of an object
    corners: Corners | None = None  # m, of an object


@dataclass(frozen=True)
class Performer:
    """A person and how they point."""

    person: Person
    habit: Habit

    @staticmethod
    def drawn(rng: np.random.Generator, number: int, settings: PeopleSettings) -> Performer:
        person = draw_person(rng, number, settings.looks)
        return Performer(person, draw_habit(rng, person, settings.pointing))

    def resting(self) -> dict[Side, ArmPose]:
        return {side: resting(self.person, side, "hanging") for side in SIDES}


def draw_target(rng: np.random.Generator, settings: PeopleSettings, objects: Sequence, room: Floor) -> PointingTarget:
    """An object, or a place on wall, floor or ceiling where no object is."""
    if objects and rng.random() >= settings.nothing:
        chosen = objects[int(rng.integers(len(objects)))]
        corners = np.asarray(chosen.corners, float)
        return PointingTarget(chosen.name, corners.mean(axis=0), corners)
    centers = np.array([np.asarray(thing.corners, float).mean(axis=0) for thing in objects]).reshape(-1, 3)
    reach = np.array([np.linalg.norm(np.ptp(np.asarray(t.corners, float), axis=0)) / 2 for t in objects])
    size = np.array(room.size_m)
    for _ in range(100):
        spot = rng.uniform(0.0, size)
        axis = int(rng.integers(3))
        spot[axis] = size[axis] * rng.integers(2)
        if (np.linalg.norm(centers - spot, axis=1) > reach + 0.15).all():
            break
    return PointingTarget("nothing", spot)


def plan_gesture(
    rng: np.random.Generator,
    performer: Performer,
    stance: Stance,
    target: PointingTarget,
    first_s: float,
    objects: Sequence,
    room: Floor,
    settings: PointingSettings,
) -> Gesture | None:
    """A gesture from this stance at what the person sees of the target.

    None where that is hardly anything, or where the body cannot make the gesture or would reach into wall or furniture.
    """
    habit, person = performer.habit, performer.person
    faced = _facing(performer, stance, target, objects)
    if faced is None:
        return None
    place, pose, stand = faced
    trial = draw_trial(rng, habit, settings)
    away = place - stand.shoulder
    if np.arctan2(abs(away[2]), np.hypot(away[0], away[1])) > STEEPEST or away @ away < NEAREST_M**2:
        return None
    arm = aim(person, habit, trial, stand, place)
    if arm is None or not _is_possible(person, habit.hand, pose, arm, room.without(stance.pelvis)):
        return None
    up, hold, down = draw_times(rng, settings.hold)
    return Gesture(
        number=0,
        person=person.number,
        first_s=first_s,
        hold_first_s=first_s + up,
        hold_last_s=first_s + up + hold,
        last_s=first_s + up + hold + down,
        hand=habit.hand,
        law=habit.law,
        target=target.name,
        target_m=place,
        aim=arm,
        twist=pose.twist,
        tremor=draw_tremor(rng, person, settings.hold),
    )


def _facing(
    performer: Performer, stance: Stance, target: PointingTarget, objects: Sequence
) -> tuple[Vector, BodyPose, PointingBody] | None:
    """The place at which the pointing eye sees the target, and the body turned there, but for the arm.

    None where the body does not turn so far, or where other objects hide the target.
    """
    others = np.array([np.asarray(o.corners, float) for o in objects if o.name != target.name]).reshape(-1, 4, 3)
    place = target.place
    for _ in range(2):  # whoever looks at another place moves the eye
        twist = _twist(performer.habit, stance, place)
        if twist is None:
            return None
        pose = _raised(performer, stance, twist, place)
        stand = _stand(performer.person, performer.habit, pose)
        if not is_hidden(stand.eye, place[None], others)[0]:
            return place, pose, stand
        seen = None if target.corners is None else seen_place(stand.eye, target.corners, others)
        if seen is None:
            return None
        place = seen
    return None


def _twist(habit: Habit, stance: Stance, target: Vector) -> float | None:
    """How far the trunk turns to the target; None where it lies too far aside or behind."""
    away = target - stance.pelvis
    aside = wrapped(np.arctan2(away[1], away[0]) - stance.yaw)
    outwards = aside if habit.hand == "left" else -aside
    if not -ACROSS < outwards < OUTWARDS:
        return None
    return float(np.clip(TWIST_SHARE * aside, -TWIST_MOST, TWIST_MOST))


def _raised(performer: Performer, stance: Stance, twist: float, target: Vector) -> BodyPose:
    """The body during the hold, but for the arm."""
    raised: dict[Side, float] = {side: float(side == performer.habit.hand) for side in SIDES}
    pose = pose_of(stance, twist, yawed(stance.yaw) @ AHEAD, performer.resting(), raised)
    return pose_of(stance, twist, gaze_at(performer.person, pose, target), pose.arms, raised)


def _stand(person: Person, habit: Habit, pose: BodyPose) -> PointingBody:
    """What the law must know of a body."""
    size = person.proportions
    thorax, neck = thorax_frame(size, pose)
    turn, centre, _ = head_frame(size, thorax, neck, pose.gaze)
    eye = centre + turn @ eyes(person)[f"{habit.eye}_eye"]
    return PointingBody(thorax, shoulder_of(size, thorax, neck, habit.hand, 1.0), eye)


def _is_possible(person: Person, hand: Side, pose: BodyPose, arm: ArmPose, room: Floor) -> bool:
    """The arm goes neither through the chest nor into walls and furniture."""
    held = pose_of(_stance(pose), pose.twist, pose.gaze, {**pose.arms, hand: arm}, pose.raised)
    joints = place(person, held).joints
    thorax, neck = thorax_frame(person.proportions, pose)
    wrist = thorax.T @ (joints[f"{hand}_wrist"] - neck)
    if wrist[0] < BEFORE_CHEST * person.stature_m and abs(wrist[1]) < 0.14 * person.stature_m:
        return False
    return room.holds(np.array([joints[f"{hand}_{name}"] for name in ("elbow", "wrist", "tip")]), WALL_M)


def _stance(pose: BodyPose) -> Stance:
    return Stance(pose.pelvis, pose.yaw, pose.lean, pose.feet)
