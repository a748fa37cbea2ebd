"""Two views and what moves their pixels, adjusted together: the epipolar error of every match is made least.

Linear in the geometry (nine entries, of any norm), both lenses, and the unknowns that move pixels along given vectors;
robust by reweighting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.clock_fit import PairView

REWEIGHTED = 8  # times
SCALE_PX = 1.0  # at an image width of 1280 px: error at which a match begins to count as an outlier
GEOMETRY = 11  # unknowns before those that move pixels: nine of F, two lenses
NOISE_FLOOR_PX = 0.05  # of the epipolar errors
STRETCHES = 12  # of time, within which errors may be alike
WIDE = 2.0  # typical errors: where an unknown is tested, an error at which a match begins to count as an outlier


@dataclass(frozen=True)
class Mover:
    """An unknown that moves the pixels of one view: by `along` for each unit of it."""

    view: int  # 0 or 1
    along: Float[np.ndarray, "N 2"]  # over half the image diagonal


@dataclass(frozen=True)
class PairSolution:
    """The unknowns that move pixels, and what the matches say of them with the geometry free."""

    values: Float[np.ndarray, " M"]
    information: Float[np.ndarray, "T T"]  # of those tested: the inverse of their covariance,
    pull: Float[np.ndarray, " T"]  # and that times the step to where they fit best


def solve_pair(
    view: PairView, seen: Bool[np.ndarray, " P"], movers: Sequence[Mover], tested: Sequence[Mover] = ()
) -> PairSolution:
    """Geometry, both lenses and the movers, from the matches of a pair.

    Args:
        seen: the matches that count, N of them.
        tested: movers that are held at 0, and of which only the next step is asked.
    """
    first, second, lenses = view.first[seen], view.second[seen], view.lenses.copy()
    matrix, values, every = view.fundamental, np.zeros(len(movers)), (*movers, *tested)
    solved, smallest = GEOMETRY + len(movers), SCALE_PX * view.width / 1280.0
    for _ in range(REWEIGHTED):
        rays = _lift(first, lenses[0]), _lift(second, lenses[1])
        lines = rays[1] @ matrix, rays[0] @ matrix.T
        moved = [
            (_turn(mover.along, (first, second)[mover.view], lenses[mover.view]) * lines[mover.view]).sum(axis=1)
            for mover in every
        ]
        columns = [
            (rays[1][:, :, None] * rays[0][:, None, :]).reshape(-1, 9),
            (lines[0][:, 2] * (first**2).sum(axis=1))[:, None],
            (lines[1][:, 2] * (second**2).sum(axis=1))[:, None],
            np.stack(moved, axis=1),
        ]
        scale = _gradient(*lines, view.half_diagonals)[:, None]
        design = np.concatenate(columns, axis=1) / scale
        error = design[:, :9] @ matrix.reshape(9) + design[:, GEOMETRY:solved] @ values
        # What is tested may be large: its errors must not count as outliers.
        width = max(smallest, WIDE * float(np.median(np.abs(error)))) if tested else smallest
        root = 1.0 / np.sqrt(1.0 + (error / width) ** 2)
        # A longer F changes nothing: its length is held by a row of its own.
        held = np.concatenate([1e3 * matrix.reshape(1, 9), np.zeros((1, 2 + len(every)))], axis=1)
        weighted = np.vstack([design * root[:, None], held])
        step = np.linalg.lstsq(weighted[:, :solved], np.append(-error * root, 0.0))[0]
        matrix = matrix + step[:9].reshape(3, 3)
        matrix, lenses, values = matrix / np.linalg.norm(matrix), lenses + step[9:11], values + step[11:]
    return PairSolution(values, *_next_step(weighted, solved, error, root))


def _next_step(weighted: Float[np.ndarray, "R U"], solved: int, error, root) -> tuple[np.ndarray, np.ndarray]:
    """What is left of the normal equations of those tested once all that was solved for has moved to suit them."""
    along, _ = np.linalg.qr(weighted[:, :solved])
    left = weighted[:, solved:] - along @ (along.T @ weighted[:, solved:])
    variance = float(((root * error) ** 2).sum() / max((root**2).sum() - weighted.shape[1], 1.0))
    information = left.T @ left / max(variance, NOISE_FLOOR_PX**2)
    each = -left * np.append(error * root, 0.0)[:, None] / max(variance, NOISE_FLOOR_PX**2)
    more = _beyond_noise(information, each)
    return information / more, each.sum(axis=0) / more


def _beyond_noise(information: Float[np.ndarray, "T T"], each: Float[np.ndarray, "R T"]) -> float:
    """How much more than independent noise the pulls of stretches of time scatter: 1, or more where a model is wrong.

    Errors of a lens model stay alike from frame to frame, so that matches count for less than they are (the sandwich
    covariance of clustered data; Liang and Zeger, "Longitudinal data analysis", Biometrika 1986).
    """
    if not information.size:
        return 1.0
    sums = np.array([part.sum(axis=0) for part in np.array_split(each, STRETCHES)])
    apart = sums - sums.mean(axis=0)
    scatter = apart.T @ apart * STRETCHES / (STRETCHES - 1)
    return max(1.0, float(np.trace(np.linalg.pinv(information) @ scatter)) / len(information))


def _turn(along: Float[np.ndarray, "N 2"], points: Float[np.ndarray, "N 2"], lens: float) -> Float[np.ndarray, "N 3"]:
    """What moving a point does to its ray."""
    return np.concatenate([along, 2.0 * lens * (points * along).sum(axis=1)[:, None]], axis=1)


def _lift(points: Float[np.ndarray, "N 2"], lens: float) -> Float[np.ndarray, "N 3"]:
    return np.concatenate([points, 1.0 + lens * (points**2).sum(axis=1, keepdims=True)], axis=1)


def _gradient(line_a, line_b, half_diagonals) -> Float[np.ndarray, " N"]:
    """Length of the gradient of the epipolar form by the pixels, about: lenses taken as straight."""
    square = (line_a[:, :2] ** 2).sum(axis=1) / half_diagonals[0] ** 2
    return np.sqrt(square + (line_b[:, :2] ** 2).sum(axis=1) / half_diagonals[1] ** 2 + 1e-20)
