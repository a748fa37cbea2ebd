"""Directions as azimuth and elevation, and turned by them (thesis 7.2).

Azimuth is counter-clockwise about the vertical z, from x: positive to the left. Elevation is positive upwards.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import AnyArray, as_float, safe_norm, stack_last


def azimuth_elevation(directions: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 2"]:
    """Azimuth and elevation of vectors of any length, rad; a vertical one has azimuth 0."""
    directions = as_float(directions)
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    level = safe_norm(directions[..., :2])
    vertical = level == 0
    azimuth = jnp.arctan2(jnp.where(vertical, 0.0, y), jnp.where(vertical, 1.0, x))
    return stack_last(azimuth, jnp.arctan2(z, level))


def wrap_angle(angles: Float[AnyArray, "*batch"]) -> Float[Array, "*batch"]:
    """Angles brought into -pi..pi, rad."""
    angles = as_float(angles)
    return jnp.arctan2(jnp.sin(angles), jnp.cos(angles))


def turn_directions(
    directions: Float[AnyArray, "*batch 3"], turn: Float[AnyArray, "*batch 2"]
) -> Float[Array, "*batch 3"]:
    """Directions rotated to the left and up.

    The elevation turns about the horizontal axis across the direction, the azimuth about the vertical; lengths stay.

    Args:
        directions: a vertical one leans towards x.
        turn: azimuth and elevation to be added, rad.
    """
    directions, turn = as_float(directions), as_float(turn)
    level = safe_norm(directions[..., :2])
    vertical = level == 0
    safe = jnp.where(vertical, 1.0, level)
    cosine = jnp.where(vertical, 1.0, directions[..., 0] / safe)
    sine = jnp.where(vertical, 0.0, directions[..., 1] / safe)
    left, up = turn[..., 0], turn[..., 1]
    forward = level * jnp.cos(up) - directions[..., 2] * jnp.sin(up)
    height = level * jnp.sin(up) + directions[..., 2] * jnp.cos(up)
    return stack_last(
        forward * (cosine * jnp.cos(left) - sine * jnp.sin(left)),
        forward * (sine * jnp.cos(left) + cosine * jnp.sin(left)),
        height,
    )
