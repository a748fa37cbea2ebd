"""The numbers and times in the names of one camera's images that rise from file to file.

A name holds many numbers: the camera, a date, an exposure, a counter, a time stamp. Only what rises from file to file
can tell a frame, so constants are left out, whatever their place in the name.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from math import gcd
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int

from jaxpoint.errors import FileFormatError

MOST_DIGITS = 18  # that an int64 holds
STRAY = 0.1  # of a folder's files that may be named unlike the others before the names count as free
REGULAR = 0.9  # of the steps that are alike where a number does not rise in the order of the names
CLOCK_STEP = 5  # a number that rises by this much or more, and unevenly, is a clock and not a counter
FEW = 10  # steps that say nothing of a clock
JITTER = 0.2  # of a period, between the frames of a clock
EVEN = 4  # the common divisor of a counter's steps is more than a fourth of the median step
MICRO, NANO = 1_000_000, 1_000_000_000


@dataclass(frozen=True)
class NameColumn:
    """What one part of the names says of every file, in the order of the files."""

    kind: Literal["number", "time"]
    label: str  # the text before it, for people: "frame_"
    values: Int[np.ndarray, " F"]  # strictly rising
    second: int | None = None  # values to a second, where the names say so; None for a number

    @property
    def words(self) -> str:
        """How to call it in a sentence."""
        what = "number" if self.kind == "number" else "time"
        return f"the {what} after '{self.label}'" if self.label else f"the {what} at the start of the names"


@dataclass(frozen=True)
class FolderNames:
    """How the files of a folder follow one another."""

    order: Int[np.ndarray, " F"]  # of the files given
    columns: tuple[NameColumn, ...]  # numbers and times that rise in this order; none where nothing rises


@dataclass(frozen=True)
class _Part:
    """A part of every name before it is known whether it rises."""

    label: str
    start: int  # place in the first name
    values: list[int]
    second: int | None = None
    time: bool = False


def read_names(stems: Sequence[str], folder: Path) -> FolderNames:
    """What the names of a folder's images, in natural order, say of their frames.

    Raises:
        FileFormatError: a few files are named unlike all the others and hide their numbers.
    """
    order = np.arange(len(stems))
    if len(stems) < 2:
        return FolderNames(order, _single(stems))
    parts = _parts(stems)
    rising = [part for part in parts if _rises(part.values)]
    if not rising:
        _refuse_strays(stems, folder)
        by = next((part for part in parts if _regular(part.values)), None)
        if by is None:
            return FolderNames(order, ())
        order = np.argsort(by.values, kind="stable")
        parts = [replace(part, values=[part.values[place] for place in order]) for part in parts]
        rising = [part for part in parts if _rises(part.values)]
    return FolderNames(order, tuple(map(_column, rising)))


def _single(stems: Sequence[str]) -> tuple[NameColumn, ...]:
    """The last number of one name alone."""
    numbers = re.findall(r"\d+", stems[0]) if stems else []
    return (NameColumn("number", "", np.array([_number(numbers[-1])])),) if numbers else ()


def _column(part: _Part) -> NameColumn:
    values = np.array(part.values, dtype=np.int64)
    kind = "time" if part.time or _is_clock(values) else "number"
    return NameColumn(kind, part.label, values, part.second)


def _is_clock(values: Int[np.ndarray, " F"]) -> bool:
    """Whether a number rises by large and uneven steps, as milliseconds do."""
    steps = np.diff(values)
    median = int(np.median(steps))
    if len(steps) < FEW or median < CLOCK_STEP or EVEN * gcd(*map(int, steps)) > median:
        return False
    periods = steps / median  # whole numbers, but for jitter; of a counter with random gaps they are anything
    even = (np.abs(periods - np.round(periods)) < JITTER) & (np.round(periods) > 0)
    return bool(even.mean() >= REGULAR)


def _rises(values: Sequence[int]) -> bool:
    return all(low < high for low, high in pairwise(values))


def _regular(values: Sequence[int]) -> bool:
    """Whether numbers out of order are a counter nevertheless: all different and evenly spaced."""
    steps = np.diff(np.sort(np.array(values, dtype=np.int64)))
    return bool((steps > 0).all() and (steps == np.median(steps)).mean() >= REGULAR)


def _refuse_strays(stems: Sequence[str], folder: Path) -> None:
    """One file of another kind among many would take away the frame numbers of all."""
    shapes = [tuple(re.split(r"\d+", stem)) for stem in stems]
    (usual, count), *others = Counter(shapes).most_common()
    few = len(stems) - count
    kept = [stem for stem, shape in zip(stems, shapes) if shape == usual]
    if others and few <= STRAY * len(stems) and any(_rises(part.values) for part in _parts(kept)):
        stray = next(stem for stem, shape in zip(stems, shapes) if shape != usual)
        raise FileFormatError(
            f"'{folder / stray}' is named unlike {count} of the {len(stems)} images there, such as '{kept[0]}', so "
            "that their numbers cannot be read; move it elsewhere, or name it like them."
        )


def _parts(stems: Sequence[str]) -> list[_Part]:
    """Times first found as such, then each number that is not of a time, from left to right."""
    times, spans = [], []
    for reader in (_date_times, _days, _decimals):
        found = reader(stems)
        if found is not None and _rises_or_repeats(found[0].values):
            part, span = found
            times.append(part)
            spans.append(span)
            break
    numbers = [part for part in _numbers(stems) if not any(start <= part.start < end for start, end in spans)]
    return sorted((*times, *map(_epoch, numbers)), key=lambda part: part.start)


def _rises_or_repeats(values: Sequence[int]) -> bool:
    return values[0] < values[-1] and all(low <= high for low, high in pairwise(values))


def _numbers(stems: Sequence[str]) -> list[_Part]:
    """Numbers with the same texts before them, or else after them, in every name."""
    split = [re.split(r"(\d+)", stem) for stem in stems]
    shortest = min(map(len, split))
    from_left = [_number_at(split, place) for place in range(1, shortest, 2) if _same(split, range(0, place, 2))]
    if all(len(parts) == shortest for parts in split) and len(from_left) == shortest // 2:
        return from_left
    ends = [-place for place in range(2, shortest + 1, 2) if _same(split, range(1 - place, 0, 2))]
    return [*from_left, *(_number_at(split, place) for place in reversed(ends))]


def _same(split: Sequence[Sequence[str]], places: range) -> bool:
    return all(len({parts[place] for parts in split}) == 1 for place in places)


def _number_at(split: Sequence[Sequence[str]], place: int) -> _Part:
    first = split[0]
    return _Part(first[place - 1], len("".join(first[:place])), [_number(parts[place]) for parts in split])


def _number(digits: str) -> int:
    return int(digits[-MOST_DIGITS:]) if len(digits) > MOST_DIGITS + 1 else int(digits)


def _epoch(part: _Part) -> _Part:
    """A number as long as the seconds, ms, us or ns since 1970 have been from 2001 to 2286 is a time."""
    second = {10: 1, 13: 1_000, 16: MICRO, 19: NANO}.get(len(str(min(part.values))))
    return part if second is None else replace(part, second=second, time=True)


Found = tuple[_Part, tuple[int, int]] | None
_END = r"(?!\d)"
_DATE = (
    r"(?<!\d)((?:19|20)\d{2})([-_.]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])[-_T ]{0,2}"
    r"([01]\d|2[0-3])[-_:.hH]?([0-5]\d)[-_:.mM]?([0-5]\d)"
)
_DAY = r"(?<!\d)(\d{2})[-_:.hH](\d{2})[-_:.mM](\d{2})"
_JOINED = r"(\d{1,9})" + _END
_FRACTION = r"[-_.,sS](\d{1,9})" + _END


def _date_times(stems: Sequence[str]) -> Found:
    """20240501_101502_123 and the like, with or without the parts of a second."""

    def seconds(groups: Sequence[str]) -> int:
        year, month, day, hour, minute, second = map(int, groups)
        return int(datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp())

    joined = _with_fraction(stems, _DATE, seconds, _JOINED)
    return joined or _with_fraction(stems, _DATE, seconds) or _match_all(stems, _DATE + _END, seconds)


def _days(stems: Sequence[str]) -> Found:
    """10-15-02.123: a time of the day."""

    def seconds(groups: Sequence[str]) -> int:
        hour, minute, second = map(int, groups)
        if hour > 23 or minute > 59 or second > 59:
            raise ValueError("no time of the day")
        return 3600 * hour + 60 * minute + second

    return _with_fraction(stems, _DAY, seconds)


def _decimals(stems: Sequence[str]) -> Found:
    """1712345678.250, or 12.345: seconds with a decimal point, or as long as the time since 1970."""
    long = _with_fraction(stems, r"(?<!\d)(\d{10})", lambda groups: int(groups[0]), r"[-_.,](\d{1,9})" + _END)
    return long or _with_fraction(stems, r"(?<!\d)(\d{1,10})", lambda groups: int(groups[0]), r"\.(\d{1,9})" + _END)


def _with_fraction(
    stems: Sequence[str], pattern: str, seconds: Callable[[Sequence[str]], int], fraction: str = _FRACTION
) -> Found:
    """Seconds and their parts; None where the last number goes on over the seconds, as a counter does."""
    whole = _match_all(stems, pattern + fraction, lambda groups: seconds(groups[:-1]))
    parts = _match_all(stems, pattern + fraction, lambda groups: int(groups[-1]))
    digits = _match_all(stems, pattern + fraction, lambda groups: len(groups[-1]))
    if whole is None or parts is None or digits is None or len(set(digits[0].values)) != 1:
        return None
    if fraction != _JOINED and _rises(parts[0].values):
        return None
    scale = 10 ** digits[0].values[0]
    values = [scale * second + part for second, part in zip(whole[0].values, parts[0].values)]
    return replace(whole[0], values=values, second=scale), whole[1]


def _match_all(stems: Sequence[str], pattern: str, read: Callable[[Sequence[str]], int]) -> Found:
    """What a pattern says in every name, None where one of them does not have it."""
    found = [re.search(pattern, stem) for stem in stems]
    first = found[0]
    if first is None:
        return None
    try:
        values = [read(list(filter(str.isdigit, match.groups()))) for match in found if match is not None]
    except ValueError:  # a month 13 and the like: other numbers that look so
        return None
    if len(values) < len(stems):
        return None
    label = re.split(r"\d", stems[0][: first.start()])[-1]
    return _Part(label, first.start(), values, second=1, time=True), first.span()
