"""Adding an object to a database (`jaxpoint.io.objects`), in the file's own unit, so that nothing in it is lost."""

from __future__ import annotations

import csv
import io
import tomllib
from itertools import zip_longest
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import StrPath, parse_header, parse_table, read_text, replacing
from jaxpoint.io.objects import (
    CORNERS,
    UNITS,
    Database,
    check_names,
    check_shape,
    check_span,
    is_toml,
    name_fault,
    numbers_of,
    parse_objects,
)
from jaxpoint.pointing.objects import Box, Rectangle, Thing

_WRITTEN = 1e-5  # m or rad, to which `append_object` writes


def append_object(path: StrPath, thing: Thing) -> tuple[str, ...]:
    """Add one object at the end of a database, in the file's own unit; the file changes whole or not at all.

    Returns:
        The warnings that the database did not have without it.

    Raises:
        FileFormatError: the file cannot be read, or the object does not fit it.
        UsageError: a name that cannot be one, or that a CSV file has no place for the object's shape, kind or tags.
    """
    path = Path(path)
    _check_new_name(thing.name)
    check_shape(thing.shape, f"'{thing.name}'")
    old = read_text(path)
    known = parse_objects(path, old)
    things = [*known.things, thing]
    check_names(path, things)
    check_span(path, things)
    added = _toml_entry(thing, tomllib.loads(old)["unit"]) if is_toml(path) else _csv_line(path, old, thing)
    new = old + ("" if old.endswith("\n") else "\n") + added
    found = _read_back(path, new, things)
    with replacing(path) as file:
        file.write(new.encode())
    return tuple(warning for warning in found.warnings if warning not in known.warnings)


def _check_new_name(name: str) -> None:
    """Refuse what cannot be a name, and what would make a comment of a line."""
    fault = name_fault(name) or ("begins with a '#', as comments do" if name.startswith("#") else None)
    if fault is not None:
        raise UsageError(f"An object cannot be named '{name}': that {fault}; give it another name.")


def _read_back(path: Path, text: str, things: list[Thing]) -> Database:
    """What a file with this text would hold, which must be these objects."""
    remedy = (
        "write every object as a [[rectangle]], [[box]] or [[sphere]] of its own"
        if is_toml(path)
        else "mend the file's last line, or the object's kind and tags"
    )
    refusal = f"{path} would not be read as it should with '{things[-1].name}' at its end; {remedy}"
    try:
        found = parse_objects(path, text)
    except FileFormatError as error:
        raise FileFormatError(f"{refusal}: {error}") from None
    by_name = attrgetter("name")
    pairs = zip_longest(sorted(found.things, key=by_name), sorted(things, key=by_name))
    if not all(_is_same(one, other) for one, other in pairs):
        raise FileFormatError(f"{refusal}.")
    return found


def _is_same(one: Thing | None, other: Thing | None) -> bool:
    """But for the rounding of what is written."""
    if one is None or other is None:
        return False
    alike = (one.name, one.kind, one.tags, type(one.shape)) == (other.name, other.kind, other.tags, type(other.shape))
    return alike and np.allclose(numbers_of(one.shape), numbers_of(other.shape), rtol=0, atol=_WRITTEN)


def _csv_line(path: Path, text: str, thing: Thing) -> str:
    if not isinstance(thing.shape, Rectangle):
        raise UsageError(f"'{path}' holds rectangles only; keep boxes and spheres in a .toml.")
    header = parse_header(path, text)
    for column, value in (("kind", thing.kind), ("tags", thing.tags)):
        if value and column not in header:
            raise UsageError(f"'{path}' has no column '{column}'; add it to every line first, or leave {column} out.")
    named = [unit for unit in UNITS if f"{CORNERS[0]}_{unit}" in header]
    unit = named[0] if named else parse_table(path, text, ("name",))[-1].text("unit")
    numbers = np.asarray(thing.shape.corners).ravel() / UNITS[unit]
    suffix = f"_{unit}" if named else ""
    values: dict[str, Any] = {f"{column}{suffix}": f"{number:.5f}" for column, number in zip(CORNERS, numbers)}
    values |= {"name": thing.name, "unit": unit, "kind": thing.kind, "tags": " ".join(thing.tags)}
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow([values.get(column, "") for column in header])
    return line.getvalue()


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
