"""What an answer says: the place that is meant, and that words made it likeliest."""

import json
from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.pointing.answers import Answer, ObjectScene, Place, _by_words, _meant, _without_words
from jaxpoint.pointing.objects import NOTHING, Objects, Thing
from jaxpoint.pointing.room_box import Room
from jaxpoint.pointing.shapes import Box, Sphere
from jaxpoint.report.answer_text import as_json
from jaxpoint.report.gesture_table import gestures_table

THINGS = (
    Thing("doormat", Box(np.array([2.0, 0.3, 0.0]), 0.3 * np.ones(3)), "mat", ("door",)),
    Thing("newspaper", Box(np.array([2.0, -0.2, 0.0]), 0.3 * np.ones(3)), "paper"),
    Thing("lamp", Sphere(np.array([0.0, 2.0, 0.0]), 0.2)),
)
CENTRES = np.array([[2.0, 0.3, 0.0], [2.0, -0.2, 0.0], [0.0, 2.0, 0.0]])
ORIGIN = np.zeros(3)
MET = Place("newspaper", 1.8, np.array([1.8, -0.1, 0.0]))
WALL = Place("the floor", 3.0, np.array([3.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def scene() -> ObjectScene:
    return ObjectScene(Objects.of(THINGS), CENTRES, Room(-3 * np.ones(3), 3 * np.ones(3)), True)


def answered(name: str, *, words: tuple[str, ...] = (), point: np.ndarray | None = None) -> Answer:
    return Answer(
        number=1, person=1, start_s=0.0, end_s=1.0, time_s=0.5, frame=3, views=4, line="forearm", joints={},
        origin=ORIGIN, direction=np.array([1.0, 0.0, 0.0]), sigma_deg=1.0, calibration_sigma_deg=None, hits=(MET,),
        surface=WALL, nearest=(("newspaper", 0.0),), probabilities=((name, 0.9),), ambiguous=False, name=name,
        distance_m=2.0, point=point, reasons=("The first reason.",), words=words,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "surface", "point"),
    [
        ("newspaper", WALL, MET.point),
        ("doormat", WALL, CENTRES[0]),  # missed: its middle
        (NOTHING, WALL, WALL.point),
        (NOTHING, None, None),
    ],
)
def test_every_answer_has_a_place_and_its_distance(scene, name, surface, point):
    meant = _meant(name, [MET], surface, ORIGIN, scene)
    assert (meant is None) == (point is None)
    if meant is not None:
        np.testing.assert_array_equal(meant.point, point)
        assert meant.distance_m == pytest.approx(np.linalg.norm(point), rel=0.01)


def test_the_place_is_told_to_programs_and_in_the_table():
    both = [answered("doormat", point=CENTRES[0]), replace(answered(NOTHING), number=2)]
    told = [json.loads(json.dumps(as_json(answer)))["point_m"] for answer in both]
    assert told == [CENTRES[0].tolist(), None]
    table = gestures_table(both)
    assert [table[f"point_{axis}_m"] for axis in "xyz"] == [[value, None] for value in CENTRES[0]]


@pytest.mark.parametrize(
    ("name", "unsaid", "words", "reason"),
    [
        ("doormat", "newspaper", ("that", "door", "mat"), "The words 'door mat' speak for the doormat."),
        ("doormat", NOTHING, ("this", "mat"), "The word 'mat' speaks for the doormat."),
        (NOTHING, "newspaper", ("lamp",), "The word 'lamp' speaks against the newspaper."),
        ("doormat", "doormat", ("door", "mat"), None),
        ("doormat", "newspaper", ("this",), None),
    ],
)
def test_a_reason_names_the_words_that_decide(scene, name, unsaid, words, reason):
    told = _by_words(answered(name, words=words), unsaid, scene.objects)
    assert told.reasons == ("The first reason.", *([reason] if reason else []))


def test_without_words_probabilities_are_those_of_silence():
    """Scores of three objects and of nothing, by two ways and in two gestures; words are a factor of the objects'."""
    scores, weight = np.random.default_rng(0).uniform(0.1, 1.0, (2, 2, 4)), np.array([[[0.3], [0.6]], [[0.7], [0.4]]])
    evidence = np.array([[1.0, 0.1, 0.01], [1.0, 1.0, 1.0]])
    said = scores * np.append(evidence, np.ones((2, 1)), axis=1)
    each, silent = (own / own.sum(axis=2, keepdims=True) for own in (said, scores))
    np.testing.assert_allclose(_without_words(each, evidence, weight), (weight * silent).sum(axis=0), rtol=1e-12)
