"""float32 handed to what is float64, and the other way: the higher precision counts, and nothing speaks of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.body.limb_axis import fit_axis
from jaxpoint.camera.resection import resect
from jaxpoint.geometry.arrays import promote
from jaxpoint.geometry.pose import Similarity
from jaxpoint.triangulation import triangulate

SINGLE, DOUBLE = np.float32, np.float64


def cast(tree, dtype):
    """All floating arrays of a tree in one precision."""
    return jax.tree.map(
        lambda leaf: jnp.asarray(leaf).astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree
    )


@pytest.mark.parametrize(("of_rig", "of_pixels"), [(DOUBLE, SINGLE), (SINGLE, DOUBLE), (SINGLE, SINGLE)])
def test_triangulation_and_the_rig(solved_room, of_rig, of_pixels):
    _, truth = solved_room
    rig, tracks = cast(truth.rig, of_rig), truth.tracks
    pixels, covariance = tracks.pixels.astype(of_pixels), 1e-6 * np.eye(60, dtype=of_rig)
    found = triangulate(rig, pixels, tracks.visible, sigma_px=0.3, camera_covariance=covariance)
    best = triangulate(truth.rig, tracks.pixels, tracks.visible, sigma_px=0.3, camera_covariance=1e-6 * np.eye(60))
    wanted = np.result_type(of_rig, of_pixels)
    assert found.points.dtype == found.covariance.dtype == found.residuals.dtype == wanted
    good = np.asarray(best.valid)
    np.testing.assert_allclose(found.points[good], best.points[good], atol=2e-3)
    np.testing.assert_allclose(found.covariance[good], best.covariance[good], rtol=0.05, atol=1e-6)
    points = truth.points.astype(of_pixels)
    whole = rig.project(points), rig.depth(points), rig.undistort(pixels)[0], rig.rays(pixels).direction
    assert {values.dtype for values in whole} == {np.dtype(wanted)}


def test_a_rig_moved_by_another_precision_still_triangulates(solved_room):
    _, truth = solved_room
    moved = cast(truth.rig, SINGLE).transformed(Similarity(np.ones(()), np.eye(3), np.array([1.0, 2.0, 3.0])))
    found = triangulate(moved, truth.tracks.pixels, truth.tracks.visible)
    good = np.asarray(found.valid) & truth.kept.any(axis=1)
    assert np.median(np.linalg.norm(np.asarray(found.points)[good] - truth.points[good] - [1, 2, 3], axis=1)) < 0.02


def test_float64_is_never_cut_silently(solved_room):
    _, truth = solved_room
    rig = cast(truth.rig, SINGLE)
    with jax.enable_x64(False), pytest.raises(ValueError, match="JAX would cut it to float32"):
        triangulate(rig, truth.tracks.pixels, truth.tracks.visible)
    with jax.enable_x64(False):
        single = truth.tracks.pixels[:4].astype(SINGLE)
        assert triangulate(rig, single, truth.tracks.visible[:4]).points.dtype == SINGLE


@pytest.mark.parametrize(("first", "second"), [(SINGLE, DOUBLE), (DOUBLE, SINGLE)])
def test_axes_and_single_cameras(solved_room, first, second):
    rng = np.random.default_rng(0)
    tip, direction, span = np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.1, 0.3])
    origins = np.array([[0.0, 3.0, 0.5], [0.5, -3.0, 1.0], [-3.0, 0.5, 2.0]])
    rays = (tip - np.linspace(0.05, 0.35, 7)[:, None] * direction)[None] - origins[:, None]
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    given = (origins, np.full(3, 900.0), rays)
    axis = fit_axis(
        *cast(given, first), np.ones((3, 7), bool), *cast((tip, direction), second), cast(np.ones(3), first), span
    )
    assert axis.direction.dtype == DOUBLE
    np.testing.assert_allclose(axis.direction, direction, atol=1e-5)
    _, truth = solved_room
    points = rng.uniform(-1, 1, (12, 3)) + truth.points[:60].mean(axis=0)
    found = resect(cast(points, first), cast(truth.rig[0].project(points), second))
    assert found.camera.focal.dtype == DOUBLE


def test_promotion_keeps_what_is_no_float():
    ints, floats = promote(np.arange(3), np.ones(2, SINGLE))
    assert ints.dtype == np.arange(3).dtype
    assert floats.dtype == SINGLE
