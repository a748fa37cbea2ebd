"""Clocks of cameras from tracks alone: offsets of any size, rates, and no clock where there is none."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from jaxpoint.calibration.camera_clock import ClockSurvey
from jaxpoint.calibration.clock_findings import Timing, contradicts, flags
from jaxpoint.calibration.clocks import find_clocks, survey_clocks
from jaxpoint.calibration.readout_search import survey_readouts
from jaxpoint.commands.inputs import tracks_from
from jaxpoint.config import EpipolarSettings, InputSettings
from jaxpoint.io.svoboda import read_svoboda
from jaxpoint.io.track_files import read_tracks
from jaxpoint.report.advice import on_readouts
from jaxpoint.simulate.rooms import random_room
from jaxpoint.tracks import Tracks

LEAD = 300  # frames of the light before the first of the tracks, for cameras that show it late


def room_with_clocks(seed, offsets, rates=None, frames=900, stride=24):
    """Tracks of cameras of which frame f shows the light at (f - offset) / rate; 2 % outliers, 5 % not seen."""
    offsets = np.asarray(offsets, float)
    rates = np.ones(len(offsets)) if rates is None else np.asarray(rates, float)
    room = random_room(
        seed, cameras=len(offsets), frames=2 * frames, layout="around", visibility=1.0, outliers=0.0, noise_px=0.3,
        stride=stride,
    )  # fmt: skip
    path = CubicSpline(np.arange(len(room.points)), room.points)
    rng, pixels = np.random.default_rng(seed), np.full((frames, len(offsets), 2), np.nan)
    for camera, (late, rate) in enumerate(zip(offsets, rates)):
        moments = (np.arange(frames) - late) / rate + LEAD
        exact, inside = room.seen(path(np.clip(moments, 0, len(room.points) - 1)))
        seen = inside[:, camera] & (moments >= 0) & (moments < len(room.points)) & (rng.random(frames) < 0.95)
        shown = exact[:, camera] + rng.normal(0.0, 0.4, (frames, 2))
        wrong = rng.random(frames) < 0.02
        shown[wrong] = rng.uniform([0, 0], [1279, 719], (wrong.sum(), 2))
        pixels[seen, camera] = shown[seen]
    return Tracks.from_pixels(pixels, room.tracks.image_sizes, names=room.tracks.names)


def with_camera(tracks, camera, pixels, visible=None):
    """The tracks with other sightings of one camera."""
    changed, seen = tracks.pixels.copy(), tracks.visible.copy()
    changed[:, camera] = pixels
    if visible is not None:
        seen[:, camera] = visible
    return Tracks.from_pixels(np.where(seen[..., None], changed, np.nan), tracks.image_sizes, names=tracks.names)


def clocks_of(tracks):
    found = find_clocks(tracks, EpipolarSettings(), 0)
    assert [clock.name for clock in found] == list(tracks.names)
    return found


def assert_clocks(found, offsets, rates=None):
    rates = np.ones(len(offsets)) if rates is None else rates
    assert all(clock.certain for clock in found)
    np.testing.assert_allclose([clock.offset_frames for clock in found], offsets, atol=0.25)
    np.testing.assert_allclose([clock.rate for clock in found], rates, atol=3e-4)
    wrong = [c for c, rate in enumerate(rates) if abs(offsets[c]) >= 2 or rate != 1]
    assert [c for c, clock in enumerate(found) if contradicts(clock)] == wrong


@pytest.fixture(scope="module")
def cases_folder(data_folder):
    folder = data_folder.parent / "cases" / "10-late-and-drift"
    if not folder.is_dir():
        pytest.skip(f"There is no folder {folder}.")
    return folder


@pytest.mark.parametrize(("name", "late"), [("lag10", 10), ("lag41", 41)])
def test_the_late_camera_is_named_and_no_other(cases_folder, name, late):
    found = clocks_of(read_tracks(cases_folder / f"{name}.csv"))
    assert_clocks(found, [0, 0, late, 0, 0])
    assert found[2].share_before < 0.4 < 0.9 < found[2].share_after


def test_a_drift_is_told_from_an_offset_and_its_flags_set_it_right(cases_folder):
    """The camera's frames are those of one in step with a frame repeated every 176."""
    path = cases_folder / "drift.csv"
    found = clocks_of(read_tracks(path))
    assert [contradicts(clock) for clock in found] == [False, False, True, False, False]
    assert found[2].rate == pytest.approx(30 / 29.83, abs=2e-5)
    given = flags([found[2]], Timing.of(read_tracks(path))).replace("--rate ", "").split()
    in_step = clocks_of(tracks_from(path, InputSettings(rate=tuple(given))))
    assert min(clock.share_before for clock in in_step) > 0.9
    assert not any(contradicts(clock) for clock in in_step)


def test_a_calibration_keeps_a_camera_whose_found_clock_is_given(cases_folder):
    from jaxpoint.calibration.selfcal import calibrate

    tracks = tracks_from(cases_folder / "drift.csv", InputSettings(rate=("all=30", "cam_2=29.83")))
    solved = calibrate(tracks)
    assert (solved.kept.sum(axis=0) / tracks.visible.sum(axis=0)).min() > 0.95


