"""Pointings as a table: one line of one gesture in each row.

`person,gesture,line,origin_x_m,origin_y_m,origin_z_m,direction_x,direction_y,direction_z`, and where it is known what
was meant `target_x_m,target_y_m,target_z_m`. Every gesture has the same kinds of line, in the order of its first rows;
directions may have any length.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxpoint.io.files import Row, StrPath, read_table
from jaxpoint.io.table import write_table
from jaxpoint.pointing.bias.pointings import Pointings

_ORIGIN, _DIRECTION, _TARGET = (
    tuple(name.format(axis) for axis in "xyz") for name in ("origin_{}_m", "direction_{}", "target_{}_m")
)
_KEYS = ("person", "gesture", "line")
_FURTHEST_M = 100.0
_NEAREST_M = 0.01


def read_pointings(path: StrPath) -> Pointings:
    """Pointings from a table; without the columns of targets these are not known.

    Raises:
        FileFormatError: a column or value is missing, a direction has no length, a line is given twice or not of every
            gesture, the target of one gesture changes or lies at the origin, or lengths cannot be metres.
    """
    rows = read_table(path, (*_KEYS, *_ORIGIN, *_DIRECTION))
    meant = any(column in rows[0].values for column in _TARGET)
    lines = tuple(dict.fromkeys(row.text("line") for row in rows))
    gestures: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        own = gestures.setdefault((row.text("person"), row.text("gesture")), {})
        if row.text("line") in own:
            raise row.error(f"the line '{row.text('line')}' of this gesture is given twice; keep one.")
        own[row.text("line")] = row
    for own in gestures.values():
        missing = [line for line in lines if line not in own]
        if missing:
            row = next(iter(own.values()))
            raise row.error(f"this gesture has no line '{missing[0]}', which others have; add it or drop the gesture.")
    ordered = [[own[line] for line in lines] for own in gestures.values()]
    return Pointings(
        tuple(gesture for _, gesture in gestures),
        tuple(person for person, _ in gestures),
        lines,
        np.array([[_place(row, _ORIGIN) for row in own] for own in ordered]),
        np.array([[_direction(row) for row in own] for own in ordered]),
        np.array([_target(own) for own in ordered]) if meant else None,
    )


def write_pointings(path: Path, pointings: Pointings) -> None:
    """Write a table that `read_pointings` reads.

    Raises:
        UsageError: another ending than .csv or .parquet.
    """
    kinds = len(pointings.lines)
    columns: dict[str, list] = {
        "person": [person for person in pointings.people for _ in range(kinds)],
        "gesture": [gesture for gesture in pointings.gestures for _ in range(kinds)],
        "line": list(pointings.lines) * len(pointings),
    }
    columns |= dict(zip(_ORIGIN, pointings.origins.reshape(-1, 3).T.tolist()))
    columns |= dict(zip(_DIRECTION, pointings.directions.reshape(-1, 3).T.tolist()))
    if pointings.targets is not None:
        columns |= dict(zip(_TARGET, np.repeat(pointings.targets, kinds, axis=0).T.tolist()))
    write_table(path, columns)


def _place(row: Row, columns: tuple[str, ...]) -> Float[np.ndarray, "3"]:
    place = np.array([row.number(column) for column in columns])
    if np.abs(place).max() > _FURTHEST_M:
        raise row.error(f"a coordinate is {np.abs(place).max():g} m; no room is that large, so give metres.")
    return place


def _direction(row: Row) -> Float[np.ndarray, "3"]:
    direction = np.array([row.number(column) for column in _DIRECTION])
    length = np.linalg.norm(direction)
    if length == 0:
        raise row.error("the direction has no length; give one, or drop the gesture.")
    return direction / length


def _target(own: list[Row]) -> Float[np.ndarray, "3"]:
    target = _place(own[0], _TARGET)
    for row in own[1:]:
        if (_place(row, _TARGET) != target).any():
            raise row.error("the target differs from that of the gesture's first line; one gesture means one target.")
    apart = np.linalg.norm(target - _place(own[0], _ORIGIN))
    if apart < _NEAREST_M:
        raise own[0].error(f"the target lies {1000 * apart:.0f} mm from the line's origin; a target must be apart.")
    return target
