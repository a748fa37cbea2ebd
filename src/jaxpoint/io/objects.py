"""The database of objects, a CSV or a TOML file.

CSV, rectangles only: `name`, `lt_x,lt_y,lt_z,rt_x,...,lb_x,...,rb_x,...` (left-top, right-top, left-bottom,
right-bottom), and optionally `kind` and `tags` (words between spaces). The unit (m, cm or mm) stands in a column
`unit`, or at the end of the corners' columns: `lt_x_cm`.

TOML: a `unit`, optionally `[room]` with `low` and `high`, and any number of

    [[rectangle]]  name, corners (four of three numbers, in the order above)
    [[box]]        name, center, size, and optionally yaw_deg, by which it is turned about the vertical
    [[sphere]]     name, center, radius

each with `kind` and `tags` where wanted.

No object is named `nothing`: that is the answer where none is meant.
"""

from __future__ import annotations

import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import jax
import msgspec
import numpy as np
from jaxtyping import Float

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import Row, StrPath, check_finite, parse_header, parse_table, read_text
from jaxpoint.pointing.objects import NOTHING, Box, Objects, Rectangle, Shape, Sphere, Thing, flat_rectangle
from jaxpoint.pointing.room import Room

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
CORNERS = tuple(f"{corner}_{axis}" for corner in ("lt", "rt", "lb", "rb") for axis in "xyz")
MAX_RESIDUAL_M = 0.05
MAX_ROOM_M = 100.0
USUAL_SPAN_M = (1.0, 30.0)  # of all objects together; beyond these the unit is often wrong
FARTHEST_M = 1e8  # from the origin, which may be that of a map
MIN_SIDE_M = 0.001
_LAYOUT = (
    "it must hold unit, and may hold [room] (low, high), [[rectangle]] (name, corners), [[box]] (name, center, size, "
    "yaw_deg) and [[sphere]] (name, center, radius), all with kind and tags"
)


@dataclass(frozen=True)
class Database:
    """What a file of objects says."""

    things: tuple[Thing, ...]
    room: Room | None  # where the file gives it
    warnings: tuple[str, ...]  # a sentence each

    @property
    def objects(self) -> Objects:
        """For `intersect` and its kin."""
        with jax.enable_x64(True):
            return Objects.of(self.things)


def read_objects(path: StrPath) -> Database:
    """Read a database of objects; lengths become metres.

    Raises:
        FileFormatError: no unit, a missing or wrong value, a name twice or that cannot be one, a rectangle that is
            twisted or has no size, or objects too far apart for a room.
    """
    path = Path(path)
    return parse_objects(path, read_text(path))


def check_shape(shape: Shape, name: str) -> None:
    """Refuse what nobody can point at.

    Raises:
        FileFormatError: a number that is not finite, a size that is not positive, or corners in another order.
    """
    numbers = numbers_of(shape)
    wrong = numbers[~(np.abs(numbers) < FARTHEST_M)]
    if wrong.size:
        raise FileFormatError(f"{name} has a coordinate or a size of {wrong[0]:g} m; correct that number.")
    if isinstance(shape, Sphere):
        what, smallest = "radius", shape.radius
    elif isinstance(shape, Box):
        what, smallest = "side", float(np.min(shape.size))
    else:
        what, smallest = "side", _smallest_side(shape, name)
    smallest = round(smallest, 6)
    if smallest < MIN_SIDE_M:
        raise FileFormatError(
            f"{name} has a {what} of {1000 * smallest:g} mm; an object needs at least {1000 * MIN_SIDE_M:.0f} mm, so "
            "correct the unit, or measure it again."
        )


def parse_objects(path: Path, text: str) -> Database:
    things, room = _parse_toml(path, text) if is_toml(path) else (_parse_csv(path, text), None)
    check_names(path, things)
    span = check_span(path, things)
    return Database(tuple(things), room, (*_bent(things), *_unusual(span)))


def is_toml(path: Path) -> bool:
    return path.suffix.lower() == ".toml"


