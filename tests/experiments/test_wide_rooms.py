"""The drawn rooms with wide lenses, and rigs of many cameras; the truth as it is solved for."""

import numpy as np
import pytest

from jaxpoint.calibration.recording import Recording, project
from large_rigs import USUAL, large_rig
from wide_rooms import seen, true_fisheye_state, wide_room


@pytest.fixture(scope="module")
def room():
    return wide_room(5)


def test_a_seed_gives_its_room_and_what_was_asked_for(room):
    again = wide_room(5)
    np.testing.assert_array_equal(room.tracks.pixels, again.tracks.pixels)
    angles = [2 * np.rad2deg(lens.half_angle) for lens in room.lenses if lens.law != "ordinary"]
    assert all(100 <= angle <= 190 for angle in angles)
    assert 0.03 < room.is_outlier.sum() / room.tracks.visible.sum() < 0.07
    good = room.tracks.visible & ~room.is_outlier
    exact, inside = seen((room.lenses, room.center, room.rotation, room.translation), room.points)
    assert inside[room.tracks.visible].all()
    off = np.linalg.norm(room.tracks.pixels - exact, axis=-1)
    assert off[good].max() < 6 * room.noise_px
    assert off[room.is_outlier].min() > 6 * room.noise_px


def test_the_reference_starts_at_the_truth(room):
    recording = Recording.of(room.tracks)
    pixels, _ = project(true_fisheye_state(room, recording))
    exact, inside = seen((room.lenses, room.center, room.rotation, room.translation), room.points)
    count, frames = room.tracks.cameras, room.tracks.frames
    assert np.abs(pixels[:frames, :count] - exact)[inside].max() < 0.2  # what four coefficients leave of other laws


@pytest.mark.parametrize("layout", USUAL)
def test_cameras_of_a_large_rig_share_frames(layout):
    rig = large_rig(layout, 12, 0)
    visible = rig.tracks.visible.astype(int)
    shared = visible.T @ visible
    assert (np.sort(shared, axis=1)[:, -3] >= 30).all()
