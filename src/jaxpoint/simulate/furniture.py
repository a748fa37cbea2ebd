"""What stands along the walls of the simulated room and hangs on them; each piece adds surfaces and named objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from jaxpoint.simulate import textures
from jaxpoint.simulate.people.floor import Chair
from jaxpoint.simulate.surfaces import Builder, box_faces
from jaxpoint.simulate.textures import Colour, Texture

WOODS: tuple[Colour, ...] = ((205, 165, 125), (222, 184, 150), (190, 135, 95), (120, 80, 55), (235, 228, 215))
"""The first three are as bright and reddish as skin."""


@dataclass(frozen=True)
class NamedObject:
    """A rectangle that can be pointed at."""

    name: str
    kind: str
    tags: tuple[str, ...]
    corners: Float[np.ndarray, "4 3"]  # m: left-top, right-top, left-bottom, right-bottom

    @property
    def center(self) -> Float[np.ndarray, "3"]:
        """The middle of the rectangle, m."""
        return self.corners.mean(axis=0)


@dataclass(frozen=True)
class Wall:
    """A wall's own frame: `along` to the right as seen from inside the room, `out` into the room."""

    origin: Float[np.ndarray, "3"]  # the lower left corner
    along: Float[np.ndarray, "3"]
    out: Float[np.ndarray, "3"]
    length: float

    def at(self, along: float, out: float, up: float) -> np.ndarray:
        """A place, m."""
        return self.origin + along * self.along + out * self.out + np.array([0.0, 0.0, up])

    @property
    def yaw(self) -> float:
        """Turn of a box whose front (-y of the box) looks into the room."""
        return float(np.arctan2(self.along[1], self.along[0]))

    def rectangle(self, left: float, top: float, width: float, height: float, out: float = 0.01) -> np.ndarray:
        """Corners of an upright rectangle parallel to the wall."""
        right, bottom = left + width, top - height
        return np.stack([self.at(a, out, u) for a, u in ((left, top), (right, top), (left, bottom), (right, bottom))])


@dataclass
class Furnished:
    """A room in the making."""

    rng: Generator
    builder: Builder = field(default_factory=Builder)
    objects: list[NamedObject] = field(default_factory=list)
    chairs: list[Chair] = field(default_factory=list)
    mirrors: list[tuple[np.ndarray, float]] = field(default_factory=list)  # corners, share of light reflected
    lamps: list[np.ndarray] = field(default_factory=list)  # m
    door: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m, a place just inside

    def name(self, name: str, kind: str, corners: np.ndarray, *tags: str) -> None:
        """Make a rectangle something that can be pointed at."""
        self.objects.append(NamedObject(name, kind, tags, np.asarray(corners, float)))

    def flat(self, name: str, kind: str, corners: np.ndarray, texture: Texture, *tags: str) -> None:
        """A rectangle that is seen and named."""
        self.builder.quad(corners, texture)
        self.name(name, kind, corners, *tags)

    def wood(self) -> Colour:
        """The colour of one piece of furniture."""
        return WOODS[int(self.rng.integers(len(WOODS)))]


def media_wall(room: Furnished, wall: Wall) -> float:
    """A cabinet with the television and a vase on it, a shelf board with books above. Returns its depth, m."""
    rng, builder = room.rng, room.builder
    width, height, depth = rng.uniform(1.5, 1.9), rng.uniform(0.5, 0.75), 0.45
    left = rng.uniform(1.0, wall.length - width - 1.0)
    colour = room.wood()
    wood, front = textures.wood(rng, colour), textures.drawers(rng, colour, 3)
    center = wall.at(left + width / 2, depth / 2 + 0.01, height / 2)
    builder.box(center, (width, depth, height), wood, wall.yaw, front=front)
    faces = box_faces(center, (width, depth, height), wall.yaw)
    room.name("cabinet", "cabinet", faces["front"], "furniture", "drawers")
    room.mirrors.append((faces["top"], 0.05))
    across = rng.uniform(0.95, 1.2)
    tall = across * 9 / 16
    screen = wall.at(left + width * 0.42, 0.22, height + 0.05 + tall / 2)
    size = (across, 0.05, tall)
    builder.box(screen, size, textures.plain((18, 18, 20)), wall.yaw, front=textures.screen(rng))
    room.name("television", "screen", box_faces(screen, size, wall.yaw)["front"], "tv", "screen")
    room.mirrors.append((box_faces(screen, size, wall.yaw)["front"], 0.08))
    # A box before the cabinet: one of the objects that hide others.
    _carton(room, "toy box", wall.at(left + width * rng.uniform(0.2, 0.8), depth + 0.25, 0.0), 0.36, 0.28, "toys")
    vase = wall.at(left + width - 0.18, 0.22, height)
    builder.tube(vase, (0.06, 0.09), 0.24, textures.plain(_vivid(rng)))
    _plant(room, vase + np.array([0.0, 0.0, 0.24]), 0.22)
    end = left - 0.45 if left > 1.6 else left + width + 0.45
    _floor_lamp(room, wall.at(end, 0.3, 0.0), wall)
    top = height + tall + 0.35
    room.flat(
        "calendar", "picture", wall.rectangle(left + width - 0.2, top, 0.32, 0.45), textures.printed(rng), "paper"
    )
    return depth + 0.5


