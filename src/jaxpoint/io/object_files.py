"""The database of objects, a CSV or a TOML file.

CSV: `name`, and of a rectangle `lt_x,lt_y,lt_z,rt_x,...,lb_x,...,rb_x,...` (left-top, right-top, left-bottom,
right-bottom). With a column `shape` a line may be of any shape: a box has `center_x` to `center_z`, `size_x` to
`size_z` and optionally `yaw_deg`, a sphere `center_x` to `center_z` and `radius`; columns of other shapes stay empty in
it. `kind` and `tags` (words between spaces) are optional. The unit (m, cm or mm) stands in a column `unit`, or at the
end of the columns of all lengths: `lt_x_cm`. A column `world` names axes other than the room's (`unity`, `x,z,-y`).

TOML: a `unit`, optionally a `world`, `[room]` with `low` and `high`, and any number of

    [[rectangle]]  name, corners (four of three numbers, in the order above)
    [[box]]        name, center, size, and optionally yaw_deg, by which it is turned about the vertical
    [[sphere]]     name, center, radius

each with `kind` and `tags` where wanted. Both hold every other registered shape (`jaxpoint.pointing.shapes`) too, under
its name and with its fields.

No object is named `nothing`: that is the answer where none is meant.
"""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import msgspec
import numpy as np

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.geometry.world_axes import World, world_of
from jaxpoint.io.files import Row, StrPath, check_finite, parse_header, parse_table, read_text
from jaxpoint.pointing.objects import NOTHING, Objects, Thing
from jaxpoint.pointing.room_box import MAX_ROOM_M, Room
from jaxpoint.pointing.shapes.registry import shapes
from jaxpoint.pointing.shapes.shape import AbstractShape, Field

ROOM = "room"  # the world of a file that names none
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
PLAIN = "rectangle"  # the shape of every line of a CSV file that has no column `shape`
USUAL_SPAN_M = (1.0, 30.0)  # of all objects together; beyond these the unit is often wrong
FARTHEST_M = 1e8  # from the origin, which may be that of a map


