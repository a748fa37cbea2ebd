"""Which frames of several cameras belong together, and when that is not known."""

from pathlib import Path

import numpy as np
import pytest

from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.frame_names import read_names
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.pairing import pair_by_ids, pair_frames

COUNT = 120
LOST = (40, 41, 90)
REMEDY = "say so by --pair-by"


class Source(FrameSource):
    """What pairing asks of a recording; there are no images."""

    def __init__(self, stems=None, times=None, count=None, start=0.0):
        self.columns = read_names(stems, Path("x")).columns if stems is not None else ()
        self.times, self.start = times, start
        counters = [column for column in self.columns if column.kind == "number"]
        count = len(stems) if stems is not None else len(times) if times is not None else count
        self.frame_ids = counters[0].values if counters else np.arange(count)
        self.numbered = bool(counters)

    def read(self, index):
        raise NotImplementedError

    def stream(self, indices=None):
        raise NotImplementedError


def images(name, frames=range(COUNT)):
    return Source([name(k) for k in frames])


def kept(lost=LOST):
    return [k for k in range(COUNT) if k not in lost]


def pair(*sources, by="auto", **options):
    return pair_frames(sources, [f"cam{i}" for i in range(len(sources))], by, remedy=REMEDY, **options)


def moments(pairing, *frames):
    """For each row and camera the true moment of its frame, -1 where it has none."""
    known = [np.append(np.asarray(own), -1) for own in frames]
    return np.stack([own[pairing.index[:, camera]] for camera, own in enumerate(known)], axis=1)


def check_in_step(pairing, *frames):
    """Every row holds frames of one moment, and no frame is left out."""
    rows = moments(pairing, *frames)
    present = rows >= 0
    assert present.sum(axis=0).tolist() == [len(own) for own in frames]
    assert (np.where(present, rows, rows.max(axis=1, keepdims=True)) == rows.max(axis=1, keepdims=True)).all()


def stamp(k, seed, clock=0.0, jitter=0.002):
    """A time in s with a jitter of its own for each camera and frame."""
    return 1712345678.25 + clock + k / 30 + np.random.default_rng([seed, k]).uniform(-jitter, jitter)


def test_the_number_that_rises_pairs_images_and_gaps_stay_gaps():
    pairing = pair(images(lambda k: f"{k:05d}_cam0"), images(lambda k: f"{k:05d}_cam1", kept()))
    check_in_step(pairing, range(COUNT), kept())
    assert pairing.by == "the number at the start of the names"
    np.testing.assert_array_equal(pairing.frame_ids, range(COUNT))
    assert pairing.times is None


def test_a_counter_wins_over_times_that_agree_and_takes_them():
    def name(seed):
        return lambda k: f"frame_{k:06d}_{stamp(k, seed):.3f}"

    pairing = pair(images(name(0)), images(name(1), kept()))
    check_in_step(pairing, range(COUNT), kept())
    assert pairing.by == "the number after 'frame_'"
    np.testing.assert_allclose(pairing.times, np.arange(COUNT) / 30, atol=6e-3)


@pytest.mark.parametrize("clock", [0.0, 0.011])
def test_times_that_jitter_pair_the_nearest_frames(clock):
    late = [k for k in range(7, COUNT) if k not in LOST]
    first = images(lambda k: f"left_{stamp(k, 0):.4f}")
    second = images(lambda k: f"right_{stamp(k, 1, clock):.4f}", late)
    pairing = pair(first, second)
    check_in_step(pairing, range(COUNT), late)
    assert pairing.by == "the time in their names"
    np.testing.assert_allclose(pairing.times, np.arange(COUNT) / 30, atol=2e-3)
    assert not pairing.other_rate.any()


def test_milliseconds_without_a_date_pair_by_the_nearest():
    def name(seed):
        return lambda k: f"img{seed}_{round(1000 * stamp(k, seed)) - 1712345678000:06d}"

    check_in_step(pair(images(name(0)), images(name(1), kept())), range(COUNT), kept())


def test_counters_that_each_camera_starts_anew_leave_the_time():
    first = images(lambda k: f"f{k:05d}_{stamp(k, 0):.3f}")
    second = images(lambda k: f"f{k + 5000:05d}_{stamp(k, 1):.3f}", kept())
    pairing = pair(first, second)
    check_in_step(pairing, range(COUNT), kept())
    assert pairing.by == "the time in their names"


def test_a_counter_of_what_was_written_contradicts_the_time():
    written = {k: place for place, k in enumerate(kept())}
    first = images(lambda k: f"f{k:05d}_{stamp(k, 0):.3f}")
    second = images(lambda k: f"f{written[k]:05d}_{stamp(k, 1):.3f}", kept())
    with pytest.raises(InsufficientDataError, match=r"'cam0' and 'cam1' differently \(\d+ of \d+\); say so by"):
        pair(first, second)
    check_in_step(pair(first, second, by="time"), range(COUNT), kept())
    assert pair(first, second, by="number").by == "the number after 'f'"


@pytest.mark.parametrize("shift", [1, 37])
def test_counters_that_start_and_end_elsewhere_by_as_much_are_refused(shift):
    sources = images(lambda k: f"a{k}"), images(lambda k: f"b{k + shift}")
    with pytest.raises(InsufficientDataError, match=f"from 0 to 119 and from {shift} to {119 + shift}, as if each"):
        pair(*sources)
    assert len(pair(*sources, by="number").frame_ids) == COUNT + shift
    check_in_step(pair(*sources, by="place"), range(COUNT), range(COUNT))


