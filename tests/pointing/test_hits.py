"""Hits, nearest objects and walls against brute force in numpy, scipy's minimisers and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from furnished import rays, room, things
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, lsq_linear

from jaxpoint.compilation import jit_once
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.hits import MOST, intersect
from jaxpoint.pointing.nearest import nearest, nearest_to_points
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.room_box import MARGIN_M, SURFACES, Room, end_in_room
from jaxpoint.pointing.shapes import Box, Rectangle, Sphere
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives
from jaxpoint.pointing.shapes.sphere import Spheres

COUNT = 64


def met(shape, origin, direction):
    """Distance at which a ray meets a shape, or None; triangles after Moeller and Trumbore, slabs, a quadratic."""
    if isinstance(shape, Rectangle):
        a, b, c, d = np.asarray(shape.corners)
        found = [triangle(origin, direction, *corners) for corners in ((a, b, c), (d, b, c))]
        return next((t for t in found if t is not None), None)
    if isinstance(shape, Sphere):
        gap = origin - shape.center
        roots = np.roots([1.0, 2 * gap @ direction, gap @ gap - shape.radius**2])
        return roots.real.min() if np.isreal(roots).all() and roots.real.min() > 0 else None
    cos, sin = np.cos(shape.yaw), np.sin(shape.yaw)
    into = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    start, step = into @ (origin - shape.center), into @ direction
    ends = np.sort(np.stack([(-shape.size / 2 - start) / step, (shape.size / 2 - start) / step]), axis=0)
    near, far = ends[0].max(), ends[1].min()
    return near if 0 < near < far else None


def triangle(origin, direction, a, b, c):
    across = np.cross(direction, c - a)
    scale = 1 / ((b - a) @ across)
    u = scale * ((origin - a) @ across)
    other = np.cross(origin - a, b - a)
    v, t = scale * (direction @ other), scale * ((c - a) @ other)
    return t if u >= 0 and v >= 0 and u + v <= 1 and t > 0 else None


@given(st.integers(0, 10**6))
@settings(max_examples=8, deadline=None)
def test_hits_are_those_of_brute_force_in_order(seed):
    listed, objects, lines = things(seed), room(seed), rays(seed, COUNT)
    hits = intersect(lines, objects)
    for g, (origin, direction) in enumerate(zip(np.asarray(lines.origin), np.asarray(lines.direction))):
        found = {k: met(thing.shape, origin, direction) for k, thing in enumerate(listed)}
        expected = sorted((t, k) for k, t in found.items() if t is not None)
        assert int(hits.count[g]) == len(expected)
        np.testing.assert_array_equal(hits.valid[g], np.arange(MOST) < len(expected))
        some = np.asarray(hits.valid[g])
        np.testing.assert_array_equal(np.asarray(hits.object[g])[some], [k for _, k in expected[:MOST]])
        np.testing.assert_allclose(np.asarray(hits.distance[g])[some], [t for t, _ in expected[:MOST]], rtol=1e-9)
        assert (np.asarray(hits.point[g])[~some] == 0).all()


def test_points_and_fractions_are_those_of_the_face():
    corners = np.array([[1.0, 3, 2], [3, 3, 2], [1, 3, 1], [3, 3, 1]])
    objects = Objects.of([Thing("screen", Rectangle(corners))])
    for u, v in ((0.1, 0.2), (0.9, 0.7)):
        aim = corners[0] + u * (corners[1] - corners[0]) + v * (corners[2] - corners[0])
        for start in np.array([[2.0, 0, 1.5], [2.0, 6, 1.5]]):  # from both sides
            hits = intersect(Ray.through(start, aim), objects)
            np.testing.assert_allclose(hits.point[0], aim, atol=1e-12)
            np.testing.assert_allclose(hits.fractions[0], [u, v], atol=1e-12)
    assert int(intersect(Ray([2.0, 0, 1.5], [1.0, 0, 0]), objects).count) == 0  # parallel to everything
    assert int(intersect(Ray([2.0, 0, 1.5], [0, -1.0, 0]), objects).count) == 0  # behind


def test_as_many_hits_as_asked_for_and_many_lines_by_all_cores():
    row = [Thing(f"{i}", Sphere(np.array([float(i), 0, 0]), 0.3)) for i in range(1, 13)]
    line = Ray([0.0, 0, 0], [1.0, 0, 0])
    hits = intersect(line, Objects.of(row))
    assert (int(hits.count), hits.valid.sum()) == (12, MOST)
    assert intersect(line, Objects.of(row), most=12).object.tolist() == list(range(12))
    objects, lines = room(5), rays(5, 2100)
    many, few = intersect(lines, objects), intersect(Ray(lines.origin[2060:], lines.direction[2060:]), objects)
    np.testing.assert_array_equal(many.object[2060:], few.object)
    np.testing.assert_allclose(many.distance[2060:], few.distance, rtol=1e-12)


def test_derivatives_of_hits():
    objects = room(7)
    lines = rays(7, COUNT)
    place = int(np.argmax(np.asarray(intersect(lines, objects).count)))
    origin, direction = np.asarray(lines.origin[place]), np.asarray(lines.direction[place])

    def last(origin, direction):
        hits = intersect(Ray(origin, direction), objects)
        return jnp.sum(hits.distance) + jnp.sum(hits.fractions * jnp.array([[1.0, 2.0]])) + jnp.sum(hits.point)

    slopes = jit_once(jax.grad(last, argnums=(0, 1)))(jnp.asarray(origin), jnp.asarray(direction))
    for which, slope in enumerate(slopes):
        for axis in range(3):
            there, back = [origin.copy(), direction.copy()], [origin.copy(), direction.copy()]
            there[which][axis] += 1e-6
            back[which][axis] -= 1e-6
            np.testing.assert_allclose(slope[axis], (last(*there) - last(*back)) / 2e-6, rtol=1e-5, atol=1e-6)


def least_angle(corner, sides, direction):
    """Of a rectangle from a ray from 0, by ever finer grids: the cones about a ray cut convex parts out of a plane."""
    middle, half = np.array([0.5, 0.5]), 0.5
    for _ in range(12):
        rows = (np.clip(part + half * np.linspace(-1, 1, 33), 0, 1) for part in middle)
        grid = np.stack(np.meshgrid(*rows), axis=-1).reshape(-1, 2)
        gaps = corner + grid @ sides
        found = np.arctan2(np.linalg.norm(np.cross(direction, gaps), axis=1), gaps @ direction)
        middle, half = grid[np.argmin(found)], half / 4
    return found.min()


def by_minimiser(shape, origin, direction):
    """Angle and distance of a rectangle from a ray, and its distance from the ray's origin."""
    a, b, c, _ = np.asarray(shape.corners)
    sides = np.stack([b - a, c - a])
    across = lsq_linear(np.stack([*sides, -direction], axis=1), origin - a, ([0, 0, 0], [1, 1, np.inf]), "bvls")
    away = lsq_linear(sides.T, origin - a, (0, 1), "bvls")
    return least_angle(a - origin, sides, direction), np.sqrt(2 * across.cost), np.sqrt(2 * away.cost)


