"""Offsets, rates and cameras left out as flags give them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jaxpoint.calibration.result import ReadoutTimes
from jaxpoint.commands.given_clocks import (
    given_offsets,
    given_rates,
    given_readouts,
    on_given_clock,
    rate_of_times,
    with_known_readouts,
    without_left_out,
)
from jaxpoint.commands.inputs import tracks_from
from jaxpoint.config import InputSettings
from jaxpoint.config.loading import load_settings, to_toml
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.track_files import save_tracks
from jaxpoint.simulate.rooms import random_room
from jaxpoint.tracks import Tracks


@pytest.fixture(scope="module")
def tracks():
    return random_room(3, cameras=4, frames=80, layout="around", visibility=0.9, outliers=0.03, noise_px=0.3).tracks


@pytest.fixture
def timeless(tracks):
    return Tracks(tracks.pixels, tracks.visible, tracks.image_sizes, tracks.frame_ids, None, tracks.names)


def test_a_whole_offset_shifts_rows_exactly(tracks, tmp_path):
    save_tracks(tmp_path / "t.npz", tracks)
    moved = tracks_from(tmp_path / "t.npz", InputSettings(offset=("cam_2=7", "cam_1=-3"), leave_out=("cam_0",)))
    assert moved.names == ("cam_1", "cam_2", "cam_3")
    np.testing.assert_array_equal(moved.pixels[:-7, 1], tracks.pixels[7:, 2])
    np.testing.assert_array_equal(moved.visible[3:, 0], tracks.visible[:-3, 1])
    np.testing.assert_array_equal(moved.pixels[:, 2], tracks.pixels[:, 3])
    assert not moved.visible[-7:, 1].any()


def test_rates_are_against_all_or_the_times(tracks, timeless):
    assert rate_of_times(tracks) == pytest.approx(25.0)
    assert rate_of_times(timeless) is None
    np.testing.assert_allclose(given_rates(tracks, ("cam_2=24.5",)), [1, 1, 24.5 / 25, 1])
    np.testing.assert_allclose(given_rates(timeless, ("all=30", "cam_2=29.83")), [1, 1, 29.83 / 30, 1])
    np.testing.assert_array_equal(given_rates(timeless, ("all=30",)), np.ones(4))
    np.testing.assert_array_equal(given_offsets(tracks, ("cam_3=-1.5",)), [0, 0, 0, -1.5])


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"offset": ("cam_9=3",)}, "--offset names a camera 'cam_9', but the tracks have cam_0, cam_1"),
        ({"offset": ("cam_2",)}, "--offset cam_2 cannot be read; give a camera's name and a number"),
        ({"offset": ("cam_2=late",)}, "cannot be read"),
        ({"offset": ("cam_2=nan",)}, "cannot be read"),
        ({"offset": ("cam_2=3", "cam_2=4")}, "--offset is given twice for 'cam_2', 3 and 4"),
        (
            {"readout": ("cam_2=18",)},
            "--readout cam_2=18 cannot be used; .* at most 1 frame. Give frames, not millisec",
        ),
        ({"readout": ("cam_9=0.5",)}, "--readout names a camera 'cam_9'"),
        ({"readout": ("cam_2",)}, "--readout cam_2 cannot be read; give a camera's name and a number, as in --readout"),
        ({"rate": ("all=30", "cam_2=0")}, "--rate cam_2=0 cannot be used; a rate is a positive number"),
        ({"rate": ("all=30", "all=25")}, "--rate is given twice for 'all'"),
        ({"rate": ("all=30", "cam_9=25")}, "--rate names a camera 'cam_9'"),
        ({"rate": ("cam_2=29.83",)}, "without the rate of the other cameras, .* give that too: --rate all=30"),
    ],
)
def test_what_cannot_be_used_is_refused(timeless, settings, match):
    with pytest.raises(UsageError, match=match):
        on_given_clock(timeless, InputSettings(**settings))


def test_what_leaves_nothing_is_refused(tracks):
    with pytest.raises(UsageError, match="--leave-out names a camera 'x'"):
        without_left_out(tracks, ("x",))
    with pytest.raises(InsufficientDataError, match="No camera is left"):
        without_left_out(tracks, tracks.names)
    with pytest.raises(InsufficientDataError, match="camera 'cam_2' has no light left in the frames 0 to 79"):
        on_given_clock(tracks, InputSettings(offset=("cam_2=500",)))


def test_readout_times_are_of_one_camera_or_of_all(tracks):
    np.testing.assert_array_equal(given_readouts(tracks, ("cam_2=-0.4",)), [0, 0, -0.4, 0])
    np.testing.assert_array_equal(given_readouts(tracks, ("all=0.6", "cam_0=0")), [0, 0.6, 0.6, 0.6])
    moved = on_given_clock(tracks, InputSettings(readout=("cam_1=0.5",)))
    np.testing.assert_array_equal(moved.pixels[:, 0], np.where(moved.visible[:, :1], tracks.pixels[:, 0], 0.0))
    both = moved.visible[:, 1] & tracks.visible[:, 1]
    assert np.abs(moved.pixels[both, 1] - tracks.pixels[both, 1]).max() > 1.0
    known = SimpleNamespace(
        rig=SimpleNamespace(names=tracks.names), readout_times=ReadoutTimes(np.array([0, 0.5, 0, 0]), np.zeros(4))
    )
    again = with_known_readouts(tracks, InputSettings(), known)
    np.testing.assert_array_equal(again.pixels[both, 1], moved.pixels[both, 1])
    assert with_known_readouts(tracks, InputSettings(readout=("all=0",)), known) is tracks


def test_names_may_hold_an_equals_sign(tracks):
    odd = replace(tracks, names=("a=b", "c", "d", "e"))
    np.testing.assert_array_equal(given_offsets(odd, ("a=b=2",)), [2, 0, 0, 0])


def test_the_configuration_file_holds_them_too(tmp_path):
    (tmp_path / "c.toml").write_text('offset = ["cam_2=37"]\nrate = ["all=30", "cam_2=29.83"]\nleave_out = ["cam_0"]\n')
    settings = load_settings(tmp_path / "c.toml", InputSettings)
    assert settings == InputSettings(offset=("cam_2=37",), rate=("all=30", "cam_2=29.83"), leave_out=("cam_0",))
    (tmp_path / "d.toml").write_text(to_toml(settings))
    assert load_settings(tmp_path / "d.toml", InputSettings) == settings
