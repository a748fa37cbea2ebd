"""Which text and which kind of CSV a file holds: encoding, separator, decimal commas, columns that say nothing."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from jaxpoint.errors import FileFormatError

StrPath = str | os.PathLike[str]
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


@dataclass(frozen=True)
class Cells:
    """What stands in a table: the header, and the cells of every line that holds any, with its number."""

    header: list[str]
    lines: list[tuple[int, list[str]]]
    separator: str
    decimal_comma: frozenset[str]  # columns whose numbers are written as 3,5


def decode(path: StrPath, data: bytes) -> str:
    """Text from UTF-8, or from UTF-16 with its byte order mark.

    Raises:
        FileFormatError: it is neither.
    """
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        known = "UTF-8" if encoding.startswith("utf-8") else "UTF-16"
        line = data[: error.start].count(b"\n") + 1
        raise FileFormatError(
            f"{path} is not {known} text (byte 0x{data[error.start]:02x} in line {line}); save it as UTF-8, in Excel "
            f"as 'CSV UTF-8', or convert it: iconv -f latin1 -t utf-8 '{Path(path).name}'."
        ) from None
    if "\0" in text:
        raise FileFormatError(
            f"{path} is not UTF-8 text (it holds zero bytes, as binary files do and UTF-16 without its mark); save it "
            "as UTF-8 text."
        )
    return text


def parse_cells(path: StrPath, text: str) -> Cells | None:
    """The cells of a table; None where it says nothing.

    The separator is the one that the header has most of. Numbers may have decimal commas where it is not the comma.
    Empty columns at the end, and a column without name that only counts lines (as pandas writes), are left out.

    Raises:
        FileFormatError: no CSV, a line with more or fewer values than the header, or values under no name.
    """
    separator = _separator(text)
    lines = list(_lines(path, text, separator))
    if not lines:
        return None
    header, body = _without_empty_columns(path, lines[0][1], lines[1:], separator)
    comma = frozenset(
        name
        for column, name in enumerate(header)
        if separator != "," and any(DECIMAL_COMMA.fullmatch(cells[column]) for _, cells in body)
    )
    return Cells(header, body, separator, comma)


def _separator(text: str) -> str:
    header = next((line for line in text.splitlines() if line.strip(" ,;\t|") and not line.startswith("#")), "")
    bare = re.sub(r'"[^"]*"', "", header)
    return max(SEPARATORS, key=bare.count)


def _lines(path: StrPath, text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and stripped values of every line that says something."""
    reader = csv.reader(io.StringIO(text, newline=None), delimiter=separator, skipinitialspace=True)
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if any(cells) and not cells[0].startswith("#"):
                yield reader.line_num, cells
    except csv.Error:
        raise FileFormatError(
            f"{path}, line {reader.line_num}: a quotation mark is not closed, or this is no CSV file; close it."
        ) from None


def _without_empty_columns(
    path: StrPath, header: list[str], body: list[tuple[int, list[str]]], separator: str
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Header and lines of equal width, of the columns that have a name."""
    while header and not header[-1]:
        header = header[:-1]
    lines = [(number, _as_wide(path, number, cells, len(header), separator)) for number, cells in body]
    named = [column for column, name in enumerate(header) if name]
    if not header[0] and _counts([cells[0] for _, cells in lines]):
        lines = [(number, ["", *cells[1:]]) for number, cells in lines]
    for number, cells in lines:
        for column, name in enumerate(header):
            if not name and cells[column]:
                raise FileFormatError(
                    f"{path}, line {number}: column {column + 1} holds '{cells[column]}' but has no name; name it in "
                    "the header, or leave it out."
                )
    return [header[i] for i in named], [(number, [cells[i] for i in named]) for number, cells in lines]


def _as_wide(path: StrPath, number: int, cells: list[str], width: int, separator: str) -> list[str]:
    while len(cells) > width and not cells[-1]:
        cells = cells[:-1]
    if len(cells) == width:
        return cells
    reason = "the line is cut off" if len(cells) < width else f"it has {SEPARATORS[separator]} too many"
    if len(cells) > width and separator == ",":
        reason += "; numbers with decimal commas need decimal points, or semicolons between the columns"
    raise FileFormatError(f"{path}, line {number}: {len(cells)} values under {width} columns; {reason}.")


def _counts(cells: Sequence[str]) -> bool:
    """Whether the values are whole numbers that rise by one."""
    if not all(re.fullmatch(r"[0-9]{1,15}", cell) for cell in cells):
        return False
    return all(int(second) == int(first) + 1 for first, second in pairwise(cells))