@given(st.integers(0, 10**6))
@settings(max_examples=2, deadline=None)
def test_nearest_rectangles_are_those_of_a_minimiser(seed):
    listed = things(seed, rectangles=6, boxes=0, spheres=0)
    objects, lines = Objects.of(listed), rays(seed, 8)
    by_angle, by_distance = nearest(lines, objects, most=6), nearest(lines, objects, "distance", most=6)
    spot = nearest_to_points(lines.origin, objects, most=6)
    for g, (origin, direction) in enumerate(zip(np.asarray(lines.origin), np.asarray(lines.direction))):
        angles, across, away = np.transpose([by_minimiser(thing.shape, origin, direction) for thing in listed])
        ahead = angles < np.pi / 2
        for ours, oracle in ((by_angle, angles), (by_distance, across)):
            some = np.asarray(ours.valid[g])
            np.testing.assert_allclose(np.asarray(ours.measure[g])[some], np.sort(oracle[ahead]), atol=1e-6)
        np.testing.assert_allclose(spot.measure[g], np.sort(away), atol=1e-6)


def test_nearest_of_spheres_and_boxes_and_what_lies_behind():
    listed = [
        Thing("ball", Sphere(np.array([2.0, 1, 0]), 0.5)),
        Thing("box", Box(np.array([2.0, -1, 0]), np.array([1.0, 0.2, 0.4]))),
        Thing("behind", Sphere(np.array([-2.0, 0, 0]), 0.5)),
    ]
    found = nearest(Ray([0.0, 0, 0], [1.0, 0, 0]), Objects.of(listed))
    assert found.object.tolist()[:2] == [0, 1]
    assert found.valid.tolist() == [True, True, False]
    ball = np.arctan2(1, 2) - np.arcsin(0.5 / np.sqrt(5))
    np.testing.assert_allclose(found.measure[:2], [ball, np.arctan2(0.9, 2.5)], atol=1e-9)
    across = nearest(Ray([0.0, 0, 0], [1.0, 0, 0]), Objects.of(listed), "distance")
    np.testing.assert_allclose(across.measure[:2], [0.5, 0.9], atol=1e-9)


def test_what_holds_for_all_convex_primitives_agrees_with_closed_forms():
    """Searched distances, and angles by the polygon of 12 corners that has the area of a sphere's outline."""
    spheres = Objects.of(things(6, rectangles=0, boxes=0, spheres=8)).shapes.primitives[0]
    line = Ray(np.array([3.0, 2.5, 1.3]), np.array([0.6, 0.0, 0.8]))

    @jit_once
    def both(spheres):
        ways = AbstractPrimitives, Spheres
        return [
            (way.distances(spheres, line), way.angles(spheres, line), way.solid_angles(spheres, line.origin))
            for way in ways
        ]

    (distance, angle, solid), exact = both(spheres)
    assert (np.asarray(exact[0]) > 0).sum() > 4
    np.testing.assert_allclose(distance, exact[0], atol=1e-8)
    np.testing.assert_allclose(angle, exact[1], atol=0.02)
    np.testing.assert_allclose(solid, exact[2], rtol=0.02)


