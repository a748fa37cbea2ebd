"""The light's motion in an image, and pixels moved in time, against exact paths and scipy."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from jaxpoint.motion import REACH, frame_step, held_still, motion, moved_to_clock, on_clock, without_jumps
from jaxpoint.tracks import Tracks

FRAMES = 200
SIZES = np.array([[1280, 720], [1280, 720]])


def cubic(moments):
    """A path that is a cubic in time, its velocity and its acceleration, (..., 2)."""
    t = np.asarray(moments, float)[..., None] / 50.0
    a, b, c = np.array([30.0, -20.0]), np.array([-90.0, 60.0]), np.array([400.0, 250.0])
    return ((a * t + b) * t + c) * t + 50.0, ((3 * a * t + 2 * b) * t + c) / 50.0, (6 * a * t + 2 * b) / 2500.0


def smooth(moments, camera):
    """A hand's path in the image of a camera, px."""
    knots = np.random.default_rng(camera).uniform([100, 100], [1100, 600], (20, 2))
    return CubicSpline(np.linspace(-5, FRAMES + 5, 20), knots)(moments)


def tracks_of(late, hidden=0.0, frame_ids=None):
    ids = np.arange(FRAMES) if frame_ids is None else frame_ids
    pixels = np.stack([smooth(ids - offset, camera) for camera, offset in enumerate(late)], axis=1)
    visible = np.random.default_rng(1).random((len(ids), len(late))) >= hidden
    return Tracks.from_pixels(pixels, SIZES[: len(late)], visible, frame_ids=ids)


@pytest.mark.parametrize("step", [1, 3])
def test_the_motion_of_a_cubic_path_is_exact(step):
    ids = step * np.arange(60)
    pixels, velocity, acceleration = (part[:, None] for part in cubic(ids))
    usable = np.random.default_rng(0).random((60, 1)) < 0.8
    found = motion(np.where(usable[..., None], pixels, 1e6), usable, ids)
    full = found.known & (found.acceleration_weights != 0).any(axis=-1)
    enough = full & (((found.velocity_weights != 0) | (found.acceleration_weights != 0)).sum(axis=-1) >= 5)
    both_sides = (found.velocity_weights[..., :REACH] != 0).sum(-1) >= 2
    both_sides &= (found.velocity_weights[..., REACH + 1 :] != 0).sum(-1) >= 2
    exact = enough & both_sides & usable
    assert exact.sum() > 30
    np.testing.assert_allclose(found.velocity[exact], velocity[exact], atol=1e-8)
    np.testing.assert_allclose(found.acceleration[exact], acceleration[exact], atol=1e-8)


def test_nothing_is_known_without_neighbours_on_both_sides():
    visible = np.zeros((40, 1), bool)
    visible[[3, 15, 16, 17, 30, 31]] = True
    found = motion(np.ones((40, 1, 2)), visible, np.arange(40))
    assert found.known[16, 0]
    assert not found.known[[3, 15, 17, 30, 31], 0].any()
    assert frame_step(np.array([0, 2, 4, 6, 20])) == 2.0


def test_a_whole_frame_late_is_a_row_later_exactly():
    late = tracks_of([0.0, 2.0])
    moved = moved_to_clock(late, np.array([0.0, 2.0]))
    np.testing.assert_array_equal(moved.pixels[:-2, 1], late.pixels[2:, 1])
    assert not moved.visible[-2:, 1].any()
    np.testing.assert_array_equal(moved.pixels[:, 0], late.pixels[:, 0])


@pytest.mark.parametrize("step", [1, 2])
def test_a_fraction_of_a_frame_against_the_true_path(step):
    ids = np.arange(0, FRAMES, step)
    late = np.array([0.0, -1.37])
    moved = moved_to_clock(tracks_of(late, 0.2, ids), late)
    wrong = np.linalg.norm(moved.pixels[:, 1] - smooth(ids, 1), axis=1)[moved.visible[:, 1]]
    assert len(wrong) > 0.6 * len(ids)
    unmoved = np.linalg.norm(smooth(ids + 1.37, 1) - smooth(ids, 1), axis=1)
    assert np.median(unmoved) > 10.0
    assert np.median(wrong) < 0.1 * step**3
    assert np.quantile(wrong, 0.95) < 1.5 * step**3


def test_what_has_no_neighbours_is_left_out_unless_nothing_moves():
    tracks = tracks_of([0.0, 0.5])
    alone = np.zeros_like(tracks.visible)
    alone[::10] = True
    sparse = Tracks.from_pixels(tracks.pixels, SIZES, alone)
    assert moved_to_clock(sparse, np.array([0.0, 0.5])).visible.sum(axis=0).tolist() == [20, 0]
    still = moved_to_clock(sparse, np.zeros(2))
    np.testing.assert_array_equal(still.visible, sparse.visible)
    np.testing.assert_array_equal(still.pixels, sparse.pixels)


