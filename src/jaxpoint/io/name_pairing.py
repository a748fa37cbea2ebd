"""Image folders paired by what their names say: a number that rises in all of them, or a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.clock import CommonClock, common_clock, period_of
from jaxpoint.io.frame_names import NameColumn
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.pairing import NUMBER, PairBy, Pairing

MOST = 0.5  # of a camera's frames must have a partner before a number or time is taken for that of the recording
CLEARER = 0.1  # of the frames: by so many more partners a time wins over a number
UNLIKE = 0.02  # of the pairs may differ between two ways of pairing that agree
SHIFT = 0.25  # relative difference of two shifts that count as one
RENAME = f"{NUMBER}, or, if all started at once and lost none, say --pair-by place"
SHIFTED = "say --pair-by number if one number is one moment, --pair-by place if all started at once and lost none"
FEW_FRAMES = 3  # lost at an end


@dataclass(frozen=True)
class _Way:
    """One way of pairing the images, and how well it does."""

    columns: tuple[NameColumn, ...]  # one a camera
    pairing: Pairing
    share: float  # of the frames of the camera with fewest partners, 0..1
    unlike: str = ""  # why the numbers of two cameras do not mean the same, the start of a sentence

    @property
    def kind(self) -> str:
        return _kind(self.columns)


def pair_by_names(sources: Sequence[FrameSource], names: Sequence[str], by: PairBy, remedy: str | None) -> Pairing:
    """The rows that the names give.

    Raises:
        InsufficientDataError: no number or time is common to all, or two of them pair the images otherwise.
        UsageError: the names do not hold what `by` asks for.
    """
    ways = [_way(columns, names) for columns in _columns(sources)]
    asked = [way for way in ways if by in ("auto", way.kind)]
    if not asked and by == "auto":
        raise InsufficientDataError(
            f"The names of the images of cameras {', '.join(names)} hold no number or time that rises in all of them; "
            f"{remedy or RENAME}."
        )
    if not asked:
        raise UsageError(
            f"The names of the images hold no {by} that rises from file to file in all cameras; leave out --pair-by, "
            "or name the images by it."
        )
    if by == "auto":
        best = _best(asked, names, remedy)
    else:
        best = max(asked, key=lambda way: way.share)
        if not best.share:
            raise InsufficientDataError(_disjoint(best, names, remedy))
    return _with_times(best, ways)


def _columns(sources: Sequence[FrameSource]) -> list[tuple[NameColumn, ...]]:
    """What all cameras have, of one label where they agree on labels, else one after the other.

    Numbers without a unit go together, be they counters or clocks, and so do times.
    """
    found: list[tuple[NameColumn, ...]] = []
    for timed in (False, True):
        own = [[column for column in source.columns if (column.second is not None) == timed] for source in sources]
        labels = [{column.label: column for column in columns} for columns in own]
        common = [column.label for column in own[0] if all(column.label in known for known in labels)]
        if common and all(len(known) == len(columns) for known, columns in zip(labels, own)):
            found += [tuple(known[label] for known in labels) for label in common]
        else:
            found += list(zip(*own))
    return found


def _kind(columns: Sequence[NameColumn]) -> str:
    return "time" if any(column.kind == "time" for column in columns) else "number"


def _way(columns: tuple[NameColumn, ...], names: Sequence[str]) -> _Way:
    if _kind(columns) == "time" and all(len(column.values) > 1 for column in columns):
        return _by_time(columns)
    return _by_number(columns, names)


def _by_number(columns: tuple[NameColumn, ...], names: Sequence[str]) -> _Way:
    ids = np.unique(np.concatenate([column.values for column in columns]))
    index = np.full((len(ids), len(columns)), -1)
    for camera, column in enumerate(columns):
        index[np.searchsorted(ids, column.values), camera] = np.arange(len(column.values))
    pairing = Pairing(ids, index, None, columns[0].words)
    return _Way(columns, pairing, _share(index), _shifted(columns, names))


def _by_time(columns: tuple[NameColumn, ...]) -> _Way:
    seconds = [_seconds(column) for column in columns]
    words = "the time in their names"
    first, last = max(own[0] for own in seconds), min(own[-1] for own in seconds)
    if first > last:
        nothing = np.zeros((0, len(columns)), dtype=int)
        return _Way(columns, Pairing(nothing[:, 0], nothing, None, words), 0.0)
    clock = common_clock(seconds)
    times = None if columns[0].second is None else clock.ticks * clock.period
    pairing = Pairing(clock.ticks, clock.index, times, words, _notes(clock), clock.places, clock.other_rate)
    return _Way(columns, pairing, _share(clock.index))


def _notes(clock: CommonClock) -> tuple[str, ...]:
    count = int(clock.other_rate.sum())
    if not count:
        return ()
    return (f"The times of {count} camera{'s' * (count > 1)} drift through those of the others: unlike frame rates.",)


def _seconds(column: NameColumn) -> Float[np.ndarray, " F"]:
    """Times of a column in s, in its own unit where the names do not say which."""
    return column.values / (column.second or 1)


def _share(index: Int[np.ndarray, "F C"]) -> float:
    """Of the frames of each camera, or of the fullest, those that both have; the least of them."""
    has = index >= 0
    counts = has.sum(axis=0)
    fullest = int(counts.argmax())
    both = (has & has[:, [fullest]]).sum(axis=0)
    return float((both / np.minimum(counts, counts[fullest])).min())


def _shifted(columns: Sequence[NameColumn], names: Sequence[str]) -> str:
    """Whether the numbers of a camera start and end elsewhere by as much, as where each camera counts for itself."""
    fullest = int(np.argmax([len(column.values) for column in columns]))
    most = columns[fullest].values
    for name, column in zip(names, columns):
        start, end = int(column.values[0] - most[0]), int(column.values[-1] - most[-1])
        low, high = sorted((abs(start), abs(end)))
        few = max(FEW_FRAMES, (most[-1] - most[0]) / 100)
        alike = start == end or (low > few and start * end > 0 and high - low <= SHIFT * high)
        if start and alike and len(column.values) > 1:
            return (
                f"The numbers of cameras '{names[fullest]}' and '{name}' go from {most[0]} to {most[-1]} and from "
                f"{column.values[0]} to {column.values[-1]}, as if each counted for itself"
            )
    return ""


def _best(ways: Sequence[_Way], names: Sequence[str], remedy: str | None) -> _Way:
    """The one way that the names speak for.

    Raises:
        InsufficientDataError: none, or several that differ.
    """
    usable = [way for way in ways if way.share and not way.unlike]
    good = [way for way in usable if way.share >= MOST] or usable
    if not good:
        told = next((way.unlike for way in ways if way.unlike and way.share), "")
        raise InsufficientDataError(f"{told}; {remedy or SHIFTED}." if told else _disjoint(ways[0], names, remedy))
    best = good[0]
    for other in good[1:]:
        _check_alike(best, other, names, remedy)
        if other.share > best.share + CLEARER:
            best = other
    return best


def _check_alike(way: _Way, other: _Way, names: Sequence[str], remedy: str | None) -> None:
    """Two ways of pairing must give the same partners to nearly all frames that both of them pair."""
    counts = (way.pairing.index >= 0).sum(axis=0)
    fullest = int(counts.argmax())
    for camera, name in enumerate(names):
        one, two = (_partners(each.pairing.index, fullest, camera, int(counts.max())) for each in (way, other))
        both = (one >= 0) & (two >= 0)
        unlike = int((one[both] != two[both]).sum())
        if unlike > max(1, UNLIKE * both.sum()):
            raise InsufficientDataError(
                f"{_capital(way.columns[0].words)} and {other.columns[0].words} pair the images of cameras "
                f"'{names[fullest]}' and '{name}' differently ({unlike} of {both.sum()}); "
                f"{remedy or f'say which is right by --pair-by {way.kind} or --pair-by {other.kind}'}."
            )


def _partners(index: Int[np.ndarray, "F C"], first: int, second: int, count: int) -> Int[np.ndarray, " N"]:
    """The second camera's position for each position of the first; -1 where it has none."""
    partners = np.full(count, -1)
    has = index[:, first] >= 0
    partners[index[has, first]] = index[has, second]
    return partners


