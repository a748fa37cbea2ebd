"""What can be pointed at, from a file of objects, and the room that holds it."""

from __future__ import annotations

from pathlib import Path

import jax

from jaxpoint.io.object_files import Database, read_objects
from jaxpoint.pointing.answers import ObjectScene
from jaxpoint.pointing.room_box import Room


def read_scene(path: Path, room: Room | None = None) -> tuple[ObjectScene, Database]:
    """What can be pointed at.

    The room is the one that is given here, else that of the file, else a guess: around the objects, until
    `answer_gestures` knows who else is in it.

    Raises:
        FileFormatError: as `read_objects`.
    """
    database = read_objects(path)
    room = database.room if room is None else room
    with jax.enable_x64(True):
        objects = database.objects
        shown = Room.around(objects) if room is None else room
        return ObjectScene(objects, objects.middles, shown, room is not None), database
