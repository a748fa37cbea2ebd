"""Which frames of several cameras belong together: by number, by time, or, only where nothing else speaks, by place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.clock import common_clock, gaps_of, period_of
from jaxpoint.io.frames import FrameSource

PairBy = Literal["auto", "number", "time", "place"]

END_FRAMES = 1.5  # one recorder may stop a frame before another
DROPPED_AT_END = 5  # frames that a recorder may lose at an end where it also lost others
END_PART = 0.01  # of the length, where as many frames were taken at unlike rates
SAME_RATE = 5e-4  # relative difference of rates that counts as none
CUT = "cut them to the same moments, or, with a timestamps.csv for `calibrate`, say --unequal-lengths"
NUMBER = "number the images of all cameras alike"
PLACE = "their place in the recordings"
STAMPS = "the time stamps of the videos"
FROM_FIRST = f"{STAMPS}, each counted from its first frame"


@dataclass(frozen=True)
class Pairing:
    """F rows, one for each moment, of C cameras."""

    frame_ids: Int[np.ndarray, " F"]  # number of the moment, rising
    index: Int[np.ndarray, "F C"]  # position in each camera's own frames; -1 where it has none
    times: Float[np.ndarray, " F"] | None  # s
    by: str  # for people: "the number after 'frame_'"
    notes: tuple[str, ...] = ()  # what a user should know, a sentence each
    places: tuple[Float[np.ndarray, " _"], ...] = ()  # when each frame of each camera was, in numbers of moments
    other_rate: Bool[np.ndarray, " C"] | None = None  # cameras that run at another rate than the rows

    def select(self, cameras: Sequence[int]) -> Pairing:
        """The rows as they are, of some cameras."""
        kept = list(cameras)
        places = tuple(self.places[i] for i in kept) if self.places else ()
        rate = None if self.other_rate is None else self.other_rate[kept]
        return Pairing(self.frame_ids, self.index[:, kept], self.times, self.by, self.notes, places, rate)


def pair_frames(
    sources: Sequence[FrameSource],
    names: Sequence[str],
    by: PairBy = "auto",
    *,
    remedy: str | None = None,
    any_length: bool = False,
) -> Pairing:
    """One row for each moment of which any camera has a frame.

    Args:
        sources: of each camera.
        names: of the cameras.
        by: `auto` takes what the input says: time stamps of videos, numbers or times in the names of images, and the
            place only where there is none of these and all cameras have as many frames. The others insist on one.
        remedy: how a user says which frames belong together, the end of a sentence; None where there is `--pair-by`.
        any_length: videos may differ in length, from their first frames on.

    Raises:
        InsufficientDataError: the input does not say which frames belong together, or says it in two ways.
        UsageError: it does not hold what `by` asks for.
    """
    from jaxpoint.io.name_pairing import pair_by_names

    if by == "place":
        return pair_by_place(sources, names, remedy)
    folders = [source.times is None and bool(source.columns) for source in sources]
    if all(folders):
        return pair_by_names(sources, names, by, remedy)
    if all(source.times is not None and len(source) > 1 for source in sources):
        if by == "number":
            raise UsageError("Videos have no frame numbers but their places; leave out --pair-by, or say place.")
        return _by_stamps(sources, names, any_length or by == "time")
    if by != "auto":
        silent = names[folders.index(False)]
        raise UsageError(f"Camera '{silent}' has no {by} of its frames; leave out --pair-by, or say --pair-by place.")
    return pair_by_place(sources, names, remedy)


def pair_by_ids(sources: Sequence[FrameSource], by: str) -> Pairing:
    """Each frame by its number, which is its position where the names hold none."""
    ids = np.unique(np.concatenate([source.frame_ids for source in sources]))
    index = np.full((len(ids), len(sources)), -1)
    for camera, source in enumerate(sources):
        index[np.searchsorted(ids, source.frame_ids), camera] = np.arange(len(source))
    return Pairing(ids, index, _agreed_times(ids, index, sources), by)


def pair_by_place(sources: Sequence[FrameSource], names: Sequence[str], remedy: str | None = None) -> Pairing:
    """The first with the first, where all cameras have as many frames and no number tells of a lost one.

    Raises:
        InsufficientDataError: they have not.
    """
    counts = [len(source) for source in sources]
    if min(counts) < max(counts):
        few, many = int(np.argmin(counts)), int(np.argmax(counts))
        raise InsufficientDataError(
            f"Cameras '{names[few]}' and '{names[many]}' have {counts[few]} and {counts[many]} frames, and neither "
            f"numbers nor times say which belong together; {remedy or CUT}."
        )
    lacking = [camera for camera, source in enumerate(sources) if source.numbered and _gaps(source.frame_ids)]
    if lacking and not all(source.numbered for source in sources):
        camera = lacking[0]
        silent = next(name for name, source in zip(names, sources) if not source.numbered)
        raise InsufficientDataError(
            f"The numbers of camera '{names[camera]}' have {_gaps(sources[camera].frame_ids)} gaps and camera "
            f"'{silent}' has no numbers, so it is not known which frames belong together; {remedy or NUMBER}."
        )
    ids = np.arange(counts[0])
    index = np.tile(ids[:, None], (1, len(sources)))
    notes = ("Nothing but the place pairs the frames: all recordings must have started at once and lost none.",)
    return Pairing(ids, index, _agreed_times(ids, index, sources), PLACE, notes if len(sources) > 1 else ())


def _by_stamps(sources: Sequence[FrameSource], names: Sequence[str], any_length: bool) -> Pairing:
    stamps, by = _on_one_clock(sources)
    clock = common_clock(stamps)
    notes = _rate_notes(stamps, names, clock.period) + _gap_notes(stamps, names)
    length, explained = _length_note(stamps, names, bool(notes))
    if length and not (any_length or explained):
        raise InsufficientDataError(
            f"{length}, and their stamps do not say which frames belong together; if all started at once, say "
            f"--pair-by time; else {CUT}."
        )
    if length:
        notes = (*notes, f"{length}; they are taken to have started at once, which is to be checked.")
    times = clock.ticks * clock.period
    return Pairing(clock.ticks, clock.index, times, by, notes, clock.places, clock.other_rate)


def _on_one_clock(sources: Sequence[FrameSource]) -> tuple[list[Float[np.ndarray, " _"]], str]:
    """Stamps (s) of all videos, and how to call them.

    Containers start their clocks at will, so each video counts from its first frame; only where all end at one time on
    the containers' clocks, and otherwise do not, the first frames of some were lost, and these clocks are right.
    """
    stamps = [source.times for source in sources if source.times is not None]
    started = [own + source.start for own, source in zip(stamps, sources)]
    frame = max(period_of(own) for own in stamps)
    if _spread_of_ends(started) + frame / 2 < _spread_of_ends(stamps):
        return started, STAMPS
    return stamps, FROM_FIRST


def _spread_of_ends(stamps: Sequence[Float[np.ndarray, " _"]]) -> float:
    ends = [own[-1] + period_of(own) for own in stamps]
    return max(ends) - min(ends)


def _rate_notes(stamps: Sequence[Float[np.ndarray, " _"]], names: Sequence[str], period: float) -> tuple[str, ...]:
    """What to tell where the rates differ."""
    periods = np.array([period_of(own) for own in stamps])
    if (np.abs(periods / period - 1) < SAME_RATE).all():
        return ()
    leader = names[int(np.abs(periods - period).argmin())]
    rates = ", ".join(f"{name} {1 / own:.4g}" for name, own in zip(names, periods))
    return (f"The videos have unlike frame rates ({rates} a second); moments are those of '{leader}', by time.",)


def _gap_notes(stamps: Sequence[Float[np.ndarray, " _"]], names: Sequence[str]) -> tuple[str, ...]:
    gaps = [(name, gaps_of(own)) for name, own in zip(names, stamps)]
    return tuple(
        f"The time stamps of '{name}' skip {count} frame{'s' * (count > 1)}; they stay gaps."
        for name, count in gaps
        if count
    )


def _length_note(stamps: Sequence[Float[np.ndarray, " _"]], names: Sequence[str], told: bool) -> tuple[str, bool]:
    """The start of a sentence where the recordings differ in length, and whether that is no wonder.

    It is none where stamps tell of dropped frames, and a few more may have been at an end, or of rates, and all
    recorders stopped after as many frames.
    """
    periods = [period_of(own) for own in stamps]
    lengths = np.array([own[-1] + period for own, period in zip(stamps, periods)])
    short, long = int(lengths.argmin()), int(lengths.argmax())
    more = lengths[long] - lengths[short]
    if more <= END_FRAMES * max(periods):
        return "", True
    as_many = len(stamps[short]) == len(stamps[long]) and more <= END_PART * lengths[long]
    note = (
        f"The videos have unlike lengths: '{names[short]}' has {len(stamps[short])} frames, others up to "
        f"{len(stamps[long])} ({lengths[short]:.4g} and {lengths[long]:.4g} s)"
    )
    return note, bool(told and (more <= DROPPED_AT_END * max(periods) or as_many))


def _agreed_times(
    ids: Int[np.ndarray, " F"], index: Int[np.ndarray, "F C"], sources: Sequence[FrameSource]
) -> Float[np.ndarray, " F"] | None:
    """Times of the rows where all cameras know them and agree within half a frame."""
    times = np.full(index.shape, np.nan)
    for camera, source in enumerate(sources):
        if source.times is None:
            return None
        has = index[:, camera] >= 0
        times[has, camera] = source.times[index[has, camera]]
    first = np.nanmin(times, axis=1)
    step = float(np.median(np.diff(first))) if len(ids) > 1 else np.inf
    agree = (np.nanmax(times, axis=1) - first < step / 2).all() and (np.diff(first) > 0).all()
    return first if agree else None


def _gaps(ids: Int[np.ndarray, " F"]) -> int:
    """Numbers that are missing between the first and the last."""
    steps = np.diff(ids)
    return int((steps // max(int(np.median(steps)), 1) - 1).clip(min=0).sum()) if len(steps) else 0
