"""What all readers and writers share: text, CSV tables with line numbers, and files that appear whole or not at all."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from jaxpoint.errors import FileFormatError
from jaxpoint.finite import not_finite
from jaxpoint.io.dialect import DECIMAL_COMMA, NUMBER, Cells, StrPath, decode, parse_cells

MAX_INTEGER = 10**15
PIXEL_ALIASES = {
    "camera": ("cam", "cam_id", "camera_id", "camera_name", "cam_name"),
    "x": ("u", "x_px", "u_px"),
    "y": ("v", "y_px", "v_px"),
}  # of columns that say where something is in which image
UNITS = {"mm": 1000.0, "cm": 100.0}  # in a metre
Aliases = Mapping[str, Sequence[str]]  # other names of a column, by ours


@contextmanager
def replacing(path: StrPath) -> Iterator[BinaryIO]:
    """A binary file beside `path` that takes its name when the block ends well, and vanishes when it does not.

    A link stays, and what it leads to is replaced.

    Raises:
        OSError: the folder is missing or not writable.
    """
    path = Path(os.path.realpath(path))
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with beside.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def read_text(path: StrPath) -> str:
    """The text of a file, UTF-8 or UTF-16.

    Raises:
        FileFormatError: there is no such file, or it is not text.
    """
    try:
        data = Path(path).read_bytes()
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise FileFormatError(f"There is no file {path}; check the path.") from None
    except PermissionError:
        raise FileFormatError(f"{path} may not be read; change its permissions.") from None
    return decode(path, data)


def check_finite(table: dict[str, Any]) -> None:
    """Refuse nan and inf, which TOML can hold, anywhere in it.

    Raises:
        ValueError: the key and the number.
    """
    for key, number in not_finite(table):
        raise ValueError(f"{key} is {number}, which is no finite number")


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Sort key by which cam_2 comes before cam_10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", text) if part]


_MISSING = {"", "nan", "na", "n/a", "<na>", "none", "null"}  # as spreadsheets, R, pandas and databases write it
_NOT_FINITE = {"nan", "inf", "infinity"}


@dataclass(frozen=True)
class Row:
    """One line of a table, whose values complain with file, line and column."""

    path: StrPath
    line: int
    values: dict[str, str]  # by the column's name in small letters
    decimal_comma: frozenset[str] = frozenset()  # columns whose numbers are written as 3,5
    divisors: Mapping[str, float] = field(
        default_factory=dict
    )  # of columns that are given in another unit than their name

    def error(self, message: str) -> FileFormatError:
        """The error that says where it is."""
        return FileFormatError(f"{self.path}, line {self.line}: {message}")

    def text(self, column: str) -> str:
        """A value that must not be empty."""
        value = self.values.get(column.casefold(), "")
        if not value:
            raise self.error(f"column '{column}' is empty; give a value.")
        return value

    def number(self, column: str) -> float:
        """A finite number, with a decimal comma where the column has those."""
        value = self.text(column)
        plain = value
        comma = column.casefold() in self.decimal_comma
        if comma and DECIMAL_COMMA.fullmatch(value):
            plain = value.replace(",", ".")
        elif comma and "." in value:
            raise self.error(f"column '{column}' is {value}, other lines have decimal commas; write all alike.")
        if plain.lower().lstrip("+-") in _NOT_FINITE:
            raise self.error(f"column '{column}' is {value}; give a finite number or drop the line.")
        if not NUMBER.fullmatch(plain):
            raise self.error(f"column '{column}' is '{value}', which is not a number; write it as 1234.5.")
        number = float(plain) / self.divisors.get(column.casefold(), 1.0)
        if not math.isfinite(number):
            raise self.error(f"column '{column}' is {value}; give a finite number or drop the line.")
        return number

    def integer(self, column: str) -> int:
        """A whole number (also written as 3.0), small enough for a float64 to hold it exactly."""
        number = self.number(column)
        if abs(number) > MAX_INTEGER:
            raise self.error(_too_long(column, self.text(column), abs(number)))
        if number != int(number):
            raise self.error(f"column '{column}' is {self.text(column)}, which is not a whole number; round it.")
        return int(number)

    def camera(self, names: Sequence[str]) -> int:
        """The place of column `camera` among names."""
        name = self.text("camera")
        if name not in names:
            raise self.error(f"there is no camera '{name}'; the cameras are {', '.join(names)}.")
        return list(names).index(name)

    def missing(self, column: str) -> bool:
        """Whether the value is empty or NaN."""
        return self.values.get(column.casefold(), "").lower() in _MISSING


def _too_long(column: str, value: str, number: float) -> str:
    """What to say of a whole number with too many digits, nearly always a clock's count."""
    unit = "us" if number < 1e17 else "ns"
    return (
        f"column '{column}' is {value}, more than 15 digits, as a clock's count has; count 0, 1, 2, ... in it (the "
        f"same number for what belongs together), and put times into a column of their own (time_{unit})."
    )


