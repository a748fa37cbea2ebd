"""The direction that planes have in common: of a limb whose middle lines were seen in two or more views."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

_ROUNDS = 3


def common_direction(normals: Float[Array, "3 V B"]) -> Float[Array, "3 B"]:
    """The unit vectors d that minimise the sum over V planes of (n . d)^2, up to sign, for B sets of planes.

    Args:
        normals: of the planes, each as long as it is to be trusted; 0 for a plane that does not count.

    The batch is last: three numbers a vector are no work for LAPACK. Powers of the adjugate of sum n n^T go to the
    eigenvector of its least eigenvalue, the faster the better the planes agree; two planes always do.
    """
    x, y, z = normals
    xx, xy, xz = jnp.sum(x * x, axis=0), jnp.sum(x * y, axis=0), jnp.sum(x * z, axis=0)
    yy, yz, zz = jnp.sum(y * y, axis=0), jnp.sum(y * z, axis=0), jnp.sum(z * z, axis=0)
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    columns = ((a, b, c), (b, d, e), (c, e, f))
    # The column of the largest diagonal entry is the longest one, or nearly so.
    best = (a >= d) & (a >= f), d >= f
    found = jnp.stack([jnp.where(best[0], p, jnp.where(best[1], q, r)) for p, q, r in zip(*columns)])
    for _ in range(_ROUNDS):
        u, v, w = _scaled(found)
        found = jnp.stack([a * u + b * v + c * w, b * u + d * v + e * w, c * u + e * v + f * w])
    return _scaled(found)


def _scaled(vectors: Float[Array, "3 B"]) -> Float[Array, "3 B"]:
    squared = jnp.sum(vectors**2, axis=0)
    some = squared > 0
    return vectors * jnp.where(some, 1 / jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)[None]
