"""The Euclidean upgrade of rigs whose truth is known, and the mirror that must not come out."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.stratification import Views, candidates, focal_grid, image_of_quadric, linear_quadric, upgrade

PAIRS = np.array([[0, 1], [0, 2], [1, 2], [2, 3]])
UNKNOWN = np.full(4, np.log(1.2)), 1e3  # nothing is believed of the focal lengths, so that the answer is exact


def scrambled(pinhole, seed, mirrored=False):
    """The true rig in a random projective frame, depths positive; `mirrored` gives the frame negative determinant."""
    rng = np.random.default_rng(seed)
    while True:
        frame = np.eye(4) + 0.3 * rng.normal(size=(4, 4))
        frame[3, :3] = 0.05 * rng.normal(size=3)
        points = pinhole.points @ frame.T
        if (np.linalg.det(frame) < 0) == mirrored and (points[:, 3] > 0).all():
            break
    cameras = pinhole.projections @ np.linalg.inv(frame)
    cameras = cameras / np.linalg.norm(cameras, axis=(1, 2))[:, None, None]
    points = points / points[:, 3:]
    belief, sigma = UNKNOWN
    views = Views(jnp.asarray(cameras), jnp.ones(4, bool), jnp.asarray(belief), jnp.asarray(sigma))
    return views, points


def true_focals(pinhole):
    return pinhole.room.focal / pinhole.data.half_diagonals


@pytest.mark.parametrize(("seed", "mirrored"), [(0, False), (1, False), (2, True), (3, True)])
def test_upgrade_recovers_the_room_and_never_its_mirror(pinhole, seed, mirrored):
    views, points = scrambled(pinhole, seed, mirrored)
    roots, costs = candidates(views, jnp.asarray(PAIRS))
    assert (np.diff(costs) >= 0).all()
    rig = upgrade(roots[0], views, jnp.asarray(points), jnp.asarray(pinhole.kept))
    np.testing.assert_allclose(rig.focal, true_focals(pinhole), rtol=1e-4)
    np.testing.assert_allclose(rig.center, 0.0, atol=1e-4)
    np.testing.assert_allclose(np.linalg.det(rig.rotation), 1.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rig.rotation, axis=2), 1.0, atol=1e-9)
    assert rig.in_front == 1.0
    depth = np.einsum("cj,fj->fc", rig.rotation[:, 2], rig.points) + np.asarray(rig.translation)[:, 2]
    assert (depth[pinhole.kept] > 0).all()
    used = pinhole.kept.any(axis=1)
    source, target = np.asarray(rig.points)[used], pinhole.points[used, :3]
    fitted = umeyama(source, target)
    assert np.linalg.norm(np.asarray(fitted @ source) - target, axis=1).max() < 1e-3  # m
    assert np.linalg.det(fitted.rotation) == pytest.approx(1.0)


def test_padding_changes_nothing(pinhole):
    views, points = scrambled(pinhole, 0)
    three = Views(views.projections[:3], views.exists[:3], views.log_focal[:3], views.log_focal_sigma)
    projections, focal = views.projections.at[3].set(jnp.eye(3, 4)), views.log_focal.at[3].set(0.0)
    padded = Views(projections, jnp.arange(4) < 3, focal, views.log_focal_sigma)
    grids = [jax.jit(focal_grid)(v, 0, 1) for v in (three, padded)]
    np.testing.assert_allclose(*grids, atol=1e-9)
    kept = pinhole.kept.copy()
    kept[:, 3] = False
    rigs = [
        upgrade(grids[0][0], v, jnp.asarray(points), jnp.asarray(kept[:, : len(v.exists)])) for v in (three, padded)
    ]
    np.testing.assert_allclose(rigs[0].rotation, rigs[1].rotation[:3], atol=1e-9)
    np.testing.assert_allclose(rigs[0].points, rigs[1].points, atol=1e-9)


def test_the_linear_quadric_is_right_where_the_belief_is(pinhole):
    """With the true focal lengths believed, the linear equations hold exactly."""
    views, _ = scrambled(pinhole, 1)
    views = eqx.tree_at(lambda v: v.log_focal, views, jnp.log(true_focals(pinhole)))
    omega = np.asarray(jax.jit(lambda v: image_of_quadric(v.projections, linear_quadric(v)))(views))
    expected = np.stack([np.diag([f**2, f**2, 1.0]) for f in true_focals(pinhole)])
    np.testing.assert_allclose(omega, expected, atol=1e-6)


def test_the_grid_comes_near_without_any_belief(pinhole):
    """Steps of the grid are a tenth; the best cell of the two reference cameras must be a neighbour of the truth."""
    views, _ = scrambled(pinhole, 2)
    roots = jax.jit(focal_grid)(views, 0, 2)
    omega = np.asarray(image_of_quadric(views.projections, roots[0]))
    found = np.sqrt(omega[[0, 2], 0, 0])
    assert np.abs(np.log(found / true_focals(pinhole)[[0, 2]])).max() < 0.3
    # The three offered are unlike each other.
    focals = [np.log(np.sqrt(np.asarray(image_of_quadric(views.projections, root))[[0, 2], 0, 0])) for root in roots]
    assert min(np.abs(focals[i] - focals[j]).max() for i in range(3) for j in range(i)) > 0.25


def test_the_upgrade_has_derivatives(pinhole):
    """Of a number of the Euclidean rig by the projective cameras, from hypotheses to focal lengths and rotations."""
    views, points = scrambled(pinhole, 0)
    views = eqx.tree_at(lambda v: v.log_focal_sigma, views, jnp.asarray(0.3))
    kept, rng = jnp.asarray(pinhole.kept), np.random.default_rng(1)

    def told(projections):
        own = eqx.tree_at(lambda v: v.projections, views, projections)
        rig = upgrade(candidates(own, jnp.asarray(PAIRS[:1]))[0][0], own, jnp.asarray(points), kept)
        relative = rig.rotation[1] @ rig.rotation[0].T
        return (relative * jnp.arange(9.0).reshape(3, 3)).sum() + rig.focal @ jnp.arange(4.0)

    start, step = views.projections, 0.1 * rng.normal(size=views.projections.shape)
    value, slope = jax.jit(told), jax.jit(jax.grad(told))(start)
    along = (value(start + 1e-4 * step) - value(start - 1e-4 * step)) / 2e-4
    assert float((slope * step).sum()) == pytest.approx(float(along), rel=1e-3)
