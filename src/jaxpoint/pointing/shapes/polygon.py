"""Polygons as seen from a point: edges, angles and solid angles; rows by component, so that sums of few terms fuse."""

from __future__ import annotations

import operator
from functools import reduce
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import safe_norm
from jaxpoint.pointing.mass import Edges, Vectors, angle


def in_frame(frame: Float[Array, "3 3"] | None, rows: Float[Array, "N 3"]) -> Vectors:
    """Rows in another frame, or as they are."""
    x, y, z = rows.T if frame is None else (dot(rows, axis) for axis in frame)
    return x, y, z


def triple_product(a: Vectors, b: Vectors, c: Vectors) -> Array:
    """Of a face's corner, right and down: positive where its corners go from left to up around it as seen from 0."""
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def dot(rows: Float[Array, "N 3"], vector: Float[Array, "3"]) -> Float[Array, " N"]:
    """Products of rows with one vector: a sum that fuses, where a matrix product would not."""
    return rows[:, 0] * vector[0] + rows[:, 1] * vector[1] + rows[:, 2] * vector[2]


def fan_solid_angle(edges: Edges) -> Float[Array, " N"]:
    """The solid angles of polygons from 0, sr: a fan of triangles about the first corner of each.

    After van Oosterom and Strackee, The solid angle of a plane triangle, IEEE Trans. Biomed. Eng. 30 (1983).
    """
    start, _, turn = edges
    (x, y, z), count = start, len(start[0])
    first, *rest = [(x[i], y[i], z[i]) for i in range(count)]
    half = reduce(operator.add, (_half_solid_angle(first, b, c) for b, c in pairwise(rest)))
    return jnp.where(turn == 0, 0.0, jnp.abs(2 * half))


def _half_solid_angle(a: Vectors, b: Vectors, c: Vectors) -> Array:
    """Half the signed solid angle of triangles."""
    u, v, w = (jnp.sqrt(_inner(x, x) + 1e-18) for x in (a, b, c))
    bottom = u * v * w + _inner(a, b) * w + _inner(a, c) * v + _inner(b, c) * u
    return angle(triple_product(a, b, c), bottom)


def angles_to(direction: Float[Array, "3"], gaps: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Between one direction and others of any length, rad; accurate for tiny angles."""
    across = safe_norm(jnp.cross(jnp.broadcast_to(direction, gaps.shape), gaps))
    along = gaps @ direction
    return jnp.arctan2(across, jnp.where((across == 0) & (along == 0), 1.0, along))


def edge_angle(direction: Float[Array, "3"], corners: Float[Array, "n 3"]) -> Float[Array, ""]:
    """From a ray from 0 to the nearest direction on the edges of a closed polygon, rad.

    Along an edge A + s E the cosine has one extremum, where the derivative of (a + s e) / |A + s E| vanishes.
    """
    edges = jnp.roll(corners, -1, axis=0) - corners
    a, e = corners @ direction, edges @ direction
    aa, ae, ee = (jnp.sum(x * y, axis=1) for x, y in ((corners, corners), (corners, edges), (edges, edges)))
    bottom = e * ae - a * ee
    s = jnp.clip((a * ae - e * aa) / jnp.where(bottom == 0, 1.0, bottom), 0.0, 1.0)
    return jnp.min(angles_to(direction, jnp.concatenate([corners, corners + s[:, None] * edges])))


def flat_edges(corner: Vectors, right: Vectors, down: Vectors, rim: np.ndarray) -> tuple[Vectors, Vectors]:
    """Starts and ends (n, N) of the edges of N polygons with the corners corner + rim[i, 0] right + rim[i, 1] down."""

    def placed(at: np.ndarray) -> Vectors:
        x, y, z = (
            a[None] + jnp.asarray(at[:, :1]) * u[None] + jnp.asarray(at[:, 1:]) * v[None]
            for a, u, v in zip(corner, right, down)
        )
        return x, y, z

    return placed(rim), placed(np.roll(rim, -1, axis=0))


def _inner(a: Vectors, b: Vectors) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
