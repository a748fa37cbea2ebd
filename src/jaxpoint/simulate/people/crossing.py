"""A play for tracking: two people walk past each other again and again."""

from __future__ import annotations

import numpy as np

from jaxpoint.config.people import PeopleSettings
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gait import Walk
from jaxpoint.simulate.people.gestures_only import WALL_MARGIN_M
from jaxpoint.simulate.people.itinerary import Itinerary
from jaxpoint.simulate.people.planning import Performer
from jaxpoint.simulate.people.route import Route, find_route

ATTEMPTS = 3000
NEAR_M, FAR_M = 0.55, 1.0  # how close they pass
SHORTEST_M = 2.0  # walk of each


def crossing(rng: np.random.Generator, settings: PeopleSettings, room: Floor) -> tuple[list[Actor], float]:
    """Two actors, and the seconds in all.

    Raises:
        ValueError: the floor is too small or too full for two people to pass.
    """
    parts: list[Itinerary] = []
    for number in range(2):
        where = room.free_place(rng, WALL_MARGIN_M)
        while parts and np.linalg.norm(where - parts[0].place) < SHORTEST_M:
            where = room.free_place(rng, WALL_MARGIN_M)
        performer = Performer.drawn(rng, number, settings)
        parts.append(Itinerary(performer, where, float(rng.uniform(-np.pi, np.pi)), settings.empty_s))
    for _ in range(settings.crossings):
        _pass(rng, parts, settings, room)
    end = max(part.now for part in parts)
    for part in parts:
        part.wait(end - part.now + 0.5)
    return [part.actor for part in parts], end + 0.5


def _pass(rng, parts: list[Itinerary], settings: PeopleSettings, room: Floor) -> None:
    """One more walk of each, during which they come near each other and go apart again."""
    for _ in range(ATTEMPTS):
        routes = [_across(rng, part, room) for part in parts]
        walks = _meeting(rng, parts, [route for route in routes if route], settings)
        if walks is None or not _is_crossing(walks):
            continue
        for part, walk in zip(parts, walks):
            turning = part.turning(walk.route.heading(0.0))
            part.wait(walk.start_s - turning - part.now)
            part.walk(walk.route, walk.speed)
        return
    raise ValueError(
        f"In {ATTEMPTS} attempts two people found no way to pass each other {NEAR_M} to {FAR_M} m apart; "
        "give the room more free floor."
    )


def _across(rng, part: Itinerary, room: Floor) -> Route | None:
    """A long walk from where the person is."""
    end = room.free_place(rng, WALL_MARGIN_M)
    return find_route(room, part.place, end) if np.linalg.norm(end - part.place) > SHORTEST_M else None


def _meeting(rng, parts: list[Itinerary], routes: list[Route], settings: PeopleSettings) -> list[Walk] | None:
    """Walks timed so that both are where their routes are nearest at about the same moment."""
    if len(routes) < 2:
        return None
    lines = [route.places[::10] for route in routes]
    apart = np.linalg.norm(lines[0][:, None] - lines[1][None], axis=2)
    nearest = np.unravel_index(np.argmin(apart), apart.shape)
    if apart[nearest] > FAR_M:
        return None
    speeds = [draw(rng, settings.walking_m_s) for _ in parts]
    needed = [route.along[::10][i] / speed for route, i, speed in zip(routes, nearest, speeds)]
    ready = [part.now + part.turning(route.heading(0.0)) + 0.2 for part, route in zip(parts, routes)]
    moment = max(start + seconds for start, seconds in zip(ready, needed))
    starts = [moment - seconds for seconds in needed]
    starts[int(rng.integers(2))] += rng.uniform(0.0, 0.6)
    sizes = [part.performer.person.proportions for part in parts]
    return [Walk(*given) for given in zip(sizes, routes, starts, speeds)]


def _is_crossing(walks: list[Walk]) -> bool:
    """They pass near, but not too near, while both walk, and are well apart before and after."""
    times = np.arange(min(w.start_s for w in walks), max(w.end_s for w in walks), 0.08)
    places = [np.array([walk.route.at(walk.distance(t)) for t in times]) for walk in walks]
    apart = np.linalg.norm(places[0] - places[1], axis=1)
    moment = times[np.argmin(apart)]
    both = all(walk.start_s + 0.6 < moment < walk.end_s - 0.6 for walk in walks)
    return both and NEAR_M < apart.min() < FAR_M and min(apart[0], apart[-1]) > 1.6 * FAR_M