@dataclass(frozen=True)
class Database:
    """The contents of a file of objects."""

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
        FileFormatError: no unit, a missing or wrong value, a name twice or that cannot be one, a shape that is
            twisted or has no size, or objects too far apart for a room.
    """
    path = Path(path)
    return parse_objects(path, read_text(path))


def check_shape(shape: AbstractShape, name: str) -> None:
    """Refuse what nobody can point at.

    Raises:
        FileFormatError: a non-finite value, a size that is not positive, or corners in another order.
    """
    numbers = shape.numbers
    wrong = numbers[~(np.abs(numbers) < FARTHEST_M)]
    if wrong.size:
        raise FileFormatError(f"{name} has a coordinate or a size of {wrong[0]:g} m; correct that number.")
    fault = shape.fault()
    if fault is not None:
        raise FileFormatError(f"{name} {fault}")


def parse_objects(path: Path, text: str) -> Database:
    """As `read_objects`, of the text of a file."""
    things, room = _parse_toml(path, text) if is_toml(path) else (_parse_csv(path, text), None)
    check_names(path, things)
    span = check_span(path, things)
    return Database(tuple(things), room, (*_doubts(things), *_unusual(span)))


def is_toml(path: Path) -> bool:
    """Whether a file is TOML by its name; else it is CSV."""
    return path.suffix.lower() == ".toml"


def known_tables() -> str:
    """The tables of TOML that hold an object, in words."""
    return _either([f"[[{name}]]" for name in shapes()])


def length_suffix(header: Sequence[str]) -> str:
    """The unit at the end of the columns of lengths, such as "_cm"; empty where no column has one."""
    found = [f"_{unit}" for unit in UNITS for column in _lengths() if f"{column}_{unit}" in header]
    return found[0] if found else ""


def _lengths() -> list[str]:
    """The columns of lengths of all shapes, without a unit."""
    fields = [field for shape in shapes().values() for field in shape.fields if not field.angle]
    return [column for field in fields for column in field.columns]


def file_columns(field: Field, suffix: str) -> tuple[str, ...]:
    """The columns of a field in a CSV file whose lengths end so."""
    return field.columns if field.angle else tuple(f"{column}{suffix}" for column in field.columns)


def _parse_csv(path: Path, text: str) -> list[Thing]:
    header = parse_header(path, text)
    suffix = length_suffix(header)
    plain = shapes()[PLAIN]
    _check_shape_column(path, header, suffix)
    if header and not suffix and "unit" not in header:
        first = next((column for column in _lengths() if column in header), _lengths()[0])
        raise FileFormatError(
            f"{path} says no unit; add a column 'unit' (m, cm or mm), or name the columns {first}_m and so on."
        )
    own = ("shape",) if "shape" in header else ()
    used = [plain]
    if own:
        used = list(dict.fromkeys(_shape_of(row) for row in parse_table(path, text, ("name", *own))))
    unit = () if suffix else ("unit",)
    rows = parse_table(path, text, ("name", *own, *unit, *_length_columns(header, used, suffix)))
    return [_thing(row, _shape_of(row) if own else plain, suffix) for row in rows]


def _check_shape_column(path: Path, header: Sequence[str], suffix: str) -> None:
    """Refuse a table that has the columns of another shape than the plain one, but does not say so."""
    if "shape" in header or set(file_columns(shapes()[PLAIN].fields[0], suffix)) & set(header):
        return
    for shape in shapes().values():
        needed = [field for field in shape.fields if field.default is None]
        if all(column in header for field in needed for column in file_columns(field, suffix)):
            raise FileFormatError(
                f"{path} has the columns of a {shape.name}, but no column 'shape'; add it, with the name of each "
                "line's shape."
            )


def _length_columns(header: Sequence[str], used: Sequence[type[AbstractShape]], suffix: str) -> list[str]:
    """The columns of values that must be there, and those that are there: these keep their unit."""
    known = [(shape, field) for shape in (*used, *shapes().values()) for field in shape.fields]
    needed = [
        column
        for shape, field in known
        for column in file_columns(field, suffix)
        if column in header or (shape in used and field.default is None)
    ]
    return list(dict.fromkeys(needed))


def _shape_of(row: Row) -> type[AbstractShape]:
    known = shapes()
    name = row.text("shape").casefold()
    if name not in known:
        raise row.error(f"the shape is '{row.text('shape')}'; use {_either(list(known))}.")
    return known[name]


def _thing(row: Row, shape: type[AbstractShape], suffix: str) -> Thing:
    unit = suffix[1:] or row.text("unit")
    if unit not in UNITS:
        raise row.error(f"the unit is '{unit}'; use m, cm or mm.")
    _check_cells(row, shape, suffix)
    values = [field.from_file(_cells(row, field, suffix), UNITS[unit]) for field in shape.fields]
    place = f"{row.path}, line {row.line}: '{row.text('name')}'"
    found = _in_room(place, shape(*values), row.values.get("world") or ROOM)
    check_shape(found, place)
    return Thing(row.text("name"), found, row.values.get("kind", ""), tuple(row.values.get("tags", "").split()))


def _cells(row: Row, field: Field, suffix: str) -> Any:
    """The numbers of a field, in the file's unit."""
    columns = file_columns(field, suffix)
    if field.default is not None and all(row.missing(column) for column in columns):
        return field.default
    numbers = np.array([row.number(column) for column in columns])
    return numbers.reshape(field.size) if field.size else float(numbers[0])


def _check_cells(row: Row, shape: type[AbstractShape], suffix: str) -> None:
    """Refuse a value that only another shape has: either it or the shape is wrong."""
    own = {column for field in shape.fields for column in file_columns(field, suffix)}
    every = {column for other in shapes().values() for field in other.fields for column in file_columns(field, suffix)}
    extra = [column for column in row.values if column in every - own and not row.missing(column)]
    if extra and "shape" in row.values:
        raise row.error(
            f"a {shape.name} has no '{extra[0]}', but it is {row.values[extra[0]]}; empty that cell, or correct the "
            "shape."
        )


class _Extent(msgspec.Struct, forbid_unknown_fields=True):
    low: tuple[float, float, float]
    high: tuple[float, float, float]


