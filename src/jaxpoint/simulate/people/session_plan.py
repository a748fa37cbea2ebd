"""A play as people live it: they enter, walk, stand or sit, point, walk on, and leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxpoint.config.people import PeopleSettings
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.floor import Chair, Floor
from jaxpoint.simulate.people.gestures_only import WALL_MARGIN_M, other_arm
from jaxpoint.simulate.people.itinerary import Itinerary
from jaxpoint.simulate.people.planning import Performer
from jaxpoint.simulate.people.proportions import Proportions
from jaxpoint.simulate.people.rotations import Vector
from jaxpoint.simulate.people.stance import before_seat

ATTEMPTS = 60
PROMPT = 20  # of them in which people enter soon after one another; after each further one
PATIENCE_S = 2.0  # whoever cannot keep clear of the others waits so much longer for them to leave
APART_M = 0.65  # between the middles of two people, at every moment
CHECKED_S = 0.2
STAND_M = 0.22  # free floor around who stands before a chair


def session(
    rng: np.random.Generator, settings: PeopleSettings, objects: Sequence, room: Floor
) -> tuple[list[Actor], float]:
    """All people of a session, who keep clear of one another, and its duration in seconds.

    Raises:
        ValueError: no way is found in which everyone makes their gestures and nobody runs into another.
    """
    actors: list[Actor] = []
    for number in range(settings.people):
        share = settings.gestures // settings.people + (number < settings.gestures % settings.people)
        actors.append(_part(rng, number, share, settings, objects, room, actors))
    return actors, max((actor.moves[-1].end_s for actor in actors), default=0.0) + settings.empty_s / 2


def _part(rng, number, gestures, settings: PeopleSettings, objects, room: Floor, others: list[Actor]) -> Actor:
    """One person's part, drawn again until it fits the others'."""
    performer = Performer.drawn(rng, number, settings)
    for attempt in range(ATTEMPTS):
        waits = PATIENCE_S * max(attempt - PROMPT, 0)
        start = settings.empty_s + number * (rng.uniform(1.0, 4.0) + waits)
        actor = _drawn_part(rng, performer, gestures, settings, objects, room, start)
        if actor is not None and all(keep_apart(actor, other, APART_M) for other in others):
            return actor
    raise ValueError(
        f"In {ATTEMPTS} attempts no part was found for person {number} ({gestures} gestures) that keeps clear of "
        f"{len(others)} others; take another seed, ask for fewer people, or give the room more free floor."
    )


def _drawn_part(rng, performer, gestures, settings: PeopleSettings, objects, room: Floor, start) -> Actor | None:
    """Enter, stops with gestures, leave; None where a way or a gesture fails."""
    door = entrance(rng, room)
    inwards = np.array([*room.size_m[:2], 0.0]) / 2 - door
    part = Itinerary(performer, door, float(np.arctan2(inwards[1], inwards[0])), start)
    part.wait(0.3)
    left = gestures
    while left > 0:
        if not _go_somewhere(rng, part, settings, room):
            return None
        made = 0
        for _ in range(min(left, settings.gestures_a_stop)):
            part.wait(draw(rng, settings.pause_s))
            made += part.point(rng, settings, objects, room)
        if not made:
            return None
        left -= made
        part.wait(draw(rng, settings.pause_s))
    part.rise()
    if not gestures and not _go_somewhere(rng, part, settings, room):
        return None
    return part.actor if part.walk_to(room, door, draw(rng, settings.walking_m_s)) else None


def _go_somewhere(rng, part: Itinerary, settings: PeopleSettings, room: Floor) -> bool:
    """To a chair and sit, or to a free place and stand with the arms at rest."""
    part.rise()
    speed = draw(rng, settings.walking_m_s)
    chairs = usable_chairs(part.performer.person.proportions, room)
    if chairs and rng.random() < settings.sitting:
        chair = chairs[int(rng.integers(len(chairs)))]
        if not part.walk_to_chair(room, chair, speed):
            return False
        part.sit(chair)
        return True
    if not part.walk_to(room, room.free_places(rng, 1, WALL_MARGIN_M)[0], speed):
        return False
    part.rest_as(other_arm(rng, part.performer.habit.hand))
    return True


def usable_chairs(size: Proportions, room: Floor) -> list[Chair]:
    """Chairs before which there is room to stand."""
    fronts = [before_seat(size, chair.place, chair.yaw)[None, :2] for chair in room.chairs]
    cleared = [room.without(chair.place) for chair in room.chairs]
    return [c for c, front, floor in zip(room.chairs, fronts, cleared) if floor.is_free(front, STAND_M).all()]


def entrance(rng: np.random.Generator, room: Floor) -> Vector:
    """The door, or without one a free place near the middle of a wall."""
    if room.door is not None:
        return np.array([*room.door, 0.0])
    places = room.free_places(rng, 30, WALL_MARGIN_M)
    edge = np.minimum(places, np.array([*room.size_m[:2], np.inf]) - places)[:, :2].min(axis=1)
    return places[np.argmin(edge)]


def keep_apart(one: Actor, other: Actor, distance: float) -> bool:
    """Whether two people who are both in the room are never nearer than this (m)."""
    start = max(one.moves[0].start_s, other.moves[0].start_s)
    end = min(one.moves[-1].end_s, other.moves[-1].end_s)
    times = np.arange(start, end, CHECKED_S)
    apart = (float(np.linalg.norm(one.stance(t).pelvis[:2] - other.stance(t).pelvis[:2])) for t in times)
    return all(away >= distance for away in apart)
