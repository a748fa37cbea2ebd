"""What people do: on their feet, within the walls, past each other, and the same for the same seed."""

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest

from jaxpoint.config.people import PeopleSettings
from jaxpoint.config.simulation import SceneSettings, ViewpointSettings
from jaxpoint.errors import UsageError
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.floor import Chair, Floor
from jaxpoint.simulate.people.gait import TOES, Walk
from jaxpoint.simulate.people.play import make_play
from jaxpoint.simulate.people.stance import SitDown
from jaxpoint.simulate.scene import make_scene
from jaxpoint.simulate.simulated_session import floor_of
from jaxpoint.simulate.viewpoints import random_viewpoints

TABLE, SEAT, SHELF = (2.2, 2.0, 3.6, 3.0, 0.75), (3.8, 2.3, 4.25, 2.75, 0.9), (0.0, 4.3, 1.5, 5.0, 2.0)
ROOM = Floor(obstacles=[TABLE, SEAT, SHELF], chairs=[Chair(4.02, 2.52, 0.0)], door=(0.6, 0.6))
FRAME_S = 1 / 25


@dataclass
class Thing:
    name: str
    corners: np.ndarray


def things() -> list[Thing]:
    """Pictures on two walls, a mat on the floor."""
    made = []
    for i, middle in enumerate([(6.0, 1.0, 1.5), (6.0, 4.0, 1.2), (3.0, 5.0, 2.0), (2.0, 5.0, 1.0), (5.0, 3.5, 0.0)]):
        along = np.array([0.0, 0.3, 0.0]) if middle[0] == 6.0 else np.array([0.3, 0.0, 0.0])
        up = np.array([0.0, 0.2, 0.0]) if middle[2] == 0.0 else np.array([0.0, 0.0, 0.2])
        made.append(
            Thing(f"thing {i}", np.array([np.array(middle) + a + b for b in (up, -up) for a in (-along, along)]))
        )
    return made


@pytest.fixture(scope="module")
def session():
    """Two people, of whom at least one sits; and joints of each at 25 frames a second."""
    play = make_play(3, PeopleSettings(people=2, gestures=6, sitting=0.6), things(), ROOM)
    assert any(isinstance(move, SitDown) for actor in play.actors for move in actor.moves)
    return play, [joints_of(actor) for actor in play.actors]


def times_of(actor: Actor, step=FRAME_S) -> np.ndarray:
    return np.arange(actor.moves[0].start_s, actor.moves[-1].end_s, step)


def joints_of(actor: Actor) -> dict[str, np.ndarray]:
    rows = [actor.joints(time) for time in times_of(actor)]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def test_motion_is_smooth(session):
    """At 25 frames a second trunk and head go less than 6 cm from frame to frame, no joint more than 22 cm."""
    for joints in session[1]:
        for name, path in joints.items():
            moved = np.linalg.norm(np.diff(path, axis=0), axis=1).max()
            assert moved < (0.06 if name in ("pelvis", "neck", "head") else 0.22), name


def test_nothing_jumps_where_one_move_ends_and_the_next_begins(session):
    for actor in session[0].actors:
        edges = [move.end_s for move in actor.moves[:-1]]
        edges += [t for g in actor.gestures for t in (g.first_s, g.hold_first_s, g.hold_last_s, g.last_s)]
        for edge in edges:
            before, after = actor.joints(edge - 5e-4), actor.joints(edge + 5e-4)
            assert max(np.linalg.norm(after[name] - before[name]) for name in before) < 0.006


def test_feet_are_on_the_floor_and_do_not_slide(session):
    for actor in session[0].actors:
        for time in times_of(actor, 0.31):
            height = actor.mesh(time).vertices[:, 2]
            assert -0.015 < height.min() < 0.003
        for walk in (move for move in actor.moves if isinstance(move, Walk)):
            toes = np.array([toes_of(actor, t) for t in np.arange(walk.start_s, walk.end_s, FRAME_S)])
            slid = np.linalg.norm(np.diff(toes, axis=0), axis=2).min(axis=1)  # of the foot that moves less
            assert slid.max() < 0.002


