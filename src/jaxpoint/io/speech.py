"""When gestures are and what was said, in files: CSV with the columns start_s and end_s, and word."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from jaxpoint.io.files import Row, read_table
from jaxpoint.pointing.spoken import Interval, Word


def read_times(path: Path) -> list[Interval]:
    """Gestures from a CSV file with the columns start_s and end_s.

    Raises:
        FileFormatError: it is not such a file, or an interval ends before it starts.
    """
    return [Interval(start, end) for start, end, _ in _intervals(path)]


def read_words(path: Path) -> list[Word]:
    """Words from a CSV file with the columns word, start_s and end_s.

    Raises:
        FileFormatError: it is not such a file, or a word ends before it starts.
    """
    return [Word(row.text("word"), start, end) for start, end, row in _intervals(path, "word")]


def _intervals(path: Path, *more: str) -> Iterator[tuple[float, float, Row]]:
    for row in read_table(path, (*more, "start_s", "end_s")):
        start, end = row.number("start_s"), row.number("end_s")
        if end < start:
            raise row.error(f"it ends at {end:g} s, before its start at {start:g} s; exchange them.")
        yield start, end, row