def test_an_object_has_its_middle_and_its_extremes():
    listed = things(2, rectangles=2, boxes=2, spheres=2)
    objects = Objects.of(listed)
    low, high = (np.stack(side) for side in zip(*(thing.shape.bounds for thing in listed)))
    np.testing.assert_allclose(objects.middles, (low + high) / 2, atol=1e-12)
    np.testing.assert_allclose(objects.bounds, [low.min(axis=0), high.max(axis=0)], atol=1e-12)


def test_another_measure_is_refused():
    with pytest.raises((ValueError, TypeError), match="wall"):
        nearest(Ray([0.0, 0, 0], [1.0, 0, 0]), room(0), "wall")


def test_derivatives_of_nearest_are_finite_and_right():
    objects, lines = room(3), rays(3, 4)

    @jit_once
    def least(origin):
        def of(measure):
            return lambda origin: jnp.sum(nearest(Ray(origin, lines.direction), objects, measure).measure)

        return [jax.value_and_grad(of(measure))(origin) for measure in ("angle", "distance")]

    step = np.zeros((4, 3))
    step[2, 1] = 1e-6
    slopes, ups, downs = (least(lines.origin + sign * step) for sign in (0, 1, -1))
    for (_, slope), (there, _), (back, _) in zip(slopes, ups, downs):
        np.testing.assert_allclose(slope[2, 1], (there - back) / 2e-6, rtol=1e-4, atol=1e-6)
        assert np.isfinite(slope).all()


def test_pointing_at_nothing_ends_on_a_wall():
    low, high = np.array([0.0, 0, 0]), np.array([6.0, 5, 2.7])
    lines = rays(11, COUNT)
    ends = end_in_room(lines, Room(low, high))
    assert bool(ends.inside.all())
    for g in range(0, COUNT, 8):
        origin, direction = np.asarray(lines.origin[g]), np.asarray(lines.direction[g])
        rows = np.concatenate([direction, -direction])[:, None]
        reach = linprog([-1.0], A_ub=rows, b_ub=np.concatenate([high - origin, origin - low])).x[0]
        np.testing.assert_allclose(ends.distance[g], reach, rtol=1e-7)
        off = np.concatenate([np.asarray(ends.point[g]) - low, high - np.asarray(ends.point[g])])
        assert int(np.argmin(np.abs(off))) == int(ends.surface[g])
    assert SURFACES[int(end_in_room(Ray([1.0, 1, 1], [0, 0, -1.0]), Room(low, high)).surface)] == "the floor"
    assert not bool(end_in_room(Ray([7.0, 1, 1], [0, 0, -1.0]), Room(low, high)).inside)


def test_a_guessed_room_is_hardly_larger_than_what_is_known_of_it():
    things = [
        Thing("clock", Sphere(np.array([2.0, 1.0, 2.0]), 0.2)),
        Thing("mat", Sphere(np.array([1.0, 3, 0.5]), 0.1)),
    ]
    guess = Room.around(Objects.of(things))
    np.testing.assert_allclose(guess.low, [0.9 - MARGIN_M, 0.8 - MARGIN_M, 0.0], atol=1e-6)
    np.testing.assert_allclose(guess.high, [2.2 + MARGIN_M, 3.1 + MARGIN_M, 2.2 + MARGIN_M], atol=1e-6)
    grown = Room.around(Objects.of(things), np.array([[-1.0, 2.0, 2.6], [1.0, 2.0, -0.1]]))
    np.testing.assert_allclose(grown.low, [-1.0 - MARGIN_M, 0.8 - MARGIN_M, -0.1], atol=1e-6)
    np.testing.assert_allclose(grown.high, [2.2 + MARGIN_M, 3.1 + MARGIN_M, 2.6 + MARGIN_M], atol=1e-6)


def test_an_empty_database():
    with pytest.raises(ValueError, match="0 objects"):
        Objects.of([])


def test_distances_have_derivatives_by_the_objects_alone():
    """The rays are plain arrays here: only what the function holds is traced."""
    ball = Objects.of([Thing("ball", Sphere(np.array([3.0, 0.0, 0.0]), 0.5))])
    rays = Ray(np.zeros((3, 3)), np.tile([1.0, 0.0, 0.0], (3, 1)))

    def distances(shift):
        return intersect(
            rays,
            eqx.tree_at(lambda o: o.shapes.primitives[0].center, ball, ball.shapes.primitives[0].center + shift[None]),
        ).distance[:, 0]

    np.testing.assert_allclose(jax.jacfwd(distances)(jnp.zeros(3)), np.tile([1.0, 0.0, 0.0], (3, 1)), atol=1e-12)
