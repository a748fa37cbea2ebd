"""Held joints and the answer to a gesture whose room, cameras and target are known: the benchmark's own."""

from dataclasses import replace

import gesture as benchmark
import numpy as np
import pytest

from jaxpoint.pointing.held_joints import held_joints


@pytest.fixture(scope="module")
def given():
    return benchmark.drawn(benchmark.GestureTime(frames=4))


def test_a_hold_is_the_same_alone_and_among_others(given):
    later = replace(given.hold, frames=given.hold.frames[1:], times=given.hold.times[1:])
    alone = held_joints(given.rig, given.following, [given.hold])
    among = held_joints(given.rig, given.following, [later, given.hold, later])
    np.testing.assert_allclose(among.joints.flat[1], alone.joints.flat[0], atol=1e-12)
    np.testing.assert_allclose(among.covariance[1], alone.covariance[0], atol=1e-12)
    assert np.abs(among.joints.flat[0] - alone.joints.flat[0]).max() > 1e-6
    assert (np.asarray(alone.calibration) == 0).all()


def test_the_gesture_of_the_benchmark_is_answered(given):
    assert given.target in benchmark.answered(given, known=False)
