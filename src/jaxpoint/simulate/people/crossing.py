"""A play for tracking: two people walk past each other again and again."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxpoint.config.people import PeopleSettings
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gait import Walk
from jaxpoint.simulate.people.itinerary import Itinerary
from jaxpoint.simulate.people.planning import Performer
from jaxpoint.simulate.people.route import CLEAR_M, Route, line_route

LINES = 400  # walks drawn, of which two are kept
ATTEMPTS = 60  # to time one crossing
NEAR_M, FAR_M = 0.55, 1.0  # how close they pass
SHORTEST_M = 1.8  # walk of each
MIDDLE = 0.25, 0.75  # of both walks, between which they are nearest


def crossing(rng: np.random.Generator, settings: PeopleSettings, room: Floor) -> tuple[list[Actor], float]:
    """Two actors who walk to and fro on lines that cross or run side by side, and the seconds in all.

    Raises:
        ValueError: the floor is too small or too full for two people to pass.
    """
    performers = [Performer.drawn(rng, number, settings) for number in range(2)]
    for lines in _pairs(rng, _free_lines(rng, room)):
        parts = [
            Itinerary(performer, line[0], float(rng.uniform(-np.pi, np.pi)), settings.empty_s)
            for performer, line in zip(performers, lines)
        ]
        if all(_pass(rng, parts, lines, number, settings) for number in range(settings.crossings)):
            end = max(part.now for part in parts) + 0.5
            for part in parts:
                part.wait(end - part.now)
            return [part.actor for part in parts], end
    raise ValueError(
        f"Among {LINES} walks no two were found on which people pass each other {NEAR_M} to {FAR_M} m apart; "
        "give the room more free floor."
    )


def _free_lines(rng, room: Floor) -> Float[np.ndarray, "L 2 3"]:
    """Ends of straight walks with nothing in the way."""
    ends = rng.uniform([0.0, 0.0], room.size_m[:2], (LINES * 10, 2, 2))
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > SHORTEST_M]
    between = ends[:, :1] + np.linspace(0.0, 1.0, 40)[:, None] * (ends[:, 1:] - ends[:, :1])
    free = room.is_free(between.reshape(-1, 2), CLEAR_M).reshape(between.shape[:2]).all(axis=1)
    ends = ends[free][:LINES]
    return np.concatenate([ends, np.zeros((len(ends), 2, 1))], axis=2)


def _pairs(rng, lines: Float[np.ndarray, "L 2 3"]) -> Iterator[Float[np.ndarray, "2 2 3"]]:
    """Two lines that come near in the middle of both, and whose ends lie apart."""
    share = np.linspace(0.0, 1.0, 21)
    for i, j in itertools.islice(itertools.combinations(rng.permutation(len(lines)), 2), 5000):
        places = [line[0] + share[:, None] * (line[1] - line[0]) for line in lines[[i, j]]]
        apart = np.linalg.norm(places[0][:, None] - places[1][None], axis=2)
        meeting = share[np.stack(np.unravel_index(np.argmin(apart), apart.shape))]
        ends = apart[[0, 0, -1, -1], [0, -1, 0, -1]]
        if apart.min() < FAR_M and (meeting > MIDDLE[0]).all() and (meeting < MIDDLE[1]).all() and ends.min() > FAR_M:
            yield lines[[i, j]]


def _pass(rng, parts: list[Itinerary], lines, number: int, settings: PeopleSettings) -> bool:
    """One walk of each along its line, every other time backwards, timed so that they pass; False if that fails."""
    routes = [line_route(line[number % 2], line[1 - number % 2]) for line in lines]
    for _ in range(ATTEMPTS):
        walks = _timed(rng, parts, routes, settings)
        if _is_crossing(walks):
            for part, walk in zip(parts, walks):
                part.wait(walk.start_s - part.turning(walk.route.heading(0.0)) - part.now)
                part.walk(walk.route, walk.speed)
            return True
    return False


def _timed(rng, parts: list[Itinerary], routes: list[Route], settings: PeopleSettings) -> list[Walk]:
    """Walks on which both are where their routes are nearest at about the same moment."""
    lines = [route.places[::10] for route in routes]
    apart = np.linalg.norm(lines[0][:, None] - lines[1][None], axis=2)
    nearest = np.unravel_index(np.argmin(apart), apart.shape)
    speeds = [draw(rng, settings.walking_m_s) for _ in parts]
    needed = [route.along[::10][i] / speed for route, i, speed in zip(routes, nearest, speeds)]
    ready = [part.now + part.turning(route.heading(0.0)) + 0.2 for part, route in zip(parts, routes)]
    moment = max(start + seconds for start, seconds in zip(ready, needed))
    starts = [moment - seconds for seconds in needed]
    starts[int(rng.integers(2))] += rng.uniform(0.0, 0.8)
    sizes = [part.performer.person.proportions for part in parts]
    return [Walk(*given) for given in zip(sizes, routes, starts, speeds)]


def _is_crossing(walks: list[Walk]) -> bool:
    """They pass near, but not too near, while both walk, and are well apart before and after."""
    times = np.arange(min(w.start_s for w in walks), max(w.end_s for w in walks), 0.08)
    places = [np.array([walk.route.at(walk.distance(t)) for t in times]) for walk in walks]
    apart = np.linalg.norm(places[0] - places[1], axis=1)
    moment = times[np.argmin(apart)]
    both = all(walk.start_s + 0.6 < moment < walk.end_s - 0.6 for walk in walks)
    return bool(both and NEAR_M < apart.min() < FAR_M and min(apart[0], apart[-1]) > FAR_M)
