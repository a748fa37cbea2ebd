"""A play for evaluation: people stand somewhere and point, with nothing between, so that every frame counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxpoint.config.people import PeopleSettings
from jaxpoint.simulate.people.actor import Actor, RestFrom, Stay
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.people.planning import Performer, draw_target, plan_gesture
from jaxpoint.simulate.people.rest import Rest
from jaxpoint.simulate.people.simulated_person import Side
from jaxpoint.simulate.people.stance import Stance, standing

ATTEMPTS = 400
WALL_MARGIN_M = 0.45
LEAD_S = 0.24  # the person is there before the arm moves, and after


def gestures_only(
    rng: np.random.Generator, settings: PeopleSettings, objects: Sequence, room: Floor
) -> tuple[list[Actor], float]:
    """One actor a gesture, one after another; bodies change as often as the settings ask. Seconds in all, too."""
    actors, now = [], settings.empty_s
    performer = None
    for number in range(settings.gestures):
        turn = number * settings.people // max(settings.gestures, 1)
        if performer is None or turn != performer.person.number:
            now += settings.change_s if performer else 0.0
            performer = Performer.drawn(rng, turn, settings)
        gesture, stance = stand_and_point(rng, performer, settings, objects, room, now + LEAD_S)
        end = gesture.last_s + LEAD_S
        rests = [RestFrom(now, other_arm(rng, gesture.hand))]
        actors.append(Actor(performer.person, [Stay(now, end, stance)], rests, [gesture]))
        now = end + draw(rng, settings.pause_s)
    return actors, now


def stand_and_point(
    rng: np.random.Generator,
    performer: Performer,
    settings: PeopleSettings,
    objects: Sequence,
    room: Floor,
    first_s: float,
) -> tuple[Gesture, Stance]:
    """A place to stand, a target, and the gesture.

    Raises:
        ValueError: after many attempts no gesture is possible.
    """
    for _ in range(ATTEMPTS):
        target = draw_target(rng, settings, objects, room)
        where = room.free_places(rng, 1, WALL_MARGIN_M)[0]
        away = target.place - where
        if not settings.target_distance_m.low <= np.hypot(away[0], away[1]) <= settings.target_distance_m.high:
            continue
        yaw = float(np.arctan2(away[1], away[0]) + np.deg2rad(draw(rng, settings.turn_deg)))
        stance = standing(performer.person.proportions, where, yaw)
        gesture = plan_gesture(rng, performer, stance, target, first_s, objects, room, settings.pointing)
        if gesture is not None:
            return gesture, stance
    raise ValueError(
        f"In {ATTEMPTS} attempts person {performer.person.number} found no place from which to point at one of "
        f"{len(objects)} objects; give the room more free floor or allow nearer targets (target_distance_m)."
    )


def other_arm(rng: np.random.Generator, hand: Side) -> dict[Side, Rest]:
    """The pointing arm hangs between its gestures, the other does so too, or rests on a hip or before the belly."""
    other: Rest = ("hanging", "hanging", "hip", "belly")[int(rng.integers(4))]
    rests: dict[Side, Rest] = {"left": other, "right": other}
    rests[hand] = "hanging"
    return rests
