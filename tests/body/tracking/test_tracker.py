"""Heads through a recording: places, ids, and what is said where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from jaxpoint.body.tracking.head_tracks import Status
from jaxpoint.body.tracking.tracker import TrackerState, step, track_heads
from jaxpoint.config.track import TrackSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.simulate.heads import random_meeting

CROSSINGS = range(500, 520)
KINDS = ("pass", "cross")


def tracked(meeting, **options):
    return track_heads(meeting.room.rig, meeting.pixels, meeting.valid, meeting.times, **options)


def whose(meeting, heads):
    """For everybody found, the person nearest in each frame (F, N); -1 where nobody is within 0.3 m."""
    gaps = np.linalg.norm(heads.positions[:, :, None] - meeting.places[:, None], axis=-1)
    return np.where(heads.present & (gaps.min(axis=2) < 0.3), gaps.argmin(axis=2), -1)


def apart(meeting):
    """Frames at which it is plain who is who."""
    return np.linalg.norm(meeting.places[:, 0] - meeting.places[:, 1], axis=1) > 0.8


@pytest.fixture(scope="module")
def crossings():
    meetings = [random_meeting(seed, kind=KINDS[seed % 2], seconds=5.0) for seed in CROSSINGS]
    return [(meeting, tracked(meeting)) for meeting in meetings]


def test_in_20_crossings_no_id_is_swapped_or_lost(crossings):
    for meeting, tracking in crossings:
        ids = [set(row[apart(meeting)].tolist()) - {-1} for row in whose(meeting, tracking.heads).T]
        assert sorted(map(tuple, ids)) == [(0,), (1,)], ids


def test_crossings_are_as_hard_as_is_said(crossings):
    """The simulation: misses, clutter, and silhouettes that merge in most views while people are close."""
    for meeting, _ in crossings:
        gaps = np.linalg.norm(meeting.places[:, 0, :2] - meeting.places[:, 1, :2], axis=1)
        assert 0.2 < gaps.min() < 0.7
    merged = np.mean([meeting.merged[~apart(meeting)].mean() for meeting, _ in crossings])
    assert 0.3 < merged < 0.9
    inside = [meeting.room.seen(meeting.places[:, 0])[1].sum(axis=1).mean() for meeting, _ in crossings]
    found = [meeting.valid.sum(axis=(1, 2)).mean() for meeting, _ in crossings]
    assert np.mean(found) < 2 * np.mean(inside) * 0.8 + 6 * 0.3


def test_places_are_right_and_know_how_well(crossings):
    """Apart from one another; error against the truth, and inside the stated covariance."""
    errors, squares = [], []
    for meeting, tracking in crossings:
        heads, person = tracking.heads, whose(meeting, tracking.heads)
        rows, columns = np.nonzero((person >= 0) & apart(meeting)[:, None] & heads.measured)
        error = heads.positions[rows, columns] - meeting.places[rows, person[rows, columns]]
        square = tracking.covariances[rows, columns, :3, :3]
        errors.append(np.linalg.norm(error, axis=1))
        squares.append(np.einsum("ni,ni->n", error, np.linalg.solve(square, error[..., None])[..., 0]))
    errors, squares = np.concatenate(errors), np.concatenate(squares)
    assert np.median(errors) < 0.015
    assert np.quantile(errors, 0.95) < 0.04
    assert 0.5 < np.median(squares) / chi2.ppf(0.5, 3) < 1.6


def test_frame_by_frame_is_the_recording_before_it_is_smoothed(crossings):
    meeting, tracking = crossings[0]
    state = TrackerState()
    for frame in range(20):
        state, heads = step(state, meeting.room.rig, meeting.pixels[frame], meeting.valid[frame], meeting.times[frame])
    people = [track.person for track in heads.tracks if track.person]
    assert people == [1, 2]
    for track in heads.tracks:
        column = list(tracking.heads.people).index(track.person)
        assert np.linalg.norm(track.mean[:3] - tracking.heads.positions[19, column]) < 0.1
    np.testing.assert_array_equal(heads.candidates, tracking.candidates[19, [p - 1 for p in people]])


@pytest.fixture(scope="module")
def alone():
    """One person, seen by all views without noise, misses or clutter; the other's heads are taken out."""
    meeting = random_meeting(7, kind="pass", noise_px=1e-9, misses=0.0, clutter=0.0)
    exact, inside = meeting.room.seen(meeting.places[:, 0])
    pixels = np.zeros_like(meeting.pixels)
    valid = np.zeros_like(meeting.valid)
    pixels[:, :, 0], valid[:, :, 0] = exact, inside
    return replace(meeting, pixels=pixels, valid=valid, places=meeting.places[:, :1])


def hidden(meeting, frames, cameras=slice(None)):
    valid = meeting.valid.copy()
    valid[frames, cameras] = False
    return replace(meeting, valid=valid)