def toes_of(actor: Actor, time: float) -> list[np.ndarray]:
    """Where each foot touches the floor last."""
    size, feet = actor.person.proportions, actor.stance(time).feet
    toes = []
    for foot in feet.values():
        c, s = np.cos(foot.pitch), np.sin(foot.pitch)
        ahead, down = TOES * size.foot, -size.ankle
        local = np.array([c * ahead + s * down, c * down - s * ahead])
        way = np.array([np.cos(foot.yaw), np.sin(foot.yaw), 0.0])
        toes.append(foot.ankle + local[0] * way + [0.0, 0.0, local[1]])
    return toes


def test_nobody_is_inside_a_wall_or_the_furniture(session):
    low, high = np.zeros(3), np.array(ROOM.size_m)
    for actor in session[0].actors:
        for time in times_of(actor, 0.37):
            corners = actor.mesh(time).vertices
            assert (corners > low - 0.015).all()
            assert (corners < high).all()
            for x0, y0, x1, y1, height in (TABLE, SHELF):
                within = (corners > [x0, y0, 0.0]) & (corners < [x1, y1, height])
                assert within.all(axis=1).sum() == 0


def test_people_keep_apart(session):
    one, two = session[0].actors
    shared = np.arange(two.moves[0].start_s, min(one.moves[-1].end_s, two.moves[-1].end_s), 0.1)
    assert len(shared) > 50
    assert min(np.linalg.norm(one.joints(t)["pelvis"][:2] - two.joints(t)["pelvis"][:2]) for t in shared) > 0.6


def test_everyone_enters_an_empty_room_points_and_leaves_by_the_door(session):
    play = session[0]
    assert len(play.gestures) == 6
    assert [g.number for g in play.gestures] == list(range(6))
    assert [g.first_s for g in play.gestures] == sorted(g.first_s for g in play.gestures)
    for actor in play.actors:
        assert not actor.present(PeopleSettings().empty_s - 0.1)
        for end in (actor.moves[0].start_s, actor.moves[-1].end_s):
            np.testing.assert_allclose(actor.stance(end).pelvis[:2], ROOM.door, atol=0.01)
        for gesture in actor.gestures:
            assert gesture.person == actor.person.number
            assert actor.moves[0].start_s < gesture.first_s < gesture.last_s < actor.moves[-1].end_s


@pytest.mark.parametrize("seed", [2, 26])  # in both the way from the door is narrow, in one nobody gets past the other
def test_people_find_their_way_through_furnished_rooms(seed):
    rngs = [np.random.default_rng([seed, 0, i]) for i in range(4)]
    scene = make_scene(rngs[0], SceneSettings())
    views = random_viewpoints(rngs[1], ViewpointSettings(), scene)
    play = make_play(rngs[3], PeopleSettings(), cast(Any, scene.objects), floor_of(scene, views))
    assert len(play.gestures) == PeopleSettings().gestures
    tables = scene.boxes[(scene.boxes[:, 0, 2] < 1.0) & (scene.boxes[:, 1, 2] > 0.1)]
    for actor in play.actors:
        for walk in (move for move in actor.moves if isinstance(move, Walk)):
            middle = walk.route.places[(walk.route.along > 0.6) & (walk.route.along < walk.route.length - 0.6)]
            aside = np.maximum(tables[:, 0, :2] - middle[:, None], middle[:, None] - tables[:, 1, :2])
            assert (np.linalg.norm(np.maximum(aside, 0.0), axis=2) > 0.2).all()


def test_sitting_people_sit():
    settings = PeopleSettings(people=1, gestures=2, sitting=1.0)
    actor = make_play(0, settings, things(), ROOM).actors[0]
    joints = actor.joints(actor.gestures[0].hold_first_s)
    assert joints["pelvis"][2] < 0.6
    for side in ("left", "right"):
        thigh = joints[f"{side}_knee"] - joints["pelvis"]
        assert thigh[2] / np.linalg.norm(thigh) == pytest.approx(0.0, abs=0.35)  # nearly level


def test_the_same_seed_gives_the_same_play_and_another_seed_another():
    settings = PeopleSettings(play="gestures", people=2, gestures=3)
    one, same, other = (make_play(seed, settings, things(), ROOM) for seed in (5, 5, 6))
    for a, b in zip(one.actors, same.actors):
        time = a.gestures[0].hold_first_s
        np.testing.assert_array_equal(a.mesh(time).vertices, b.mesh(time).vertices)
        np.testing.assert_array_equal(a.mesh(time).albedo, b.mesh(time).albedo)
    assert one.gestures[0].hold_first_s != other.gestures[0].hold_first_s


