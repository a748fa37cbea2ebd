"""What all readers and writers share: text, CSV tables with line numbers, and files that appear whole or not at all."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from jaxpoint.errors import FileFormatError
from jaxpoint.finite import not_finite

StrPath = str | os.PathLike[str]
MAX_INTEGER = 10**15


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
    """The text of a file.

    Raises:
        FileFormatError: there is no such file, or it is not text.
    """
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise FileFormatError(f"There is no file {path}; check the path.") from None
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path} is not UTF-8 text (byte {error.start}); save it as plain text.") from None


def check_finite(table: dict[str, Any]) -> None:
    """Refuse nan and inf, which TOML can hold, anywhere in it.

    Raises:
        ValueError: the key and the number.
    """
    for key, number in not_finite(table):
        raise ValueError(f"{key} is {number}, which is no finite number")


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Sort key by which cam_2 comes before cam_10."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", text) if part]


@dataclass(frozen=True)
class Row:
    """One line of a table, whose values complain with file, line and column."""

    path: StrPath
    line: int
    values: dict[str, str]

    def error(self, message: str) -> FileFormatError:
        """The error that says where it is."""
        return FileFormatError(f"{self.path}, line {self.line}: {message}")

    def text(self, column: str) -> str:
        """A value that must not be empty."""
        value = self.values.get(column, "")
        if not value:
            raise self.error(f"column '{column}' is empty; give a value.")
        return value

    def number(self, column: str) -> float:
        """A finite number."""
        value = self.text(column)
        try:
            number = float(value)
        except ValueError:
            raise self.error(f"column '{column}' is '{value}', which is not a number.") from None
        if not math.isfinite(number):
            raise self.error(f"column '{column}' is {value}; give a finite number or drop the line.")
        return number

    def integer(self, column: str) -> int:
        """A whole number (also written as 3.0), small enough for a float64 to hold it exactly."""
        number = self.number(column)
        if number != int(number) or abs(number) > MAX_INTEGER:
            raise self.error(
                f"column '{column}' is {self.values[column]}, which is not a whole number of at most 15 digits."
            )
        return int(number)

    def camera(self, names: Sequence[str]) -> int:
        """The place of column `camera` among names."""
        name = self.text("camera")
        if name not in names:
            raise self.error(f"there is no camera '{name}'; the cameras are {', '.join(names)}.")
        return list(names).index(name)

    def missing(self, column: str) -> bool:
        """Whether the value is empty or NaN."""
        return self.values.get(column, "").lower() in {"", "nan", "na"}


def read_header(path: StrPath) -> list[str]:
    """The column names of a CSV file; none where it is empty.

    Raises:
        FileFormatError: no such file, or no CSV.
    """
    return parse_header(path, read_text(path))


def parse_header(path: StrPath, text: str) -> list[str]:
    """As `read_header`, of the text of a file."""
    return next((cells for _, cells in _cells(path, text)), [])


def read_table(path: StrPath, required: Sequence[str]) -> list[Row]:
    """The rows of a CSV file with a header; empty lines and lines that start with # are left out.

    Raises:
        FileFormatError: a column is missing, a line has more or fewer values than the header, or there are no rows.
    """
    return parse_table(path, read_text(path), required)


def parse_table(path: StrPath, text: str, required: Sequence[str]) -> list[Row]:
    """As `read_table`, of the text of a file."""
    header: list[str] | None = None
    rows = []
    for line, cells in _cells(path, text):
        if header is None:
            header = cells
            _check_header(path, header, required)
        elif len(cells) != len(header):
            raise FileFormatError(
                f"{path}, line {line}: {len(cells)} values under {len(header)} columns; "
                "the line is cut off or has a comma too many."
            )
        else:
            rows.append(Row(path, line, dict(zip(header, cells))))
    if header is None:
        raise FileFormatError(f"{path} is empty; its first line must be {','.join(required)}.")
    if not rows:
        raise FileFormatError(f"{path} has a header but no rows; it must hold at least one.")
    return rows


def _cells(path: StrPath, text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and stripped values of every line that says something."""
    reader = csv.reader(text.splitlines())
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if any(cells) and not cells[0].startswith("#"):
                yield reader.line_num, cells
    except csv.Error as error:
        raise FileFormatError(f"{path}, line {reader.line_num}: {error}; it is not a CSV file.") from None


def _check_header(path: StrPath, header: list[str], required: Sequence[str]) -> None:
    missing = [column for column in required if column not in header]
    if missing:
        raise FileFormatError(
            f"{path} has no column '{missing[0]}' (it has {', '.join(header)}); "
            f"its first line must be {','.join(required)}, separated by commas."
        )
    twice = [column for column in header if column and header.count(column) > 1]
    if twice:
        raise FileFormatError(f"{path} has the column '{twice[0]}' twice; keep one.")
