"""Recordings that cannot calibrate anything: one sentence or two with the number and the remedy."""

import re

import numpy as np
import pytest

from jaxpoint.calibration.degenerate import check_volume
from jaxpoint.calibration.pairs import check_pairs, pair_table
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.errors import InsufficientDataError
from jaxpoint.simulate.rooms import ROOM_M, random_room
from jaxpoint.tracks import Tracks


@pytest.fixture(scope="module")
def room():
    return random_room(11, cameras=4, frames=300, layout="around", visibility=0.85, outliers=0.0, noise_px=0.5)


def changed(tracks, pixels=None, visible=None):
    return Tracks.from_pixels(
        tracks.pixels if pixels is None else pixels,
        tracks.image_sizes,
        tracks.visible if visible is None else visible,
        names=("north", "east", "south", "west")[: tracks.cameras],
    )


def refused(tracks, *words):
    """The message of the refusal, once it has been held against the rules for messages."""
    with pytest.raises(InsufficientDataError) as caught:
        calibrate(tracks)
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert re.search(r"\d", message), message
    assert len(re.findall(r"[.;:] |\.$", message)) <= 4, message
    assert len(message) < 300
    assert caught.value.exit_code == 4
    return message


def seen_by_room(room, points, seed=0):
    """Tracks of other points in the same room, with the same noise."""
    pixels, inside = room.seen(points)
    pixels = pixels + np.random.default_rng(seed).normal(0.0, room.noise_px, pixels.shape)
    return changed(room.tracks, np.where(inside[..., None], pixels, 0.0), inside)


def test_two_cameras_need_known_intrinsics(room):
    refused(room.tracks.select_cameras([0, 1]), "at least 3 cameras", "are 2", "--intrinsics")


def test_one_camera_is_never_enough(room):
    with pytest.raises(InsufficientDataError, match="at least 2 cameras, but there is 1"):
        calibrate(room.tracks.select_cameras([0]), intrinsics=room.rig.select([0]))


def test_intrinsics_must_be_of_these_cameras(room):
    with pytest.raises(ValueError, match="Intrinsics of 3 cameras were given for tracks of 4"):
        calibrate(room.tracks, intrinsics=room.rig.select([0, 1, 2]))


def test_too_few_frames(room):
    shared = np.flatnonzero(room.tracks.visible.sum(axis=1) >= 2)
    refused(changed(room.tracks).select_frames(shared[:15]), "Only 15 frames", "at least 20", "longer")


def test_a_camera_that_shares_nothing(room):
    visible = room.tracks.visible.copy()
    visible[:, 2] &= ~visible[:, [0, 1, 3]].any(axis=1)
    refused(changed(room.tracks, visible=visible), "Camera 'south' shares 0 frames", "20", "--leave-out")


def test_two_groups_that_are_not_connected(room):
    visible = room.tracks.visible.copy()
    visible[:150, :2] = visible[150:, 2:] = False
    refused(changed(room.tracks, visible=visible), "south, west", "north, east", "20", "both groups")


def test_one_recording_given_twice(room):
    pixels, visible = room.tracks.pixels.copy(), room.tracks.visible.copy()
    pixels[:, 3], visible[:, 3] = pixels[:, 1], visible[:, 1]
    refused(changed(room.tracks, pixels, visible), "'east' and 'west'", "identical", "drop one")


def test_a_light_that_never_moves(room):
    points = np.tile(ROOM_M / 2 - [0.0, 0.0, 0.5], (300, 1))
    refused(seen_by_room(room, points), "hardly moves", "px", "wave the light")


def test_a_light_that_moves_on_a_line(room):
    share = np.linspace(-1.0, 1.0, 300)[:, None]
    refused(seen_by_room(room, ROOM_M / 2 - [0.0, 0.0, 0.5] + share * [0.9, 0.7, 0.3]), "straight line", "px", "volume")


def test_a_light_that_moves_on_a_plane(room):
    rng = np.random.default_rng(1)
    flat = ROOM_M / 2 - [0.0, 0.0, 0.5] + rng.uniform(-1.0, 1.0, (300, 1)) * [1.5, 0.4, 0.1]
    flat = flat + rng.uniform(-1.0, 1.0, (300, 1)) * [-0.3, 1.2, 0.4]
    refused(seen_by_room(room, flat), "plane", "volume")


def test_a_light_that_stays_in_one_corner(room):
    pixels = room.tracks.pixels.copy()
    pixels[:, 1] = 20.0 + pixels[:, 1] / [1280, 720] * [150, 100]
    refused(changed(room.tracks, pixels), "Camera 'east'", "image area", "%", "rest of its view")


def test_an_unsynchronised_camera(room):
    pixels, visible = room.tracks.pixels.copy(), room.tracks.visible.copy()
    pixels[:, 2], visible[:, 2] = np.roll(pixels[:, 2], 100, axis=0), np.roll(visible[:, 2], 100)
    found = calibrate(changed(room.tracks, pixels, visible))
    assert found.rig.names == ("north", "east", "west")
    (why,) = found.findings
    assert (why.cause, why.left_out) == ("out of step", True)
    assert "south shows the light 100 frames late" in why.finding
    assert "--offset south=100" in why.remedy


def test_an_unsynchronised_camera_of_three(room):
    """Two cameras are left without it, which are too few."""
    pixels, visible = room.tracks.pixels.copy(), room.tracks.visible.copy()
    pixels[:, 2], visible[:, 2] = np.roll(pixels[:, 2], 100, axis=0), np.roll(visible[:, 2], 100)
    refused(changed(room.tracks, pixels, visible).select_cameras([0, 1, 2]), "Camera 'south'", "same time")


def test_points_without_volume():
    rng = np.random.default_rng(2)
    path = rng.normal(size=(200, 3)) * [1.0, 0.8, 0.5]
    check_volume(path)
    with pytest.raises(InsufficientDataError, match=r"0\.5% as thick .* volume"):
        check_volume(path * [1.0, 1.0, 0.01])
    with pytest.raises(InsufficientDataError, match="Only 3 positions"):
        check_volume(path[:3])


def test_the_pair_table_counts(room):
    table = pair_table(room.tracks)
    check_pairs(room.tracks, table)
    visible = room.tracks.visible
    for i in range(4):
        for j in range(4):
            assert table.shared[i, j] == (visible[:, i] & visible[:, j]).sum()
        cells = {(int(x // 160), int(y // 120)) for x, y in room.tracks.pixels[visible[:, i], i]}
        assert table.coverage[i] == len(cells) / 48
    np.testing.assert_array_equal(table.seen, visible.sum(axis=0))
