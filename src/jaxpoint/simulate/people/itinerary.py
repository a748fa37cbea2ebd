"""A person's part, written move by move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxpoint.config.people import PeopleSettings
from jaxpoint.simulate.people.actor import Actor, Move, RestFrom, Stay
from jaxpoint.simulate.people.drawing import draw
from jaxpoint.simulate.people.floor import Chair, Floor
from jaxpoint.simulate.people.gait import Turn, Walk
from jaxpoint.simulate.people.gesture import LOOK_AHEAD_S, Gesture
from jaxpoint.simulate.people.planning import Performer, draw_target, plan_gesture
from jaxpoint.simulate.people.rest import Rest
from jaxpoint.simulate.people.rotations import Vector
from jaxpoint.simulate.people.route import Route, find_route
from jaxpoint.simulate.people.simulated_person import Side
from jaxpoint.simulate.people.stance import SitDown, Stance, before_seat, sitting, standing

HANGING: dict[Side, Rest] = {"left": "hanging", "right": "hanging"}
LAP: dict[Side, Rest] = {"left": "lap", "right": "lap"}
TARGETS_TRIED = 60
SHORTEST_WALK_M = 0.1  # who stands that near is there


class Itinerary:
    """What a performer does from the moment of entering; every method adds to its end."""

    def __init__(self, performer: Performer, place: Vector, yaw: float, start_s: float):
        self.performer, self.place, self.yaw, self.now = performer, place, yaw, start_s
        self.seat: Stance | None = None
        self.moves: list[Move] = []
        self.rests = [RestFrom(start_s, HANGING)]
        self.gestures: list[Gesture] = []

    @property
    def actor(self) -> Actor:
        return Actor(self.performer.person, tuple(self.moves), tuple(self.rests), tuple(self.gestures))

    @property
    def stance(self) -> Stance:
        """Where the person is now."""
        return self.seat or standing(self.performer.person.proportions, self.place, self.yaw)

    def wait(self, seconds: float) -> None:
        self._add(Stay(self.now, self.now + seconds, self.stance))

    def turning(self, yaw: float) -> float:
        """Seconds that a turn to this yaw takes."""
        return self._turn(yaw).end_s - self.now

    def turn(self, yaw: float) -> None:
        turn = self._turn(yaw)
        if turn.end_s > self.now:
            self._add(turn)
            self.yaw = yaw

    def _turn(self, yaw: float) -> Turn:
        return Turn(self.performer.person.proportions, self.place, self.now, self.yaw, yaw)

    def walk(self, route: Route, speed: float) -> None:
        """Along the route, the arms hanging, after a turn into it."""
        if route.length < SHORTEST_WALK_M:
            return
        self.turn(route.heading(0.0))
        self.rest_as(HANGING)
        self._add(Walk(self.performer.person.proportions, route, self.now, speed))
        self.place, self.yaw = route.at(route.length), route.heading(route.length)

    def sit(self, chair: Chair) -> None:
        """Turn the back to the chair one stands before, and sit down."""
        self.turn(chair.yaw)
        size = self.performer.person.proportions
        seat = sitting(size, chair.place, chair.yaw, chair.seat_m)
        self.rest_as(LAP)
        self._add(SitDown(self.now, self.stance, seat))
        self.seat = seat

    def rise(self) -> None:
        """Stand up, if sitting."""
        if self.seat is None:
            return
        seat, self.seat = self.seat, None
        rise = SitDown(self.now, self.stance, seat, up=True)
        self._add(rise)
        # Hands leave the lap when it has gone.
        self.rests.append(RestFrom(rise.start_s + 0.5 * (rise.end_s - rise.start_s), HANGING))

    def point(self, rng: np.random.Generator, settings: PeopleSettings, objects: Sequence, room: Floor) -> bool:
        """Turn to a target and point at it; False, and nothing added, where no target can be pointed at from here."""
        for _ in range(TARGETS_TRIED):
            target = draw_target(rng, settings, objects, room)
            away = target.place - self.place
            if not settings.target_distance_m.low <= np.hypot(away[0], away[1]) <= settings.target_distance_m.high:
                continue
            yaw = float(np.arctan2(away[1], away[0]) + np.deg2rad(draw(rng, settings.turn_deg)))
            stance = self.stance if self.seat else standing(self.performer.person.proportions, self.place, yaw)
            gesture = plan_gesture(rng, self.performer, stance, target, 0.0, objects, room, settings.pointing)
            if gesture is None:
                continue
            if self.seat is None:
                self.turn(yaw)
            gesture = gesture.later(self.now + LOOK_AHEAD_S)
            self.gestures.append(gesture)
            self._add(Stay(self.now, gesture.last_s, self.stance))
            return True
        return False

    def walk_to(self, room: Floor, place: Vector, speed: float) -> bool:
        """Around the furniture to a place; False, and nothing added, where there is no way."""
        route = find_route(room, self.place, place)
        if route is None:
            return False
        self.walk(route, speed)
        return True

    def walk_to_chair(self, room: Floor, chair: Chair, speed: float) -> bool:
        """To the place in front of a chair."""
        return self.walk_to(room, before_seat(self.performer.person.proportions, chair.place, chair.yaw), speed)

    def _add(self, move: Move) -> None:
        self.moves.append(move)
        self.now = move.end_s

    def rest_as(self, rest: dict[Side, Rest]) -> None:
        """From now on the arms rest like this."""
        if rest != self.rests[-1].rest:
            self.rests.append(RestFrom(self.now, rest))