def sofa_wall(room: Furnished, wall: Wall) -> float:
    """A sofa under pictures, with a low table and its book before it. Returns its depth, m."""
    rng, builder = room.rng, room.builder
    width, depth = rng.uniform(1.7, 2.1), 0.85
    left = rng.uniform(0.9, wall.length - width - 0.9)
    cloth = textures.fabric(rng, _muted(rng))
    middle = left + width / 2
    builder.box(wall.at(middle, depth / 2 + 0.02, 0.22), (width, depth, 0.36), cloth, wall.yaw)
    builder.box(wall.at(middle, 0.14, 0.6), (width, 0.24, 0.5), cloth, wall.yaw)
    for side in (left + 0.1, left + width - 0.1):
        builder.box(wall.at(side, depth / 2 + 0.02, 0.48), (0.2, depth, 0.3), cloth, wall.yaw)
    for i, share in enumerate((0.25, 0.75)):
        pillow = wall.at(left + width * share, 0.33, 0.58)
        colour = ((225, 190, 165), _vivid(rng))[i]
        size = (0.42, 0.14, 0.38)
        builder.box(pillow, size, textures.fabric(rng, colour), wall.yaw + rng.uniform(-0.2, 0.2))
    room.name("cushion", "cushion", box_faces(pillow, size, wall.yaw)["front"], "sofa")
    _low_table(room, wall.at(middle, depth + 0.55, 0.0), wall)
    at, top = left + 0.05, rng.uniform(1.75, 1.95)
    for name, span, tall in (("painting", 0.9, 0.65), ("photograph", 0.4, 0.5), ("small picture", 0.35, 0.3)):
        corners = wall.rectangle(at, top, span, tall)
        room.flat(name, "picture", corners, textures.picture(rng), "frame")
        at += span + rng.uniform(0.1, 0.25)
    return depth + 0.95


def shelf_wall(room: Furnished, wall: Wall) -> float:
    """A bookshelf, a door with a clock beside it and a light switch. Returns its depth, m."""
    rng, builder = room.rng, room.builder
    width, height, depth = rng.uniform(0.9, 1.2), rng.uniform(1.6, 1.9), 0.32
    left = rng.uniform(0.3, 0.9)
    wood = textures.wood(rng, room.wood())
    size = (width, depth, height)
    center = wall.at(left + width / 2, depth / 2 + 0.01, height / 2)
    builder.box(center, size, wood, wall.yaw, front=None)
    levels = 5
    for level in range(levels):
        bottom = 0.04 + level * (height - 0.06) / levels
        builder.box(wall.at(left + width / 2, depth / 2, bottom), (width - 0.02, depth, 0.025), wood, wall.yaw)
        tall = (height - 0.06) / levels - 0.04
        row = wall.rectangle(left + 0.02, bottom + 0.012 + tall, width - 0.04, tall, out=depth - 0.06)
        builder.quad(row, textures.books(rng))
        if level == 3:
            room.name("row of books", "book", row, "books", "shelf")
    # It is open: what stands in it lies before it.
    back = wall.rectangle(left, height, width, height, out=depth - 0.07)
    room.name("bookshelf", "shelf", back, "books", "furniture")
    card = wall.rectangle(left + 0.15, 0.04 + 3.75 * (height - 0.06) / levels, 0.14, 0.19, out=depth - 0.02)
    room.flat("postcard", "picture", card, textures.picture(rng), "photo")
    opening = rng.uniform(left + width + 0.7, wall.length - 1.2)
    leaf = textures.door(rng, WOODS[int(rng.integers(len(WOODS)))])
    room.flat("door", "door", wall.rectangle(opening, 2.05, 0.92, 2.05), leaf, "exit")
    room.door = wall.at(opening + 0.46, 0.5, 0.0)
    switch = wall.rectangle(opening - 0.25, 1.15, 0.1, 0.1)
    room.flat("light switch", "switch", switch, textures.plain((236, 234, 228)), "light")
    clock = wall.rectangle(left + width + 0.15, 2.15, 0.32, 0.32)
    room.flat("clock", "clock", clock, textures.clock(rng), "time")
    mat = wall.at(opening + 0.46, 0.45, 0.006)
    room.flat("doormat", "mat", _lying(mat, 0.7, 0.42, wall), textures.carpet(rng, _muted(rng)), "floor")
    return 0.75


