"""People in pictures: where the lens puts them, whose pixel is which, what hides what, and what their shadows do."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.config.simulation import SceneSettings, ViewpointSettings
from jaxpoint.simulate.capsules import Capsule
from jaxpoint.simulate.lighting import light_room
from jaxpoint.simulate.mesh import Mesh, Part
from jaxpoint.simulate.render import COARSE, RoomView, draw_people, label_of, light_people, render_room, samples_alone
from jaxpoint.simulate.scene import make_scene
from jaxpoint.simulate.viewpoints import random_viewpoints, rig_of

SIZE = (480, 270)
WHITE = np.ones(3)
ARM = (Part.RIGHT_UPPER_ARM, Part.RIGHT_FOREARM, Part.RIGHT_HAND)
PLACE = np.array([3.0, 2.4, 1.2])


@pytest.fixture(scope="module")
def room():
    scene = make_scene(np.random.default_rng(5), SceneSettings())
    return scene, light_room(scene)


@pytest.fixture(scope="module")
def views(room):
    return random_viewpoints(np.random.default_rng(5), ViewpointSettings(size=SIZE, cameras=4), room[0])


def nothing_behind(size) -> RoomView:
    """A camera's view of a black room without walls."""
    width, height = size
    return RoomView(
        np.zeros((height, width, 3), np.float32),
        np.full((2 * height, 2 * width), np.inf, np.float32),
        (),
        np.zeros((0, 1, 1), np.float32),
        np.zeros((0, 1, 1), np.float32),
    )


def arm_at(place, part=Part.RIGHT_FOREARM, along=(0.0, 0.0, 0.25)) -> Mesh:
    return Capsule(place, place + np.array(along), 0.04, part).mesh(WHITE)


def test_a_small_bright_ball_appears_where_the_rig_projects_it(room, views):
    rng = np.random.default_rng(0)
    size = (1280, 720)
    views = random_viewpoints(np.random.default_rng(5), ViewpointSettings(size=size, cameras=4), room[0])
    rig, compared = rig_of(views), 0
    for place in rng.uniform([1.5, 1.5, 0.3], [4.5, 3.5, 2.2], (12, 3)):
        people = light_people(*2 * (Capsule(place, place, 0.02).mesh(WHITE),), room[1])
        expected, depth = np.asarray(rig.project(place)), np.asarray(rig.depth(place))
        for camera, view in enumerate(views):
            # Near the lens the middle of a ball's outline is not the image of its middle.
            if depth[camera] < 2 or not ((expected[camera] > 20) & (expected[camera] < np.array(size) - 20)).all():
                continue
            lit = replace(people, colour=np.ones_like(people.colour))
            image = draw_people(view, nothing_behind(size), lit).image[..., 0]
            y, x = np.nonzero(image)
            weight = image[y, x]
            centroid = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
            np.testing.assert_allclose(centroid, expected[camera], atol=0.1)
            compared += 1
    assert compared >= 20


def test_labels_follow_the_limbs(room, views):
    forearm = arm_at(PLACE)
    hand = arm_at(PLACE + np.array([0.0, 0.0, 0.33]), Part.RIGHT_HAND, (0.0, 0.0, 0.06))
    mesh = Mesh.joined([forearm, replace(hand, parts=hand.parts + np.uint8(32))])
    people = light_people(mesh, mesh, room[1])
    rig = rig_of(views)
    for camera, view in enumerate(views):
        labels = draw_people(view, nothing_behind(SIZE), people).labels
        for place, label in (
            (PLACE + np.array([0, 0, 0.12]), label_of(Part.RIGHT_FOREARM, 0)),
            (PLACE + np.array([0, 0, 0.36]), 32 + 10),
        ):
            x, y = np.rint(np.asarray(rig.project(place))[camera]).astype(int)
            assert labels[y, x] == label
        assert set(np.unique(labels)) == {0, Part.RIGHT_FOREARM, 32 + Part.RIGHT_HAND}


def test_half_an_arm_behind_furniture_is_half_visible(room, views):
    view = views[0]
    across = view.rotation[0]
    start = PLACE - 0.15 * across
    mesh = Capsule(start, PLACE + 0.15 * across, 0.04, Part.RIGHT_FOREARM).mesh(WHITE)
    people = light_people(mesh, mesh, room[1])
    behind = nothing_behind(SIZE)
    edge = round(2 * view.project(PLACE[None])[0][0, 0])
    behind.depth[:, :edge] = 0.5
    label = label_of(Part.RIGHT_FOREARM, 0)
    alone = samples_alone(view, people, label, ARM)
    assert draw_people(view, nothing_behind(SIZE), people).samples[label] == alone > 200
    assert draw_people(view, behind, people).samples[label] / alone == pytest.approx(0.5, abs=0.02)
    # Another person before it hides it as well.
    board = PLACE + 0.5 * (view.position - PLACE) / np.linalg.norm(view.position - PLACE)
    other = Capsule(board - 5 * across, board - 0.3 * across, 0.3).mesh(WHITE)
    both = Mesh.joined([mesh, replace(other, parts=other.parts + np.uint8(32))])
    hidden = draw_people(view, nothing_behind(SIZE), light_people(both, both, room[1]))
    assert hidden.samples[label] / alone == pytest.approx(0.5, abs=0.06)
    assert hidden.samples[label_of(Part.BODY, 1)] > 0


