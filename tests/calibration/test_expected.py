"""The expected error of places, and the gain of more light: against triangulation, OpenCV, and light really added."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxpoint.calibration.alignment import Alignment
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.expected import boxes_of, eighths, expected_error, gains
from jaxpoint.calibration.sight import in_view, project
from jaxpoint.calibration.uncertainty import Anchors, variance_px2
from jaxpoint.geometry.pose import Similarity
from jaxpoint.simulate.recalibration import Recalibrated
from jaxpoint.triangulation import triangulate

SIGMA_PX = 0.5
UNTOUCHED = Alignment(Similarity.identity(), "landmarks", (), np.zeros(0), (), 0.0, 0.0, True)
ADDED = 96  # twelve at each of the eight places of a box


@pytest.fixture(scope="module")
def room():
    return Recalibrated.of(3, cameras=5, frames=120, noise_px=SIGMA_PX)


@pytest.fixture(scope="module")
def stated(room):
    return with_covariance(room.truth())


@pytest.fixture(scope="module")
def places():
    return np.random.default_rng(1).uniform([0.3, 0.3, 0.0], [5.7, 4.7, 2.5], (200, 3))


def with_more_light(room, rig, light):
    """The room's calibration had the light also been at these places, each seen by all that have it in view."""
    more = replace(
        room,
        room=replace(room.room, points=np.concatenate([room.room.points, light])),
        exact=np.concatenate([room.exact, project(rig, light)]),
        visible=np.concatenate([room.visible, in_view(rig, light)]),
    )
    return more.truth()


def test_projection_is_opencvs_and_views_are_the_rooms(room, stated, places):
    seen, found = in_view(stated.rig, places), project(stated.rig, places)
    _, expected = room.room.seen(places)
    # The simulation keeps away from the edge of a lens's range.
    assert (seen & expected).sum() == expected.sum()
    assert seen.sum() <= 1.02 * expected.sum()
    for c, camera in enumerate(stated.rig):
        pose = camera.cam_from_world
        lens = np.asarray(camera.distortion)
        turn = cv2.Rodrigues(np.asarray(pose.rotation))[0]
        there, _ = cv2.projectPoints(
            places[seen[:, c]], turn, np.asarray(pose.translation), np.asarray(camera.intrinsics), lens
        )
        np.testing.assert_allclose(found[seen[:, c], c], there[:, 0], atol=1e-6)


def test_the_expected_error_is_that_of_triangulated_places(stated, places):
    expected = expected_error(stated.rig, stated.camera_covariance, SIGMA_PX, places)
    covariances = stated.camera_covariance, np.zeros_like(stated.camera_covariance)
    seen, alone = (
        triangulate(stated.rig, project(stated.rig, places), expected.seen, sigma_px=SIGMA_PX, camera_covariance=each)
        for each in covariances
    )
    known = expected.known
    assert 50 < known.sum() < len(places)
    np.testing.assert_array_equal(known, seen.valid)
    both = np.trace(np.asarray(seen.covariance)[known], axis1=1, axis2=2)
    np.testing.assert_allclose(expected.total[known] ** 2, both, rtol=1e-4)
    observed = np.trace(np.asarray(alone.covariance)[known], axis1=1, axis2=2)
    np.testing.assert_allclose(expected.observation[known], observed, rtol=1e-6)
    assert np.isinf(expected.total[~known]).all()


@pytest.mark.parametrize("held_by", ["centres", "light"])
def test_the_predicted_gain_is_the_one_that_more_light_brings(room, stated, places, held_by):
    """Light added at the very positions of the prediction brings what was predicted; scattered in the box, nearly."""
    frames, nothing = stated.tracks.frames, (np.zeros(0), np.zeros((0, 5, 2)), np.zeros((0, 5), bool))
    lit = np.where((np.arange(frames) % 20 == 0) & (held_by == "light"), 0.004, np.inf)
    anchors = Anchors(lit, np.full(5, 0.004 if held_by == "centres" else np.inf), *nothing)
    aligned = with_covariance(replace(stated, alignment=UNTOUCHED), anchors)
    boxes = boxes_of(np.array([0.6, 0.5, 0.2]), np.array([5.4, 4.5, 2.3]))
    positions = eighths(boxes)
    seen = in_view(stated.rig, positions.reshape(-1, 3)).reshape(*positions.shape[:2], 5)
    whole = np.flatnonzero((seen.sum(axis=2) >= 2).all(axis=1))
    found = gains(
        aligned.rig, aligned.camera_covariance, SIGMA_PX, variance_px2(aligned), places, positions[whole], ADDED
    )  # fmt: skip
    assert len(found) == len(whole) >= 8
    assert found[0].fraction > 1.5 * found[-1].fraction > 0
    assert found[0].fraction > 0.05
    for gain, scattered in ((found[0], False), (found[-1], False), (found[0], True)):
        box = whole[gain.part]
        light = np.repeat(positions[box], ADDED // 8, axis=0)
        if scattered:
            drawn = np.random.default_rng(0).uniform(*boxes[box], (2 * ADDED, 3))
            light = drawn[in_view(stated.rig, drawn).sum(axis=1) >= 2][:ADDED]
        more = replace(with_more_light(room, stated.rig, light), alignment=UNTOUCHED)
        more = with_covariance(more, replace(anchors, light=np.concatenate([lit, np.full(len(light), np.inf)])))
        now = expected_error(more.rig, more.camera_covariance, SIGMA_PX, places)
        really = 1 - now.total[now.known].mean() / gain.before
        assert gain.fraction == pytest.approx(really, rel=0.15 if scattered else 1e-5)
        assert gain.cameras == tuple(np.flatnonzero(seen[box].mean(axis=0) > 0.5))
