"""The hand: a palm, four fingers of two segments, a thumb. Made for the right hand, mirrored for the left.

Frame: origin in the wrist, z to the knuckles, x out of the palm, y to the thumb (on the left hand away from it).
Fingers bend about y, towards x.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.people.proportions import Proportions
from jaxpoint.simulate.people.rotations import about
from jaxpoint.simulate.people.simulated_person import Person, Side
from jaxpoint.simulate.people.surface import Surface, loft, mirrored

Y = np.array([0.0, 1.0, 0.0])
# Knuckle's place across the hand (of half its breadth), length over the index finger's, radius (of the stature).
KNUCKLES = {"index": 0.72, "middle": 0.24, "ring": -0.24, "little": -0.70}
LENGTHS = {"index": 1.0, "middle": 1.08, "ring": 1.0, "little": 0.80}
RADIUS = {"index": 0.0050, "middle": 0.0051, "ring": 0.0048, "little": 0.0043, "thumb": 0.0058}
NEAR = 0.52  # of a finger's length lies before its bend
# Bend (rad) at the knuckle and in the middle: hanging loosely, and pointing with the index finger.
LOOSE = {"index": (0.25, 0.35), "middle": (0.35, 0.45), "ring": (0.42, 0.5), "little": (0.45, 0.5)}
POINTING = {"index": (0.0, 0.0), "middle": (1.25, 1.75), "ring": (1.35, 1.75), "little": (1.4, 1.7)}


def grip(size: Proportions, side: Side) -> Float[np.ndarray, "3"]:
    """From the wrist to the index fingertip of a pointing hand, in the hand's frame, m."""
    return knuckle(size, "index", side) + np.array([0.0, 0.0, size.index])


def knuckle(size: Proportions, finger: str, side: Side) -> Float[np.ndarray, "3"]:
    """Where a finger starts, in the hand's frame."""
    across = size.hand_half_breadth * KNUCKLES[finger]
    return np.array([0.0, across if side == "right" else -across, size.palm])


def finger_frames(
    size: Proportions, side: Side, pointing: float
) -> dict[str, tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]]:
    """Rotation and origin of every finger bone in the hand's frame; `pointing` 0 is a loose hand, 1 a pointing one."""
    frames = {}
    for finger in LENGTHS:
        first, second = ((1 - pointing) * a + pointing * b for a, b in zip(LOOSE[finger], POINTING[finger]))
        start, near = knuckle(size, finger, side), about(Y, first)
        bend = start + near[:, 2] * (NEAR * LENGTHS[finger] * size.index)
        frames[f"{finger}_near"] = near, start
        frames[f"{finger}_far"] = about(Y, first + second), bend
    frames["thumb_near"], frames["thumb_far"] = _thumb(size, side, pointing)
    return frames


def _thumb(size: Proportions, side: Side, pointing: float) -> tuple[tuple, tuple]:
    """The thumb starts at the side of the wrist and lies on the curled fingers when the hand points."""
    sign = 1.0 if side == "right" else -1.0
    start = np.array([0.004, 0.62 * sign * size.hand_half_breadth, 0.25 * size.palm])
    near = about(np.array([1.0, 0.0, 0.0]), -sign * (0.55 - 0.15 * pointing)) @ about(Y, 0.25 + 0.25 * pointing)
    far = about(np.array([1.0, 0.0, 0.0]), sign * (0.1 + 0.5 * pointing)) @ near @ about(Y, 0.1 + 0.35 * pointing)
    return (near, start), (far, start + near[:, 2] * 0.62 * size.index)


def hand_surfaces(person: Person, side: Side, capped: bool) -> dict[str, Surface]:
    """Surfaces by bone name (without the side), each in its bone's frame."""
    size, build = person.proportions, 0.5 + 0.5 * person.build
    made = {"hand": _palm(person, build)}
    for finger, ratio in LENGTHS.items():
        near, far = NEAR * ratio * size.index, (1 - NEAR) * ratio * size.index
        thick = RADIUS[finger] * size.stature * build
        cap = person.cap_length_m if capped and finger == "index" else 0.0
        made[f"{finger}_near"] = _segment(person, near, (thick * 1.08, thick), max(0.0, cap - far), is_tip=False)
        made[f"{finger}_far"] = _segment(person, far, (thick, 0.80 * thick), min(cap, far), is_tip=True)
    thumb = RADIUS["thumb"] * size.stature * build
    made["thumb_near"] = _segment(person, 0.62 * size.index, (1.5 * thumb, 1.05 * thumb), 0.0, is_tip=False)
    made["thumb_far"] = _segment(person, 0.55 * size.index, (1.05 * thumb, 0.85 * thumb), 0.0, is_tip=True)
    return made if side == "right" else {name: mirrored(surface) for name, surface in made.items()}


def _palm(person: Person, build: float) -> Surface:
    size, height = person.proportions, person.stature_m
    share = np.array([-0.16, -0.1, 0.0, 0.15, 0.35, 0.6, 0.82, 0.98, 1.08, 1.12])
    thick = np.array([0.0, 0.009, 0.0125, 0.0135, 0.0150, 0.0140, 0.0115, 0.0090, 0.0050, 0.0]) * height * build
    wide = np.array([0.0, 0.50, 0.68, 0.74, 0.88, 1.0, 1.02, 1.0, 0.85, 0.0]) * size.hand_half_breadth * build
    colour = np.tile(person.skin, (len(share), 1))
    return loft(share * size.palm, np.stack([thick, wide], 1), colour, around=10, exponent=2.4)


def _segment(person: Person, length: float, radii: tuple[float, float], cap: float, *, is_tip: bool) -> Surface:
    """A tapered finger segment with round ends; `cap` metres of its far end are covered. The tip ends at `length`."""
    first, last = radii
    end = length - last if is_tip else length
    steps = [0.0, *np.linspace(0.0, end, 4)[1:-1], end]
    if 0 < cap < length:
        edge = length - cap
        steps = sorted([*(s for s in steps if abs(s - edge) > 0.002), edge - 0.0005, edge + 0.0005])
    body = np.array(steps)
    radius = np.interp(body, [0.0, end], radii)
    heights = np.concatenate([[-first, -0.6 * first], body, [end + 0.7 * last, end + last]])
    around = np.concatenate([[0.0, 0.8 * first], radius, [0.72 * last, 0.0]])
    covered = (heights > length - cap) & (cap > 0)
    around = around + 0.0012 * (covered & (around > 0))
    colour = np.where(covered[:, None], person.cap if person.cap is not None else person.skin, person.skin)
    return loft(heights, np.stack([around, around], 1), colour, around=8)