def test_hidden_for_a_second_the_id_stays_and_the_gap_is_filled(alone):
    tracking = tracked(hidden(alone, slice(40, 52)))
    assert tracking.heads.people.tolist() == [1]
    assert (tracking.heads.status[40:52, 0] == Status.NO_VIEW).all()
    assert tracking.heads.sigma[46, 0] > 5 * tracking.heads.sigma[30, 0]
    error = np.linalg.norm(tracking.heads.positions[40:52, 0] - alone.places[40:52, 0], axis=1)
    assert (error < 3 * tracking.heads.sigma[40:52, 0]).all()


def test_away_for_longer_is_a_new_person(alone):
    heads = tracked(hidden(alone, slice(25, 60))).heads
    assert heads.people.tolist() == [1, 2]
    assert (heads.status[25:60] == Status.ABSENT).all()


def test_whom_two_views_see_again_beside_where_he_was_lost_keeps_his_id(alone):
    """Nobody else is there whose rays could cross."""
    places = alone.places[:, 0] + np.where(np.arange(len(alone.times)) < 60, 0.0, 0.6)[:, None] * [0, 1, 0]
    exact, inside = alone.room.seen(places)
    two = np.flatnonzero(inside[66:].all(axis=0))[:2]
    pixels, valid = alone.pixels.copy(), alone.valid.copy()
    pixels[:, :, 0], valid[:, :, 0] = exact, inside
    stepped = replace(alone, pixels=pixels, valid=valid)
    others = np.setdiff1d(np.arange(valid.shape[1]), two)
    heads = tracked(hidden(hidden(stepped, slice(60, 66)), slice(66, None), others)).heads
    assert heads.people.tolist() == [1]
    assert heads.measured[68:90, 0].all()


def test_what_is_hidden_never_matters(alone):
    spoilt = alone.pixels.copy()
    spoilt[~alone.valid] = np.nan
    one, other = tracked(alone), tracked(replace(alone, pixels=spoilt))
    np.testing.assert_array_equal(one.heads.positions, other.heads.positions)


def test_views_are_counted_and_named(alone):
    views = alone.valid[..., 0].sum(axis=1)
    tracking = tracked(alone)
    full = views[10] >= 3
    assert full
    assert tracking.heads.status[10, 0] == Status.MEASURED
    np.testing.assert_array_equal(tracking.heads.used[10, 0], alone.valid[10, :, 0])
    shown = np.flatnonzero(alone.valid[10, :, 0])
    for count, status in ((2, Status.TWO_VIEWS), (1, Status.ONE_VIEW)):
        less = tracked(hidden(alone, 10, shown[count:]))
        assert less.heads.status[10, 0] == status
        assert less.heads.used[10, 0].sum() == count


def test_nobody(alone):
    tracking = tracked(hidden(alone, slice(None)))
    assert tracking.heads.positions.shape == (len(alone.times), 0, 3)


def test_a_flash_of_two_frames_is_nobody(alone):
    valid = np.zeros_like(alone.valid)
    valid[30:32] = alone.valid[30:32]
    assert len(tracked(replace(alone, valid=valid)).heads.people) == 0


def test_weights_are_those_of_the_candidates(alone):
    """A view that is off hardly moves the head where it says how bad it is."""
    pixels, sigma = alone.pixels.copy(), np.full(alone.valid.shape, 4.0)
    camera = int(np.flatnonzero(alone.valid[:, :, 0].all(axis=0))[0])
    pixels[:, camera] += 5.0
    plain = tracked(replace(alone, pixels=pixels))
    sigma[:, camera] = 60.0
    told = tracked(replace(alone, pixels=pixels), sigma_px=sigma)
    error = [np.linalg.norm(t.heads.positions[20:60, 0] - alone.places[20:60, 0], axis=1).mean() for t in (plain, told)]
    assert error[1] < 0.2 * error[0]


def test_heights_and_room_bound_the_places(alone):
    assert len(tracked(alone, settings=TrackSettings(height_m=(0.6, 1.0))).heads.people) == 0
    far = np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 3.0]])
    assert len(tracked(alone, room=far).heads.people) == 0


def test_wrong_input_is_said(alone, any_shape):
    rig, pixels, valid, times = alone.room.rig, alone.pixels, alone.valid, alone.times
    with pytest.raises(InsufficientDataError, match="One camera gives no place"):
        track_heads(rig.select([0]), pixels[:, :1], valid[:, :1], times)
    with pytest.raises(ValueError, match=r"need pixels \(F, 6, K, 2\)"):
        track_heads(rig, pixels[:, :5], valid[:, :5], times)
    twice = times.copy()
    twice[3] = twice[2]
    with pytest.raises(ValueError, match=r"Times must rise, but frame 3 is at 0\.16 s"):
        track_heads(rig, pixels, valid, twice)
    state, _ = step(TrackerState(), rig, pixels[0], valid[0], 0.5)
    with pytest.raises(ValueError, match=r"A frame at 0\.5 s comes after one at 0\.5 s"):
        step(state, rig, pixels[1], valid[1], 0.5)
