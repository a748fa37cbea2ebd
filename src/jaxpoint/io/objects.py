"""The database of objects, a CSV or a TOML file.

CSV, rectangles only: `name`, `lt_x,lt_y,lt_z,rt_x,...,lb_x,...,rb_x,...` (left-top, right-top, left-bottom,
right-bottom), and optionally `kind` and `tags` (words between spaces). The unit (m, cm or mm) stands in a column
`unit`, or at the end of the corners' columns: `lt_x_cm`.

TOML: a `unit`, optionally `[room]` with `low` and `high`, and any number of

    [[rectangle]]  name, corners (four of three numbers, in the order above)
    [[box]]        name, center, size, and optionally yaw_deg, by which it is turned about the vertical
    [[sphere]]     name, center, radius

each with `kind` and `tags` where wanted.
"""

from __future__ import annotations

import csv
import io
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import msgspec
import numpy as np
import tomli_w

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import Row, StrPath, read_header, read_table, read_text, replacing
from jaxpoint.pointing.objects import Box, Objects, Rectangle, Shape, Sphere, Thing, flat_rectangle
from jaxpoint.pointing.room import Room

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
CORNERS = tuple(f"{corner}_{axis}" for corner in ("lt", "rt", "lb", "rb") for axis in "xyz")
MAX_RESIDUAL_M = 0.05
MAX_ROOM_M = 100.0
MIN_SIDE_M = 0.001


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
        FileFormatError: no unit, a missing or wrong value, a name twice, a rectangle that is twisted or has no size, or
            objects too far apart for a room.
    """
    path = Path(path)
    things, room = _read_toml(path) if path.suffix == ".toml" else (_read_csv(path), None)
    _check_names(path, things)
    _check_room(path, things)
    return Database(tuple(things), room, tuple(_bent(things)))


def append_object(path: StrPath, thing: Thing) -> None:
    """Add one object at the end of a database, in the file's own unit; the file changes whole or not at all.

    Raises:
        FileFormatError: the file cannot be read, or the object does not fit it.
        UsageError: a CSV file cannot hold a box or a sphere.
    """
    path = Path(path)
    old = read_text(path)
    known = read_objects(path).things
    check_shape(thing.shape, f"'{thing.name}'")
    _check_names(path, [*known, thing])
    _check_room(path, [*known, thing])
    added = _toml_entry(thing, tomllib.loads(old)["unit"]) if path.suffix == ".toml" else _csv_line(path, thing)
    with replacing(path) as file:
        file.write((old + ("" if old.endswith("\n") else "\n") + added).encode())


def check_shape(shape: Shape, name: str) -> None:
    """Refuse what nobody can point at.

    Raises:
        FileFormatError: a size that is not positive, or corners in another order.
    """
    if isinstance(shape, Sphere):
        smallest = shape.radius
    elif isinstance(shape, Box):
        smallest = float(np.min(shape.size))
    else:
        smallest = _smallest_side(shape, name)
    if smallest < MIN_SIDE_M:
        raise FileFormatError(
            f"{name} has a side of {1000 * smallest:.1f} mm; an object needs at least {1000 * MIN_SIDE_M:.0f} mm, so "
            "measure its corners again."
        )


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
    return float(np.linalg.norm(np.cross(across, down)) / max(np.linalg.norm(across), np.linalg.norm(down)))


def _read_csv(path: Path) -> list[Thing]:
    header = read_header(path)
    suffixes = [f"_{unit}" for unit in UNITS if f"{CORNERS[0]}_{unit}" in header]
    suffix = suffixes[0] if suffixes else ""
    if not suffix and "unit" not in header:
        raise FileFormatError(
            f"{path} says no unit; add a column 'unit' (m, cm or mm), or name the corners {CORNERS[0]}_m and so on."
        )
    rows = read_table(path, ("name", *(f"{column}{suffix}" for column in CORNERS)))
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


def _read_toml(path: Path) -> tuple[list[Thing], Room | None]:
    try:
        raw = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path} is not TOML: {error}.") from None
    if "unit" not in raw:
        raise FileFormatError(f'{path} says no unit; put unit = "m" (or cm, mm) into its first line.')
    try:
        file = msgspec.convert(raw, _File)
    except msgspec.ValidationError as error:
        raise FileFormatError(f"{path} cannot be used: {error}.") from None
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
    with jax.enable_x64(True):
        return Room(low, high)


def _check_names(path: Path, things: list[Thing]) -> None:
    name, count = Counter(thing.name for thing in things).most_common(1)[0]
    if count > 1:
        raise FileFormatError(f"{path} has {count} objects named '{name}'; give each a name of its own.")


def _check_room(path: Path, things: list[Thing]) -> None:
    with jax.enable_x64(True):
        low, high = Objects.of(things).bounds
    span = float((high - low).max())
    if span > MAX_ROOM_M:
        raise FileFormatError(
            f"The objects of {path} lie up to {span:.0f} m apart, and no room is larger than {MAX_ROOM_M:.0f} m; "
            "correct the unit, or the farthest object."
        )


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


def _csv_line(path: Path, thing: Thing) -> str:
    if not isinstance(thing.shape, Rectangle):
        raise UsageError(f"'{path}' holds rectangles only; keep boxes and spheres in a .toml.")
    header = read_header(path)
    named = [unit for unit in UNITS if f"{CORNERS[0]}_{unit}" in header]
    unit = named[0] if named else read_table(path, ("name",))[-1].text("unit")
    numbers = np.asarray(thing.shape.corners).ravel() / UNITS[unit]
    suffix = f"_{unit}" if named else ""
    values: dict[str, Any] = {f"{column}{suffix}": f"{number:.5f}" for column, number in zip(CORNERS, numbers)}
    values |= {"name": thing.name, "unit": unit, "kind": thing.kind, "tags": " ".join(thing.tags)}
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([values.get(column, "") for column in header])
    return text.getvalue()


def _toml_entry(thing: Thing, unit: str) -> str:
    scale = 1 / UNITS[unit]
    shape = thing.shape
    entry: dict[str, Any] = {"name": thing.name}
    entry |= {key: value for key, value in (("kind", thing.kind), ("tags", list(thing.tags))) if value}
    if isinstance(shape, Rectangle):
        kind, entry["corners"] = "rectangle", _rounded(scale * np.asarray(shape.corners))
    elif isinstance(shape, Box):
        kind, entry["center"], entry["size"] = "box", _rounded(scale * shape.center), _rounded(scale * shape.size)
        entry |= {"yaw_deg": round(float(np.rad2deg(shape.yaw)), 3)} if shape.yaw else {}
    else:
        kind, entry["center"], entry["radius"] = (
            "sphere",
            _rounded(scale * shape.center),
            round(scale * shape.radius, 5),
        )
    return "\n" + tomli_w.dumps({kind: [entry]})


def _rounded(values: np.ndarray) -> list:
    return np.round(values, 5).tolist()