def read_header(path: StrPath, aliases: Aliases | None = None) -> list[str]:
    """The column names of a CSV file, in small letters; none where it is empty.

    Raises:
        FileFormatError: no such file, or no CSV.
    """
    return parse_header(path, read_text(path), aliases)


def parse_header(path: StrPath, text: str, aliases: Aliases | None = None) -> list[str]:
    """As `read_header`, of the text of a file."""
    cells = parse_cells(path, text)
    return [] if cells is None else _names(cells.header, aliases or {})


def read_table(path: StrPath, required: Sequence[str], aliases: Aliases | None = None) -> list[Row]:
    """The rows of a CSV file with a header; empty lines and lines that start with # are left out.

    Columns are separated by commas, semicolons, tabs or bars; their names may be written in capitals. Where we name a
    column by metres (x_m), x_cm, x_mm and x [mm] are read too.

    Args:
        path: the file.
        required: columns that it must have.
        aliases: other names of columns, which count where ours is not there.

    Raises:
        FileFormatError: a column is missing, a line has more or fewer values than the header, or there are no rows.
    """
    return parse_table(path, read_text(path), required, aliases)


def parse_table(path: StrPath, text: str, required: Sequence[str], aliases: Aliases | None = None) -> list[Row]:
    """As `read_table`, of the text of a file."""
    cells = parse_cells(path, text)
    if cells is None:
        raise FileFormatError(f"{path} is empty; its first line must be {','.join(required)}.")
    names = _names(cells.header, aliases or {})
    names, divisors = _in_metres(names, {name.casefold() for name in required})
    _check_header(path, cells, names, required)
    if not cells.lines:
        raise FileFormatError(f"{path} has a header but no rows; it must hold at least one.")
    comma = frozenset(name for name, written in zip(names, cells.header) if written in cells.decimal_comma)
    return [Row(path, line, dict(zip(names, values)), comma, divisors) for line, values in cells.lines]


def _names(header: Sequence[str], aliases: Aliases) -> list[str]:
    """Our names of the columns, in small letters; a unit as x_mm, whether written so or as x [mm], x (mm), x mm."""
    names = [re.sub(r"[\s_]*[\[(\s](mm|cm|m|px|s|ms|us|ns)[\])]?$", r"_\1", cell.casefold()) for cell in header]
    for name, others in aliases.items():
        alias = next((other for other in others if other in names), None)
        if name not in names and alias is not None:
            names[names.index(alias)] = name
    return names


def _in_metres(names: Sequence[str], required: set[str]) -> tuple[list[str], dict[str, float]]:
    """Columns that are named by millimetres or centimetres under our name, and by what their numbers are divided."""
    ours, divisors = list(names), {}
    for i, name in enumerate(names):
        base, _, unit = name.rpartition("_")
        if unit in UNITS and name not in required and f"{base}_m" not in ours:
            ours[i] = f"{base}_m"
            divisors[ours[i]] = UNITS[unit]
    return ours, divisors


def _check_header(path: StrPath, cells: Cells, names: Sequence[str], required: Sequence[str]) -> None:
    missing = [column for column in required if column.casefold() not in names]
    wanted = f"its first line must be {','.join(required)}"
    if missing and any(NUMBER.fullmatch(cell) or DECIMAL_COMMA.fullmatch(cell) for cell in cells.header):
        raise FileFormatError(f"{path} starts with values ({', '.join(cells.header)}), not names; {wanted}.")
    bare = [column for column in missing if column.endswith("_m") and column.removesuffix("_m") in names]
    if bare:
        base = bare[0].removesuffix("_m")
        raise FileFormatError(
            f"{path} has no column '{bare[0]}' (it has {', '.join(cells.header)}); say the unit of '{base}': name it "
            f"{base}_m, {base}_cm or {base}_mm, and the others alike."
        )
    if missing:
        raise FileFormatError(
            f"{path} has no column '{missing[0]}' (it has {', '.join(cells.header)}); {wanted}, separated by commas."
        )
    twice = [column for column in names if names.count(column) > 1]
    if twice:
        raise FileFormatError(f"{path} has the column '{twice[0]}' twice; keep one.")
