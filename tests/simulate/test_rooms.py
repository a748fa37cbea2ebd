"""Random rooms are what they say: checked with OpenCV and by their own statements."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxpoint.simulate.rooms import IMAGE_PX, MIN_SHARED, ROOM_M, random_room


@pytest.fixture(scope="module")
def room():
    return random_room(3, cameras=5, frames=400, visibility=0.8, outliers=0.1, noise_px=0.5)


def test_pixels_are_those_of_opencv(room):
    for camera in range(5):
        focal, (cx, cy) = room.focal[camera], room.center[camera]
        matrix = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
        vector = cv2.Rodrigues(room.rotation[camera])[0]
        theirs, _ = cv2.projectPoints(room.points, vector, room.translation[camera], matrix, room.distortion[camera])
        ours, inside = room.seen(room.points)
        np.testing.assert_allclose(ours[inside[:, camera], camera], theirs[inside[:, camera], 0], atol=1e-8)
        good = room.tracks.visible[:, camera] & ~room.is_outlier[:, camera]
        noise = room.tracks.pixels[good, camera] - theirs[good, 0]
        assert noise.std() == pytest.approx(room.noise_px, rel=0.1)
        assert np.abs(noise.mean(axis=0)).max() < 0.1


def test_the_rig_projects_alike(room):
    ours, inside = room.seen(room.points)
    np.testing.assert_allclose(np.asarray(room.rig.project(room.points))[inside], ours[inside], atol=1e-8)
    np.testing.assert_allclose(room.rig.positions, room.positions, atol=1e-12)


def test_a_camera_out_of_step_shows_the_light_late():
    """By whole frames it shows what it showed in the room in step; by a fraction, a place between two of those."""

    def shown(late):
        return random_room(
            3, cameras=4, visibility=1.0, outliers=0.0, noise_px=0.0, stride=40, time_offsets=np.array(late)
        ).tracks

    in_step, late = shown([0.0] * 4), shown([0.0, 2.0, -1.0, 0.5])
    for camera, rows in ((1, 2), (2, -1)):
        then, now = slice(max(-rows, 0), 300 - max(rows, 0)), slice(max(rows, 0), 300 + min(rows, 0))
        both = in_step.visible[then, camera] & late.visible[now, camera]
        assert both.sum() > 100
        np.testing.assert_allclose(late.pixels[now, camera][both], in_step.pixels[then, camera][both], atol=1e-8)
    seen = in_step.visible[1:, 3] & in_step.visible[:-1, 3] & late.visible[1:, 3]
    middle = (in_step.pixels[1:, 3] + in_step.pixels[:-1, 3]) / 2
    apart = np.linalg.norm(in_step.pixels[1:, 3] - in_step.pixels[:-1, 3], axis=1)
    assert np.median(apart[seen]) > 5.0
    assert np.median(np.linalg.norm(late.pixels[1:, 3] - middle, axis=1)[seen]) < 0.5


def test_outliers_are_gross_and_as_many_as_asked(room):
    exact, _ = room.seen(room.points)
    wrong = np.linalg.norm(room.tracks.pixels - exact, axis=-1)
    assert wrong[room.is_outlier].min() > 10 * room.noise_px
    assert wrong[room.tracks.visible & ~room.is_outlier].max() < 6 * room.noise_px
    assert room.is_outlier.sum() / room.tracks.visible.sum() == pytest.approx(0.1, abs=0.03)
    assert (room.is_epipolar <= room.is_outlier).all()
    assert room.is_epipolar.sum() / room.is_outlier.sum() == pytest.approx(1 / 3, abs=0.12)


def test_epipolar_outliers_lie_on_the_epipolar_line_of_another_view(room):
    """The ray of the wrong pixel meets the true ray of some other camera that saw the frame."""
    rays = room.rig.rays(room.tracks.pixels)
    origin, direction = np.asarray(rays.origin), np.asarray(rays.direction)
    for frame, camera in np.argwhere(room.is_epipolar):
        gaps = []
        for other in range(5):
            if other != camera and room.tracks.visible[frame, other]:
                toward = room.points[frame] - origin[frame, other]
                normal = np.cross(direction[frame, camera], toward / np.linalg.norm(toward))
                apart = abs(normal @ (origin[frame, camera] - origin[frame, other])) / np.linalg.norm(normal)
                gaps.append(apart)
        assert min(gaps) < 1e-4  # m


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_every_room_can_be_calibrated(seed):
    room = random_room(seed)
    tracks = room.tracks
    assert 3 <= tracks.cameras <= 12
    inside = tracks.pixels[tracks.visible]
    assert (inside >= -6).all()
    assert (inside <= np.array(IMAGE_PX) + 5).all()
    assert (room.points >= 0).all()
    assert (room.points <= ROOM_M).all()
    assert (room.positions >= 0).all()
    assert (room.positions <= ROOM_M).all()
    np.testing.assert_allclose(np.linalg.det(room.rotation), 1.0, atol=1e-12)
    shared = (tracks.visible[:, :, None] & tracks.visible[:, None, :]).sum(axis=0)
    np.fill_diagonal(shared, 0)
    assert ((shared >= MIN_SHARED).sum(axis=1) >= 2).all()
    depth = np.einsum("cj,fj->fc", room.rotation[:, 2], room.points) + room.translation[:, 2]
    assert (depth[tracks.visible] > 0).all()


def test_the_same_seed_gives_the_same_room():
    first, second, other = (random_room(seed, cameras=4, frames=100, visibility=0.9) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.tracks.pixels, second.tracks.pixels)
    np.testing.assert_array_equal(first.rotation, second.rotation)
    assert not np.array_equal(first.points, other.points)


def test_layouts():
    wall = random_room(1, cameras=6, frames=100, layout="wall", visibility=1.0)
    np.testing.assert_allclose(wall.positions[:, 1], 0.1, atol=1e-12)
    around = random_room(1, cameras=6, frames=100, layout="around", visibility=1.0)
    assert np.ptp(around.positions[:, 0]) > 4
    assert np.ptp(around.positions[:, 1]) > 3


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="No room with 4 cameras, 20 frames"):
        random_room(0, cameras=4, frames=20)
