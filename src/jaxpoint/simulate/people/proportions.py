"""Lengths of a body from its stature."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Proportions:
    """Segment lengths in metres of a standing body.

    Fractions of stature after Drillis & Contini (1966), as printed in Winter, "Biomechanics and Motor Control of Human
    Movement", figure 3.1: heights of ankle 0.039, knee 0.285, hip 0.530, shoulder 0.818, chin 0.870, eye 0.936; upper
    arm 0.186, forearm 0.146, hand 0.108, foot 0.152. Joint centres lie nearer to the middle than the breadths printed
    there (shoulders 0.259, hips 0.191).
    """

    stature: float

    @property
    def ankle(self) -> float:
        return 0.039 * self.stature

    @property
    def shank(self) -> float:
        return (0.285 - 0.039) * self.stature

    @property
    def thigh(self) -> float:
        return (0.530 - 0.285) * self.stature

    @property
    def hip_height(self) -> float:
        return 0.530 * self.stature

    @property
    def hip_half_width(self) -> float:
        return 0.050 * self.stature

    @property
    def waist_height(self) -> float:
        """Where the trunk turns upon the pelvis."""
        return 0.610 * self.stature

    @property
    def shoulder_height(self) -> float:
        return 0.818 * self.stature

    @property
    def shoulder_half_width(self) -> float:
        return 0.106 * self.stature

    @property
    def neck_height(self) -> float:
        """Base of the neck."""
        return 0.830 * self.stature

    @property
    def skull_height(self) -> float:
        """Where the head turns upon the neck."""
        return 0.885 * self.stature

    @property
    def head_height(self) -> float:
        """Centre of the head's ellipsoid, whose ends are chin and crown."""
        return 0.935 * self.stature

    @property
    def upper_arm(self) -> float:
        return 0.186 * self.stature

    @property
    def forearm(self) -> float:
        return 0.146 * self.stature

    @property
    def palm(self) -> float:
        """Wrist to knuckles."""
        return 0.055 * self.stature

    @property
    def index(self) -> float:
        """Knuckle to tip of the index finger."""
        return 0.045 * self.stature

    @property
    def hand_half_breadth(self) -> float:
        return 0.024 * self.stature

    @property
    def foot(self) -> float:
        return 0.152 * self.stature
