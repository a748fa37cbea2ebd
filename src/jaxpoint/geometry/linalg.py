"""Null vectors and spans with safe derivatives, many small symmetric matrices at once, and one large one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
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


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def smallest_vectors(matrix: Float[Array, "n n"], count: int) -> Float[Array, "n count"]:
    """Unit eigenvectors of a symmetric matrix for its `count` smallest eigenvalues, in ascending order.

    The derivative needs a gap above these eigenvalues alone: where two of them coincide, their vectors are any basis
    of their plane, and the derivative leaves out a turn within it. JAX's own rule for `eigh` is NaN there.
    """
    return jnp.linalg.eigh(matrix)[1][:, :count]


@smallest_vectors.defjvp
def _smallest_vectors_jvp(count: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (matrix,), (change,) = primals, tangents
    values, vectors = jnp.linalg.eigh(matrix)
    found = vectors[:, :count]
    gaps = values[None, :count] - values[:, None]
    apart = jnp.abs(gaps) > len(values) * jnp.finfo(values.dtype).eps * jnp.max(jnp.abs(values))
    turn = vectors.T @ ((change + change.T) / 2) @ found
    return found, vectors @ jnp.where(apart, turn / jnp.where(apart, gaps, 1.0), 0.0)


def span_projector(basis: Float[Array, "n m"]) -> Float[Array, "n n"]:
    """The projector onto the span of m independent columns; its derivative knows no order or scale among them."""
    orthogonal = jnp.linalg.qr(basis)[0]
    return orthogonal @ orthogonal.T


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


def symmetric_root(matrix: Symmetric) -> Float[Array, "e *B"]:
    """Lower roots L of symmetric positive d x d matrices, e = d (d + 1) / 2: 1 / l00, l10, 1 / l11, l20, l21, ...

    The identity where a matrix is zero; pivots that vanish are held at 1e-15 of the trace.

    Args:
        matrix: the upper triangles row by row (xx, xy, xz, yy, yz, zz where d is 3), each entry an array.
    """
    size = triangle_size(len(matrix))
    entry = dict(zip(upper_triangle(size), matrix))
    trace = sum((entry[i, i] for i in range(1, size)), start=entry[0, 0])
    least = jnp.where(trace > 0, 1e-15 * trace, 1.0)
    root: dict[tuple[int, int], Array] = {}
    for i in range(size):
        for j in range(i + 1):
            left = entry[j, i]
            for k in range(j):
                left = left - root[i, k] * root[j, k]
            root[i, j] = left * root[j, j] if j < i else jax.lax.rsqrt(jnp.maximum(left, least))
    return jnp.stack(list(root.values()))


def upper_triangle(size: int) -> list[tuple[int, int]]:
    """Row and column of the entries of an upper triangle, row by row."""
    return [(i, j) for i in range(size) for j in range(i, size)]


def triangle_size(entries: int) -> int:
    """d of a d x d matrix whose triangle has so many entries."""
    return (math.isqrt(8 * entries + 1) - 1) // 2


def forward_solve(root: Float[Array, "e *B"], vector: Sequence[Array] | Array) -> tuple[Array, ...]:
    """L^-1 v for vectors of d components, each an array."""
    found: list[Array] = []
    for i in range(len(vector)):
        row, left = i * (i + 1) // 2, vector[i]
        for j in range(i):
            left = left - root[row + j] * found[j]
        found.append(left * root[row + i])
    return tuple(found)


def backward_solve(root: Float[Array, "e *B"], vector: Sequence[Array] | Array) -> tuple[Array, ...]:
    """L^-T v for vectors of d components, each an array."""
    found: dict[int, Array] = {}
    for i in reversed(range(len(vector))):
        left = vector[i]
        for j in range(i + 1, len(vector)):
            left = left - root[j * (j + 1) // 2 + i] * found[j]
        found[i] = left * root[i * (i + 3) // 2]
    return tuple(found[i] for i in range(len(vector)))


def root_solve(root: Float[Array, "e *B"], vector: Sequence[Array] | Array) -> tuple[Array, ...]:
    """(L L^T)^-1 v for vectors of d components, each an array."""
    return backward_solve(root, forward_solve(root, vector))


PANEL = 64


def solve_positive(matrix: Float[Array, "D D"], right: Float[Array, " D"]) -> Float[Array, " D"]:
    """Solve with a symmetric positive definite matrix by a blocked Cholesky root; NaN where it is not positive.

    LAPACK sees small matrices only: its threads fight with XLA's for the cores of a busy machine (a root of 240
    columns took 0.6 ms alone and 250 ms beside another program).
    """
    size = right.shape[0]
    if size <= 1.5 * PANEL:
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix), right)
    count = -(-size // PANEL)
    total = count * PANEL
    pad = total - size
    matrix = jnp.pad(matrix, (0, pad)) + jnp.diag(jnp.where(jnp.arange(total) < size, 0.0, 1.0).astype(right.dtype))

    def eliminate(left, panel):
        matrix, right = left
        at = panel * PANEL
        column = jax.lax.dynamic_slice(matrix, (0, at), (total, PANEL))
        inverse = _inverse_root(jax.lax.dynamic_slice(column, (at, 0), (PANEL, PANEL)))
        below = jnp.where(jnp.arange(total)[:, None] >= at + PANEL, column, 0.0) @ inverse.T
        solved = inverse @ jax.lax.dynamic_slice(right, (at,), (PANEL,))
        return (matrix - below @ below.T, right - below @ solved), (below, inverse, solved)

    def substitute(found, panel):
        at, (below, inverse, solved) = panel[0] * PANEL, panel[1]
        part = inverse.T @ (solved - below.T @ found)
        return jax.lax.dynamic_update_slice(found, part, (at,)), None

    panels = jnp.arange(count)
    start = (matrix, jnp.pad(right, (0, pad)))
    _, kept = jax.lax.scan(eliminate, start, panels)
    found, _ = jax.lax.scan(substitute, jnp.zeros_like(start[1]), (panels, kept), reverse=True)
    return found[:size]


def _inverse_root(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """L^-1 of M = L L^T by elimination beside the unit matrix."""
    size = matrix.shape[0]
    rows = jnp.arange(size)

    def eliminate(k, both):
        factor = jnp.where(rows > k, both[:, k] / both[k, k], 0.0)
        return both - factor[:, None] * both[k][None]

    both = jax.lax.fori_loop(0, size, eliminate, jnp.concatenate([matrix, jnp.eye(size, dtype=matrix.dtype)], axis=1))
    return both[:, size:] * jax.lax.rsqrt(jnp.diagonal(both))[:, None]
