"""Are the cameras in step? A look at it after everything is solved; before, see `calibration.clocks`."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.motion import Motion

MOST_FRAMES = 1000  # of a longer recording every n-th are looked at
ROUNDS = 10  # of reweighting


def time_offsets(
    residuals: Float[np.ndarray, "F C 2"],
    judged: Bool[np.ndarray, "F C"],
    moving: Motion,
    slopes: Float[np.ndarray, "F C 2 3"],
    sigma_px: float,
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """By how much each camera lags the others, from residuals that follow the light's motion in the image.

    A camera that shows the light dt after the others sees it v dt behind, so projected minus observed is v dt, but for
    what the frame's point has taken of it: with two views nearly all. So points are eliminated: what is fitted is what
    no shift of a point explains. Robustly over all observations, rejected ones too, as those that show an offset best
    are rejected first. The cameras have adapted as well, so that the figures are lower bounds.

    Args:
        residuals: projected minus observed, px.
        judged: observations that have a residual.
        moving: of the observations.
        slopes: derivatives of the pixels by the frame's point, px per unit.
        sigma_px: standard deviation of a pixel coordinate.

    Returns:
        offset: frames against the median camera; positive where the camera shows the light after the others.
        sigma: its standard error; infinite where the light never moved.
    """
    some = slice(None, None, -(-len(judged) // MOST_FRAMES))
    residuals, slopes = residuals[some], slopes[some]
    use = (judged & moving.known)[some]
    velocity = np.where(use[..., None], moving.velocity[some], 0.0)
    tells = (velocity**2).sum(axis=(0, 2)) > 0
    offset, sigma, weights = np.zeros(len(tells)), np.full(len(tells), np.inf), use.astype(float)
    if not tells.any():
        return offset, sigma
    for _ in range(ROUNDS):
        root = np.sqrt(weights)[..., None]
        left = np.where(use[..., None], residuals - offset[:, None] * velocity, 0.0) * root
        left, moved = _without_points(slopes * root[..., None], left, velocity * root)
        normal = np.einsum("fckd,fcke->de", moved, moved)[np.ix_(tells, tells)]
        # All cameras late together is next to nothing: the light a little farther on its way.
        inverse = np.linalg.inv(normal + 1e-6 * np.trace(normal))
        offset[tells] += inverse @ np.einsum("fckd,fck->d", moved, left)[tells]
        error = np.linalg.norm(left, axis=-1) / np.where(root[..., 0] > 0, root[..., 0], 1.0)
        weights = np.where(use, 1.0 / (1.0 + (error / (3.0 * sigma_px)) ** 2), 0.0)
    apart = np.eye(len(inverse)) - 1.0 / len(inverse)
    sigma[tells] = sigma_px * np.sqrt(np.diag(apart @ inverse @ apart))
    return offset - np.median(offset), sigma


def _without_points(slopes, residuals, velocity) -> tuple[Float[np.ndarray, "F C 2"], Float[np.ndarray, "F C 2 C"]]:
    """What is left of weighted residuals, and of each camera's velocity, once every point has moved to suit them."""
    frames, cameras = residuals.shape[:2]
    columns = np.zeros((frames, cameras, 2, cameras + 1))
    columns[..., 0] = residuals
    each = np.arange(cameras)
    columns[:, each, :, each + 1] = np.moveaxis(velocity, 1, 0)
    columns, slopes = columns.reshape(frames, 2 * cameras, -1), slopes.reshape(frames, 2 * cameras, 3)
    turned = np.swapaxes(slopes, 1, 2)
    normal = turned @ slopes
    normal += (1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-30) * np.eye(3)
    columns = columns - slopes @ np.linalg.solve(normal, turned @ columns)
    columns = columns.reshape(frames, cameras, 2, -1)
    return columns[..., 0], columns[..., 1:]
