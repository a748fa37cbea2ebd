"""Null vectors with safe derivatives, and many small symmetric matrices at once."""

from __future__ import annotations

from typing import TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Many points are tuples of components, each with the points last: XLA makes one pass over them where a batched call
# of LAPACK on tiny matrices is slow.
Vector: TypeAlias = tuple[Float[Array, " B"], ...]  # x, y, z
Symmetric: TypeAlias = tuple[Float[Array, " B"], ...]  # xx, xy, xz, yy, yz, zz


@jax.custom_jvp
def null_vector(matrix: Float[Array, "m n"]) -> Float[Array, " n"]:
    """The unit vector v that minimises |matrix @ v|, up to sign.

    Its derivative needs only the smallest singular value to be single; JAX's own rule for the SVD is NaN as soon as
    any two coincide.
    """
    rows, columns = matrix.shape
    return jnp.linalg.svd(matrix, full_matrices=rows < columns)[2][-1]


@null_vector.defjvp
def _null_vector_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (matrix,), (change,) = primals, tangents
    vector = null_vector(matrix)
    gram = matrix.T @ matrix
    projector = jnp.outer(vector, vector)
    change_of_gram_times_vector = change.T @ (matrix @ vector) + matrix.T @ (change @ vector)
    free = change_of_gram_times_vector - vector * (vector @ change_of_gram_times_vector)
    smallest = vector @ gram @ vector
    # Along the vector itself the shifted Gram matrix is singular: any positive value of its own size will do there.
    shifted = gram - smallest * jnp.eye(gram.shape[0], dtype=gram.dtype) + jnp.trace(gram) * projector
    return vector, -jnp.linalg.solve(shifted, free)


def symmetric_inverse(matrix: Symmetric) -> Symmetric:
    """Inverses of symmetric positive matrices by L D L^T; pivots too small to mean anything are raised."""
    xx, xy, xz, yy, yz, zz = matrix
    trace = xx + yy + zz
    least = jnp.where(trace > 0, trace, 1.0) * jnp.finfo(trace.dtype).eps
    i0 = 1 / jnp.maximum(xx, least)
    l10, l20 = xy * i0, xz * i0
    d1 = jnp.maximum(yy - l10 * xy, least)
    i1 = 1 / d1
    l21 = (yz - l20 * xy) * i1
    i22 = 1 / jnp.maximum(zz - l20 * xz - l21 * l21 * d1, least)
    across = l10 * l21 - l20
    i12 = -l21 * i22
    i02 = across * i22
    i01 = -l10 * i1 - l21 * i02
    return i0 + l10 * l10 * i1 + across * i02, i01, i02, i1 - l21 * i12, i12, i22


def symmetric_times(matrix: Symmetric, vector: Vector) -> Vector:
    """Products of symmetric matrices and vectors."""
    (xx, xy, xz, yy, yz, zz), (x, y, z) = matrix, vector
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def symmetric_full(matrix: Symmetric) -> Float[Array, "B 3 3"]:
    """The matrices in the usual layout."""
    xx, xy, xz, yy, yz, zz = matrix
    return jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
