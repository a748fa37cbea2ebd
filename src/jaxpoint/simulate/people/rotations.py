"""Small rotations in numpy: a renderer asks for them thousands of times, one at a time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, "3"]
Matrix = Float[np.ndarray, "3 3"]
UP = np.array([0.0, 0.0, 1.0])


def unit(vector: Vector) -> Vector:
    return vector / np.sqrt(vector @ vector)


def about(axis: Vector, angle: float) -> Matrix:
    """Rotation by `angle` (rad) about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


def yawed(angle: float) -> Matrix:
    """Rotation about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def between(start: Vector, end: Vector) -> Matrix:
    """The shortest rotation that takes one unit vector to another."""
    axis, cosine = np.cross(start, end), start @ end
    if cosine < -0.9999:
        other = np.cross(start, [1.0, 0.0, 0.0])
        return about(unit(other if other @ other > 0.1 else np.cross(start, [0.0, 1.0, 0.0])), np.pi)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def frame_along(direction: Vector, reference: Vector) -> Matrix:
    """Columns x, y, z: z along `direction` (unit), x as near to `reference` as a right angle allows."""
    x = reference - (reference @ direction) * direction
    x = unit(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


def turned_towards(start: Vector, end: Vector, share: float) -> Vector:
    """On the great circle from one unit vector to another, `share` of the way."""
    angle = np.arccos(np.clip(start @ end, -1.0, 1.0))
    if angle < 1e-6:
        return end if share >= 1 else start
    weights = np.sin((1 - share) * angle), np.sin(share * angle)
    return unit(weights[0] * start + weights[1] * end)


def wrapped(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    return float(-((np.pi - angle) % (2 * np.pi) - np.pi))


def smooth(share: float) -> float:
    """From 0 to 1 with minimum jerk (Flash & Hogan 1985); 0 before, 1 after."""
    x = min(max(share, 0.0), 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)