def test_counters_without_a_common_number_are_refused():
    with pytest.raises(InsufficientDataError, match=r"no frame number in common \(0 to 119, and 1000 to 1119\)"):
        pair(images(lambda k: f"a{k}"), images(lambda k: f"b{k + 1000}"))


def test_a_camera_that_joined_late_is_no_shift():
    late = range(30, COUNT)
    check_in_step(pair(images(lambda k: f"a{k}"), images(lambda k: f"b{k}", late)), range(COUNT), late)


def test_names_without_numbers_go_by_place_where_there_are_as_many():
    letters = [f"{'abcdefghij'[k // 26]}{'abcdefghijklmnopqrstuvwxyz'[k % 26]}" for k in range(COUNT)]
    pairing = pair(Source(letters), Source(letters))
    assert "place" in pairing.by
    assert "started at once" in pairing.notes[0]
    with pytest.raises(InsufficientDataError, match=r"'cam1' and 'cam0' have 119 and 120 frames, and neither"):
        pair(Source(letters), Source(letters[1:]))
    with pytest.raises(InsufficientDataError, match="'cam1' have 3 gaps and camera 'cam0' has no numbers"):
        pair(Source(letters[:-3]), images(lambda k: f"a{k}", kept()))


def test_time_stamps_pair_videos_and_dropped_frames_stay_gaps():
    pairing = pair(Source(times=np.arange(COUNT) / 30), Source(times=np.array(kept()) / 30))
    check_in_step(pairing, range(COUNT), kept())
    assert pairing.notes == ("The time stamps of 'cam1' skip 3 frames; they stay gaps.",)
    np.testing.assert_allclose(pairing.times, np.arange(COUNT) / 30)


def test_first_frames_that_were_dropped_are_told_by_the_containers_clock():
    late = range(4, COUNT)
    lost = Source(times=np.arange(COUNT - 4) / 30, start=4 / 30)
    check_in_step(pair(Source(times=np.arange(COUNT) / 30), lost), range(COUNT), late)
    started = Source(times=np.arange(COUNT) / 30, start=0.5)  # whose clock began anywhere
    check_in_step(pair(Source(times=np.arange(COUNT) / 30), started), range(COUNT), range(COUNT))


def test_another_rate_goes_by_time_and_is_said():
    usual, slow = np.arange(900) / 30, np.arange(895) / 29.83
    pairing = pair(Source(times=usual), Source(times=slow), Source(times=usual))
    assert pairing.other_rate.tolist() == [False, True, False]
    assert "unlike frame rates (cam0 30, cam1 29.83, cam2 30 a second); moments are those of 'cam0'" in pairing.notes[0]
    has = pairing.index[:, 1] >= 0
    late = slow[pairing.index[has, 1]] - pairing.times[has]
    assert np.abs(late).max() <= 0.5 / 30
    np.testing.assert_allclose(pairing.places[1], slow * 30, atol=1e-6)


def test_the_slower_of_two_rates_is_the_clock():
    pairing = pair(Source(times=np.arange(60) / 30), Source(times=np.arange(30) / 15))
    np.testing.assert_array_equal(pairing.index[:30], np.stack([np.arange(0, 60, 2), np.arange(30)], axis=1))


def test_videos_of_unlike_lengths_are_refused_unless_the_start_is_vouched_for():
    whole, short = Source(times=np.arange(COUNT) / 30), Source(times=np.arange(COUNT - 3) / 30)
    with pytest.raises(InsufficientDataError, match=r"'cam1' has 117 frames, others up to 120 \(3.9 and 4 s\)"):
        pair(whole, short)
    for pairing in (pair(whole, short, by="time"), pair(whole, short, any_length=True)):
        check_in_step(pairing, range(COUNT), range(COUNT - 3))
        assert "taken to have started at once" in pairing.notes[0]
    pair(whole, Source(times=np.arange(COUNT - 1) / 30))  # a recorder may stop a frame before another


def test_a_gap_does_not_excuse_seconds_that_are_missing_at_an_end():
    whole, gappy = np.arange(3000) / 30, np.delete(np.arange(3000), [5, 6]) / 30
    with pytest.raises(InsufficientDataError, match="'cam1' has 2973 frames, others up to 3000"):
        pair(Source(times=whole), Source(times=gappy[:-25]))
    few = pair(Source(times=whole), Source(times=gappy[:-3]))
    assert "taken to have started at once" in few.notes[1]
    as_many = pair(Source(times=whole), Source(times=np.arange(3000) / 29.83))
    assert "(100 and 100.6 s)" in as_many.notes[1]


def test_what_is_asked_for_must_be_there():
    with pytest.raises(UsageError, match="no time that rises"):
        pair(images(lambda k: f"a{k}"), images(lambda k: f"b{k}"), by="time")
    with pytest.raises(UsageError, match="no frame numbers but their places"):
        pair(Source(times=np.arange(9) / 30), Source(times=np.arange(9) / 30), by="number")
    with pytest.raises(UsageError, match="'cam1' has no number of its frames"):
        pair(images(lambda k: f"a{k}"), Source(count=COUNT), by="number")


def test_own_numbers_pair_whatever_their_lengths():
    pairing = pair_by_ids([Source(times=np.arange(9) / 30), Source(times=np.arange(5) / 30)], "own numbers")
    assert pairing.index[:, 1].tolist() == [0, 1, 2, 3, 4, -1, -1, -1, -1]
    np.testing.assert_allclose(pairing.times, np.arange(9) / 30)
