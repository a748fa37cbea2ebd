"""The room: what can be pointed at, where people stand, where cameras hang."""

import cv2
import numpy as np
import pytest

from jaxpoint.config.simulation import SceneSettings, ViewpointSettings
from jaxpoint.simulate.scene import make_scene
from jaxpoint.simulate.simulated_session import floor_of
from jaxpoint.simulate.viewpoints import random_viewpoints, rig_of

SEEDS = range(6)


@pytest.fixture(scope="module")
def scenes():
    return [make_scene(np.random.default_rng(seed), SceneSettings()) for seed in SEEDS]


def test_at_least_twenty_named_rectangles_lie_in_the_room(scenes):
    for scene in scenes:
        names = [thing.name for thing in scene.objects]
        assert len(set(names)) == len(names) >= 20
        for thing in scene.objects:
            left_top, right_top, left_bottom, right_bottom = thing.corners
            np.testing.assert_allclose(right_bottom, right_top + left_bottom - left_top, atol=1e-9)
            assert abs((right_top - left_top) @ (left_bottom - left_top)) < 1e-9
            assert (thing.corners >= 0).all()
            assert (thing.corners <= scene.size).all(), thing.name
        heights = np.array([thing.center[2] for thing in scene.objects])
        assert (heights < 0.01).any()
        assert (heights > 2.9).any()


def test_the_front_of_every_object_looks_into_the_room(scenes):
    for scene in scenes:
        for thing in scene.objects:
            left_top, right_top, left_bottom, _ = thing.corners
            front = np.cross(left_bottom - left_top, right_top - left_top)
            assert front @ (scene.size / 2 - thing.center) > 0, thing.name


def test_triangles_face_the_side_of_their_normals(scenes):
    surfaces = scenes[0].surfaces
    a, b, c = (surfaces.vertices[surfaces.triangles[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    large = np.linalg.norm(across, axis=1) > 1e-9
    towards = np.einsum("tc,tc->t", across, surfaces.normals[surfaces.triangles].mean(axis=1))
    assert (towards[large] > 0).all()


def test_rooms_differ_and_come_back_by_their_seed(scenes):
    again = make_scene(np.random.default_rng(2), SceneSettings())
    np.testing.assert_array_equal(again.surfaces.vertices, scenes[2].surfaces.vertices)
    assert len({scene.surfaces.vertices.shape for scene in scenes}) > 3


def test_people_find_free_floor_before_chairs_and_away_from_cameras(scenes):
    for seed, scene in enumerate(scenes):
        views = random_viewpoints(np.random.default_rng(seed), ViewpointSettings(), scene)
        floor = floor_of(scene, views)
        grid = np.stack(np.meshgrid(np.linspace(0, 6, 121), np.linspace(0, 5, 101)), axis=-1).reshape(-1, 2)
        assert floor.is_free(grid, 0.3).mean() * 30 > 6  # m2
        assert len(floor.chairs) == 2
        for view in views:
            assert not floor.is_free(view.position[None, :2], 0.1).any()


def test_what_hangs_from_the_ceiling_is_in_nobodys_way(scenes):
    for scene in scenes:
        floor = floor_of(scene)
        standing = scene.boxes[scene.boxes[:, 0, 2] < 2.5]
        below = np.array([lamp.position[:2] for lamp in scene.lamps])
        over = ((below[:, None] > standing[:, 0, :2] - 0.2) & (below[:, None] < standing[:, 1, :2] + 0.2)).all(axis=2)
        assert len(standing) < len(scene.boxes)
        assert not over.all()
        assert floor.is_free(below[~over.any(axis=1)], 0.2).all()


def test_cameras_look_at_the_room_through_the_lenses_asked_for(scenes):
    settings = ViewpointSettings()
    for seed, scene in enumerate(scenes):
        views = random_viewpoints(np.random.default_rng(seed), settings, scene)
        rig = rig_of(views)
        assert len(rig) == 6
        fields = np.rad2deg(2 * np.arctan(640 / np.array([view.focal for view in views])))
        assert (fields >= 55).all()
        assert (fields <= 85).all()
        heights = np.array([view.position[2] for view in views])
        assert (heights >= 1.8).all()
        assert (heights <= 2.8).all()
        middle = np.asarray(rig.project(np.array(scene.size * [0.5, 0.5, 0.37], np.float64)))
        assert (np.abs(middle - [639.5, 359.5]) < [320, 240]).all()


def test_the_lens_is_that_of_opencv_and_of_the_rig(scenes):
    views = random_viewpoints(np.random.default_rng(0), ViewpointSettings(), scenes[0])
    points = np.random.default_rng(1).uniform([1, 1, 0], [5, 4, 2.5], (200, 3))
    rig = np.asarray(rig_of(views).project(points))
    for i, view in enumerate(views):
        pixels, depth = view.project(points)
        matrix = np.array([[view.focal, 0, view.center[0]], [0, view.focal, view.center[1]], [0, 0, 1]])
        turn = cv2.Rodrigues(view.rotation)[0]
        expected = cv2.projectPoints(points, turn, -view.rotation @ view.position, matrix, view.distortion)[0][:, 0]
        seen = np.isfinite(pixels).all(axis=1)
        assert seen.sum() > 80
        np.testing.assert_allclose(pixels[seen], expected[seen], atol=1e-6)
        np.testing.assert_allclose(pixels[seen], rig[seen, i], atol=1e-6)
        assert (depth[seen] > 0).all()
        # What no lens of this kind can show is left out, not folded into the image.
        inside = ((expected >= 0) & (expected <= [1279, 719])).all(axis=1) & (depth > 0.3)
        assert seen[inside].mean() > 0.95
