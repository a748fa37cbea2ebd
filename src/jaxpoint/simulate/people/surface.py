"""Closed surfaces around an axis: rings of corners, and a pole at each end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Surface:
    """V corners and T triangles of one closed surface, counter-clockwise from outside, in metres of its own frame."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "T 3"]
    albedo: Float[np.ndarray, "V 3"]


def loft(
    heights: Float[np.ndarray, " S"],
    half_axes: Float[np.ndarray, "S 2"],
    albedo: Float[np.ndarray, "S 3"],
    *,
    around: int,
    centers: Float[np.ndarray, "S 2"] | None = None,
    exponent: float = 2.0,
) -> Surface:
    """A surface along z: an ellipse at every height, closed by a pole at the first and at the last height.

    Args:
        heights: rising along z; the first and the last are the poles.
        half_axes: half widths along x and y at each height; those of the poles are not used.
        albedo: of each ring.
        around: corners of a ring.
        centers: x and y of each ring's centre.
        exponent: 2 is an ellipse, larger ones are squarer.
    """
    middle = np.zeros((len(heights), 2)) if centers is None else centers
    angle = np.arange(around) * 2 * np.pi / around
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    circle = np.sign(circle) * np.abs(circle) ** (2 / exponent)
    rings = middle[1:-1, None] + circle * half_axes[1:-1, None]
    levels = np.broadcast_to(heights[1:-1, None, None], (*rings.shape[:2], 1))
    poles = np.column_stack([middle[[0, -1]], heights[[0, -1]]])
    vertices = np.concatenate([poles, np.concatenate([rings, levels], axis=2).reshape(-1, 3)])
    triangles = _triangles(len(heights) - 2, around)
    colour = np.concatenate([albedo[[0, -1]], np.repeat(albedo[1:-1], around, axis=0)])
    return Surface(vertices, corner_normals(vertices, triangles), triangles, colour)


def _triangles(rings: int, around: int) -> np.ndarray:
    """Two triangles between each two rings and their next corners, and a fan at either pole (corners 0 and 1)."""
    here = np.arange(around)
    after = (here + 1) % around
    start = 2 + np.arange(rings - 1)[:, None] * around
    low, low_next, high, high_next = start + here, start + after, start + around + here, start + around + after
    sides = np.stack([np.stack([low, low_next, high_next], -1), np.stack([low, high_next, high], -1)]).reshape(-1, 3)
    last = 2 + (rings - 1) * around
    bottom = np.stack([np.zeros(around, int), 2 + after, 2 + here], axis=1)
    top = np.stack([np.ones(around, int), last + here, last + after], axis=1)
    return np.concatenate([bottom, sides, top])


def corner_normals(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "T 3"]) -> Float[np.ndarray, "V 3"]:
    """Unit normals: the mean of a corner's triangles, weighted by area."""
    corners = vertices[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(total, triangles[:, i], face)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def mirrored(surface: Surface) -> Surface:
    """The same on the other side of y = 0."""
    flip = np.array([1.0, -1.0, 1.0])
    return Surface(surface.vertices * flip, surface.normals * flip, surface.triangles[:, ::-1], surface.albedo)
