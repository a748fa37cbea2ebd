"""Two calibrations against each other: simulated pairs, moved cameras, and least squares written out."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration import difference as diff
from jaxpoint.calibration.alignment import transformed_covariance
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.gauge import gauge_directions_of_cameras
from jaxpoint.calibration.sight import in_view
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.simulate.recalibration import Recalibrated, from_truth

PAIRS = 10
ELSEWHERE = Similarity.exp(jnp.array([1.0, -2.0, 0.5, 0.4, -1.1, 2.0, np.log(0.3)]))


@pytest.fixture(scope="module")
def room():
    return Recalibrated.of(1, cameras=4, frames=200, noise_px=0.5)


def calibrated(room, seed):
    return with_covariance(from_truth(room, "least_squares", np.random.default_rng([seed, 5])))


def compared(one, other, **options):
    both = one.camera_covariance, other.camera_covariance
    return diff.difference(one.rig, other.rig, one.points[one.point_valid][::3], both, **options)


@pytest.fixture(scope="module")
def pairs(room):
    return [(calibrated(room, 2 * seed), calibrated(room, 2 * seed + 1)) for seed in range(PAIRS)]


def test_two_recordings_of_one_room_are_consistent(pairs):
    found = [compared(*pair) for pair in pairs]
    allowed = [one.allowed for one in found]
    freedoms = allowed[0].freedoms
    assert freedoms == 4 * 11 - 7
    assert all(one.consistent and one.culprits == () for one in allowed)
    # Ten independent chi-squares: within four standard deviations.
    mean = np.mean([one.ratio_all**2 for one in allowed])
    assert mean == pytest.approx(1.0, abs=4 * np.sqrt(2 / (freedoms * PAIRS)))
    # All places of a pair share one error, so these scatter more.
    for ratios in (
        [(one.pixels / one.allowed.pixels) ** 2 for one in found],
        [(one.centres / one.allowed.centres) ** 2 for one in found],
        [(one.points / one.allowed.points) ** 2 for one in found],
        [one.allowed.ratio**2 for one in found],
    ):
        assert 0.6 < np.mean(ratios) < 1.6


@pytest.mark.parametrize(("camera", "shift_m"), [(2, 0.02), (0, 0.3)])
def test_a_moved_camera_is_named(room, pairs, camera, shift_m):
    moved = room.room.translation.copy()
    moved[camera, 0] += shift_m
    there = replace(room.room, translation=moved)
    again = replace(room, room=there, exact=there.seen(room.room.points)[0])
    found = compared(pairs[0][0], calibrated(again, 99))
    assert not found.allowed.consistent
    assert found.allowed.culprits == (camera,)
    others = np.arange(4) != camera
    assert found.allowed.ratio[camera] > 3
    assert (found.allowed.ratio[others] < 1.6).all()
    assert found.pixels[camera] > 2.5 * found.pixels[others].max()


def test_another_frame_changes_nothing(pairs):
    one, other = pairs[1]
    plain = compared(one, other)
    rig = other.rig.transformed(ELSEWHERE)
    away = replace(other, rig=rig, camera_covariance=transformed_covariance(other.camera_covariance, rig, ELSEWHERE))
    found = compared(one, away)
    np.testing.assert_allclose(found.pixels, plain.pixels, rtol=1e-6)
    np.testing.assert_allclose(found.moved, plain.moved, atol=1e-7)
    assert found.allowed.ratio_all == pytest.approx(plain.allowed.ratio_all, rel=1e-4)
    np.testing.assert_allclose(found.allowed.pixels, plain.allowed.pixels, rtol=1e-4)
    same = compared(one, replace(one, rig=one.rig.transformed(ELSEWHERE)))
    assert same.points < 1e-8
    assert same.pixels.max() < 1e-6
    assert float(same.similarity.scale) == pytest.approx(1 / 0.3)


def test_chi_square_is_that_of_least_squares_written_out(pairs):
    """With covariances of full rank: whiten, and let least squares find the frame."""
    one, other = pairs[2]
    rng = np.random.default_rng(0)
    joint = one.camera_covariance + other.camera_covariance
    scale = np.sqrt(np.diag(joint))
    scale = np.where(scale > 0, scale, 1e-3)
    mixed = rng.normal(size=(60, 60)) * 0.1
    full = np.outer(scale, scale) * (np.eye(60) + mixed @ mixed.T)
    apart, ways = scale * rng.normal(size=60), gauge_directions_of_cameras(one.rig)

    def least(kept):
        part = np.repeat(kept, 15)
        root = np.linalg.inv(np.linalg.cholesky(full[np.ix_(part, part)]))
        of_frame = root @ ways[kept].reshape(-1, 7)
        away = root @ apart[part]
        return ((away - of_frame @ np.linalg.lstsq(of_frame, away)[0]) ** 2).sum()

    found = diff._squares(apart.reshape(4, 15), full.reshape(4, 15, 4, 15), ways, range(4))
    everything = np.ones(4, bool)
    assert (found.whole, found.freedoms) == (pytest.approx(least(everything), rel=1e-6), 53)
    for c in range(4):
        assert found.shares[c] == pytest.approx(least(everything) - least(np.arange(4) != c), rel=1e-5)
        assert found.share_freedoms[c] == 15


def test_without_an_alignment_the_frame_counts(pairs):
    one = pairs[3][0]
    shifted = one.rig.transformed(Similarity(jnp.ones(()), jnp.eye(3), jnp.array([0.0, 0.0, 0.02])))
    places = one.points[one.point_valid][::3]
    found = diff.difference(one.rig, shifted, places, align=False)
    np.testing.assert_allclose(found.centres, 0.02, rtol=1e-6)
    np.testing.assert_allclose(found.moved, np.tile([0, 0, 0.02], (len(found.moved), 1)), atol=1e-6)
    assert found.allowed is None
    assert diff.difference(one.rig, shifted, places).centres.max() < 1e-7


def test_sampled_places_are_seen(room):
    places = diff.sampled_places(room.truth().rig)
    assert 100 <= len(places) <= diff.PLACES
    assert (in_view(room.truth().rig, places).sum(axis=1) >= 2).all()


def test_what_cannot_be_compared_is_named(pairs):
    one, other = pairs[0]
    renamed = CameraRig(other.rig.cameras, other.rig.image_sizes, tuple("abcd"))
    with pytest.raises(ValueError, match="The cameras differ"):
        diff.difference(one.rig, renamed, one.points)
    with pytest.raises(InsufficientDataError, match="1 camera in common"):
        diff.difference(one.rig.select([0]), other.rig.select([0]), one.points)
    with pytest.raises(InsufficientDataError, match="Only 0 places"):
        diff.difference(one.rig, other.rig, one.points + 1e3)