def test_the_predicted_noise_is_that_of_repeated_draws():
    tracks = tracks_of([0.0, 0.4], 0.3)
    rng = np.random.default_rng(0)
    offsets = np.array([0.0, 0.4])

    def drawn():
        noisy = np.where(tracks.visible[..., None], tracks.pixels + rng.normal(0.0, 0.5, tracks.pixels.shape), 0.0)
        return moved_to_clock(Tracks.from_pixels(noisy, SIZES, tracks.visible), offsets).pixels

    spread = np.std([drawn() for _ in range(200)], axis=0).mean(axis=-1) / 0.5
    moving = motion(tracks.pixels, tracks.visible, tracks.frame_ids)
    clock = on_clock(tracks, moving, offsets)
    predicted = moving.gain(clock.rows, clock.ahead)[:, 1]
    seen = clock.visible[:, 1]
    np.testing.assert_allclose(spread[seen, 1], predicted[seen], rtol=0.25)


def test_a_verdict_goes_back_to_the_frame_that_it_is_about():
    late = tracks_of([0.0, 2.0])
    clock = on_clock(late, motion(late.pixels, late.visible, late.frame_ids), np.array([0.0, 2.0]))
    marked = np.zeros_like(late.visible)
    marked[50] = True
    assert np.argwhere(clock.back(marked)).tolist() == [[50, 0], [52, 1]]


@pytest.mark.parametrize("rate", [29.83 / 30, 25 / 30, 31.2 / 30])
def test_a_camera_of_another_rate_against_the_true_path(rate):
    ids = np.arange(FRAMES)
    pixels = np.stack([smooth(ids, 0), smooth((ids - 3.0) / rate, 1)], axis=1)
    tracks = Tracks.from_pixels(pixels, SIZES, np.ones((FRAMES, 2), bool))
    moved = moved_to_clock(tracks, np.array([0.0, 3.0]), np.array([1.0, rate]))
    inside = moved.visible[:, 1] & (ids < (FRAMES - 10) / max(rate, 1.0))
    assert inside.sum() > 0.85 * FRAMES / max(rate, 1.0) - 10
    wrong = np.linalg.norm(moved.pixels[:, 1] - smooth(ids, 1), axis=1)[inside]
    assert np.quantile(wrong, 0.95) < 1.5
    np.testing.assert_array_equal(moved.pixels[:, 0], tracks.pixels[:, 0])


@pytest.mark.parametrize("step", [1, 2])
def test_rolling_shutters_against_the_true_path(step):
    """Each pixel was seen when its row was read, one camera from above and one from below."""
    ids, readouts = np.arange(0, FRAMES, step), np.array([0.8, -0.6])
    moments = np.repeat(ids[:, None].astype(float), 2, axis=1)
    for _ in range(20):
        pixels = np.stack([smooth(moments[:, camera], camera) for camera in range(2)], axis=1)
        moments = ids[:, None] + readouts * (pixels[..., 1] / 720 - 0.5)
    visible = np.random.default_rng(1).random((len(ids), 2)) >= 0.2
    tracks = Tracks.from_pixels(pixels, SIZES, visible, frame_ids=ids)
    true = np.stack([smooth(ids, camera) for camera in range(2)], axis=1)
    moved = moved_to_clock(tracks, np.zeros(2), readouts=readouts)
    wrong, unmoved = (np.linalg.norm(part - true, axis=-1)[moved.visible] for part in (moved.pixels, pixels))
    assert moved.visible.sum() > 0.6 * visible.size
    assert np.median(unmoved) > 2.0
    assert np.median(wrong) < 0.01 * step**3
    assert np.quantile(wrong, 0.95) < 0.5 * step**3


def test_no_readout_is_a_global_shutter():
    tracks, late = tracks_of([0.0, 1.3], 0.2), np.array([0.0, 1.3])
    plain, same = moved_to_clock(tracks, late), moved_to_clock(tracks, late, readouts=np.zeros(2))
    np.testing.assert_array_equal(plain.visible, same.visible)
    np.testing.assert_allclose(plain.pixels, same.pixels, atol=1e-9)


def test_jumps_are_found_and_spare_their_neighbours():
    tracks = tracks_of([0.0, 0.0], 0.1)
    pixels, jump = tracks.pixels.copy(), np.array([20, 60, 61, 120])
    pixels[jump, 1] += np.array([90.0, -40.0])
    good = without_jumps(pixels, tracks.visible, tracks.frame_ids, np.array([1280.0, 1280.0]))
    assert not (good & ~tracks.visible).any()
    assert not good[jump[[0, 3]], 1].any()
    away = np.ones(FRAMES, bool)
    away[jump] = False
    assert good[away].sum() > 0.97 * tracks.visible[away].sum()


def test_a_light_that_stands_is_held_from_the_third_frame():
    tracks = tracks_of([0.0, 0.0])
    pixels, visible = tracks.pixels.copy(), tracks.visible.copy()
    pixels[50:60, 1], visible[54, 1] = pixels[50, 1], False
    pixels[100, 1] = pixels[101, 1]
    held = held_still(pixels, visible)
    assert np.argwhere(held)[:, 0].tolist() == [50, 51, 52, 53, 55, 56, 57, 58, 59]
    assert not held[:, 0].any()