def numbers_of(shape: Shape) -> Float[np.ndarray, " n"]:
    """All lengths (m) and angles (rad) of a shape."""
    if isinstance(shape, Sphere):
        return np.array([*shape.center, shape.radius], float)
    if isinstance(shape, Box):
        return np.array([*shape.center, *shape.size, shape.yaw], float)
    return np.asarray(shape.corners, float).ravel()


def _smallest_side(shape: Rectangle, name: str) -> float:
    left_top, right_top, left_bottom, right_bottom = np.asarray(shape.corners)
    top, bottom, left, right = (
        right_top - left_top,
        right_bottom - left_bottom,
        left_bottom - left_top,
        right_bottom - right_top,
    )
    sides = [float(np.linalg.norm(side)) for side in (top, bottom, left, right)]
    if min(sides) < MIN_SIDE_M:
        return min(sides)
    for one, other, what in ((top, bottom, "top and bottom"), (left, right, "left and right side")):
        cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
        if cosine < 0.5:
            angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
            raise FileFormatError(
                f"{name} is twisted: its {what} are {angle:.0f} degrees apart; give the corners in the order left-top, "
                "right-top, left-bottom, right-bottom."
            )
    _, across, down = flat_rectangle(shape.corners)[0]
    narrow = float(np.linalg.norm(np.cross(across, down)) / max(np.linalg.norm(across), np.linalg.norm(down)))
    if narrow < MIN_SIDE_M / 1000:
        raise FileFormatError(f"{name} has all corners on one line, so that its area is 0; measure them again.")
    return narrow


def _parse_csv(path: Path, text: str) -> list[Thing]:
    header = parse_header(path, text)
    suffixes = [f"_{unit}" for unit in UNITS if f"{CORNERS[0]}_{unit}" in header]
    suffix = suffixes[0] if suffixes else ""
    if header and not suffix and "unit" not in header:
        raise FileFormatError(
            f"{path} says no unit; add a column 'unit' (m, cm or mm), or name the corners {CORNERS[0]}_m and so on."
        )
    unit = () if suffix else ("unit",)
    rows = parse_table(path, text, ("name", *unit, *(f"{column}{suffix}" for column in CORNERS)))
    return [_thing(row, suffix) for row in rows]


def _thing(row: Row, suffix: str) -> Thing:
    unit = suffix[1:] or row.text("unit")
    if unit not in UNITS:
        raise row.error(f"the unit is '{unit}'; use m, cm or mm.")
    corners = UNITS[unit] * np.array([row.number(f"{column}{suffix}") for column in CORNERS]).reshape(4, 3)
    shape = Rectangle(corners)
    check_shape(shape, f"{row.path}, line {row.line}: '{row.text('name')}'")
    return Thing(row.text("name"), shape, row.values.get("kind", ""), tuple(row.values.get("tags", "").split()))


class _Extent(msgspec.Struct, forbid_unknown_fields=True):
    low: tuple[float, float, float]
    high: tuple[float, float, float]


class _Entry(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    name: str
    kind: str = ""
    tags: tuple[str, ...] = ()


class _Rectangle(_Entry, kw_only=True):
    corners: tuple[tuple[float, float, float], ...]


class _Box(_Entry, kw_only=True):
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw_deg: float = 0.0


class _Sphere(_Entry, kw_only=True):
    center: tuple[float, float, float]
    radius: float


class _File(msgspec.Struct, forbid_unknown_fields=True):
    unit: str
    room: _Extent | None = None
    rectangle: tuple[_Rectangle, ...] = ()
    box: tuple[_Box, ...] = ()
    sphere: tuple[_Sphere, ...] = ()


def _parse_toml(path: Path, text: str) -> tuple[list[Thing], Room | None]:
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path} is not TOML: {error}.") from None
    if "unit" not in raw:
        raise FileFormatError(f'{path} says no unit; put unit = "m" (or cm, mm) into its first line.')
    try:
        check_finite(raw)
        file = msgspec.convert(raw, _File)
    except msgspec.ValidationError as error:  # which is a ValueError too
        raise FileFormatError(f"{path} cannot be used: {error}; {_LAYOUT}.") from None
    except ValueError as error:
        raise FileFormatError(f"{path} cannot be used: {error}; correct it.") from None
    if file.unit not in UNITS:
        raise FileFormatError(f"{path}: the unit is '{file.unit}'; use m, cm or mm.")
    scale = UNITS[file.unit]
    things = [
        Thing(entry.name, _shape(path, entry, scale), entry.kind, entry.tags)
        for entry in (*file.rectangle, *file.box, *file.sphere)
    ]
    if not things:
        raise FileFormatError(f"{path} holds 0 objects; add [[rectangle]], [[box]] or [[sphere]].")
    return things, None if file.room is None else _room(path, file.room, scale)


