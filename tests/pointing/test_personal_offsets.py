"""People's own offsets against Bayes' rule written out, and on a person who misses by the same each time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_t

from jaxpoint.body.joints import joints_with_covariance
from jaxpoint.geometry.angles import azimuth_elevation
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.answers import ObjectScene, answers
from jaxpoint.pointing.held_joints import HeldJoints
from jaxpoint.pointing.holds import Hold
from jaxpoint.pointing.line_hypotheses import LineHypothesis, People, line_hypotheses
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.personal_offsets import Offsets, learnt_offsets, turned_lines
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import Behaviour
from jaxpoint.pointing.room_box import Room
from jaxpoint.pointing.shapes import Rectangle

PEOPLE = People(jnp.diag(jnp.deg2rad(jnp.array([5.0, 8.0])) ** 2), Behaviour(np.deg2rad(2.0), np.deg2rad(3.0)))
WHO = [4, 9, 4, 2, 9, 4]
LEFT = np.array([False, True, False, False, True, False])
OTHERS, WRONG = np.array([0.3, 0.2, 0.1, 0.5, 0.2, 0.05]), np.array([0.02, 0.15, 0.02, 0.02, 0.02, 0.15])
WEIGHT = np.array([0.9, 0.4, 0.6, 0.8, 0.99, 0.7])


def way() -> LineHypothesis:
    turn = np.linspace(0.0, 1.0, len(WHO))
    direction = np.stack([np.cos(turn), np.sin(turn), 0.1 * turn], axis=1)
    lines = PointingLine(Ray(np.zeros((len(WHO), 3)), direction), np.zeros((len(WHO), 6, 6)))
    return LineHypothesis("forearm", lines, WEIGHT, Behaviour(), np.zeros((len(WHO), 3, 3)), people=PEOPLE)


def density(azimuth, elevation):
    """As if everything that can be meant lay about two directions."""
    return np.exp(-((azimuth - 0.5) ** 2 + (elevation + 0.1) ** 2) / 0.02) + 0.5 * np.exp(
        -((azimuth - 0.2) ** 2) / 0.01
    )


def ask(lines, behaviour, gestures):
    assert behaviour is PEOPLE.within
    azimuth, elevation = np.moveaxis(np.asarray(azimuth_elevation(lines.ray.direction)), -1, 0)
    first = 1 / (1 + np.exp(-5 * azimuth - gestures))
    return np.stack([first, 1 - first], axis=-1), density(azimuth, elevation)


def by_hand(gesture: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Offset, probabilities and density of one gesture: loops over offsets and the person's other gestures."""
    grid, start = Offsets.of(PEOPLE), np.asarray(azimuth_elevation(way().lines.ray.direction))
    total, offset, told = 0.0, np.zeros(2), np.zeros(2)
    before = 0.0
    for angles, prior in zip(grid.angles, grid.prior):
        chance = prior

        def seen(i, angles=angles):
            azimuth = start[i, 0] - (-1 if LEFT[i] else 1) * angles[0]
            return azimuth, start[i, 1] - angles[1]

        for i in range(len(WHO)):
            if i != gesture and WHO[i] == WHO[gesture]:
                other = OTHERS[i] + WEIGHT[i] * density(*seen(i))
                chance *= (1 - WRONG[i]) * other + WRONG[i] / (4 * np.pi)
        before += chance
        azimuth, elevation = seen(gesture)
        offset += chance * density(azimuth, elevation) * angles
        first = 1 / (1 + np.exp(-5 * azimuth - gesture))
        total += chance * density(azimuth, elevation)
        told += chance * density(azimuth, elevation) * np.array([first, 1 - first])
    return offset / total, told / total, total / before


def test_offsets_are_those_of_bayes():
    with jax.enable_x64(True):
        found = learnt_offsets(way(), OTHERS, WRONG, WHO, LEFT, ask)
        expected = [by_hand(i) for i in (0, 1, 2, 4, 5)]
    np.testing.assert_array_equal(found.gestures, [0, 1, 2, 4, 5])  # a person who points once has no scatter
    for got, wanted in zip((found.offset, found.probability, found.marginal), zip(*expected)):
        np.testing.assert_allclose(got, wanted, rtol=1e-7, atol=1e-10)


