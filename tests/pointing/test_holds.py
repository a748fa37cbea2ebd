"""Gestures in arms over time, made by hand: rest, a hold with gaps and wrong limbs, and what is no gesture."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.config.pointing import GestureSettings
from jaxpoint.pointing.holds import ArmTrack, find_holds, hold_within

PERIOD = 0.16
POINTING = np.array([0.8, 0.0, 0.6])


def track(holds=((10, 18), (30, 36)), frames=45, seed=0) -> ArmTrack:
    """An arm that hangs, and points in the given frames; it trembles by 3 mm."""
    rng = np.random.default_rng(seed)
    tips = np.tile([0.1, -0.2, 0.65], (frames, 1))
    directions, stretch = np.tile([0.0, 0.0, -1.0], (frames, 1)), np.full(frames, 0.14)
    for number, (first, last) in enumerate(holds):
        part = slice(first, last + 1)
        tips[part], stretch[part] = [0.6, -0.2 + number, 1.5], 0.4
        directions[part] = POINTING * [1, (-1) ** number, 1]
    tips += 0.003 * rng.normal(size=tips.shape)
    rising = np.arange(frames)
    return ArmTrack(0, rising, PERIOD * rising, tips, directions, stretch, np.full(frames, 4))


def select(arm: ArmTrack, kept) -> ArmTrack:
    names = ("frames", "times", "tips", "directions", "stretch", "views")
    return replace(arm, **{name: getattr(arm, name)[kept] for name in names})


def test_holds_are_found_and_rest_is_none():
    first, second = find_holds([track()], GestureSettings())
    assert (first.frames[0], first.frames[-1]) == (10, 18)
    assert (second.frames[0], second.frames[-1]) == (30, 36)
    assert first.time_s == pytest.approx(14 * PERIOD)
    assert not find_holds([track(holds=())], GestureSettings())


def test_an_arm_that_moves_is_not_held():
    arm = track(holds=((5, 40),))
    arm.tips[:, 1] += 0.15 * np.arange(len(arm.tips))  # about 1 m/s
    assert not find_holds([arm], GestureSettings())


def test_missing_frames_and_another_limb_do_not_break_a_hold():
    arm = track(holds=((10, 20),))
    wrong = [12, 16, 19]
    arm.tips[wrong] += [-0.5, 0.1, 0.2]
    arm.directions[wrong] = -POINTING
    (hold,) = find_holds([select(arm, ~np.isin(arm.frames, [14, 15]))], GestureSettings())
    assert set(hold.frames) == set(range(10, 21)) - {12, 14, 15, 16, 19}


def test_a_long_gap_ends_a_hold():
    arm = track(holds=((10, 30),))
    holds = find_holds([select(arm, ~np.isin(arm.frames, range(17, 24)))], GestureSettings())
    assert [(hold.frames[0], hold.frames[-1]) for hold in holds] == [(10, 16), (24, 30)]


def test_another_limb_as_the_arm_comes_up_is_no_gesture():
    arm = track(holds=((5, 8), (11, 20)))
    (hold,) = find_holds([arm], GestureSettings())
    assert (hold.frames[0], hold.frames[-1]) == (11, 20)


@pytest.mark.parametrize(("frames", "found"), [(1, 0), (2, 0), (3, 1)])
def test_short_holds_are_none(frames, found):
    assert len(find_holds([track(holds=((10, 9 + frames),))], GestureSettings())) == found


def test_given_times_take_what_agrees_most_within_them():
    arm = track(holds=((10, 18),))
    hold = hold_within([arm], 12 * PERIOD, 18 * PERIOD, GestureSettings())
    assert (hold.frames[0], hold.frames[-1]) == (12, 18)
    assert hold_within([arm], 100.0, 101.0, GestureSettings()) is None


def test_the_order_of_people_does_not_matter():
    one, other = track(), replace(track(holds=((20, 26),), seed=1), person=1)
    both = [find_holds(tracks, GestureSettings()) for tracks in ([one, other], [other, one])]
    assert [(h.person, h.start_s) for h in both[0]] == [(h.person, h.start_s) for h in both[1]]
    assert [hold.person for hold in both[0]] == [0, 1, 0]


def test_an_arm_of_which_no_view_has_a_say_ends_nothing():
    arm = replace(track(), views=np.zeros(45, int))
    assert len(find_holds([arm], GestureSettings())) == 2
    assert hold_within([arm], 10 * PERIOD, 18 * PERIOD, GestureSettings()) is None
