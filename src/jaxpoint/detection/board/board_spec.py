"""A board from the text that `--board` takes, or from a TOML file."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from jaxpoint.detection.board.abstract_board import AbstractBoard
from jaxpoint.detection.board.aprilgrid import AprilGrid
from jaxpoint.detection.board.charuco import Charuco
from jaxpoint.detection.board.chessboard import Chessboard
from jaxpoint.detection.board.markers import dictionary_of
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import read_text
from jaxpoint.targets import SIZE_SIGMA

FORMS = "chessboard:9x6:25mm, charuco:7x5:40mm:30mm:DICT_4X4_50, aprilgrid:6x6:55mm:0.3, or a TOML file"
UNITS_IN_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
LARGEST_M = 20.0
Side = Annotated[int, Meta(ge=1, le=500)]
Part = Annotated[float, Meta(gt=0, le=10)]


@dataclass(frozen=True, kw_only=True)
class BoardTable:
    """The table `[board]` of a TOML file; lengths are text with a unit."""

    kind: str
    columns: Side
    rows: Side
    square: str | None = None
    marker: str | None = None
    dictionary: str | None = None
    inverted: bool = False
    tag: str | None = None
    spacing: Part | None = None
    size_sigma: Annotated[float, Meta(ge=0)] = SIZE_SIGMA


@dataclass(frozen=True, kw_only=True)
class BoardFile:
    """A TOML file of one board."""

    board: BoardTable


def read_board(text: str) -> AbstractBoard:
    """The board that a text or the TOML file of this name describes.

    Raises:
        UsageError: the text or a figure in it cannot be used.
        FileFormatError: the file is missing or is not TOML.
    """
    if text.endswith(".toml"):
        return _of_table(_table_of_file(Path(text)))
    kind, _, rest = text.partition(":")
    if kind not in _FIELDS:
        raise UsageError(f"There is no board '{text}'; write {FORMS}.")
    parts = rest.split(":")
    shape = re.fullmatch(r"(\d+)x(\d+)", parts[0])
    if shape is None or not len(_NEEDED[kind]) <= len(parts) - 1 <= len(_FIELDS[kind]):
        raise UsageError(f"The board '{text}' has {len(parts)} parts that do not fit its kind; write it as {FORMS}.")
    values: dict[str, object] = dict(zip(_FIELDS[kind], parts[1:]))
    if "inverted" in values:
        if values["inverted"] != "inverted":
            raise UsageError(f"The last part of the board '{text}' may only be 'inverted', not '{values['inverted']}'.")
        values["inverted"] = True
    if "spacing" in values:
        values["spacing"] = _number(str(values["spacing"]), "spacing")
    table = {"kind": kind, "columns": int(shape[1]), "rows": int(shape[2]), **values}
    return _of_table(_converted(table, BoardTable, f"The board '{text}'"))


def _converted(values: object, kind: type, what: str):
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise UsageError(f"{what} cannot be used: {error}; write it as {FORMS}.") from None


def _table_of_file(path: Path) -> BoardTable:
    try:
        values = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"'{path}' is not TOML ({error}); see the guide to boards.") from None
    known = {field.name for field in fields(BoardTable)}
    unknown = sorted(set(values.get("board", {})) - known) if isinstance(values.get("board"), dict) else []
    if unknown:
        raise UsageError(
            f"The board of '{path}' has an unknown key '{unknown[0]}'; known are {', '.join(sorted(known))}."
        )
    return _converted(values, BoardFile, f"The board of '{path}'").board


_FIELDS = {
    "chessboard": ("square",),
    "charuco": ("square", "marker", "dictionary", "inverted"),
    "aprilgrid": ("tag", "spacing"),
}
_NEEDED = {"chessboard": ("square",), "charuco": ("square", "marker"), "aprilgrid": ("tag", "spacing")}


def _of_table(table: BoardTable) -> AbstractBoard:
    if table.kind not in _MADE:
        raise UsageError(f"There is no kind of board '{table.kind}'; choose one of {', '.join(_MADE)}.")
    for name in _NEEDED[table.kind]:
        if getattr(table, name) is None:
            raise UsageError(f"The board of kind '{table.kind}' lacks its '{name}'; write it as {FORMS}.")
    return _MADE[table.kind](table)


def _chessboard(table: BoardTable) -> AbstractBoard:
    _check_side(table, 3, "inner corners")
    return Chessboard(table.columns, table.rows, _length(table.square, "square"), table.size_sigma)


def _charuco(table: BoardTable) -> AbstractBoard:
    _check_side(table, 3, "squares")
    square, marker = _length(table.square, "square"), _length(table.marker, "marker")
    if not marker < square:
        raise UsageError(
            f"The markers of a ChArUco board must be smaller than its squares, but {1e3 * marker:g} mm is not below "
            f"{1e3 * square:g} mm; the square comes first."
        )
    dictionary = table.dictionary or Charuco.dictionary
    _check_markers(dictionary, table.columns * table.rows // 2)
    return Charuco(table.columns, table.rows, square, marker, dictionary, table.inverted, table.size_sigma)


def _aprilgrid(table: BoardTable) -> AbstractBoard:
    _check_side(table, 1, "tags")
    _check_markers("DICT_APRILTAG_36h11", table.columns * table.rows)
    return AprilGrid(table.columns, table.rows, _length(table.tag, "tag"), table.spacing or 0.0, table.size_sigma)


_MADE: dict[str, Callable[[BoardTable], AbstractBoard]] = {
    "chessboard": _chessboard,
    "charuco": _charuco,
    "aprilgrid": _aprilgrid,
}


def _check_side(table: BoardTable, least: int, what: str) -> None:
    if min(table.columns, table.rows) < least:
        raise UsageError(
            f"A board of {table.columns} x {table.rows} {what} is too small: each side needs {least} or more."
        )


def _check_markers(dictionary: str, needed: int) -> None:
    """Enough of them for the board."""
    there = len(dictionary_of(dictionary).bytesList)
    if needed > there:
        raise UsageError(f"The board needs {needed} markers, but {dictionary} has {there}; take a larger dictionary.")


def _length(text: str | None, what: str) -> float:
    """A length with its unit, m."""
    found = re.fullmatch(r"\s*(.*?)\s*(mm|cm|m)\s*", text or "")
    if found is None:
        raise UsageError(f"The length '{text}' of the board's {what} has no unit; write 25mm, 2.5cm or 0.025m.")
    metres = _number(found[1], what) * UNITS_IN_METRES[found[2]]
    if not 0 < metres <= LARGEST_M:
        raise UsageError(f"The {what} of the board is {text}; it must be above 0 and at most {LARGEST_M:g} m.")
    return metres


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise UsageError(f"The {what} of the board is '{text}', which is no number; write it as {FORMS}.")
    return value
