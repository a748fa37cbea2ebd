"""Rooms, true rigs and helpers shared by the tests of the calibration.

Compilation dominates: all rooms have 4 cameras or fewer and at most 512 frames, so that they share their programs.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from jaxpoint.calibration.recording import Recording, RigState
from jaxpoint.calibration.twoview import TwoViewGeometry, normalise_tracks
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import CENTER, FOCAL, size_of
from jaxpoint.simulate.rooms import RandomRoom, random_room
from jaxpoint.tracks import Tracks


def true_state(room: RandomRoom, recording: Recording) -> RigState:
    """The true rig as the adjustment writes it."""
    size, count = len(recording.image_sizes), recording.cameras
    numbers, base = np.zeros((size, size_of(Brown))), np.tile(np.eye(3), (size, 1, 1))
    base[:count] = room.rotation
    numbers[:count, 3:6] = room.translation
    numbers[:, FOCAL] = np.log(1000.0)
    numbers[:count, FOCAL] = np.log(room.focal)
    numbers[:count, CENTER] = room.center
    numbers[:count, 10:] = room.distortion
    points = np.zeros((len(recording.visible), 3))
    points[: recording.frames] = room.points
    return RigState(numbers, base, points)


def room_fundamental(room: RandomRoom, first: int, second: int) -> np.ndarray:
    """F with ray_second^T F ray_first = 0, of ideal image points over half the diagonal about the image centre."""
    half = np.hypot(*room.tracks.image_sizes.T) / 2
    middle = (room.tracks.image_sizes - 1) / 2
    inverse = []
    for camera in (first, second):
        focal, shift = room.focal[camera], (room.center - middle)[camera]
        matrix = np.array([[focal, 0, shift[0]], [0, focal, shift[1]], [0, 0, half[camera]]]) / half[camera]
        inverse.append(np.linalg.inv(matrix))
    turn = room.rotation[second] @ room.rotation[first].T
    x, y, z = room.translation[second] - turn @ room.translation[first]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = inverse[1].T @ cross @ turn @ inverse[0]
    return matrix / np.linalg.norm(matrix)


@pytest.fixture(scope="session")
def noisy():
    """Four cameras, 300 frames, 0.5 px of noise, 5 % of outliers: what is measured, and the truth."""
    room = random_room(11, cameras=4, frames=300, layout="around", visibility=0.85, outliers=0.05, noise_px=0.5)
    recording = Recording.of(room.tracks)
    return SimpleNamespace(room=room, recording=recording, truth=true_state(room, recording))


@pytest.fixture(scope="session")
def pinhole():
    """Four perfect cameras (no distortion, no noise, no outliers) with gaps, and their true epipolar geometry."""
    drawn = random_room(5, cameras=4, frames=300, layout="around", visibility=0.8, outliers=0.0, noise_px=0.0)
    middle = (drawn.tracks.image_sizes - 1) / 2.0
    lens = {"center": middle, "distortion": np.zeros((4, 5))}
    room = RandomRoom(**{**{name: getattr(drawn, name) for name in drawn.__dataclass_fields__}, **lens})
    pixels, inside = room.seen(room.points)
    visible = inside & (np.random.default_rng(0).random(inside.shape) < 0.8)
    tracks = Tracks.from_pixels(pixels, drawn.tracks.image_sizes, visible)
    room = RandomRoom(**{**{name: getattr(room, name) for name in room.__dataclass_fields__}, "tracks": tracks})
    data = normalise_tracks(tracks)
    kept = data.visible & (data.visible.sum(axis=1) >= 2)[:, None]
    shared = data.visible.T.astype(int) @ data.visible.astype(int)
    pairs = {(i, j): room_fundamental(room, i, j) for i in range(4) for j in range(i + 1, 4)}
    geometry = TwoViewGeometry(np.zeros(4), pairs, shared, shared, np.ones(data.visible.shape))
    projections = np.einsum("cij,cjk->cik", ideal_matrices(room), poses(room))
    points = np.ones((len(data.points), 4))
    points[:, :3] = room.points.mean(axis=0)
    points[: len(room.points), :3] = room.points
    return SimpleNamespace(
        room=room,
        data=data,
        kept=kept,
        geometry=geometry,
        projections=projections,
        points=points,
        recording=Recording.of(tracks),
    )


def ideal_matrices(room: RandomRoom) -> np.ndarray:
    """K over half the diagonal about the image centre, (C, 3, 3), of cameras whose principal point lies there."""
    half = np.hypot(*room.tracks.image_sizes.T) / 2
    return np.stack([np.diag([f, f, 1.0]) for f in room.focal / half])


def poses(room: RandomRoom) -> np.ndarray:
    """[R | t] of every camera, (C, 3, 4)."""
    return np.concatenate([room.rotation, room.translation[:, :, None]], axis=2)


@pytest.fixture(scope="session")
def state_of():
    """The function that writes a room's true rig as the adjustment does."""
    return true_state
