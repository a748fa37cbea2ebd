"""Rotations against scipy and jaxlie, with derivatives near 0 and near pi."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from jaxpoint.geometry import rotation as so3

ANGLES = [0.0, 1e-12, 1e-8, 1e-5, 1e-3, 0.3, 0.499999, 0.500001, 1.0, 2.0, 3.0, np.pi - 1e-4, np.pi - 1e-8]
AXES = np.random.default_rng(0).normal(size=(4, 3))
ROTVECS = np.array([angle * axis / np.linalg.norm(axis) for angle in ANGLES for axis in AXES])
EXP, LOG, NEAREST = jax.jit(so3.exp), jax.jit(so3.log), jax.jit(so3.nearest_rotation)
EXP_JACOBIAN = jax.jit(jax.jacfwd(lambda d, rotvec: so3.exp(rotvec + d) @ so3.exp(rotvec).T))
LOG_JACOBIAN = jax.jit(jax.jacrev(lambda d, start: so3.log(so3.exp(d) @ start)))
JACOBIAN_PAIR = jax.jit(lambda rotvec: (so3.left_jacobian(rotvec), so3.left_jacobian_inverse(rotvec)))


def test_exp_is_scipys():
    ours = jax.jit(jax.vmap(so3.exp))(ROTVECS)
    np.testing.assert_allclose(ours, Rotation.from_rotvec(ROTVECS).as_matrix(), atol=2e-15)


def test_log_undoes_exp():
    ours = jax.jit(jax.vmap(so3.log))(Rotation.from_rotvec(ROTVECS).as_matrix())
    np.testing.assert_allclose(ours, ROTVECS, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, -0.8, 0], [0.48, 0.6, -0.64]])
def test_log_of_half_turn(axis):
    half_turn = Rotation.from_rotvec(np.pi * np.array(axis)).as_matrix()
    ours = LOG(half_turn)
    assert np.linalg.norm(ours) == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_allclose(EXP(ours), half_turn, atol=1e-14)


@pytest.mark.parametrize("rotvec", ROTVECS[[0, 4, 8, 17, 24, 28, 32, 40, 44]])
def test_derivative_of_exp_is_the_left_jacobian(rotvec):
    # exp(rotvec + d) exp(-rotvec) = exp(J d): the oracle's tangent of the group.
    derivative = EXP_JACOBIAN(np.zeros(3), rotvec)
    ours = np.stack([derivative[2, 1], derivative[0, 2], derivative[1, 0]])
    left, inverse = JACOBIAN_PAIR(rotvec)
    np.testing.assert_allclose(ours, left, atol=1e-13)
    # jaxlie: the inverse of the right Jacobian, the transpose of the left one.
    theirs = jaxlie.SO3.exp(jnp.asarray(rotvec)).jlog()
    np.testing.assert_allclose(inverse.T, theirs, atol=1e-7)
    np.testing.assert_allclose(left @ inverse, np.eye(3), atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.5, 2.0, 3.1, np.pi - 1e-6])
def test_derivative_of_log(angle):
    start = np.array([0.36, 0.48, -0.8]) * angle
    derivative = LOG_JACOBIAN(np.zeros(3), EXP(start))
    np.testing.assert_allclose(derivative, JACOBIAN_PAIR(start)[1], rtol=1e-8, atol=1e-9)


def test_second_derivatives_at_zero():
    second = jax.jit(jax.hessian(lambda v: so3.exp(v)[0, 1]))(np.zeros(3))
    np.testing.assert_allclose(second, [[0, 0.5, 0], [0.5, 0, 0], [0, 0, 0]], atol=1e-15)


def test_nearest_rotation_is_the_polar_factor():
    matrices = np.random.default_rng(1).normal(size=(20, 3, 3))
    theirs = []
    for matrix in matrices:  # Kabsch: the rotation that turns the identity's columns best into the matrix's
        theirs.append(Rotation.align_vectors(matrix.T, np.eye(3))[0].as_matrix())
    np.testing.assert_allclose(jax.vmap(NEAREST)(matrices), theirs, atol=1e-12)


def test_nearest_rotation_has_derivatives_at_a_rotation():
    rotation = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    noise = np.random.default_rng(2).normal(size=(3, 3)) * 0.1
    for matrix in (rotation, rotation + noise, np.eye(3)):
        check_grads(NEAREST, (matrix,), order=2, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)


def test_float32_stays():
    rotvec = np.array([0.1, 0.2, 0.3], dtype=np.float32)
    assert EXP(rotvec).dtype == LOG(EXP(rotvec)).dtype == NEAREST(EXP(rotvec)).dtype == jnp.float32
    np.testing.assert_allclose(LOG(EXP(rotvec)), rotvec, rtol=1e-6)


def test_float64_is_not_cut_silently():
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        so3.exp(np.zeros(3))
