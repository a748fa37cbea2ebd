"""One pointing gesture: the arm comes up, holds with tremor, goes down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxpoint.config.people import HoldSettings
from jaxpoint.simulate.people.behaviour import Law
from jaxpoint.simulate.people.body_pose import ArmPose
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.rotations import Vector, smooth
from jaxpoint.simulate.people.simulated_person import Person, Side

LOOK_AHEAD_S = 0.35  # the head turns before the arm does
WAVES = 3


@dataclass(frozen=True)
class Tremor:
    """A sum of sines that turns the arm about the shoulder; rad and Hz."""

    amplitude: Float[np.ndarray, "W 3"]
    frequency: Float[np.ndarray, "W 3"]
    phase: Float[np.ndarray, "W 3"]

    def turn(self, time: float) -> Vector:
        """A small rotation vector."""
        return (self.amplitude * np.sin(2 * np.pi * self.frequency * time + self.phase)).sum(axis=0)


@dataclass(frozen=True)
class Gesture:
    """When and how one person points at what; a row of `truth/gestures.csv`. Times in seconds of the session."""

    number: int
    person: int
    first_s: float
    hold_first_s: float
    hold_last_s: float
    last_s: float
    hand: Side
    law: Law
    target: str  # name of an object, or "nothing"
    target_m: Vector
    aim: ArmPose  # during the hold, tremor aside
    twist: float  # of the trunk during the hold
    tremor: Tremor

    def later(self, seconds: float) -> Gesture:
        """The same, that much later."""
        times = ("first_s", "hold_first_s", "hold_last_s", "last_s")
        return replace(self, **{name: getattr(self, name) + seconds for name in times})

    def raised(self, time: float) -> float:
        """0 before and after, 1 during the hold."""
        up = smooth((time - self.first_s) / (self.hold_first_s - self.first_s))
        return up - smooth((time - self.hold_last_s) / (self.last_s - self.hold_last_s))

    def attention(self, time: float) -> float:
        """How far the head has turned to the target; it goes ahead of the arm."""
        start = self.first_s - LOOK_AHEAD_S
        up = smooth((time - start) / (self.hold_first_s - 0.2 - start))
        return up - smooth((time - self.hold_last_s) / (self.last_s - self.hold_last_s))

    def arm(self, time: float, rest: ArmPose) -> ArmPose:
        """The pointing arm, which rests as `rest` says."""
        share = self.raised(time)
        pose = rest.towards(self.aim, share)
        turn = share * self.tremor.turn(time)
        shaken = [v + np.cross(turn, v) for v in (pose.upper, pose.fore, pose.hand)]
        upper, fore, hand = (v / np.sqrt(v @ v) for v in shaken)
        return ArmPose(upper, fore, hand, pose.roll, pose.pointing)


def draw_times(rng: np.random.Generator, settings: HoldSettings) -> tuple[float, float, float]:
    """Seconds of raising, holding and lowering."""
    return draw(rng, settings.raise_s), draw(rng, settings.hold_s), draw(rng, settings.lower_s)


def draw_tremor(rng: np.random.Generator, person: Person, settings: HoldSettings) -> Tremor:
    """A tremor whose fingertip moves by the drawn standard deviation in each direction across the arm."""
    size = person.proportions
    reach = size.upper_arm + size.forearm + size.palm + size.index
    sd = draw(rng, settings.tremor_sd_m) / reach
    weight = rng.uniform(0.5, 1.0, (WAVES, 3))
    weight /= np.sqrt((weight**2).sum(axis=0))
    frequency = rng.uniform(settings.tremor_hz.low, settings.tremor_hz.high, (WAVES, 3))
    return Tremor(np.sqrt(2) * sd * weight, frequency, rng.uniform(0.0, 2 * np.pi, (WAVES, 3)))
