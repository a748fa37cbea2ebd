"""Which part of a rectangle is seen from an eye, others in front of it: people point at what they see."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from jaxpoint.simulate.people.rotations import Vector

SAMPLES = 40  # a side of a rectangle
LEAST_SEEN = 0.1  # of a rectangle: who sees less of it does not mean it
TOUCHING = 1e-6  # of the way: what is nearer by less lies in the same plane and hides nothing

Corners = Float[np.ndarray, "4 3"]  # left top, right top, left bottom, right bottom; m
Others = Float[np.ndarray, "K 4 3"]


def seen_place(eye: Vector, corners: Corners, others: Others) -> Vector | None:
    """The middle of what is seen of a rectangle: of the largest disc there, the one nearest to the rectangle's middle.

    Args:
        eye: m.
        corners: of the rectangle, m.
        others: rectangles that may hide it, from both sides, m.

    Returns:
        A place on the rectangle (m), or None where hardly anything of it is seen.
    """
    left_top, right, down = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    places = left_top + share[:, None, None] * down + share[:, None] * right
    seen = ~is_hidden(eye, places.reshape(-1, 3), others).reshape(SAMPLES, SAMPLES)
    if seen.mean() < LEAST_SEEN:
        return None
    steps = np.linalg.norm([down, right], axis=1) / SAMPLES
    depth = np.asarray(distance_transform_edt(np.pad(seen, 1), sampling=steps))[1:-1, 1:-1]
    deepest = places[depth > depth.max() - steps.min() / 2]
    return deepest[np.argmin(np.linalg.norm(deepest - corners.mean(axis=0), axis=1))]


def is_hidden(eye: Vector, places: Float[np.ndarray, "N 3"], others: Others) -> Bool[np.ndarray, " N"]:
    """Whether the straight line from an eye to each place (m) meets a rectangle on the way."""
    corner, right, down = others[:, 0], others[:, 1] - others[:, 0], others[:, 2] - others[:, 0]
    normal = np.cross(right, down)
    sight = places - eye
    closing = sight @ normal.T
    parallel = np.abs(closing) < 1e-12
    share = ((corner - eye) * normal).sum(axis=1) / np.where(parallel, 1.0, closing)  # of the way to the place
    met = eye + share[..., None] * sight[:, None] - corner
    u, v = ((met * side).sum(axis=2) / (side**2).sum(axis=1) for side in (right, down))
    within = (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    return (within & ~parallel & (share > 0) & (share < 1 - TOUCHING)).any(axis=1)
