"""Which frames are looked at again, from arms whose directions and tips are made up."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.body.arm import PointingArm
from jaxpoint.body.continuity import with_neighbours
from jaxpoint.body.joint_arms import JointPixels
from jaxpoint.body.limb_axis import LimbAxis

TIMES = np.arange(12) / 25


def arm(azimuth_deg: float, tip=(1.0, 2.0, 1.3)) -> PointingArm:
    angle = np.deg2rad(azimuth_deg)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    tip = np.array(tip)
    parts = (tip - 0.2 * direction, tip - 0.4 * direction, direction, np.zeros((3, 3)), np.zeros((6, 6)))
    axis = LimbAxis(*(jnp.asarray(part) for part in parts), rms=jnp.zeros(()), slices=jnp.zeros(2))
    pixels = JointPixels(np.zeros((3, 0, 2)), np.zeros((3, 0), bool), np.array(True), np.array(0.0))
    return PointingArm(tip, 0.0, axis, (), 0.5, pixels)


class Again:
    """Finds the arm that a table says, and remembers for which frames it was asked."""

    def __init__(self, found: dict[int, PointingArm | None]):
        self.found, self.asked = found, []

    def __call__(self, frame: int, other: int) -> PointingArm | None:
        self.asked.append((frame, other))
        return self.found.get(frame)


def test_a_steady_arm_is_left_alone():
    arms = {frame: arm(0.5 * frame) for frame in range(12)}
    again = Again({})
    assert with_neighbours(arms, TIMES, again) == arms
    assert again.asked == []


def test_a_gap_is_filled_from_its_nearest_neighbour():
    arms = {frame: None if frame == 5 else arm(10.0) for frame in range(12)}
    again = Again({5: arm(12.0)})
    found = with_neighbours(arms, TIMES, again)
    assert found[5] is again.found[5]
    assert again.asked[0] in ((5, 4), (5, 6))
    assert all(found[m] is arms[m] for m in range(12) if m != 5)


def test_a_long_gap_is_filled_from_its_ends():
    arms = {frame: None if 3 <= frame <= 8 else arm(10.0) for frame in range(12)}
    found = with_neighbours(arms, TIMES, Again({frame: arm(11.0) for frame in range(12)}))
    assert all(found.values())


@pytest.mark.parametrize(
    ("wrong", "new", "expected"),
    [(arm(150.0), arm(1.0), "new"), (arm(150.0), None, None), (arm(0.0, (1.6, 2.0, 1.3)), arm(1.0), "new")],
    ids=["found elsewhere", "withdrawn", "tip elsewhere"],
)
def test_an_answer_that_stands_alone_is_replaced_or_withdrawn(wrong, new, expected):
    arms = {frame: wrong if frame == 5 else arm(0.0) for frame in range(12)}
    found = with_neighbours(arms, TIMES, Again({5: new}))
    assert found[5] is (new if expected == "new" else None)


def test_an_arm_that_is_raised_is_no_contradiction():
    arms = {frame: arm(100.0 * TIMES[frame], (1.0, 2.0, 1.0 + TIMES[frame])) for frame in range(12)}
    again = Again({})
    with_neighbours(arms, TIMES, again)
    assert again.asked == []


def test_frames_far_away_are_not_used():
    arms = {0: arm(0.0), 1: arm(150.0), 2: arm(0.0), 3: arm(0.0), 4: arm(0.0)}
    again = Again({})
    assert with_neighbours(arms, np.arange(5.0), again) == arms
    assert again.asked == []