class _Entry(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    name: str
    kind: str = ""
    tags: tuple[str, ...] = ()


def _file_type() -> type[msgspec.Struct]:
    """What a TOML file holds: a table of every registered shape."""
    tables = []
    for name, shape in shapes().items():
        entry = msgspec.defstruct(name, [_key(field) for field in shape.fields], bases=(_Entry,), kw_only=True)
        tables.append((name, tuple[entry, ...], ()))
    every = [("unit", str), ("world", str, ROOM), ("room", _Extent | None, None), *tables]
    return msgspec.defstruct("File", every, kw_only=True, forbid_unknown_fields=True)


def _key(field: Field) -> tuple:
    three = tuple[float, float, float]
    kind = float if not field.size else tuple[three, ...] if field.points else three
    return (field.name, kind) if field.default is None else (field.name, kind, field.default)


def _parse_toml(path: Path, text: str) -> tuple[list[Thing], Room | None]:
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path} is not TOML: {error}.") from None
    if "unit" not in raw:
        raise FileFormatError(f'{path} says no unit; put unit = "m" (or cm, mm) into its first line.')
    try:
        check_finite(raw)
        file: Any = msgspec.convert(raw, _file_type())
    except msgspec.ValidationError as error:  # which is a ValueError too
        raise FileFormatError(f"{path} cannot be used: {error}; {_layout()}.") from None
    except ValueError as error:
        raise FileFormatError(f"{path} cannot be used: {error}; correct it.") from None
    if file.unit not in UNITS:
        raise FileFormatError(f"{path}: the unit is '{file.unit}'; use m, cm or mm.")
    scale = UNITS[file.unit]
    things = [
        Thing(entry.name, _shape(path, shape, entry, scale, file.world), entry.kind, entry.tags)
        for name, shape in shapes().items()
        for entry in getattr(file, name)
    ]
    if not things:
        raise FileFormatError(f"{path} holds 0 objects; add {known_tables()}.")
    return things, None if file.room is None else _room(path, file.room, scale, file.world)


def _in_room(where: str, shape: AbstractShape, world: str) -> AbstractShape:
    """A shape of a world in the axes of the room."""
    found = shape if world == ROOM else shape.to_room(_world(where, world))
    if found is None:
        raise FileFormatError(f"{where} is a {shape.name}, which cannot be turned; give it in the axes of the room.")
    return found


def _world(where: str, text: str) -> World:
    try:
        return world_of(text)
    except UsageError as error:
        raise FileFormatError(f"{where}: {error}") from None


def _shape(path: Path, shape: type[AbstractShape], entry: _Entry, scale: float, world: str) -> AbstractShape:
    name = f"{path}: '{entry.name}'"
    for field in shape.fields:
        found = len(getattr(entry, field.name)) if field.points else 0
        if found != len(field.points):
            raise FileFormatError(f"{name} has {found} {field.name}; a {shape.name} has {len(field.points)}.")
    made = shape(*(field.from_file(getattr(entry, field.name), scale) for field in shape.fields))
    made = _in_room(name, made, world)
    check_shape(made, name)
    return made


def _layout() -> str:
    """What a TOML file holds, in words."""
    tables = [
        f"[[{name}]] (name, {', '.join(field.name for field in shape.fields)})" for name, shape in shapes().items()
    ]
    return f"it must hold unit, and may hold world, [room] (low, high), {_either(tables, 'and')}, with kind and tags"


def _either(words: Sequence[str], word: str = "or") -> str:
    return f"{', '.join(words[:-1])} {word} {words[-1]}"


def _room(path: Path, extent: _Extent, scale: float, world: str) -> Room:
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
    ends = np.stack([low, high]) if world == ROOM else _world(str(path), world).to_room(np.stack([low, high]))
    with jax.enable_x64(True):
        return Room(ends.min(axis=0), ends.max(axis=0))


def name_fault(name: str) -> str | None:
    """The fault of a word that cannot be a name."""
    if name.strip().splitlines() != [name]:
        return "is empty, or has a line break or spaces around it"
    return "is the answer where no object is meant" if name.lower() == NOTHING else None


def check_names(path: Path, things: list[Thing]) -> None:
    """Refuse names that cannot be one, or that two objects have.

    Raises:
        FileFormatError: there is one.
    """
    for thing in things:
        fault = name_fault(thing.name)
        if fault is not None:
            raise FileFormatError(f"{path} has an object named '{thing.name}': that {fault}; give it another name.")
    name, count = Counter(thing.name for thing in things).most_common(1)[0]
    if count > 1:
        raise FileFormatError(f"{path} has {count} objects named '{name}'; give each a name of its own.")


def check_span(path: Path, things: list[Thing]) -> float:
    """How far apart the objects lie, m, which must be within a room.

    Raises:
        FileFormatError: it is not.
    """
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


def _doubts(things: list[Thing]) -> list[str]:
    """A warning for each object that was probably measured wrong."""
    notes = (thing.shape.doubt(thing.name) for thing in things)
    return [note for note in notes if note is not None]
