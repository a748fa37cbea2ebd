"""Which candidates of a frame are the same head: by hand, and rays against OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxpoint.body.tracking.head_association import Predictions, associate
from jaxpoint.body.tracking.rays import rays_of_frames
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.track import TrackSettings
from jaxpoint.simulate.rooms import random_room

SETTINGS = TrackSettings()
BOUNDS = np.array([[-1.0, -1.0, 0.6], [7.0, 6.0, 2.2]])
NOBODY = Predictions(np.zeros((0, 3)), np.zeros((0, 3, 3)))
PLACES = np.array([[2.6, 2.3, 1.62], [3.5, 2.9, 1.55]])  # m, two heads


@pytest.fixture(scope="module")
def room():
    return random_room(4, cameras=5, layout="around", frames=100, visibility=1.0, outliers=0.0)


def rays_to(room, places, cameras=None, sigma=4.0):
    """Rays of all cameras (or some) to some places (m) whether or not they are inside the image.

    K is always 4, so that one program is compiled.
    """
    pixels = np.zeros((1, len(room.rig), 4, 2))
    pixels[0, :, : len(places)] = np.asarray(room.rig.project(places)).transpose(1, 0, 2)
    valid = np.zeros(pixels.shape[:3], bool)
    valid[:, :, : len(places)] = True
    if cameras is not None:
        valid[:, np.setdiff1d(np.arange(len(room.rig)), cameras)] = False
    return rays_of_frames(room.rig, pixels, valid, np.full(valid.shape, sigma))[0]


def heads(room, rays, predictions=NOBODY, settings=SETTINGS):
    found = associate(rays, len(room.rig), predictions, settings, BOUNDS)
    return found.tracks.tolist(), found.candidates.tolist()


def test_rays_are_opencvs(room):
    pixels = np.random.default_rng(0).uniform([300, 200], [900, 500], (1, 5, 4, 2))
    rays = rays_of_frames(room.rig, pixels, np.ones((1, 5, 4), bool), np.full((1, 5, 4), 4.0))[0]
    for camera in range(5):
        matrix = np.asarray(room.rig[camera].intrinsics)
        stop = cv2.TERM_CRITERIA_COUNT, 50, 0
        ideal = cv2.undistortPoints(pixels[0, camera][:, None], matrix, room.distortion[camera], None, None, None, stop)
        ahead = np.column_stack([ideal[:, 0], np.ones(4)]) @ room.rotation[camera]
        own = rays.camera == camera
        np.testing.assert_allclose(rays.direction[own], ahead / np.linalg.norm(ahead, axis=1, keepdims=True), atol=1e-9)
        np.testing.assert_allclose(rays.origin[own], np.tile(room.positions[camera], (4, 1)), atol=1e-9)


def test_sigma_of_a_ray_is_the_angle_that_the_pixels_noise_makes(room):
    rng = np.random.default_rng(1)
    pixel = np.array([500.0, 300.0])
    noisy = np.tile(pixel, (1, 5, 20001, 1)) + rng.normal(0, 4.0, (1, 5, 20001, 2))
    noisy[:, :, 0] = pixel
    rays = rays_of_frames(room.rig, noisy, np.ones(noisy.shape[:3], bool), np.full(noisy.shape[:3], 4.0))[0]
    for camera in range(5):
        own = rays.direction[rays.camera == camera]
        squared = (np.cross(own[1:], own[0]) ** 2).sum(axis=1).mean()  # of two directions across
        np.testing.assert_allclose(rays.sigma[rays.camera == camera][0], np.sqrt(squared / 2), rtol=0.05)


def test_what_the_lens_does_not_know_is_left_out(room):
    lenses = np.array(room.distortion)
    lenses[0] = [-0.35, 0.0, 0.0, 0.0, 0.0]
    rig = CameraRig.from_parameters(
        np.full((5, 2), 600.0), room.center, lenses, room.rotation, room.translation, room.tracks.image_sizes
    )
    pixels = np.full((1, 5, 4, 2), 1e4)
    rays = rays_of_frames(rig, pixels, np.ones((1, 5, 4), bool), np.full((1, 5, 4), 4.0))[0]
    assert 0 not in rays.camera
    assert np.isfinite(rays.direction).all()


def test_two_heads_are_told_apart_and_each_candidate_is_used_once(room):
    tracks, candidates = heads(room, rays_to(room, PLACES))
    assert tracks == [-1, -1]
    assert sorted(candidates) == [[0] * 5, [1] * 5]


def test_order_of_candidates_does_not_matter(room):
    _, candidates = heads(room, rays_to(room, PLACES[::-1]))
    assert sorted(candidates) == [[0] * 5, [1] * 5]


def test_a_stray_candidate_is_left_out(room):
    rays = rays_to(room, PLACES[:1])
    wrong = rays.direction.copy()
    wrong[2] = rays_to(room, PLACES[:1] + np.array([0.0, 0.0, 0.5])).direction[2]
    _, candidates = heads(room, replace(rays, direction=wrong))
    assert candidates == [[0, 0, -1, 0, 0]]


@pytest.fixture(scope="module")
def level():
    """Four cameras at the height of the heads, where any two rays meet."""
    places = np.array([[0.1, 0.1], [5.9, 0.2], [5.8, 4.9], [0.2, 4.8]])
    position = np.column_stack([places, np.full(4, 1.6)])
    forward = np.array([3.0, 2.5, 1.6]) - position
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return CameraRig.from_parameters(
        np.full((4, 2), 800.0), np.tile([639.5, 359.5], (4, 1)), np.zeros((4, 5)), rotation,
        -np.einsum("cij,cj->ci", rotation, position), np.tile([1280, 720], (4, 1)),
    )  # fmt: skip


class Level:
    """What `rays_to` asks of a room."""

    def __init__(self, rig):
        self.rig = rig


LEVEL_PLACES = np.array([[2.5, 2.4, 1.6], [3.5, 2.7, 1.6]])


def test_two_views_of_two_people_are_not_believed(level):
    rays = rays_to(Level(level), LEVEL_PLACES, cameras=[0, 1])
    assert heads(Level(level), rays) == ([], [])


def test_two_views_of_one_person_are(level):
    rays = rays_to(Level(level), LEVEL_PLACES[:1], cameras=[0, 1])
    assert heads(Level(level), rays) == ([-1], [[0, 0, -1, -1]])


def test_a_third_view_suppresses_the_ghosts(level):
    _, candidates = heads(Level(level), rays_to(Level(level), LEVEL_PLACES, cameras=[0, 1, 2]))
    assert sorted(candidates) == [[0, 0, 0, -1], [1, 1, 1, -1]]


def test_tracks_suppress_the_ghosts_of_two_views(level):
    expected = Predictions(LEVEL_PLACES[::-1] + 0.03, np.tile(0.05**2 * np.eye(3), (2, 1, 1)))
    tracks, candidates = heads(Level(level), rays_to(Level(level), LEVEL_PLACES, cameras=[0, 1]), expected)
    assert sorted(zip(tracks, candidates)) == [(0, [1, 1, -1, -1]), (1, [0, 0, -1, -1])]


def test_one_view_goes_to_the_track_that_is_expected_there(level):
    expected = Predictions(LEVEL_PLACES, np.tile(0.05**2 * np.eye(3), (2, 1, 1)))
    rays = rays_to(Level(level), LEVEL_PLACES[1:], cameras=[3])
    assert heads(Level(level), rays, expected) == ([1], [[-1, -1, -1, 0]])
    lost = replace(expected, covariances=np.tile(0.5**2 * np.eye(3), (2, 1, 1)))
    assert heads(Level(level), rays, lost) == ([], [])


def test_heads_lie_within_the_heights(level):
    for height, seen in ((0.3, 0), (1.0, 1), (2.4, 0)):
        rays = rays_to(Level(level), np.array([[2.5, 2.4, height]]))
        assert len(heads(Level(level), rays)[0]) == seen
