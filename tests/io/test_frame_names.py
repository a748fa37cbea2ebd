"""Names of images: what rises from file to file, whatever else they hold."""

from pathlib import Path

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.frame_names import read_names

COUNT = 90
K = range(COUNT)


def columns(stems):
    return read_names(stems, Path("folder")).columns


def told(stems):
    """Kind and label of each part of the names that rises."""
    return [(column.kind, column.label) for column in columns(stems)]


@pytest.mark.parametrize(
    ("name", "label"),
    [
        (lambda k: f"{k:05d}_cam0", ""),
        (lambda k: f"cam12_{k}", "_"),
        (lambda k: f"2024-05-01_frame_{k:04d}", "_frame_"),
        (lambda k: f"192.168.0.12_{k:05d}", "_"),
        (lambda k: f"20240501_1015{k // 30:02d}_{k:04d}", "_"),  # seconds that repeat, and a counter
        (lambda k: f"frame_{k:04d}_{'abcdef'[k % 6]}{k % 7}x", "frame_"),  # a checksum
        (lambda k: f"{'abcdef'[k % 6]}{k % 7}x_frame_{k:04d}", "x_frame_"),
        (lambda k: f"exposure{120 + k * 7 % 3}_frame{k}", "_frame"),
    ],
)
def test_a_counter_is_found_beside_all_that_does_not_rise(name, label):
    stems = sorted((name(k) for k in K), key=lambda stem: stem)
    found = read_names(stems, Path("folder"))
    (column,) = found.columns
    assert (column.kind, column.label) == ("number", label)
    assert column.values.tolist() == list(K)
    assert [stems[place] for place in found.order] == [name(k) for k in K]


@pytest.mark.parametrize(
    "name",
    [
        lambda ms: f"20240501_1015{ms // 1000:02d}_{ms % 1000:03d}",
        lambda ms: f"cam3_20240501T10:15:{ms // 1000:02d}.{ms % 1000:03d}Z",
        lambda ms: f"202405011015{ms // 1000:02d}{ms % 1000:03d}",
        lambda ms: f"10h15m{ms // 1000:02d}s{ms % 1000:03d}ms",
        lambda ms: f"{1712345678 + ms // 1000}.{ms % 1000:03d}",
        lambda ms: f"{1712345678000 + ms}_cam1",
        lambda ms: f"{1712345678_000_000_000 + ms * 1_000_000}",
        lambda ms: f"t{ms / 1000:.3f}",
    ],
)
def test_times_are_read_in_seconds(name):
    (column,) = columns([name(round(k * 1000 / 30)) for k in K])
    assert column.kind == "time"
    seconds = (column.values - column.values[0]) / column.second
    np.testing.assert_allclose(seconds, np.arange(COUNT) / 30, atol=6e-4)


@pytest.mark.parametrize(
    "name",
    [
        lambda k: f"frame_{k:06d}_{1712345678.25 + k / 30:.3f}",
        lambda k: f"frame_{k:04d}_202402151816{k // 30:02d}{k % 30 * 33:03d}",  # 0000 is no year
        lambda k: f"frame_{2000 + k}_202402151816{k // 30:02d}{k % 30 * 33:03d}",
    ],
)
def test_a_counter_and_a_time_stand_side_by_side(name):
    found = columns([name(k) for k in K])
    assert [(column.kind, column.label) for column in found] == [("number", "frame_"), ("time", "_")]
    assert found[1].second == 1000


def test_milliseconds_without_a_date_are_a_clock_and_random_gaps_are_not():
    assert told([f"img_{round(k * 33.4):06d}" for k in K]) == [("time", "img_")]
    gaps = np.cumsum(np.random.default_rng(0).integers(1, 20, COUNT))
    assert told([f"img_{k}" for k in gaps]) == [("number", "img_")]
    assert told(["cam1_2", "cam1_9", "cam1_10", "cam1_30"]) == [("number", "_")]


def test_names_in_which_nothing_rises():
    assert columns(["a1", "b1", "c"]) == ()
    assert columns(["lamp", "table"]) == ()


def test_one_file_of_another_kind_does_not_hide_the_numbers():
    with pytest.raises(FileFormatError, match=r"folder/background' is named unlike 90 of the 91 images"):
        columns(["background", *(f"frame_{k:04d}" for k in K)])
