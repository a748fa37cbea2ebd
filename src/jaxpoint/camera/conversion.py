"""One lens as another: the coefficients under which it sees directions where they are seen."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.camera.lens import COMMON, AbstractLens

STEPS = 8  # of Gauss and Newton; lenses that are linear in their coefficients need one
RIDGE = 1e-12  # of the largest diagonal entry: holds coefficients that the directions do not determine


def fit_coefficients(
    lens: type[AbstractLens],
    common: Float[np.ndarray, "4"],
    directions: Float[np.ndarray, "N 3"],
    pixels: Float[np.ndarray, "N 2"],
    free: Bool[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"] | None = None,
) -> Float[np.ndarray, " k"]:
    """Coefficients for which the lens sees directions at these pixels, by least squares.

    Args:
        common: fx, fy, cx, cy, px; they stay.
        free: which coefficients to fit.
        mean: where they begin and the others stand; at their prior means if not given.
    """
    found = np.array([coefficient.prior_mean for coefficient in lens.coefficients] if mean is None else mean, float)
    if not len(directions) or not free.any():
        return found
    aim = tuple(directions.T)
    for _ in range(STEPS):
        slopes = lens.slopes_of(np.concatenate([common, found]), aim, np)
        missing = np.concatenate([pixels[:, axis] - slopes.pixel[axis] for axis in range(2)])
        rows = [np.stack([np.broadcast_to(part, len(directions)) for part in row]) for row in slopes.by_coefficients]
        design = np.concatenate(rows, axis=1)[free].T
        normal = design.T @ design
        step = np.linalg.solve(normal + RIDGE * np.diagonal(normal).max() * np.eye(len(normal)), design.T @ missing)
        found[free] += step
        if not np.abs(step).max() > 1e-12:
            break
    return found


def convert(
    parameters: Float[np.ndarray, " p"],
    lens: type[AbstractLens],
    other: type[AbstractLens],
    pixels: Float[np.ndarray, "N 2"],
    free: Bool[np.ndarray, " k"],
) -> Float[np.ndarray, " q"]:
    """The parameters of another lens that sees these pixels in the directions in which the first one does.

    Focal lengths and principal point stay; pixels that the first lens has no direction for do not count.
    """
    with jax.enable_x64(True):
        direction, valid = lens(parameters).unproject(pixels)  # pyright: ignore[reportCallIssue]
        direction, valid = np.asarray(direction), np.asarray(valid)
    usable = valid & (direction[:, 2] > 0)
    fitted = fit_coefficients(other, parameters[:COMMON], direction[usable], pixels[usable], free)
    return np.concatenate([parameters[:COMMON], fitted])
