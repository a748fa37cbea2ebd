"""Worlds with other axes: scipy's rotations, the axes that the tools document, and what happens to shapes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.errors import UsageError
from jaxpoint.geometry.world_axes import WORLDS, world_of
from jaxpoint.pointing.shapes import Box, Rectangle, Sphere

EAST, NORTH, UP = np.eye(3)

# Of each tool, as its documentation has them: which way is up, whether x to y to z is right-handed, what a metre is.
DOCUMENTED = {
    "unity": ([0, 1, 0], False, "m"),
    "unreal": ([0, 0, 1], False, "cm"),
    "opengl": ([0, 1, 0], True, "m"),
    "gltf": ([0, 1, 0], True, "m"),
    "opensim": ([0, 1, 0], True, "m"),
    "opencv": ([0, -1, 0], True, "m"),
    "colmap": ([0, -1, 0], True, "m"),
    "blender": ([0, 0, 1], True, "m"),
    "ros": ([0, 0, 1], True, "m"),
    "room": ([0, 0, 1], True, "m"),
}


@pytest.mark.parametrize("name", WORLDS)
def test_the_worlds_are_as_documented(name):
    world = world_of(name)
    up, right_handed, unit = DOCUMENTED[name]
    assert world.from_room(UP).tolist() == up
    assert (world.right_handed, world.unit) == (right_handed, unit)
    images = world.from_room(np.eye(3))
    assert np.linalg.det(images) == pytest.approx(1.0 if right_handed else -1.0)
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    np.testing.assert_array_equal(world.to_room(world.from_room(points)), points)


def test_right_handed_worlds_are_turned_by_a_rotation():
    turned = Rotation.from_euler("x", -90, degrees=True).apply([1.0, 2.0, 3.0])
    np.testing.assert_allclose(world_of("opengl").from_room(np.array([1.0, 2.0, 3.0])), turned, atol=1e-12)


def test_axes_may_be_written_out():
    assert world_of("X, +z, -y").axes == world_of("opengl").axes
    assert str(world_of("-z,y,x")) == "-z,y,x"


@pytest.mark.parametrize(
    ("text", "what"), [("up", "no world 'up'"), ("x,y", "no world"), ("x,x,z", "an axis of the room twice")]
)
def test_what_is_no_world_is_refused(text, what):
    with pytest.raises(UsageError, match=what):
        world_of(text)


@pytest.mark.parametrize("name", WORLDS)
def test_a_box_has_the_same_corners(name):
    """Turned about the vertical axis of its world by the formula for that axis there, whatever its hand."""
    world = world_of(name)
    yaw, center, size = 0.4, np.array([1.0, 2.0, 3.0]), np.array([0.6, 0.4, 0.2])
    up = int(np.abs(world.from_room(UP)).argmax())
    first, second = (up + 1) % 3, (up + 2) % 3
    axes = np.eye(3)
    axes[first], axes[second] = (
        np.cos(yaw) * np.eye(3)[first] + np.sin(yaw) * np.eye(3)[second],
        (np.cos(yaw) * np.eye(3)[second] - np.sin(yaw) * np.eye(3)[first]),
    )
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T / 2
    known = world.to_room(center + (signs * size) @ axes)
    found = Box(center, size, yaw).to_room(world)
    mine = found.center + signs @ found._sides()
    order = [np.lexsort(np.round(corners, 6).T) for corners in (known, mine)]
    np.testing.assert_allclose(mine[order[1]], known[order[0]], atol=1e-12)


def test_other_shapes_move_with_their_points():
    world = world_of("unity")
    corners = np.random.default_rng(1).normal(size=(4, 3))
    np.testing.assert_array_equal(Rectangle(corners).to_room(world).corners, corners[:, [0, 2, 1]])
    ball = Sphere(np.array([1.0, 2.0, 3.0]), 0.5).to_room(world)
    assert (ball.center.tolist(), ball.radius) == ([1.0, 3.0, 2.0], 0.5)
