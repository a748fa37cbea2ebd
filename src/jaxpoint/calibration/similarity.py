"""The similarity or rigid motion between two sets of points (Umeyama 1991), for single small sets on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def fit_similarity(
    source: Float[np.ndarray, "K 3"],
    target: Float[np.ndarray, "K 3"],
    weights: Float[np.ndarray, " K"],
    scaled: bool = True,
) -> tuple[float, Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Scale s, rotation R and translation t that bring s R `source` + t closest to `target`.

    Of two points, or points on a line, the turn about it is any. Plain numpy: one program for each number of points
    would take longer to compile than all of them take to run; `alignment.umeyama` is the differentiable one.

    Args:
        scaled: whether the scale is free; it is 1 otherwise.
    """
    share = (weights / weights.sum())[:, None]
    source_mean, target_mean = (share * source).sum(axis=0), (share * target).sum(axis=0)
    centred = source - source_mean
    u, values, vt = np.linalg.svd((target - target_mean).T @ (share * centred))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((values * sign).sum() / (share * centred**2).sum()) if scaled else 1.0
    return scale, rotation, target_mean - scale * rotation @ source_mean
