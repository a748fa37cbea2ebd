"""Adding an object to a database (`io.object_files`), in the file's own unit, so that the file loses nothing."""

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
from jaxpoint.io.object_files import (
    PLAIN,
    UNITS,
    Database,
    check_names,
    check_shape,
    check_span,
    file_columns,
    is_toml,
    known_tables,
    length_suffix,
    name_fault,
    parse_objects,
)
from jaxpoint.pointing.objects import Thing

_WRITTEN = 1e-5  # m or rad, to which `append_object` writes


def append_object(path: StrPath, thing: Thing) -> tuple[str, ...]:
    """Add one object at the end of a database, in the file's own unit; the file changes whole or not at all.

    Returns:
        The warnings that the database did not have without it.

    Raises:
        FileFormatError: the file cannot be read, or the object does not fit it.
        UsageError: a name that cannot be one, or a CSV file without columns for the object's shape, kind or tags.
    """
    path = Path(path)
    _check_new_name(thing.name)
    check_shape(thing.shape, f"'{thing.name}'")
    old = read_text(path)
    known = parse_objects(path, old)
    if "world" in (tomllib.loads(old) if is_toml(path) else parse_header(path, old)):
        raise UsageError(
            f"'{path}' names the world of its axes, and objects are added in those of the room; write '{thing.name}' "
            "into the file by hand."
        )
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
        f"write every object as a {known_tables()} of its own"
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
    return alike and np.allclose(one.shape.numbers, other.shape.numbers, rtol=0, atol=_WRITTEN)


def _csv_line(path: Path, text: str, thing: Thing) -> str:
    header = parse_header(path, text)
    suffix = length_suffix(header)
    unit = suffix[1:] or parse_table(path, text, ("name",))[-1].text("unit")
    values: dict[str, Any] = {"name": thing.name, "unit": unit, "shape": thing.shape.name}
    values |= {"kind": thing.kind, "tags": " ".join(thing.tags)}
    wanted = [column for column in ("kind", "tags") if values[column]]
    wanted += ["shape"] if thing.shape.name != PLAIN else []
    for field, value in zip(thing.shape.fields, thing.shape.values):
        columns = file_columns(field, suffix)
        written = np.ravel(field.to_file(value, UNITS[unit]))
        values |= {column: f"{number:.5f}" for column, number in zip(columns, written)}
        wanted += columns if field.default is None or written[0] != field.default else ()
    _check_columns(path, header, wanted, thing)
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow([values.get(column, "") for column in header])
    return line.getvalue()


def _check_columns(path: Path, header: list[str], wanted: list[str], thing: Thing) -> None:
    """Refuse to drop what the table has no column for."""
    missing = [column for column in wanted if column not in header]
    if not missing:
        return
    if missing[0] in ("kind", "tags"):
        remedy = f"or leave {missing[0]} out"
    else:
        remedy = f"or keep the {thing.shape.name} in a .toml"
    raise UsageError(f"'{path}' has no column '{missing[0]}'; add it to every line first, {remedy}.")


def _toml_entry(thing: Thing, unit: str) -> str:
    entry: dict[str, Any] = {"name": thing.name}
    entry |= {key: value for key, value in (("kind", thing.kind), ("tags", list(thing.tags))) if value}
    for field, value in zip(thing.shape.fields, thing.shape.values):
        written = field.to_file(value, UNITS[unit])
        entry |= {} if field.default is not None and written == field.default else {field.name: written}
    return "\n" + tomli_w.dumps({thing.shape.name: [entry]})