def desk_wall(room: Furnished, wall: Wall) -> float:
    """A window with curtains, a desk with monitor, lamp and papers, a poster, a bin. Returns its depth, m."""
    rng, builder = room.rng, room.builder
    width, depth, height = rng.uniform(1.2, 1.5), 0.68, 0.74
    opening, wide = rng.uniform(0.6, 0.9), rng.uniform(1.3, 1.6)
    room.flat("window", "window", wall.rectangle(opening, 2.25, wide, 1.3, out=0.005), textures.window(rng), "outside")
    room.mirrors.append((room.objects[-1].corners, 0.06))
    for place in (opening - 0.3, opening + wide - 0.05):
        _curtain(room, wall, place, textures.fabric(rng, _muted(rng)))
    left = rng.uniform(opening + wide + 0.35, wall.length - width - 0.25)
    left = min(left, wall.length - width - 0.2)
    wood = textures.wood(rng, room.wood())
    _table(builder, wall.at(left + width / 2, depth / 2 + 0.02, 0.0), (width, depth, height), wood, wall.yaw)
    board = box_faces(wall.at(left + width / 2, depth / 2, height - 0.02), (width, depth, 0.04), wall.yaw)["top"]
    room.mirrors.append((board, 0.06))
    size = (0.56, 0.04, 0.34)
    monitor = wall.at(left + width * 0.45, 0.28, height + 0.28)
    builder.box(monitor, size, textures.plain((22, 22, 24)), wall.yaw, front=textures.screen(rng))
    builder.box(wall.at(left + width * 0.45, 0.26, height + 0.06), (0.08, 0.05, 0.12), textures.plain((30, 30, 30)))
    room.name("monitor", "screen", box_faces(monitor, size, wall.yaw)["front"], "computer", "screen")
    # The poster hangs partly behind the monitor.
    across = left + width * rng.uniform(0.05, 0.25)
    room.flat("poster", "picture", wall.rectangle(across, 1.85, 0.62, 0.86), textures.poster(rng), "paper")
    paper = wall.at(left + width * 0.82, 0.4, height + 0.004)
    room.flat("notepad", "paper", _lying(paper, 0.21, 0.3, wall), textures.printed(rng), "desk")
    lamp = wall.at(left + 0.14, 0.25, height)
    builder.tube(lamp, (0.015, 0.015), 0.34, textures.plain((40, 40, 42)))
    builder.tube(lamp + np.array([0.0, 0.0, 0.28]), (0.11, 0.05), 0.14, textures.plain(_vivid(rng)))
    shade = wall.rectangle(left + 0.14 - 0.11, height + 0.42, 0.22, 0.14, out=0.25)
    room.name("desk lamp", "lamp", shade, "light", "desk")
    waste = wall.at(left + width + 0.0, depth + 0.1, 0.0)
    builder.tube(waste, (0.1, 0.14), 0.3, textures.plain((70, 74, 80)))
    return depth + 0.2


def scattered(room: Furnished, size: np.ndarray, free: np.ndarray) -> None:
    """What lies on the floor and hangs from the ceiling, and chairs at the edge of the free floor."""
    rng = room.rng
    middle = (free[0] + free[1]) / 2
    ground = Wall(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), float(size[0]))
    spread = (free[1] - free[0]) * rng.uniform(0.5, 0.75, 2)
    room.flat("rug", "rug", _lying(np.append(middle, 0.004), spread[0], spread[1], ground), textures.rug(rng), "carpet")
    corner = np.array([free[1, 0] + 0.25, free[0, 1] - 0.2, 0.0])
    _carton(room, "cardboard box", corner, 0.42, 0.35, "floor", "parcel")
    other = np.array([free[0, 0] - 0.2, free[1, 1] + 0.15, 0.006])
    room.flat("newspaper", "paper", _lying(other, 0.4, 0.3, ground), textures.printed(rng), "floor")
    for i, x in enumerate((free[0, 0] + 0.35, free[1, 0] - 0.35)):
        low = i == int(rng.integers(2))
        y = free[0, 1] - 0.28 if low else free[1, 1] + 0.28
        _chair(room, f"chair {i + 1}", np.array([x, y]), np.pi / 2 if low else -np.pi / 2)
    _ceiling(room, size)


