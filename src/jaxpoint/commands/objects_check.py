"""`jaxpoint objects check`: is a database of objects what it should be?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import check_no_out
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig
from jaxpoint.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class ObjectsCheck(Options):
    """Check a database of objects: how plane and how large they are, which overlap, which lie outside the room.

    jaxpoint objects check objects.csv --room-low 0 0 0 --room-high 6 5 3

    A file that cannot be used (no unit, a name twice, a twisted rectangle) is an error; unusual values are listed.
    """

    objects: Annotated[Path, tyro.conf.Positional]
    """Database: a CSV or TOML file of rectangles, boxes and spheres."""
    room_low: tuple[float, float, float] | None = None
    """Lowest x, y and z of the room, m; else those of the database, where it is a TOML file with a [room]."""
    room_high: tuple[float, float, float] | None = None
    """Highest x, y and z of the room, m."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> ObjectsCheck:
        """The command's defaults under a configuration file."""
        return ObjectsCheck(objects=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Read, measure and print."""
        from jaxpoint.io.object_files import read_objects
        from jaxpoint.pointing.room_box import Room
        from jaxpoint.pointing.survey import outside, overlaps, survey

        check_no_out(self.out)
        if (self.room_low is None) != (self.room_high is None):
            raise UsageError("Give both --room-low and --room-high, three numbers each in metres, or neither.")
        if self.room_low is not None and self.room_high is not None and not _below(self.room_low, self.room_high):
            raise UsageError(
                f"--room-low {self.room_low} is not below --room-high {self.room_high} in all three; exchange them."
            )
        database = read_objects(self.objects)
        room = database.room
        if self.room_low is not None and self.room_high is not None:
            room = Room(list(self.room_low), list(self.room_high))
        found = survey(database.things)
        notes = [*database.warnings, *overlaps(database.things)]
        notes += outside(database.things, room) if room is not None else []
        figures = {
            "objects": [one.figures for one in found],
            "warnings": notes,
            "room": None if room is None else {"low": room.low.tolist(), "high": room.high.tolist()},
        }
        rows = [
            (
                one.name,
                " x ".join(f"{side:.3f}" for side in one.size_m),
                f"{1e3 * one.residual_m:.1f}",
                f"{one.bottom_m:.2f}",
            )
            for one in found
        ]
        unknown = ("The room's size is not known: give --room-low and --room-high to see what lies outside.",)
        lines = table(("name", "size m", "off its plane mm", "bottom m"), rows)
        summary = f"{_count(len(found), 'object')}, {_count(len(notes), 'warning')}"
        return Outcome(figures, (*lines, *notes, *(unknown if room is None else ()), summary))


def _below(low: tuple[float, ...], high: tuple[float, ...]) -> bool:
    return all(a < b for a, b in zip(low, high))


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
