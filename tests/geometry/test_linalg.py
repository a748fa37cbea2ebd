"""Null vectors and symmetric matrices against numpy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxpoint.geometry.linalg import (
    null_vector,
    root_solve,
    smallest_vectors,
    solve_positive,
    span_projector,
    symmetric_full,
    symmetric_inverse,
    symmetric_root,
    symmetric_times,
)

RNG = np.random.default_rng(0)
ROWS, COLUMNS = np.triu_indices(3)
HALVES = RNG.normal(size=(20, 3, 5))
MATRICES = HALVES @ HALVES.transpose(0, 2, 1)
PACKED = tuple(jnp.asarray(MATRICES[:, i, j]) for i, j in zip(ROWS, COLUMNS, strict=True))


def test_symmetric_matrices_are_numpys():
    np.testing.assert_allclose(symmetric_full(PACKED), MATRICES, atol=1e-15)
    inverse = jax.jit(symmetric_inverse)(PACKED)
    np.testing.assert_allclose(symmetric_full(inverse), np.linalg.inv(MATRICES), rtol=1e-9, atol=1e-12)
    vectors = RNG.normal(size=(20, 3))
    product = symmetric_times(PACKED, tuple(jnp.asarray(vectors.T)))
    np.testing.assert_allclose(np.stack(product, axis=1), np.einsum("nij,nj->ni", MATRICES, vectors), atol=1e-12)


def test_inverse_of_a_singular_matrix_is_finite():
    for packed in (np.zeros((6, 1)), np.array([[1.0], [1], [1], [1], [1], [1]])):
        assert np.isfinite(symmetric_full(symmetric_inverse(tuple(jnp.asarray(packed))))).all()


def test_null_vector_is_numpys_with_derivatives():
    matrix = RNG.normal(size=(9, 4))
    theirs = np.linalg.svd(matrix)[2][-1]

    @jax.jit
    def fixed(m):
        vector = null_vector(m)
        return vector * jnp.sign(vector @ theirs)

    np.testing.assert_allclose(fixed(matrix), theirs, atol=1e-13)
    check_grads(fixed, (matrix,), order=1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)
    wide = jnp.asarray(RNG.normal(size=(2, 3)))
    np.testing.assert_allclose(wide @ null_vector(wide), 0, atol=1e-14)


def test_spans_have_derivatives_where_eigenvalues_coincide():
    """Of a matrix with the eigenvalues 0, 0, 1, 1, 2: the projector onto the first two vectors, in any basis."""
    basis = np.linalg.qr(RNG.normal(size=(5, 5)))[0]
    matrix = (basis * [0.0, 0.0, 1.0, 1.0, 2.0]) @ basis.T

    @jax.jit
    def onto(m):
        vectors = smallest_vectors(m + m.T, 2)
        return vectors @ vectors.T

    np.testing.assert_allclose(onto(matrix), basis[:, :2] @ basis[:, :2].T, atol=1e-13)
    check_grads(onto, (matrix,), order=1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)
    orthonormal = jnp.asarray(basis[:, :3])  # its singular values coincide
    np.testing.assert_allclose(span_projector(2.0 * orthonormal), orthonormal @ orthonormal.T, atol=1e-13)
    check_grads(jax.jit(span_projector), (orthonormal,), order=1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-6)


def test_roots_of_symmetric_matrices_are_numpys():
    root = symmetric_root(PACKED)
    theirs = np.linalg.cholesky(MATRICES)
    expected = [1 / theirs[:, 0, 0], theirs[:, 1, 0], 1 / theirs[:, 1, 1], theirs[:, 2, 0], theirs[:, 2, 1]]
    np.testing.assert_allclose(root, [*expected, 1 / theirs[:, 2, 2]], rtol=1e-6)
    right = RNG.normal(size=(20, 3))
    found = np.stack(root_solve(root, tuple(jnp.asarray(right.T))), axis=1)
    np.testing.assert_allclose(found, np.linalg.solve(MATRICES, right[..., None])[..., 0], rtol=1e-7)
    assert np.isfinite(symmetric_root((jnp.zeros(2),) * 6)).all()


@pytest.mark.parametrize("size", [7, 128, 129, 240])
def test_positive_definite_systems_are_those_of_numpy(size):
    square = np.random.default_rng(7).normal(size=(size, size + 3))
    matrix, right = square @ square.T, np.arange(size, dtype=float)
    ours = jax.jit(solve_positive)(matrix, right)
    np.testing.assert_allclose(ours, np.linalg.solve(matrix, right), rtol=1e-8, atol=1e-10)
    assert np.isnan(solve_positive(jnp.asarray(-matrix), jnp.asarray(right))).any()
