"""Who does what when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from jaxpoint.config.people import PeopleSettings
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.people.gestures_only import gestures_only


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
        ValueError: the room has too little free floor, or nobody can point at anything in it.
    """
    rng = np.random.default_rng(seed)
    actors, duration = gestures_only(rng, settings, objects, room)
    gestures = sorted((g for actor in actors for g in actor.gestures), key=lambda g: g.first_s)
    return Play(actors, gestures, duration)