def test_nothing_is_learnt_where_nobody_points_twice_or_people_are_not_known():
    assert learnt_offsets(way(), OTHERS, WRONG, range(6), LEFT, ask) is None
    with_none = LineHypothesis("", way().lines, WEIGHT, Behaviour(), np.zeros((6, 3, 3)))
    assert learnt_offsets(with_none, OTHERS, WRONG, WHO, LEFT, ask) is None


def test_the_grid_has_peoples_offsets_with_heavy_tails():
    between = np.deg2rad(4.0) ** 2 * np.array([[1.0, 0.5], [0.5, 1.5]])
    with jax.enable_x64(True):
        grid = Offsets.of(People(jnp.asarray(between), PEOPLE.within))
    expected = multivariate_t(shape=between, df=4).pdf(grid.angles)
    np.testing.assert_allclose(grid.prior, expected / expected.sum())
    bare = np.einsum("oi,ij,oj->o", grid.angles, np.linalg.inv(between), grid.angles)
    assert 5.0 < np.sqrt(bare.max()) < 6.5  # some people are unlike all others


OFFSET = np.deg2rad([6.0, 11.0])  # inwards and up


def card(middle, name) -> Thing:
    """20 cm wide and high, square to a wall that faces x."""
    sides = 0.1 * np.array([[0, 1, 1], [0, -1, 1], [0, 1, -1], [0, -1, -1]], float)
    return Thing(name, Rectangle(middle + sides))


def pointed(hand: str) -> tuple[HeldJoints, ObjectScene]:
    """Four gestures of a bent arm at cards on a wall; the line of the first meets another one."""
    side, held, things = (1.0 if hand == "right" else -1.0), [], []
    head = np.array([1.0, 3.0, 1.6])
    for i, (y, z) in enumerate(((3.0, 1.2), (2.2, 0.7), (3.8, 1.5), (3.0, 0.5))):
        meant = np.array([5.0, y, z])
        tip = head + np.array([0.45, -0.25 * side, -0.45])
        straight = PointingLine(Ray(tip[None], (meant - tip)[None] / np.linalg.norm(meant - tip)), np.zeros((1, 6, 6)))
        ahead = np.asarray(turned_lines(straight, -OFFSET[None], np.array([side < 0])).ray.direction[0])
        places = np.concatenate([head, tip - 0.42 * ahead, tip - 0.17 * ahead, tip])
        held.append(joints_with_covariance(jnp.asarray(places), jnp.eye(12) * 0.003**2))
        things.append(card(meant, f"meant {i}"))
        if i == 0:
            things.append(card(tip + ahead * (5.0 - tip[0]) / ahead[0], "met"))
    joints, covariance = jax.tree.map(lambda *leaves: jnp.stack(leaves), *held)
    centres = np.array([np.asarray(thing.shape.corners).mean(axis=0) for thing in things])
    scene = ObjectScene(Objects.of(things), centres, Room(np.zeros(3), np.array([6.0, 6.0, 3.0])), True)
    return HeldJoints(joints, covariance, jnp.zeros_like(covariance), np.zeros(4, int)), scene


@pytest.mark.parametrize("kind", ["auto", "forearm"])
@pytest.mark.parametrize("hand", ["right", "left"])
def test_a_persons_other_gestures_tell_the_offset(hand, kind):
    with jax.enable_x64(True):
        held, scene = pointed(hand)
        ways = line_hypotheses(held, kind)
        apart, one = (
            answers(
                [Hold(who, np.arange(2), np.array([0.0, 1.0]) + i, 5) for i, who in enumerate(people)],
                held,
                ways,
                scene,
                range(4),
                [0] * 4,
            )
            for people in ([0, 1, 2, 3], [0, 0, 0, 0])
        )
    assert apart[0].name == "met"
    assert not any("turned" in reason for reason in apart[0].reasons)
    assert [answer.name for answer in one] == [f"meant {i}" for i in range(4)]
    meant = scene.centres[0] - one[0].origin
    off = np.degrees(np.arccos(one[0].direction @ meant / np.linalg.norm(meant)))
    assert off < 3.0  # it was 12
    assert "this person's gestures" in one[0].reasons[-1]