def test_what_leaves_the_image_counts_as_not_visible(room, views):
    view = views[0]
    right = np.linspace(0.0, 6.0, 400)[:, None] * view.rotation[0] + PLACE
    at_edge = right[np.argmin(np.abs(view.project(right)[0][:, 0] - (SIZE[0] - 0.5)))]
    mesh = Capsule(at_edge - 0.15 * view.rotation[0], at_edge + 0.15 * view.rotation[0], 0.04, 9).mesh(WHITE)
    people = light_people(mesh, mesh, room[1])
    share = draw_people(view, nothing_behind(SIZE), people).samples[9] / samples_alone(view, people, 9, ARM)
    assert share == pytest.approx(0.5, abs=0.05)


def test_motion_smears_over_the_way_gone(room, views):
    view = views[1]
    mesh = Capsule(PLACE, PLACE + np.array([0, 0, 0.3]), 0.02).mesh(WHITE)
    step = 0.1 * view.rotation[0]
    moved = replace(mesh, vertices=mesh.vertices + step)
    still = light_people(mesh, mesh, room[1])
    smeared = replace(light_people(mesh, moved, room[1]), colour=still.colour)
    images = [draw_people(view, nothing_behind(SIZE), people).image.sum(axis=2) for people in (still, smeared)]
    assert images[1].sum() == pytest.approx(images[0].sum(), rel=0.05)  # the same light, over more pixels
    widths = [(image > 0).any(axis=0).sum() for image in images]
    pixels = view.project(np.stack([PLACE, PLACE + step]))[0]
    assert widths[1] - widths[0] == pytest.approx(0.75 * np.abs(pixels[1] - pixels[0])[0], abs=1.5)
    column = np.arange(SIZE[0])
    centres = [(image.sum(axis=0) * column).sum() / image.sum() for image in images]
    assert centres[1] - centres[0] == pytest.approx((pixels[1] - pixels[0])[0] / 2, abs=0.2)


def test_people_shade_the_floor_and_not_the_ceiling(room, views):
    scene, light = room
    view = views[2]
    empty = render_room(view, scene, light)
    assert np.isfinite(empty.image).all()
    assert np.isfinite(empty.depth).mean() > 0.99
    middle = np.append(scene.free_floor.mean(axis=0), 0.0)
    mesh = Capsule(middle + np.array([0, 0, 0.3]), middle + np.array([0, 0, 1.6]), 0.25).mesh(WHITE)
    shown = draw_people(view, empty, light_people(mesh, mesh, light))
    darker = empty.image.mean(axis=2) - shown.image.mean(axis=2)
    room_only = shown.labels == 0
    assert (darker[room_only] > -1e-4).mean() > 0.97  # the rest are half-covered outlines
    floor = room_only & (darker > 0.1 * empty.image.mean(axis=2))
    assert floor.sum() > 200
    y, _ = np.nonzero(floor)
    assert np.quantile(y, 0.05) > SIZE[1] / 4


@pytest.mark.parametrize("size", [(96, 52), (97, 53), (98, 54), (99, 55)])
def test_shadows_reach_the_edges_of_images_of_every_size(room, size):
    scene, light = room
    (view,) = random_viewpoints(np.random.default_rng(5), ViewpointSettings(size=size, cameras=1), scene)
    empty = render_room(view, scene, light)
    assert empty.lamp_shares.shape[1:] == (-(-size[1] // COARSE), -(-size[0] // COARSE))
    mesh = arm_at(PLACE)
    people = light_people(mesh, mesh, light)
    everywhere = replace(people, coverage=np.ones_like(people.coverage), distance=np.zeros_like(people.distance))
    darker = draw_people(view, empty, everywhere).image < empty.image
    assert darker[-1].mean() > 0.9
    assert darker[:, -1].mean() > 0.9


def test_furniture_hides_people(room, views):
    scene, light = room
    table = next(thing for thing in scene.objects if thing.name == "coffee table")
    away = [np.abs(view.project(table.center[None])[0][0] / SIZE - 0.5).max() for view in views]
    view = views[int(np.nanargmin(away))]
    empty = render_room(view, scene, light)
    shares = []
    for height in (-0.08, 0.2):
        ball = Capsule(table.center + np.array([0, 0, height]), table.center + np.array([0, 0, height]), 0.03).mesh(
            WHITE
        )
        people = light_people(ball, ball, light)
        alone = draw_people(view, nothing_behind(SIZE), people).samples[1:].sum()
        shares.append(draw_people(view, empty, people).samples[1:].sum() / alone)
    assert shares[0] < 0.1
    assert shares[1] > 0.9
