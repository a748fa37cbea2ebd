"""The aiming eye against Bayes' rule written out, and on a person whose eye is known."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.body.joints import joints_with_covariance, other_eye
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.aiming_eye import MOST_SURE, learnt_eyes
from jaxpoint.pointing.answers import ObjectScene, answers
from jaxpoint.pointing.held_joints import HeldJoints
from jaxpoint.pointing.holds import Hold
from jaxpoint.pointing.line_hypotheses import LineHypothesis, line_hypotheses
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import Behaviour
from jaxpoint.pointing.room_box import Room
from jaxpoint.pointing.shapes import Rectangle

AIMING = np.array([0.9, 0.5, 0.99, 0.8, 0.02])
PEOPLE = [7, 3, 7, 3, 3]
MARGINAL = np.array([[0.2, 1.0, 0.3, 0.5, 0.1], [0.6, 0.4, 0.5, 1.5, 9.0], [0.1, 0.3, 0.2, 0.1, 0.4]])


def ways(aiming: np.ndarray) -> list[LineHypothesis]:
    count = len(aiming)
    lines = PointingLine(Ray(np.zeros((count, 3)), np.zeros((count, 3))), np.zeros((count, 6, 6)))
    weights = (0.7 * aiming, 0.3 * aiming, 1 - aiming)
    return [
        LineHypothesis("", lines, weight, Behaviour(), np.zeros((count, 3, 3)), aims)
        for weight, aims in zip(weights, (True, True, False))
    ]


def by_hand(gesture: int) -> float:
    """The probability of the first eye: a product over all that this person does."""
    chances = []
    for eye, prior in enumerate((0.7, 0.3)):
        own = [i for i in range(len(PEOPLE)) if PEOPLE[i] == PEOPLE[gesture]]
        chances.append(prior * np.prod([AIMING[i] * MARGINAL[eye, i] + (1 - AIMING[i]) * MARGINAL[2, i] for i in own]))
    return chances[0] / sum(chances)


def test_the_eye_is_that_of_bayes():
    found = learnt_eyes(ways(AIMING), MARGINAL, PEOPLE)
    expected = np.array([by_hand(i) for i in range(len(PEOPLE))])
    np.testing.assert_allclose(found, [AIMING * expected, AIMING * (1 - expected), 1 - AIMING], rtol=1e-12)


def test_no_number_of_gestures_makes_an_eye_certain():
    many = learnt_eyes(ways(np.full(50, 0.9)), np.tile([[0.1], [5.0], [0.1]], 50), [0] * 50)
    np.testing.assert_allclose(many[1], 0.9 * MOST_SURE)
    without = learnt_eyes(ways(AIMING), np.zeros((3, 5)), PEOPLE)  # where no line says anything
    np.testing.assert_allclose(without[0], 0.7 * AIMING)


def test_one_line_that_was_asked_for_keeps_its_weight():
    only = [replace(way, weight=np.ones(5), aims=False) for way in ways(AIMING)[:1]]
    np.testing.assert_array_equal(learnt_eyes(only, MARGINAL[:1], PEOPLE), np.ones((1, 5)))


def card(origin, direction) -> Rectangle:
    """10 cm wide and high, 2.5 m along a line."""
    left = np.cross([0.0, 0.0, 1.0], direction)
    left /= np.linalg.norm(left)
    up = np.cross(direction, left)
    middle = origin + 2.5 * direction
    return Rectangle(middle + 0.05 * np.array([left + up, up - left, left - up, -left - up]))


@pytest.fixture(scope="module")
def aimed() -> tuple[HeldJoints, ObjectScene]:
    """Four gestures with the eye away from the hand; in the first the other eye's line meets something, too."""
    held, things = [], []
    for i, turn in enumerate(np.deg2rad([-50.0, -10.0, 30.0, 70.0])):
        ahead, right = np.array([np.cos(turn), np.sin(turn), -0.2]), np.array([np.sin(turn), -np.cos(turn), 0.0])
        head = np.array([3.0, 3.0, 1.65])
        tip = head + 0.65 * ahead / np.linalg.norm(ahead)
        elbow = tip - 0.42 * ahead + 0.12 * right - [0, 0, 0.12]
        wrist = tip - 0.17 * ahead + 0.02 * right
        places = np.concatenate([head, elbow, wrist, tip])
        held.append(joints_with_covariance(jnp.asarray(places), jnp.eye(12) * 0.004**2))
        for eye, name in ((other_eye(held[-1][0]), "meant"), (held[-1][0], "beside"))[: 2 if i == 0 else 1]:
            direction = np.asarray(eye.tip - eye.eye)
            things.append(Thing(f"{name} {i}", card(tip, direction / np.linalg.norm(direction))))
    joints, covariance = jax.tree.map(lambda *leaves: jnp.stack(leaves), *held)
    centres = np.array([np.asarray(thing.shape.corners).mean(axis=0) for thing in things])
    scene = ObjectScene(Objects.of(things), centres, Room(np.zeros(3), np.array([6.0, 6.0, 3.0])), True)
    return HeldJoints(joints, covariance, jnp.zeros_like(covariance), np.zeros(4, int)), scene


@pytest.mark.parametrize(("person", "named"), [([0, 1, 2, 3], "beside 0"), ([0, 0, 0, 0], "meant 0")])
def test_a_persons_other_gestures_tell_the_eye(aimed, person, named):
    held, scene = aimed
    holds = [Hold(who, np.arange(2), np.array([0.0, 1.0]) + i, 5) for i, who in enumerate(person)]
    told = answers(holds, held, line_hypotheses(held, "auto"), scene, range(4), [0] * 4)
    assert [answer.name for answer in told] == [named, "meant 1", "meant 2", "meant 3"]
    assert told[0].line == "eye-fingertip"
    assert [place.name for place in told[0].hits] == [named]