def _disjoint(way: _Way, names: Sequence[str], remedy: str | None) -> str:
    first = way.columns[0]
    what = "frame number" if way.kind == "number" else "time"
    index = next(
        (i for i, column in enumerate(way.columns) if not len(np.intersect1d(first.values, column.values))),
        len(names) - 1,
    )
    other = way.columns[index].values
    return (
        f"Cameras '{names[0]}' and '{names[index]}' have no {what} in common ({first.values[0]} to "
        f"{first.values[-1]}, and {other[0]} to {other[-1]}); {remedy or RENAME}."
    )


def _with_times(way: _Way, ways: Sequence[_Way]) -> Pairing:
    """The rows of a number with the times that the names also hold."""
    clocks = [other for other in ways if other.kind == "time" and other.columns[0].second is not None]
    if way.kind == "time" or not clocks or len(way.pairing.frame_ids) < 2:
        return way.pairing
    fullest = int((way.pairing.index >= 0).sum(axis=0).argmax())
    seconds = _seconds(clocks[0].columns[fullest])
    row = np.flatnonzero(way.pairing.index[:, fullest] >= 0)
    ids = way.pairing.frame_ids.astype(float)
    period = period_of(seconds) / float(np.median(np.diff(ids[row])))
    known = seconds[way.pairing.index[row, fullest]]
    times = np.interp(ids, ids[row], known)
    before, after = ids < ids[row[0]], ids > ids[row[-1]]
    times[before] = known[0] + period * (ids[before] - ids[row[0]])
    times[after] = known[-1] + period * (ids[after] - ids[row[-1]])
    return replace(way.pairing, times=times - times[0])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
