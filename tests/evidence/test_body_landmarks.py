"""Landmarks as evidence of single views: heads, boxes, and no claim about outlines."""

import numpy as np
import pytest

from jaxpoint.evidence import BodyLandmarks, FrameReason, HeadReason, landmark_views

SIZES = np.array([[640, 480], [320, 240]])


@pytest.fixture(scope="module")
def views():
    """Two cameras and three frames; the second camera has no image of the last one."""
    ears = {"left_ear": (110.0, 50.0, 0.7), "right_ear": (90.0, 54.0, 0.9), "nose": (100.0, 70.0, 0.4)}
    people = [
        (2, 0, {"left_elbow": (200.0, 100.0)}),
        (0, 1, {"nose": (20.0, 30.0), "left_eye": (24.0, 26.0)}),
        (0, 0, ears),
        (0, 0, {"head": (300.0, 40.0, 0.5), "right_wrist": (310.0, 140.0, 0.2)}),
    ]
    has_image = np.array([[True, True], [True, True], [True, False]])
    return landmark_views(BodyLandmarks.of(people), SIZES, has_image)


def test_frames_say_what_they_held(views):
    person, nobody, missing = FrameReason.PERSON, FrameReason.NOBODY, FrameReason.NO_IMAGE
    assert [view.reasons.tolist() for view in views] == [[person, nobody, person], [person, nobody, missing]]
    assert [[len(view.of(frame)) for frame in range(3)] for view in views] == [[2, 0, 1], [1, 0, 0]]
    assert [view.size for view in views] == [(640, 480), (320, 240)]


def test_a_head_is_between_the_ears_or_given_or_in_the_face(views):
    np.testing.assert_allclose(views[0].head[:2], [[100.0, 52.0], [300.0, 40.0]])
    np.testing.assert_allclose(views[1].head, [[22.0, 28.0]])
    assert views[0].head_reason.tolist() == [HeadReason.FOUND, HeadReason.FOUND, HeadReason.UNLIKE]
    np.testing.assert_allclose(views[0].head_certainty, [0.9, 0.5, 1.0])
    assert (views[0].head_height >= 10).all()


def test_boxes_hold_what_was_seen(views):
    assert views[0].box[0].tolist() == [90, 50, 21, 21]


def test_nothing_is_claimed_of_outlines(views):
    person = views[0].person(1)
    assert not person.outlined
    assert person.joints().seen.sum() == 2
    assert person.limb_ends(100.0, None, 20.0) == []
    assert person.edges_along(np.zeros((24, 2)), np.array([0.0, 1.0]), 100.0) is None
    assert person.tips_beyond(np.zeros(2), np.array([1.0, 0.0]), 100.0) == []
    assert not person.pixels_at(np.zeros((3, 2))).any()
    assert not person.shows_skin
    assert views[0].labels(1) is None
    assert not views[0].moving_edges.any()
    assert not views[0].colourless.any()
    assert not views[0].silhouette_px.any()


def test_unknown_joints_are_refused():
    with pytest.raises(ValueError, match="There is no joint 'tail'"):
        BodyLandmarks.of([(0, 0, {"tail": (1.0, 2.0)})])
    assert len(BodyLandmarks.of([]).frame) == 0
