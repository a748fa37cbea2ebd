"""The simulated room: 6 x 5 x 3 m, furnished along its walls, with named rectangles and lamps; drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from jaxpoint.config.simulation import SceneSettings
from jaxpoint.simulate import textures
from jaxpoint.simulate.furniture import (
    Furnished,
    NamedObject,
    Wall,
    desk_wall,
    media_wall,
    scattered,
    shelf_wall,
    sofa_wall,
)
from jaxpoint.simulate.people.floor import Chair
from jaxpoint.simulate.surfaces import Surfaces

SIZE_M = (6.0, 5.0, 3.0)
MARGIN_M = 1.15  # floor along every wall that stays free of people
LAMP_RADIUS_M = 0.22
INTENSITY = 9.0  # of all lamps together, linear light at 1 m


@dataclass(frozen=True)
class Lamp:
    """A disc that shines down; what it lights grows dark with the square of the distance."""

    position: Float[np.ndarray, "3"]  # m
    intensity: Float[np.ndarray, "3"]  # linear red, green, blue at 1 m
    radius: float = LAMP_RADIUS_M  # m, which makes shadows soft


@dataclass(frozen=True)
class Scene:
    """A furnished room."""

    size: Float[np.ndarray, "3"]  # m
    surfaces: Surfaces
    objects: tuple[NamedObject, ...]
    lamps: tuple[Lamp, ...]
    indirect: float  # strength of the light sent back by walls and ceiling
    chairs: tuple[Chair, ...]
    door: Float[np.ndarray, "3"]  # m, a place on the floor just inside
    free_floor: Float[np.ndarray, "2 2"]  # m: lowest and highest x, y where people stand and walk
    boxes: Float[np.ndarray, "N 2 3"]  # m: lowest and highest corner of what stands in the room
    mirrors: tuple[tuple[Float[np.ndarray, "4 3"], float], ...]  # shiny rectangles and the share they reflect


def make_scene(rng: Generator, settings: SceneSettings) -> Scene:
    """A room with its furniture on walls drawn at random."""
    size = np.array(SIZE_M)
    room = Furnished(rng)
    walls = _walls(size)
    _shell(room, size, walls)
    pieces = (media_wall, sofa_wall, shelf_wall, desk_wall)
    order = rng.permutation(4)
    depths = [max(MARGIN_M, pieces[piece](room, wall)) for piece, wall in zip(order, walls)]
    low_y, high_x, high_y, low_x = depths
    free = np.array([[low_x, low_y], [size[0] - high_x, size[1] - high_y]])
    scattered(room, size, free)
    return Scene(
        size,
        room.builder.build(),
        tuple(room.objects),
        tuple(_lamp(rng, settings, place, len(room.lamps)) for place in room.lamps),
        _drawn(rng, settings.indirect),
        tuple(room.chairs),
        room.door,
        free,
        np.array(room.builder.boxes),
        tuple(room.mirrors),
    )


def _walls(size: np.ndarray) -> list[Wall]:
    """South, east, north, west; each seen from inside, its `along` to the right."""
    x, y, _ = np.eye(3)
    length, width, _ = size
    return [
        Wall(np.array([length, 0.0, 0.0]), -x, y, float(length)),
        Wall(np.array([length, width, 0.0]), -y, -x, float(width)),
        Wall(np.array([0.0, width, 0.0]), x, -y, float(length)),
        Wall(np.zeros(3), y, x, float(width)),
    ]


def _shell(room: Furnished, size: np.ndarray, walls: list[Wall]) -> None:
    """Walls with skirting, floor and ceiling."""
    rng, builder = room.rng, room.builder
    length, width, height = size
    base = [(232, 226, 214), (214, 222, 226), (236, 220, 200), (222, 228, 212)][int(rng.integers(4))]
    accent = [(150, 170, 180), (190, 150, 130), (165, 175, 140), (225, 195, 165)][int(rng.integers(4))]
    coloured = int(rng.integers(4))
    for i, wall in enumerate(walls):
        paint = textures.plaster(rng, accent if i == coloured else base)
        builder.quad(wall.rectangle(0.0, height, wall.length, height, out=0.0), paint)
        skirting = textures.plain((238, 236, 230))
        builder.quad(wall.rectangle(0.0, 0.09, wall.length, 0.09, out=0.008), skirting)
    kind = int(rng.integers(4))
    wood = [(190, 145, 105), (150, 105, 75), (215, 180, 145)][int(rng.integers(3))]
    floor = (
        textures.planks(rng, wood)
        if kind < 2
        else textures.tiles(rng, (205, 200, 190), (120, 118, 115) if rng.random() < 0.5 else (205, 200, 190))
        if kind == 2
        else textures.carpet(rng, (125, 125, 130))
    )
    corners = [(0.0, width, 0.0), (length, width, 0.0), (0.0, 0.0, 0.0), (length, 0.0, 0.0)]
    builder.quad(np.array(corners), floor)
    top = [(0.0, 0.0, height), (length, 0.0, height), (0.0, width, height), (length, width, height)]
    builder.quad(np.array(top), textures.plaster(rng, (240, 240, 236)))


def _lamp(rng: Generator, settings: SceneSettings, place: np.ndarray, lamps: int) -> Lamp:
    warmth = _drawn(rng, settings.lamp_warmth)
    colour = np.array([1 + warmth / 2, 1.0, 1 - warmth / 2])
    return Lamp(place, colour * _drawn(rng, settings.lamp_brightness) * INTENSITY / lamps)


def _drawn(rng: Generator, bounds) -> float:
    return float(rng.uniform(bounds.low, bounds.high))
