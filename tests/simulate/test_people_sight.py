"""People point at what they see: the line from the pointing eye meets what is meant before anything else."""

from typing import Any, cast

import jax
import numpy as np
import pytest

from jaxpoint.config.people import PeopleSettings, PointingSettings
from jaxpoint.config.simulation import SceneSettings
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.shapes import Rectangle
from jaxpoint.simulate.people.line_of_sight import seen_place
from jaxpoint.simulate.people.play import make_play
from jaxpoint.simulate.scene import make_scene
from jaxpoint.simulate.simulated_session import floor_of


def upright(distance: float, low: tuple[float, float], high: tuple[float, float]) -> np.ndarray:
    """Corners of a rectangle across the x axis, between two places (y, z)."""
    return np.array([(distance, y, z) for z in (high[1], low[1]) for y in (high[0], low[0])])


BOARD = upright(2.0, (-1.0, -0.5), (1.0, 0.5))
EYE = np.zeros(3)


def test_the_largest_part_that_is_seen_is_pointed_at_in_its_middle():
    # Its shadow on the board leaves y from -1 to -0.2, in which discs of 0.4 m lie at heights of -0.1 to 0.1.
    hides = upright(1.0, (-0.1, -0.3), (0.5, 0.3))
    np.testing.assert_allclose(seen_place(EYE, BOARD, hides[None]), [2.0, -0.6, 0.0], atol=0.03)


@pytest.mark.parametrize("behind", [upright(2.1, (-1, -1), (1, 1)), upright(-1.0, (-1, -1), (1, 1)), BOARD])
def test_what_lies_behind_hides_nothing(behind):
    np.testing.assert_allclose(seen_place(EYE, BOARD, behind[None]), [2.0, 0.0, 0.0], atol=0.03)


def test_what_is_hidden_but_for_an_edge_is_not_pointed_at():
    for edge in (-0.5, -0.47):
        assert seen_place(EYE, BOARD, upright(1.0, (edge, -0.5), (0.5, 0.5))[None]) is None


@pytest.mark.parametrize("nothing", [0.0, 1.0])
def test_the_line_of_sight_first_meets_what_is_meant(nothing):
    settings = PeopleSettings(
        play="gestures", people=14, gestures=14, nothing=nothing, pointing=PointingSettings(accurate_share=1.0)
    )
    for seed in range(5):
        scene = make_scene(np.random.default_rng(seed), SceneSettings())
        play = make_play(seed, settings, cast(Any, scene.objects), floor_of(scene))
        with jax.enable_x64(True):
            objects = Objects.of([Thing(thing.name, Rectangle(thing.corners)) for thing in scene.objects])
            eyes, targets = np.stack([sight(actor) for actor in play.actors], axis=1)
            away = targets - eyes
            hits = intersect(Ray(eyes, away / np.linalg.norm(away, axis=1, keepdims=True)), objects, 1)
        met = [objects.names[k] if valid else "nothing" for k, valid in zip(hits.object[:, 0], hits.valid[:, 0])]
        assert met == [actor.gestures[0].target for actor in play.actors]


def sight(actor) -> tuple[np.ndarray, np.ndarray]:
    """The eye that is in line with fingertip and target, and the target."""
    gesture = actor.gestures[0]
    joints = actor.joints((gesture.hold_first_s + gesture.hold_last_s) / 2)
    tip, target = joints[f"{gesture.hand}_tip"], gesture.target_m

    def aside(eye: np.ndarray) -> float:
        return float(np.linalg.norm(np.cross(tip - eye, target - eye)) / np.linalg.norm(target - eye))

    return min((joints["left_eye"], joints["right_eye"]), key=aside), target
