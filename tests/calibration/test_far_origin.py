"""Rooms on a national grid: nothing that a calibration says may depend on how far away the origin is."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxpoint.calibration.alignment import align_to_landmarks
from jaxpoint.calibration.covariance import aligned_with_covariance
from jaxpoint.calibration.expected import expected_error, gains
from jaxpoint.io.calibration import read_calibration_json, write_calibration_json
from jaxpoint.triangulation import triangulate

GRID = np.array([313334.0, 5154531.0, 14.0])  # m, as UTM has it


@pytest.fixture(scope="module")
def aligned(free_room):
    """The same room about its own origin and on the grid."""
    known, calibration = free_room
    calibration = dataclasses.replace(calibration, unit="arbitrary")
    names = calibration.tracks.names
    centres = np.asarray(calibration.rig.positions)
    rooms = []
    for shift in (np.zeros(3), GRID):
        found = align_to_landmarks(centres, known.room.positions + shift, names=names, camera_centres=centres)
        rooms.append(aligned_with_covariance(calibration, found, np.full(len(names), 0.01)))
    return rooms


def test_the_covariance_of_places_is_the_same(aligned):
    here, there = aligned
    assert here.gauge == there.gauge == "landmarks"
    places = here.points[:10]
    expected = [
        expected_error(room.rig, room.camera_covariance, room.sigma_px, places + shift)
        for room, shift in ((here, 0 * GRID), (there, GRID))
    ]
    np.testing.assert_allclose(expected[1].total, expected[0].total, rtol=5e-3)
    more = gains(there.rig, there.camera_covariance, 0.3, 0.1, places + GRID, (places + GRID)[None])
    less = gains(here.rig, here.camera_covariance, 0.3, 0.1, places, places[None])
    assert more[0].after == pytest.approx(less[0].after, rel=5e-2)  # what rounding leaves of it out there


def test_a_file_keeps_it_and_triangulation_uses_it(aligned, tmp_path):
    here, there = aligned
    write_calibration_json(tmp_path / "calibration.json", there.rig, covariance=there.camera_covariance)
    saved = read_calibration_json(tmp_path / "calibration.json")
    np.testing.assert_array_equal(saved.covariance, there.camera_covariance)
    tracks = here.tracks
    with jax.enable_x64(True):
        near, far = (
            triangulate(rig, tracks.pixels, tracks.visible, sigma_px=0.3, camera_covariance=covariance)
            for rig, covariance in ((here.rig, here.camera_covariance), (saved.rig, saved.covariance))
        )
    good = np.asarray(near.valid)
    np.testing.assert_allclose(far.points[good], np.asarray(near.points)[good] + GRID, rtol=0, atol=1e-6)
    sizes = np.trace(near.covariance[good], axis1=1, axis2=2)  # m^2; rounding far away leaves 1 % of it
    assert (np.abs(far.covariance[good] - near.covariance[good]).max(axis=(1, 2)) < 0.01 * sizes).all()
    np.testing.assert_allclose(far.residuals[good], near.residuals[good], atol=1e-6)