@pytest.mark.parametrize(
    ("offsets", "rates"),
    [
        ([17, 0, 0, -220, 0], None),
        ([0, 3, -70, 5, 150], None),
        ([0, 0, 40, 0, 0], [1, 1, 25 / 30, 1, 1]),
        ([0, 0, 0, 0, 0], [1, 31.2 / 30, 1, 1, 29.97 / 30]),
    ],
)
def test_offsets_of_any_size_and_rates_come_back(offsets, rates):
    assert_clocks(clocks_of(room_with_clocks(100, offsets, rates)), offsets, rates)


def test_the_clock_is_that_of_the_most_cameras_and_runs_are_alike():
    tracks = room_with_clocks(103, [9, 0, 0, 0], frames=500)
    found = clocks_of(tracks)
    assert_clocks(found, [9, 0, 0, 0])
    assert found == clocks_of(tracks)
    turned = clocks_of(tracks.select_cameras([2, 0, 3, 1]))
    assert_clocks(turned, [0, 9, 0, 0])


def test_fractions_of_a_frame_are_no_contradiction():
    found = clocks_of(room_with_clocks(104, [0, 0.4, 0, -1.3]))
    np.testing.assert_allclose([clock.offset_frames for clock in found], [0, 0.4, 0, -1.3], atol=0.15)
    assert not any(contradicts(clock) for clock in found)


def test_a_thinned_recording_counts_offsets_in_frames():
    tracks = room_with_clocks(100, [0, 30, 0, 0], stride=48).select_frames(np.arange(0, 900, 3))
    assert_clocks(clocks_of(tracks), [0, 30, 0, 0])


def test_a_camera_that_belongs_to_nothing_is_not_late():
    """Of another room, frozen, or frozen for half of the recording; a mirrored image is in step."""
    tracks, other = room_with_clocks(100, [0] * 4, frames=500), room_with_clocks(500, [0] * 4, frames=500)
    found = clocks_of(with_camera(tracks, 0, other.pixels[:, 1], other.visible[:, 1]))
    assert [clock.certain for clock in found] == [False, True, True, True]
    assert found[0].offset_frames == 0.0
    assert found[0].share_after < 0.5
    frozen = clocks_of(with_camera(tracks, 2, tracks.pixels[np.flatnonzero(tracks.visible[:, 2])[0], 2]))
    assert [clock.certain for clock in frozen] == [True, True, False, True]
    half = tracks.pixels[:, 2].copy()
    half[250:] = half[tracks.visible[:, 2]][-1]
    assert not any(abs(clock.offset_frames) > 0.2 for clock in clocks_of(with_camera(tracks, 2, half)))
    mirrored = clocks_of(with_camera(tracks, 2, np.array([1279, 0]) + tracks.pixels[:, 2] * [-1, 1]))
    assert_clocks(mirrored, [0] * 4)


def test_waves_of_one_period_are_not_taken_for_a_lag_of_a_period():
    """A light that repeats its path but for a slow walk fits nearly as well a period later."""
    tracks = room_with_clocks(100, [0] * 4, frames=300)
    twice = np.concatenate([tracks.pixels, tracks.pixels]), np.concatenate([tracks.visible, tracks.visible])
    late = twice[0].copy(), twice[1].copy()
    late[0][7:, 2], late[1][7:, 2] = twice[0][:-7, 2], twice[1][:-7, 2]
    found = clocks_of(Tracks.from_pixels(np.where(late[1][..., None], late[0], np.nan), tracks.image_sizes))
    assert not found[2].certain or abs(found[2].offset_frames - 7) < 0.25


def rolling(tracks, clocks):
    """What `check` says of rolling shutters."""
    return list(on_readouts(survey_readouts(ClockSurvey(clocks, ()), tracks, EpipolarSettings(), 0).clocks))


def test_real_recordings_are_in_step(data_folder):
    tracks = read_svoboda(data_folder / "svoboda_arctic4")
    arctic = clocks_of(tracks)
    assert rolling(tracks, arctic) == []
    assert max(abs(clock.offset_frames) for clock in arctic) < 0.1
    assert not any(contradicts(clock) for clock in arctic)
    tracks = read_tracks(Path(data_folder) / "drone_rolex" / "tracks.csv")
    drones = clocks_of(tracks)
    assert rolling(tracks, drones) == []  # wide lenses, whose errors must not be taken for it
    assert not any(contradicts(clock) for clock in drones)
    np.testing.assert_allclose([c.offset_frames for c in drones], [0, 0.26, 0.39, 0.71, 0.02], atol=0.2)


def test_nothing_is_said_about_one_camera_or_one_frame():
    tracks = room_with_clocks(100, [0] * 3, frames=100)
    for few in (tracks.select_cameras([0]), tracks.select_frames(np.arange(1))):
        survey = survey_clocks(few, EpipolarSettings(), 0)
        assert not any(clock.certain for clock in survey.clocks)
        assert survey.pairs == ()
