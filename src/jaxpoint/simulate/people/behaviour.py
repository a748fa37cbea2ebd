"""How people point: the law of behaviour, apart from everything that estimates it.

Accurate pointing (thesis 7.1) puts the dominant eye, the fingertip and the target in line; the arm's own line then
rises above it, because the shoulder lies below the eye. Approximate pointing sends the bent arm roughly to the target:
a person's own mean error of the forearm's axis in elevation and azimuth, and scatter from trial to trial. Both point at
what the pointing eye sees (`planning`, `sight`).

Everything here is drawn from `config.people.PointingSettings`; nothing is taken from any detector or estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from jaxpoint.config.people import Normal, PointingSettings
from jaxpoint.simulate.people.body_pose import ArmPose
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.hand import grip
from jaxpoint.simulate.people.rotations import UP, Matrix, Vector, about, frame_along, unit
from jaxpoint.simulate.people.simulated_person import Person, Side
from jaxpoint.simulate.people.skeleton import hand_frame, middle_joint, sign

Law = Literal["accurate", "approximate"]
ROUNDS = 100  # the direction to the target starts at the tip, which depends on that direction
CLOSE_M = 1e-9


@dataclass(frozen=True)
class Habit:
    """How one person points; angles in rad."""

    law: Law
    hand: Side
    eye: Side  # the dominant one
    elbow_flexion: float
    swivel: float
    palm_turn: float
    finger_error: tuple[float, float]  # accurate: azimuth and elevation of the finger off the line of sight
    elevation_bias: float  # approximate: of the forearm, positive too high
    azimuth_bias: float  # approximate: positive turned inwards
    finger_follows: float


@dataclass(frozen=True)
class Trial:
    """What differs from one gesture of a person to the next; angles in rad."""

    elevation: float
    azimuth: float


@dataclass(frozen=True)
class PointingBody:
    """What the law must know of the body that points: world metres."""

    thorax: Matrix
    shoulder: Vector
    eye: Vector


def draw_habit(rng: np.random.Generator, person: Person, settings: PointingSettings) -> Habit:
    """One person's way of pointing."""
    law: Law = "accurate" if rng.random() < settings.accurate_share else "approximate"
    other: Side = "left" if person.handed == "right" else "right"
    own = settings.accurate if law == "accurate" else settings.approximate
    return Habit(
        law=law,
        hand=person.handed,
        eye=person.handed if rng.random() < settings.eye_of_same_side else other,
        elbow_flexion=_radians(rng, own.elbow_flexion_deg),
        swivel=_radians(rng, own.swivel_deg),
        palm_turn=float(np.deg2rad(draw(rng, settings.palm_turn_deg))),
        finger_error=(
            _radians(rng, settings.accurate.finger_error_deg),
            _radians(rng, settings.accurate.finger_error_deg),
        ),
        elevation_bias=_radians(rng, settings.approximate.elevation_bias_deg),
        azimuth_bias=_radians(rng, settings.approximate.azimuth_bias_deg),
        finger_follows=draw(rng, settings.approximate.finger_follows),
    )


def draw_trial(rng: np.random.Generator, habit: Habit, settings: PointingSettings) -> Trial:
    """One gesture's deviation from the person's habit."""
    if habit.law == "accurate":
        return Trial(*(_radians(rng, settings.accurate.aim_error_deg) for _ in range(2)))
    law = settings.approximate
    scatter = np.deg2rad([law.elevation_scatter_deg, law.azimuth_scatter_deg])
    return Trial(*(float(v) for v in rng.normal(0.0, scatter)))


def aim(person: Person, habit: Habit, trial: Trial, stand: PointingBody, target: Vector) -> ArmPose | None:
    """The arm's pose in which the person points at the target, or None where the arm cannot reach it."""
    law = _accurate if habit.law == "accurate" else _approximate
    return law(person, habit, trial, stand, target)


def _accurate(person: Person, habit: Habit, trial: Trial, stand: PointingBody, target: Vector) -> ArmPose | None:
    """The fingertip on the line from the dominant eye to the target, where the elbow is bent as habit has it."""
    size, side = person.proportions, habit.hand
    sight = target - stand.eye
    sight = _turned(sight / np.sqrt(sight @ sight), trial.azimuth, trial.elevation)
    hand = stand.thorax.T @ _turned(sight, *habit.finger_error)
    held = hand_frame(stand.thorax, side, hand, habit.palm_turn) @ grip(size, side)
    # |eye + d sight - held - shoulder| = the distance from shoulder to wrist that this bend leaves
    span2 = size.upper_arm**2 + size.forearm**2 + 2 * size.upper_arm * size.forearm * np.cos(habit.elbow_flexion)
    start = stand.eye - held - stand.shoulder
    half = start @ sight
    root = half**2 - (start @ start - span2)
    if root < 0:
        return None
    distance = -half + np.sqrt(root)
    if distance < 0.2:
        return None
    wrist = stand.shoulder + start + distance * sight
    out = _elbow_side(stand, side, wrist - stand.shoulder, habit.swivel)
    elbow = middle_joint(stand.shoulder, wrist, size.upper_arm, size.forearm, out)
    upper, fore = unit(elbow - stand.shoulder), unit(wrist - elbow)
    return ArmPose(stand.thorax.T @ upper, stand.thorax.T @ fore, hand, habit.palm_turn, 1.0)


def _approximate(person: Person, habit: Habit, trial: Trial, stand: PointingBody, target: Vector) -> ArmPose | None:
    """The forearm's axis off the direction from fingertip to target by the person's and the trial's error."""
    size, side = person.proportions, habit.hand
    up = habit.elevation_bias + trial.elevation
    inwards = -sign(side) * habit.azimuth_bias + trial.azimuth  # inwards is to the left of a right hand
    tip = stand.shoulder
    for _ in range(ROUNDS):
        true = unit(target - tip)
        fore = _turned(true, inwards, up)
        hand = stand.thorax.T @ _turned(true, habit.finger_follows * inwards, habit.finger_follows * up)
        out = _elbow_side(stand, side, fore, habit.swivel)
        upper = np.cos(habit.elbow_flexion) * fore + np.sin(habit.elbow_flexion) * out
        wrist = stand.shoulder + size.upper_arm * upper + size.forearm * fore
        before, tip = tip, wrist + hand_frame(stand.thorax, side, hand, habit.palm_turn) @ grip(size, side)
        if np.linalg.norm(tip - before) < CLOSE_M:
            return ArmPose(stand.thorax.T @ upper, stand.thorax.T @ fore, hand, habit.palm_turn, 1.0)
    return None


def _turned(direction: Vector, azimuth: float, elevation: float) -> Vector:
    """The direction whose azimuth and elevation are larger by these angles."""
    flat = np.hypot(direction[0], direction[1])
    turn = np.arctan2(direction[1], direction[0]) + azimuth
    rise = np.clip(np.arctan2(direction[2], flat) + elevation, -1.55, 1.55)
    return np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])


def _elbow_side(stand: PointingBody, side: Side, along: Vector, swivel: float) -> Vector:
    """The unit vector across the arm to which the elbow goes: down, and by the swivel out, as the arm lies before one.

    Of an arm held out to its side the elbow turns back.
    """
    along = unit(along)
    down = frame_along(along, -UP - 0.15 * stand.thorax[:, 0])[:, 0]
    return about(along, sign(side) * swivel) @ down


def _radians(rng, spread: Normal) -> float:
    return float(np.deg2rad(draw(rng, spread)))