def _ceiling(room: Furnished, size: np.ndarray) -> None:
    rng = room.rng
    top = float(size[2])

    def hanging(x: float, y: float, across: float, along: float, drop: float) -> np.ndarray:
        low_x, high_x, low_y, high_y = x - across / 2, x + across / 2, y - along / 2, y + along / 2
        corners = [(low_x, low_y), (high_x, low_y), (low_x, high_y), (high_x, high_y)]
        return np.array([(*corner, top - drop) for corner in corners])  # seen from below

    shares = ((0.27, 0.3), (0.72, 0.68), (0.5, 0.5))[: 2 + int(rng.random() < 0.5)]
    glow = Texture(np.full((2, 2, 3), (3.2, 3.0, 2.7), np.float32), shines=True)
    for i, (x, y) in enumerate(shares):
        center = np.array([x * size[0], y * size[1], top - 0.03]) + np.append(rng.uniform(-0.25, 0.25, 2), 0.0)
        panel = hanging(center[0], center[1], 0.55, 0.55, 0.06)
        room.builder.box(center, (0.6, 0.6, 0.059), textures.plain((240, 240, 240)), bottom=None, top=None)
        room.flat(f"ceiling lamp {i + 1}", "lamp", panel, glow, "light", "ceiling")
        room.lamps.append(center - np.array([0.0, 0.0, 0.12]))
    vent = hanging(size[0] * 0.3, size[1] * 0.8, 0.45, 0.45, 0.005)
    room.flat("ventilator", "grille", vent, textures.grille(rng), "ceiling", "air")
    alarm = hanging(size[0] * 0.62, size[1] * 0.25, 0.16, 0.16, 0.03)
    room.flat("smoke alarm", "alarm", alarm, textures.plain((225, 60, 50)), "ceiling")


def _lying(center: np.ndarray, across: float, along: float, wall: Wall) -> np.ndarray:
    """Corners of a horizontal rectangle seen from above; its bottom edge is nearest the wall."""
    a, b = wall.along * across / 2, wall.out * along / 2
    if np.cross(a, b)[2] < 0:
        a = -a
    return np.stack([center - a + b, center + a + b, center - a - b, center + a - b])


def _table(builder: Builder, center: np.ndarray, size: Sequence[float], wood: Texture, yaw: float) -> None:
    width, depth, height = size
    builder.box(center + np.array([0.0, 0.0, height - 0.02]), (width, depth, 0.04), wood, yaw)
    cos, sin = np.cos(yaw), np.sin(yaw)
    for x in (-width / 2 + 0.05, width / 2 - 0.05):
        for y in (-depth / 2 + 0.05, depth / 2 - 0.05):
            leg = center + np.array([cos * x - sin * y, sin * x + cos * y, (height - 0.04) / 2])
            builder.box(leg, (0.05, 0.05, height - 0.04), wood, yaw)


def _low_table(room: Furnished, center: np.ndarray, wall: Wall) -> None:
    rng = room.rng
    width, depth, height = rng.uniform(0.8, 1.1), rng.uniform(0.45, 0.55), rng.uniform(0.38, 0.48)
    _table(room.builder, center, (width, depth, height), textures.wood(rng, room.wood()), wall.yaw)
    top = center + np.array([0.0, 0.0, height])
    board = box_faces(top - np.array([0.0, 0.0, 0.02]), (width, depth, 0.04), wall.yaw)["top"]
    room.name("coffee table", "table", board, "table", "furniture")
    room.mirrors.append((board, 0.07))
    size = np.array([0.17, 0.24, 0.035])
    book = top + wall.along * rng.uniform(-0.25, 0.0) + np.array([0.0, 0.0, size[2] / 2])
    cover = textures.printed(rng)
    room.builder.box(book, size, textures.plain((235, 230, 215)), wall.yaw, top=cover)
    room.name("book", "book", box_faces(book, size, wall.yaw)["top"], "reading", "table")
    mug = top + wall.along * 0.25
    room.builder.tube(mug, (0.04, 0.045), 0.1, textures.plain(_vivid(rng)))


