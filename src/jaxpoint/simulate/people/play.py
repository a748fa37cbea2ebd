"""Who does what when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxpoint.config.people import PeopleSettings
from jaxpoint.errors import UsageError
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.crossing import crossing
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.people.gestures_only import gestures_only
from jaxpoint.simulate.people.session_plan import session


@runtime_checkable
class Pointable(Protocol):
    """Something to point at."""

    name: str
    corners: Float[np.ndarray, "4 3"]  # left top, right top, left bottom, right bottom; m


@dataclass(frozen=True)
class Play:
    """All people of a session and what they point at."""

    actors: Sequence[Actor]
    gestures: Sequence[Gesture]
    duration_s: float


def make_play(
    seed: int | np.random.Generator, settings: PeopleSettings, objects: Sequence[Pointable], room: Floor
) -> Play:
    """The play of a seed: the same seed, settings, objects and room give the same play.

    Raises:
        UsageError: as many people as are asked for cannot do what is asked for.
        ValueError: the room has too little free floor, or nobody can point at anything in it.
    """
    _check_cast(settings)
    rng = np.random.default_rng(seed)
    if settings.play == "empty" or settings.people == 0:
        return Play((), (), settings.empty_s)
    if settings.play == "crossing":
        actors, duration = crossing(rng, settings, room)
    elif settings.play == "gestures":
        actors, duration = gestures_only(rng, settings, objects, room)
    else:
        actors, duration = session(rng, settings, objects, room)
    return _numbered(actors, duration)


def _check_cast(settings: PeopleSettings) -> None:
    people, gestures = settings.people, settings.gestures
    if settings.play == "crossing" and people != 2:
        raise UsageError(
            f"In the play 'crossing' 2 people pass each other, not {people}; set people to 2, or choose another play."
        )
    if settings.play in ("session", "gestures") and people == 0 < gestures:
        raise UsageError(
            f"Without people nobody makes the {gestures} gestures asked for; set people to 1 or more, or gestures to 0."
        )


def _numbered(actors: Sequence[Actor], duration: float) -> Play:
    """Gestures numbered in the order in which they begin, in the play as in its actors."""
    order = sorted((g.first_s, i, j) for i, actor in enumerate(actors) for j, g in enumerate(actor.gestures))
    number = {(i, j): n for n, (_, i, j) in enumerate(order)}
    cast = [
        replace(actor, gestures=tuple(replace(g, number=number[i, j]) for j, g in enumerate(actor.gestures)))
        for i, actor in enumerate(actors)
    ]
    return Play(tuple(cast), tuple(cast[i].gestures[j] for _, i, j in order), duration)
