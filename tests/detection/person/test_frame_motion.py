"""Motion in drawn rooms: people who walk, light that is switched, and nothing at all."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy import ndimage

from jaxpoint.config.person import MotionSettings, thesis_person
from jaxpoint.detection.person.frame_motion import intervals, learn_threshold, motion_between
from jaxpoint.errors import InsufficientDataError

SETTINGS = MotionSettings()
FPS = 12.5


@pytest.fixture(scope="module")
def empty(drawn):
    return drawn.room(np.random.default_rng(0))


def flicker(frame, rng):
    """Mains against the shutter, and exposure: a gain a frame, and a light that fades over ten minutes."""
    return (1 - 0.3 * frame / (600 * FPS)) * (1 + 0.02 * np.sin(0.9 * frame) + rng.normal(0, 0.005))


def counts_of(frames, settings):
    frames = list(frames)
    return np.array([motion_between(*pair, settings).edges for pair in pairwise(frames)])


def test_ten_minutes_of_an_empty_room_raise_no_alarm(drawn, empty):
    """Learnt from the first 60 pairs, then one second of every ten."""
    rng = np.random.default_rng(1)
    learnt = counts_of((drawn.exposed(empty, rng, gain=flicker(i, rng)) for i in range(61)), SETTINGS)
    threshold = learn_threshold(learnt, SETTINGS)
    for start in range(125, int(600 * FPS), 125):
        images = [drawn.exposed(empty, rng, gain=flicker(start + i, rng)) for i in range(6)]
        assert not intervals(counts_of(images, SETTINGS) > threshold, SETTINGS)


@pytest.mark.parametrize("settings", [SETTINGS, thesis_person().motion], ids=["default", "thesis"])
def test_a_walker_is_found_from_the_first_step_to_the_last(drawn, empty, settings):
    rng = np.random.default_rng(2)
    quiet = counts_of((drawn.exposed(empty, rng, gain=flicker(i, rng)) for i in range(52)), settings)
    threshold = learn_threshold(quiet, settings)
    frames = []
    for i in range(60):
        scene = empty if not 20 <= i < 40 else drawn.Person(100.0 + 9 * i, 80.0, height=200).drawn(empty)
        frames.append(drawn.exposed(scene, rng, gain=flicker(i, rng)))
    assert intervals(counts_of(frames, settings) > threshold, settings) == [(19, 39)]  # pairs: the change into and out


def test_a_hand_far_away_is_motion(drawn, empty):
    rng = np.random.default_rng(3)
    quiet = counts_of((drawn.exposed(empty, rng) for _ in range(52)), SETTINGS)
    first, then = (drawn.Person(300.0, 90.0, height=160, arm=angle).drawn(empty) for angle in (0.2, 0.5))
    edges = motion_between(drawn.exposed(first, rng), drawn.exposed(then, rng), SETTINGS).edges
    assert edges > learn_threshold(quiet, SETTINGS)


def test_a_switched_light_is_told_from_a_person_close_by(drawn, empty):
    rng = np.random.default_rng(4)
    before, after = drawn.exposed(empty, rng), drawn.exposed(empty, rng, gain=0.6)
    for pair in ((before, after), (after, before)):
        motion = motion_between(*pair, SETTINGS)
        assert motion.is_light_switch
        assert motion.changed > 0.9
    close = empty.copy()
    cv2.ellipse(close, (320, 220), (190, 260), 0, 0, 360, (90, 140, 150), -1)
    close[100:300, 200:300] = 230
    motion = motion_between(before, drawn.exposed(close, rng), SETTINGS)
    assert motion.changed > 0.3
    assert not motion.is_light_switch
    assert motion_between(before, before, SETTINGS).changed == 0


def test_the_threshold_is_the_mean_and_five_deviations():
    counts = np.random.default_rng(5).poisson(400, 80)
    assert learn_threshold(counts, SETTINGS) == pytest.approx(counts.mean() + 5 * counts.std())
    assert learn_threshold(np.zeros(50, int), thesis_person().motion) == 50
    with pytest.raises(InsufficientDataError, match="at least 50 pairs of images of the empty room, and there are 49"):
        learn_threshold(counts[:49], SETTINGS)


def test_images_of_different_sizes_are_refused(any_shape):
    with pytest.raises(ValueError, match="cannot be compared"):
        motion_between(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5, 3), np.uint8), SETTINGS)


@pytest.mark.parametrize("seed", range(5))
def test_hysteresis_against_morphology(seed):
    """The same from scipy: openings of 3 above, gaps of fewer than 10 below, grown to the frames above around them."""
    rng = np.random.default_rng(seed)
    above = ndimage.uniform_filter1d(rng.random(600), 4) > 0.55
    runs, count = ndimage.label(above)
    joined, parts = ndimage.label(ndimage.binary_closing(np.pad(above, 20), np.ones(10))[20:-20])
    expected = []
    for part in range(1, parts + 1):
        frames = np.flatnonzero((joined == part) & above)
        lengths = [(np.flatnonzero(runs == run)[0], (runs == run).sum()) for run in range(1, count + 1)]
        starts = [first for first, length in lengths if length >= 3 and frames[0] <= first <= frames[-1]]
        if starts:
            expected.append((int(min(starts)), int(frames[-1])))
    assert intervals(above, SETTINGS) == expected
    assert expected


def test_intervals_at_the_ends():
    assert intervals(np.ones(4, bool), SETTINGS) == [(0, 3)]
    assert intervals(np.zeros(30, bool), SETTINGS) == []
    assert intervals(np.array([True, True] + [False] * 20), SETTINGS) == []
