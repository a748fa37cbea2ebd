"""The null vector of a matrix, differentiable where the singular values coincide."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


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
