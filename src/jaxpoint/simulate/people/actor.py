"""A person who plays a part: a surface and joints at every moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.mesh import Mesh
from jaxpoint.simulate.people.body import Body, make_body
from jaxpoint.simulate.people.body_pose import ArmPose, BodyPose
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.people.rest import Rest, resting, swung
from jaxpoint.simulate.people.rotations import Vector, smooth, turned_towards, unit, yawed
from jaxpoint.simulate.people.simulated_person import Person, Side
from jaxpoint.simulate.people.skeleton import SIDES, Skeleton, place, sign, thorax_frame
from jaxpoint.simulate.people.stance import Stance

SETTLE_S = 0.7  # an arm goes from one rest to the next


@runtime_checkable
class Move(Protocol):
    """What the legs do for a while."""

    @property
    def start_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...

    def stance(self, time: float) -> Stance: ...


@dataclass(frozen=True)
class Stay:
    """A stance that does not change."""

    start_s: float
    end_s: float
    held: Stance

    def stance(self, time: float) -> Stance:
        return self.held


@dataclass(frozen=True)
class RestFrom:
    """How both arms rest from a moment on."""

    start_s: float
    rest: dict[Side, Rest]


@dataclass(frozen=True)
class Actor:
    """One person from entering to leaving. Moves and rests follow one another in time; gestures do not overlap."""

    person: Person
    moves: Sequence[Move]
    rests: Sequence[RestFrom]
    gestures: Sequence[Gesture]

    @cached_property
    def body(self) -> Body:
        return make_body(self.person)

    def present(self, time: float) -> bool:
        """Whether the person is in the room at this time (s); elsewhere there is neither mesh nor joints."""
        return bool(self.moves[0].start_s <= time <= self.moves[-1].end_s)

    def mesh(self, time: float) -> Mesh:
        """The surface, clothes and all, in world metres."""
        return self.body.mesh(self.skeleton(time).frames)

    def joints(self, time: float) -> dict[str, Float[np.ndarray, "3"]]:
        """Head, eyes, neck, shoulders, elbows, wrists, index fingertips, pelvis, knees, ankles: world metres."""
        return self.skeleton(time).joints

    def skeleton(self, time: float) -> Skeleton:
        return place(self.person, self.pose(time))

    def stance(self, time: float) -> Stance:
        """Pelvis and feet; before the first and after the last move, those of its end."""
        move = next((move for move in self.moves if time <= move.end_s), self.moves[-1])
        return move.stance(min(max(time, move.start_s), move.end_s))

    def pose(self, time: float) -> BodyPose:
        """Everything the bones follow from."""
        stance = self.stance(time)
        arms, raised = {}, {}
        for side in SIDES:
            rest = self._resting(side, time, stance)
            gesture = self._gesture(time, side)
            arms[side] = rest if gesture is None else gesture.arm(time, rest)
            raised[side] = 0.0 if gesture is None else gesture.raised(time)
        twist = sum((g.attention(time) * g.twist for g in self.gestures), 0.0)
        pose = pose_of(stance, twist, yawed(stance.yaw) @ AHEAD, arms, raised)
        return replace(pose, gaze=self._gaze(time, pose))

    def _gaze(self, time: float, pose: BodyPose) -> Vector:
        gaze = pose.gaze
        for gesture in self.gestures:
            attention = gesture.attention(time)
            if attention > 0:
                gaze = turned_towards(gaze, gaze_at(self.person, pose, gesture.target_m), attention)
        return gaze

    def _gesture(self, time: float, side: Side) -> Gesture | None:
        return next((g for g in self.gestures if g.hand == side and g.first_s <= time <= g.last_s), None)

    def _resting(self, side: Side, time: float, stance: Stance) -> ArmPose:
        now = max((i for i, rest in enumerate(self.rests) if rest.start_s <= time), default=0)
        pose = self._rests[now][side]
        share = smooth((time - self.rests[now].start_s) / SETTLE_S)
        if now > 0 and share < 1:
            pose = self._rests[now - 1][side].towards(pose, share)
        return swung(pose, sign(side) * stance.swing) if stance.swing else pose

    @cached_property
    def _rests(self) -> list[dict[Side, ArmPose]]:
        return [{side: resting(self.person, side, entry.rest[side]) for side in SIDES} for entry in self.rests]


AHEAD = unit(np.array([1.0, 0.0, -0.12]))  # where people look who look at nothing


def pose_of(
    stance: Stance, twist: float, gaze: Vector, arms: dict[Side, ArmPose], raised: dict[Side, float]
) -> BodyPose:
    """A stance with arms and a face."""
    return BodyPose(stance.pelvis, stance.yaw, stance.lean, twist, gaze, arms, stance.feet, raised)


def gaze_at(person: Person, pose: BodyPose, target: Vector) -> Vector:
    """The direction of a face that is turned to a target."""
    size = person.proportions
    thorax, neck = thorax_frame(size, pose)
    return unit(target - neck - thorax[:, 2] * (size.head_height - size.neck_height))
