"""Why there is no gesture: each cause is named, with a remedy that can help."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jaxpoint.config.pointing import GestureSettings
from jaxpoint.pointing.holds import ArmTrack, find_holds
from jaxpoint.pointing.no_gesture import no_gesture

SETTINGS = GestureSettings()


def following(present):
    return SimpleNamespace(tracking=SimpleNamespace(heads=SimpleNamespace(present=np.full((45, 1), present))))


pytestmark = pytest.mark.usefixtures("any_shape")  # a stand-in for what follows people


def arm(stretch=0.4, speed_m=0.0, frames=range(45)):
    """One that hangs, and points in frames 10 to 19."""
    frames = np.array(frames)
    out = (frames >= 10) & (frames < 20)
    tips = np.where(out[:, None], [0.6, -0.2, 1.5], [0.1, -0.2, 0.65])
    tips[:, 1] += speed_m * frames
    directions = np.where(out[:, None], [0.8, 0.0, 0.6], [0.0, 0.0, -1.0])
    reached = np.where(out, stretch, min(0.14, stretch))
    return ArmTrack(0, frames, 0.16 * frames, tips, directions, reached, np.full(len(frames), 4))


@pytest.mark.parametrize(
    ("present", "tracks", "says", "not_said"),
    [
        (False, [], "nobody was followed in the room", "min-stretch"),
        (True, [arm(frames=[12, 30])], "a whole forearm was measured in 2 only", "min-stretch"),
        (True, [arm(0.185)], "held out was 0.18, not 0.19 of the stature", "min-hold-s"),
        (True, [arm(0.15)], "none was held out farther than 0.17 of the stature, as arms hang", "lower"),
        (True, [arm(speed_m=0.15)], "but was not held still for 0.4 s", "lower --gesture.min-stretch"),
    ],
)
def test_every_cause_has_its_own_sentence(present, tracks, says, not_said):
    error = no_gesture(45, following(present), tracks, SETTINGS)
    assert str(error).startswith("No gesture was found in 45 frames")
    assert says in str(error)
    assert not_said not in str(error)


def test_the_stretch_that_is_named_finds_the_gesture():
    bent = arm(0.185)
    error = str(no_gesture(45, following(True), [bent], SETTINGS))
    asked = float(error.rstrip(".").rsplit(" ", 1)[1])
    assert asked < SETTINGS.min_stretch
    assert find_holds([bent], replace(SETTINGS, min_stretch=asked))