def _shape(path: Path, entry: _Entry, scale: float) -> Shape:
    name = f"{path}: '{entry.name}'"
    if isinstance(entry, _Rectangle):
        if len(entry.corners) != 4:
            raise FileFormatError(f"{name} has {len(entry.corners)} corners; a rectangle has 4.")
        shape: Shape = Rectangle(scale * np.array(entry.corners))
    elif isinstance(entry, _Box):
        shape = Box(scale * np.array(entry.center), scale * np.array(entry.size), float(np.deg2rad(entry.yaw_deg)))
    else:
        assert isinstance(entry, _Sphere)
        shape = Sphere(scale * np.array(entry.center), scale * entry.radius)
    check_shape(shape, name)
    return shape


def _room(path: Path, extent: _Extent, scale: float) -> Room:
    low, high = scale * np.array(extent.low), scale * np.array(extent.high)
    if (low >= high).any():
        axis = "xyz"[int(np.argmax(low >= high))]
        raise FileFormatError(f"{path}: the room's low {axis} is not below its high {axis}; exchange them.")
    size = float((high - low).max())
    if size > MAX_ROOM_M:
        raise FileFormatError(
            f"The room of {path} is {size:.0f} m long, and no room is larger than {MAX_ROOM_M:.0f} m; correct the "
            "unit, or its low and high."
        )
    with jax.enable_x64(True):
        return Room(low, high)


def name_fault(name: str) -> str | None:
    """What keeps a word from being a name."""
    if name.strip().splitlines() != [name]:
        return "is empty, or has a line break or spaces around it"
    return "is the answer where no object is meant" if name.lower() == NOTHING else None


def check_names(path: Path, things: list[Thing]) -> None:
    for thing in things:
        fault = name_fault(thing.name)
        if fault is not None:
            raise FileFormatError(f"{path} has an object named '{thing.name}': that {fault}; give it another name.")
    name, count = Counter(thing.name for thing in things).most_common(1)[0]
    if count > 1:
        raise FileFormatError(f"{path} has {count} objects named '{name}'; give each a name of its own.")


def check_span(path: Path, things: list[Thing]) -> float:
    """How far apart the objects lie, m, which must be within a room."""
    with jax.enable_x64(True):
        low, high = Objects.of(things).bounds
    span = float((high - low).max())
    if span > MAX_ROOM_M:
        raise FileFormatError(
            f"The objects of {path} lie up to {span:.0f} m apart, and no room is larger than {MAX_ROOM_M:.0f} m; "
            "correct the unit, or the farthest object."
        )
    return span


def _unusual(span: float) -> list[str]:
    """A warning where the objects' extent is that of no usual room."""
    low, high = USUAL_SPAN_M
    if low <= span <= high:
        return []
    return [f"All objects together span {span:.2f} m, where {low:.0f} to {high:.0f} m are usual; check the unit."]


def _bent(things: list[Thing]) -> list[str]:
    """Warnings about rectangles that are not plane."""
    notes = []
    for thing in things:
        residual = flat_rectangle(thing.shape.corners)[1] if isinstance(thing.shape, Rectangle) else 0.0
        if residual > MAX_RESIDUAL_M:
            notes.append(
                f"The corners of '{thing.name}' lie {100 * residual:.1f} cm off a common plane (limit "
                f"{100 * MAX_RESIDUAL_M:.0f} cm); measure them again."
            )
    return notes
