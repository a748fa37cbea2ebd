"""Walking along a route and turning on the spot: feet that stand still on the floor while they carry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxpoint.simulate.people.body_pose import Foot
from jaxpoint.simulate.people.proportions import Proportions
from jaxpoint.simulate.people.rotations import UP, Vector, about, smooth, wrapped, yawed
from jaxpoint.simulate.people.route import Route
from jaxpoint.simulate.people.simulated_person import Side
from jaxpoint.simulate.people.skeleton import LEFT, sign
from jaxpoint.simulate.people.stance import STRAIGHT, Stance, foot_at, hip_height

STEP = 0.32  # of stature; walking at 1.2 m/s (Winter: stride 0.83 of stature)
SPEED_UP_S = 0.55  # to full speed, and to a stop
LIFT_M = 0.06
IN_AIR = 0.84  # of the time between two steps a foot is off the floor; the rest both stand
HEEL = np.deg2rad(28.0)  # pitch of a foot as it leaves the floor
TOES = 0.70  # of a foot's length, from the ankle to where it touches the floor last
ARM_SWING = np.deg2rad(20.0)
TURN_STEP = np.deg2rad(55.0)
TURN_S = 0.45  # one step of a turn
DIP = 0.008  # of stature: knees are a little bent in walking
OVERLAP = 0.56  # of a step: how far a foot is ahead or behind when the feet change
MOST_HEEL = np.deg2rad(50.0)


@dataclass(frozen=True)
class FootStep:
    """One foot goes from here to there, between two moments."""

    side: Side
    start_s: float
    end_s: float
    there: Foot


@dataclass(frozen=True)
class Walk:
    """Along a route from stand to stand."""

    size: Proportions
    route: Route
    start_s: float
    speed: float  # m/s once under way

    @cached_property
    def seconds(self) -> float:
        """At least both ramps, however short the way."""
        return max(self.route.length / self.speed + SPEED_UP_S, 2 * SPEED_UP_S)

    @property
    def end_s(self) -> float:
        return self.start_s + self.seconds

    def distance(self, time: float) -> float:
        """How far along the route (m): speed rises and falls in SPEED_UP_S, and its slope is continuous."""
        t, total = np.clip(time - self.start_s, 0.0, self.seconds), self.seconds
        top = self.route.length / (total - SPEED_UP_S)
        return float(top * (_ramp(t) - _ramp(t - (total - SPEED_UP_S))))

    @cached_property
    def steps(self) -> list[FootStep]:
        """Feet alternate."""
        count = self._count
        share = self.route.length / count
        # The body is half a step ahead of one foot and behind the other when they change.
        edges = [self._when(share * min(max(k - 0.5, 0.0), count)) for k in range(count + 2)]
        steps = []
        for k in range(count + 1):
            side: Side = "left" if k % 2 == 0 else "right"
            reached = min(k + 1, count) * share
            yaw = self.route.heading(reached)
            there = foot_at(self.size, self.route.at(reached), yaw, side)
            rest = (1 - IN_AIR) / 2 * (edges[k + 1] - edges[k])
            steps.append(FootStep(side, edges[k] + rest, edges[k + 1] - rest, there))
        return steps

    def stance(self, time: float) -> Stance:
        gone = self.distance(time)
        flat = feet_of(self.size, self.route.at(0.0), self.route.heading(0.0), self.steps, time)
        place, yaw = self.route.at(gone), self.route.heading(gone)
        walking = self._walking(time)
        pelvis = np.array([place[0], place[1], self.size.hip_height * STRAIGHT - walking * self._dip(gone)])
        feet: dict[Side, Foot] = {s: _heel_up(self.size, foot, s, pelvis, yaw) for s, foot in flat.items()}
        pelvis[2] = min(pelvis[2], hip_height(self.size, feet, place, yaw))
        return Stance(pelvis, yaw, 0.03 + 0.03 * walking, feet, walking * ARM_SWING * self._phase(feet, place, yaw))

    @property
    def _count(self) -> int:
        """Steps, without the last, which sets the feet side by side."""
        return max(int(np.ceil(self.route.length / (STEP * self.size.stature))), 1)

    def _dip(self, gone: float) -> float:
        """How far the pelvis is below that of standing (m): least over a foot, most half way between two."""
        step = self.route.length / self._count
        leg = self.size.thigh + self.size.shank
        most = leg - np.sqrt(leg**2 - (OVERLAP * step) ** 2)
        return DIP * self.size.stature + most * (1 - np.cos(2 * np.pi * gone / step)) / 2

    def _walking(self, time: float) -> float:
        """1 under way, 0 at both ends."""
        return smooth((time - self.start_s) / SPEED_UP_S) * smooth((self.end_s - time) / SPEED_UP_S)

    def _phase(self, feet: dict[Side, Foot], place: Vector, yaw: float) -> float:
        """-1..1: how far the right foot is ahead of the left; the left arm goes with the right foot."""
        ahead = yawed(yaw)[:, 0]
        apart = (feet["right"].ankle - feet["left"].ankle) @ ahead
        return float(np.clip(apart / (STEP * self.size.stature), -1.0, 1.0))

    def _when(self, distance: float) -> float:
        times = np.linspace(self.start_s, self.end_s, 200)
        return float(np.interp(distance, [self.distance(t) for t in times], times))


@dataclass(frozen=True)
class Turn:
    """On the spot, foot by foot."""

    size: Proportions
    place: Vector
    start_s: float
    from_yaw: float
    to_yaw: float

    @property
    def _angle(self) -> float:
        return wrapped(self.to_yaw - self.from_yaw)

    @property
    def _pairs(self) -> int:
        return int(np.ceil(abs(self._angle) / TURN_STEP - 1e-9))

    @property
    def end_s(self) -> float:
        return self.start_s + 2 * self._pairs * TURN_S

    @cached_property
    def steps(self) -> list[FootStep]:
        """The foot on the side of the turn goes first."""
        order: tuple[Side, Side] = ("left", "right") if self._angle > 0 else ("right", "left")
        steps = []
        for k in range(2 * self._pairs):
            yaw = self.from_yaw + self._angle * (k // 2 + 1) / self._pairs
            start = self.start_s + k * TURN_S
            there = foot_at(self.size, self.place, yaw, order[k % 2])
            steps.append(FootStep(order[k % 2], start + 0.1 * TURN_S, start + 0.9 * TURN_S, there))
        return steps

    def stance(self, time: float) -> Stance:
        share = smooth((time - self.start_s) / max(self.end_s - self.start_s, 1e-9))
        yaw = self.from_yaw + share * self._angle
        feet = feet_of(self.size, self.place, self.from_yaw, self.steps, time)
        height = min(hip_height(self.size, feet, self.place, yaw), self.size.hip_height * 0.997)
        return Stance(np.array([self.place[0], self.place[1], height]), yaw, 0.03, feet)


def feet_of(size: Proportions, place: Vector, yaw: float, steps: list[FootStep], time: float) -> dict[Side, Foot]:
    """Both feet at a moment, having stood side by side at a place before the first step."""
    sides: tuple[Side, Side] = ("left", "right")
    feet: dict[Side, Foot] = {side: foot_at(size, place, yaw, side) for side in sides}
    for step in steps:
        if time >= step.end_s:
            feet[step.side] = step.there
        elif time > step.start_s:
            share = (time - step.start_s) / (step.end_s - step.start_s)
            feet[step.side] = _in_air(size, feet[step.side], step.there, share)
    return feet


def _in_air(size: Proportions, here: Foot, there: Foot, share: float) -> Foot:
    """A foot on its way: heel first up, then the whole foot, flat again where it lands."""
    gone = share**2 * (3 - 2 * share)
    way = there.ankle - here.ankle
    length = min(float(np.hypot(way[0], way[1])) / 0.5, 1.0)
    lift = LIFT_M * length * np.sin(np.pi * share) ** 2
    pitch = HEEL * length * np.sin(np.pi * min(share / 0.7, 1.0)) ** 2
    yaw = here.yaw + wrapped(there.yaw - here.yaw) * gone
    flat = Foot(here.ankle + gone * way + UP * lift, yaw)
    return Foot(flat.ankle + _rocked(size, flat, pitch), yaw, pitch)


def _heel_up(size: Proportions, foot: Foot, side: Side, pelvis: Vector, yaw: float) -> Foot:
    """The foot, its heel raised over the toes just so far that the leg reaches it; a foot that is ahead stays flat."""
    turn = yawed(yaw)
    hip = pelvis + turn[:, 1] * sign(side) * size.hip_half_width
    leg = STRAIGHT * (size.thigh + size.shank)
    if (foot.ankle - hip) @ turn[:, 0] > 0:
        return foot
    raised = foot
    for more in np.linspace(0.0, MOST_HEEL, 40):
        raised = Foot(foot.ankle + _rocked(size, foot, more), foot.yaw, foot.pitch + more)
        if np.linalg.norm(raised.ankle - hip) <= leg:
            break
    return raised


def _rocked(size: Proportions, foot: Foot, more: float) -> Vector:
    """How the ankle moves when the foot turns over its toes by `more` rad."""
    arm = np.array([-TOES * size.foot, 0.0, size.ankle])
    return yawed(foot.yaw) @ (about(LEFT, foot.pitch + more) @ arm - about(LEFT, foot.pitch) @ arm)


def _ramp(time: float) -> float:
    """The integral of a speed that rises smoothly from 0 to 1 within SPEED_UP_S."""
    t = max(time, 0.0) / SPEED_UP_S
    rising = min(t, 1.0)
    return SPEED_UP_S * (rising**3 - rising**4 / 2 + max(t - 1.0, 0.0))