def _carton(room: Furnished, name: str, base: np.ndarray, side: float, height: float, *tags: str) -> None:
    rng = room.rng
    size, yaw = (side, side * rng.uniform(0.75, 1.0), height), rng.uniform(-0.4, 0.4)
    colour = ((200, 160, 115), _vivid(rng))[int(rng.random() < 0.5)]
    center = base + np.array([0.0, 0.0, height / 2])
    room.builder.box(center, size, textures.cardboard(rng, colour), yaw)
    room.name(name, "box", box_faces(center, size, yaw)["top"], *tags)


def _floor_lamp(room: Furnished, base: np.ndarray, wall: Wall) -> None:
    pole = textures.plain((60, 58, 55))
    room.builder.tube(base, (0.14, 0.14), 0.03, pole)
    room.builder.tube(base, (0.015, 0.015), 1.45, pole)
    shade = Texture(np.full((2, 2, 3), (0.95, 0.8, 0.55), np.float32), shines=True)
    room.builder.tube(base + np.array([0.0, 0.0, 1.35]), (0.2, 0.13), 0.3, shade)
    room.builder.boxes.append(base + np.array([[-0.22, -0.22, 0.0], [0.22, 0.22, 1.7]]))
    across = 0.36 * wall.along
    top = base + wall.out * 0.0 + np.array([0.0, 0.0, 1.65])
    corners = np.stack([top - across / 2, top + across / 2]).repeat(2, axis=0)[[0, 2, 1, 3]]
    corners[2:, 2] -= 0.3
    room.name("floor lamp", "lamp", corners, "light")


def _plant(room: Furnished, base: np.ndarray, reach: float) -> None:
    """Leaves as narrow sheets that arch outward, seen from both sides."""
    rng = room.rng
    for _ in range(14):
        turn, lean = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.0)
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        side = np.array([-np.sin(turn), np.cos(turn), 0.0])
        along = np.linspace(0, 1, 6)[:, None]
        spine = base + reach * (lean * along**1.5 * out + along * np.sqrt(1.2 - lean**2 * along) * [0.0, 0.0, 1.4])
        width = 0.022 * np.sin(np.pi * np.clip(along, 0.08, 0.96))
        leaf = np.stack([spine - width * side, spine + width * side], axis=1)
        green = textures.plain((int(rng.integers(40, 80)), int(rng.integers(100, 150)), int(rng.integers(40, 70))))
        room.builder.sheet(leaf, green)
        room.builder.sheet(leaf[:, ::-1], green)


def _curtain(room: Furnished, wall: Wall, left: float, cloth: Texture) -> None:
    along = np.linspace(0, 0.35, 29)
    rows = [
        [wall.at(left + a, 0.09 + 0.03 * np.sin(a * 2 * np.pi / 0.09), up) for a in along]
        for up in np.linspace(2.4, 0.15, 20)
    ]
    room.builder.sheet(np.array(rows), cloth)


def _chair(room: Furnished, name: str, position: np.ndarray, facing: float) -> None:
    rng = room.rng
    wood, seat_m = textures.wood(rng, room.wood()), 0.45
    yaw = facing + np.pi / 2  # the front of a box is its -y
    ground = np.append(position, 0.0)
    _table(room.builder, ground, (0.42, 0.42, seat_m), wood, yaw)
    behind = ground - 0.2 * np.array([np.cos(facing), np.sin(facing), 0.0])
    size = (0.42, 0.03, 0.45)
    back = behind + np.array([0.0, 0.0, seat_m + size[2] / 2 + 0.02])
    room.builder.box(back, size, wood, yaw)
    room.name(name, "chair", box_faces(back, size, yaw)["front"], "seat")
    room.chairs.append(Chair(float(position[0]), float(position[1]), facing, seat_m))


def _vivid(rng: Generator) -> Colour:
    colour = rng.permutation([int(rng.integers(150, 220)), int(rng.integers(40, 190)), int(rng.integers(20, 70))])
    return int(colour[0]), int(colour[1]), int(colour[2])


def _muted(rng: Generator) -> Colour:
    red, green, blue = (int(value) for value in rng.integers(70, 180) + rng.integers(-22, 22, 3))
    return red, green, blue