def test_gestures_only_changes_bodies_and_has_one_person_at_a_time():
    play = make_play(2, PeopleSettings(play="gestures", people=4, gestures=8), things(), ROOM)
    assert [actor.person.number for actor in play.actors] == [0, 0, 1, 1, 2, 2, 3, 3]
    assert len({actor.person.stature_m for actor in play.actors}) == 4
    for time in np.arange(0.0, play.duration_s, 0.1):
        assert sum(actor.present(time) for actor in play.actors) <= 1
    assert not any(actor.present(PeopleSettings().empty_s - 0.01) for actor in play.actors)


def test_the_room_is_empty_before_the_next_person():
    settings = PeopleSettings(play="gestures", people=2, gestures=4)
    near, far = (make_play(3, replace(settings, change_s=seconds), things(), ROOM) for seconds in (0.0, 2.5))
    later = [
        after.gestures[0].hold_first_s - before.gestures[0].hold_first_s
        for before, after in zip(near.actors, far.actors)
    ]
    np.testing.assert_allclose(later, [0.0, 0.0, 2.5, 2.5])


def test_gestures_point_at_objects_or_at_nothing():
    settings = PeopleSettings(play="gestures", people=40, gestures=80, nothing=0.4)
    objects = {thing.name: thing.corners.mean(axis=0) for thing in things()}
    gestures = make_play(1, settings, things(), ROOM).gestures
    vacant = [g for g in gestures if g.target == "nothing"]
    assert 0.2 < len(vacant) / len(gestures) < 0.6
    for gesture in gestures:
        if gesture.target != "nothing":
            np.testing.assert_array_equal(gesture.target_m, objects[gesture.target])
    for gesture in vacant:  # on a wall, the floor or the ceiling, and beside every object
        on = np.isclose(gesture.target_m, 0.0) | np.isclose(gesture.target_m, ROOM.size_m)
        assert on.any()
        assert min(np.linalg.norm(gesture.target_m - middle) for middle in objects.values()) > 0.3


def test_two_people_pass_each_other():
    settings = PeopleSettings(play="crossing", crossings=3)
    for seed in range(3):
        one, two = make_play(seed, settings, (), ROOM).actors
        times = times_of(one, 0.05)
        places = [np.array([actor.stance(t).pelvis[:2] for t in times]) for actor in (one, two)]
        apart = np.linalg.norm(places[0] - places[1], axis=1)
        near = (apart[1:-1] < apart[:-2]) & (apart[1:-1] <= apart[2:]) & (apart[1:-1] < 1.0)
        assert near.sum() >= 3
        assert apart.min() > 0.5
        walks = [[move for move in actor.moves if isinstance(move, Walk)] for actor in (one, two)]
        assert [len(own) for own in walks] == [3, 3]


def test_an_empty_play_is_empty():
    play = make_play(0, PeopleSettings(play="empty", empty_s=7.0), things(), ROOM)
    assert (play.actors, play.gestures, play.duration_s) == ((), (), 7.0)


@pytest.mark.parametrize("play", ["session", "gestures", "crossing"])
def test_a_room_without_free_floor_is_refused(play):
    full = replace(ROOM, obstacles=[(0.0, 0.0, 6.0, 5.0, 1.0)], door=None)
    with pytest.raises(ValueError, match="floor"):
        make_play(0, PeopleSettings(play=play), things(), full)


@pytest.mark.parametrize(
    ("play", "people", "message"),
    [
        ("crossing", 3, "2 people pass each other, not 3"),
        ("crossing", 0, "2 people pass each other, not 0"),
        ("session", 0, "nobody makes the 8 gestures"),
        ("gestures", 0, "nobody makes the 8 gestures"),
    ],
)
def test_a_play_that_its_people_cannot_make_is_refused(play, people, message):
    with pytest.raises(UsageError, match=message):
        make_play(0, PeopleSettings(play=play, people=people), things(), ROOM)


def test_without_people_and_gestures_the_room_stays_empty():
    assert make_play(0, PeopleSettings(people=0, gestures=0), things(), ROOM).actors == ()
