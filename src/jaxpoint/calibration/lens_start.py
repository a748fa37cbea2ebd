"""A first lens of one camera from views of a flat target: Zhang's homographies, or a search over focal lengths.

Zhang 2000 for lenses that are nearly perspective; of very wide ones no homography holds, so focal lengths of a
perspective and of an equidistant lens are tried in turn, and what explains the views best is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.planar_pose import homography, pose_from_rays

FOCALS = np.geomspace(0.15, 4.0, 16)  # of the image's larger side
FINER = 5  # focal lengths between two of these, for the second pass
CLIP = 0.02  # of the image's larger side: a larger error counts as this
MOST_VIEWS = 40


@dataclass(frozen=True)
class FlatView:
    """What a camera saw of a flat target in one frame."""

    flat: Float[np.ndarray, "K 2"]  # m
    pixels: Float[np.ndarray, "K 2"]


@dataclass(frozen=True)
class LensStart:
    """A lens without distortion that explains the views roughly; the principal point is the image's middle."""

    equidistant: bool  # else perspective
    focal: float  # px
    cost: float  # px^2, the mean over points, clipped


def lens_starts(views: list[FlatView], size: Float[np.ndarray, "2"]) -> list[LensStart]:
    """The best perspective and the best equidistant lens, the better one first."""
    some = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, MOST_VIEWS).astype(int))]
    center, side = (size - 1) / 2.0, float(size.max())
    zhang = zhang_focal(some, center)
    found = []
    for equidistant in (False, True):
        tried = list(side * FOCALS)
        if zhang is not None and not equidistant:
            tried.append(zhang)
        best = min(tried, key=lambda focal: _cost(some, focal, center, equidistant, side))
        step = FOCALS[1] / FOCALS[0]
        finer = [best, *(best * step ** (k / FINER) for k in range(-FINER + 1, FINER) if k)]
        costs = [_cost(some, focal, center, equidistant, side) for focal in finer]
        found.append(LensStart(equidistant, finer[int(np.argmin(costs))], min(costs)))
    return sorted(found, key=lambda start: start.cost)


def zhang_focal(views: list[FlatView], center: Float[np.ndarray, "2"]) -> float | None:
    """The focal length of square pixels under which all homographies are of rotations, by linear least squares.

    Zhang 2000, eqs. 3 and 4, with the principal point known. None where views are too few or too parallel to tell.
    """
    rows, right = [], []
    for view in views:
        (a, b, _), (c, d, _), (e, f, _) = _unit(homography(view.flat, view.pixels - center))
        rows += [a * b + c * d, a * a + c * c - b * b - d * d]
        right += [-e * f, f * f - e * e]
    rows, right = np.array(rows), np.array(right)
    inverse_square = float(rows @ right) / max(float(rows @ rows), 1e-300)
    return inverse_square**-0.5 if inverse_square > 0 else None


def _unit(found: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    return found / np.linalg.norm(found[:, :2])


def directions_of(
    pixels: Float[np.ndarray, "K 2"], focal: float, center: Float[np.ndarray, "2"], equidistant: bool
) -> Float[np.ndarray, "K 3"]:
    """Unit directions of pixels for a lens without distortion."""
    away = (pixels - center) / focal
    radius = np.linalg.norm(away, axis=1)
    angle = np.minimum(radius, np.pi) if equidistant else np.arctan(radius)
    across = np.sin(angle) / np.maximum(radius, 1e-12)
    return np.concatenate([across[:, None] * away, np.cos(angle)[:, None]], axis=1)


def _pixels(
    directions: Float[np.ndarray, "K 3"], focal: float, center: Float[np.ndarray, "2"], equidistant: bool
) -> Float[np.ndarray, "K 2"]:
    across = np.maximum(np.linalg.norm(directions[:, :2], axis=1), 1e-12)
    angle = np.arctan2(across, directions[:, 2])
    radius = angle if equidistant else np.tan(np.minimum(angle, 1.5))
    return center + focal * (radius / across)[:, None] * directions[:, :2]


def _cost(views: list[FlatView], focal: float, center: Float[np.ndarray, "2"], equidistant: bool, side: float) -> float:
    """Mean squared error of points whose pose each view tells under this lens; errors are clipped."""
    errors = []
    for view in views:
        pose = pose_from_rays(view.flat, directions_of(view.pixels, focal, center, equidistant))
        if pose is None:
            errors.append(np.full(len(view.flat), np.inf))
            continue
        rotation, translation = pose
        seen = _pixels(view.flat @ rotation[:, :2].T + translation, focal, center, equidistant)
        errors.append(((seen - view.pixels) ** 2).sum(axis=1))
    return float(np.minimum(np.concatenate(errors), (CLIP * side) ** 2).mean())
