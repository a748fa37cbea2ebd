"""`jaxpoint objects list`: what a database of objects holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import check_no_out
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig


@dataclass(frozen=True, kw_only=True)
class ObjectsList(Options):
    """Print the objects of a database, in metres.

    jaxpoint objects list objects.csv
    """

    objects: Annotated[Path, tyro.conf.Positional]
    """Database: a CSV or TOML file of rectangles, boxes and spheres."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> ObjectsList:
        """The command's defaults under a configuration file."""
        return ObjectsList(objects=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Read and print."""
        from jaxpoint.io.object_files import read_objects
        from jaxpoint.pointing.survey import survey

        check_no_out(self.out)
        found = survey(read_objects(self.objects).things)
        rows = [
            (one.name, one.kind, one.shape, *(f"{x:.2f}" for x in one.center_m), _size(one.size_m), " ".join(one.tags))
            for one in found
        ]
        header = ("name", "kind", "shape", "x m", "y m", "z m", "size m", "tags")
        return Outcome({"objects": [one.figures for one in found]}, table(header, rows))


def _size(size: tuple[float, ...]) -> str:
    return " x ".join(f"{side:.2f}" for side in size)
