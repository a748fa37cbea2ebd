"""The normal equations of a calibration at its solution: what another choice of free parameters would change.

One pass over the inliers gives them for every parameter of every camera, free or held, and for a time offset. Each
question ("are this camera's pixels square?", "what if the lenses were known?") is then one small linear solve: the
score test (Rao 1948) and the covariance under that choice, points eliminated as in `uncertainty`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from jaxpoint.calibration.gauge import FREEDOMS, gauge_directions_of_cameras
from jaxpoint.calibration.recording import Freedom
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.row_groups import GroupSlopes, row_groups, slopes_of
from jaxpoint.calibration.shared_lenses import places_of, summed
from jaxpoint.calibration.uncertainty import variance_px2
from jaxpoint.camera.parameters import FOCAL, adjusted_lenses
from jaxpoint.motion import motion
from jaxpoint.tracks import Tracks

OFFSET, DRIFT, ROWS = -3, -2, -1
"""The last columns: frames by which a camera shows the light late, by how many more at the end of the recording than at
its start, and frames that it takes from its first image row to its last. `calibrate` solves for none, if not asked."""
EXTRA = 3  # of them


@dataclass(frozen=True)
class GaussNewtonStep:
    """The Gauss-Newton step under one choice of free parameters, and the covariance there."""

    change: Float[np.ndarray, "C q"]
    covariance: Float[np.ndarray, "D D"]  # D = q C; zero where held
    gain: float  # predicted fall of the cost in variances: chi-square, one degree of freedom a freed parameter

    @property
    def sigmas(self) -> Float[np.ndarray, "C q"]:
        """One standard deviation of every parameter; of camera parameters in some frame, of lens parameters in any."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(self.change.shape)

    def block(self, camera: int, columns: slice) -> Float[np.ndarray, "n n"]:
        """The covariance of some parameters of one camera."""
        start = camera * self.change.shape[1]
        some = slice(start + columns.start, start + columns.stop)
        return self.covariance[some, some]


@dataclass(frozen=True)
class NormalEquations:
    """J^T W J and J^T W r with the points eliminated (px^2), of all p parameters of a camera and the extra ones."""

    matrix: Float[np.ndarray, "D D"]
    gradient: Float[np.ndarray, " D"]
    gauge: Float[np.ndarray, "D n"]  # directions in which what is open of a similarity moves the cameras
    parameters: Float[np.ndarray, "C p"]  # where the solution stands; the poses as zeros
    variance: float  # px^2, by which the inverse is to be scaled

    def solve(self, freedom: Freedom, extra: tuple[int, ...] = ()) -> GaussNewtonStep:
        """The step and covariance when these parameters are free, under these priors (weighed for this noise).

        Args:
            extra: which of the extra columns are free too; ROWS in all cameras, the others in all but the first, which
                is the clock.

        Raises:
            LinAlgError: the observations leave more than a similarity open.
        """
        more = ((0, 0), (0, EXTRA))
        free = np.pad(freedom.free, more)
        weight = np.pad(np.where(freedom.free, freedom.prior_weight, 0.0), more)
        free[1:, list(extra)] = True
        free[0, ROWS] = ROWS in extra
        places = places_of(freedom.owner, len(free), freedom.free.shape[1], EXTRA).ravel()
        free &= (places == np.arange(free.size)).reshape(free.shape)
        pull = weight * np.pad(self.parameters - freedom.prior_mean, more)
        gradient = np.zeros(free.size)
        np.add.at(gradient, places, self.gradient + pull.ravel())
        chosen = np.flatnonzero(free)
        matrix = summed(self.matrix + np.diag(weight.ravel()), places)[np.ix_(chosen, chosen)]
        inverse = _inverse(matrix, self.gauge[chosen])
        change, covariance = np.zeros(free.size), np.zeros((free.size, free.size))
        change[chosen] = -inverse @ gradient[chosen]
        covariance[np.ix_(chosen, chosen)] = self.variance * inverse
        gain = -float(gradient @ change) / self.variance
        covariance = covariance[np.ix_(places, places)] if freedom.owner is not None else covariance
        return GaussNewtonStep(change[places].reshape(free.shape), covariance, gain)


def _inverse(matrix: np.ndarray, gauge: np.ndarray) -> np.ndarray:
    """Inverse but for the gauge directions."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    open_directions, _ = np.linalg.qr(gauge * scale[:, None])
    root = cho_factor(matrix / np.outer(scale, scale) + open_directions @ open_directions.T, check_finite=False)
    return cho_solve(root, np.eye(len(scale)), check_finite=False) / np.outer(scale, scale)


def normal_equations(calibration: Calibration) -> NormalEquations:
    """The normal equations of the inliers of a calibration as `calibrate` returned it. Plain numpy, float64."""
    rig, tracks = calibration.rig, calibration.tracks
    cameras, columns = len(rig), rig.camera_size + EXTRA
    seen = calibration.kept & calibration.point_valid[:, None]
    late = _late(tracks, motion(tracks.pixels, seen, tracks.series_ids).velocity)
    square = (calibration.residuals**2).sum(axis=-1)
    loss = np.inf if calibration.loss_scale is None else calibration.loss_scale
    weights = np.where(seen, 1.0 / (1.0 + square / loss**2), 0.0)
    matrix, gradient = np.zeros((cameras * columns, cameras * columns)), np.zeros(cameras * columns)
    for group in row_groups(calibration):
        slopes = slopes_of(calibration, group, seen)
        extra = np.where(seen[..., None, None], late, 0.0)[group.rows]
        slopes = slopes._replace(by_camera=np.concatenate([slopes.by_camera, extra], axis=-1))
        shown = np.where(group.shown[..., None], weights[group.rows], 0.0)
        part, slope = _eliminate(slopes, shown, calibration.residuals[group.rows], group.prior)
        matrix, gradient = matrix + part, gradient + slope
    parameters = np.zeros((cameras, rig.camera_size))
    parameters[:, FOCAL:] = adjusted_lenses(rig)
    count = FREEDOMS if calibration.hold is None else calibration.hold.open_freedoms
    gauge = np.pad(gauge_directions_of_cameras(rig)[..., :count], ((0, 0), (0, EXTRA), (0, 0)))
    mean_weight = weights[seen].mean() if seen.any() else 1.0
    variance = variance_px2(calibration) * mean_weight
    return NormalEquations(matrix, gradient, gauge.reshape(len(matrix), count), parameters, variance)


def _late(tracks: Tracks, velocity: Float[np.ndarray, "F C 2"]) -> Float[np.ndarray, "F C 2 3"]:
    """Derivatives of the residuals by the extra columns: a late observation moves on along its velocity.

    A row that is read later shows the light earlier than it would.
    """
    ids = tracks.frame_ids.astype(float)
    through = (ids - ids.mean()) / max(float(np.ptp(ids)), 1.0)
    down = tracks.pixels[..., 1] / tracks.image_sizes[:, 1] - 0.5
    factors = np.stack([np.ones_like(down), np.broadcast_to(through[:, None], down.shape), -down], axis=-1)
    return -velocity[..., None] * factors[:, :, None]


def _eliminate(
    slopes: GroupSlopes,
    weights: Float[np.ndarray, "B K C"],
    residuals: Float[np.ndarray, "B K C 2"],
    prior: Float[np.ndarray, " B"],
) -> tuple[Float[np.ndarray, "D D"], Float[np.ndarray, " D"]]:
    """What some unknowns add to the matrix and to the gradient."""
    root = np.sqrt(weights)[..., None, None]
    slopes = GroupSlopes(slopes.by_camera * root, slopes.by_unknown * root)
    left = residuals * root[..., 0]
    own, cross = slopes.own(prior), slopes.cross
    pull = np.einsum("bkcid,bkci->bd", slopes.by_unknown, left)
    moved = own @ cross
    matrix = -cross.reshape(-1, cross.shape[2]).T @ moved.reshape(-1, cross.shape[2])
    gradient = np.einsum("bkciq,bkci->cq", slopes.by_camera, left).ravel() - np.einsum("bdn,bd->n", moved, pull)
    count = weights.shape[2]
    each, blocks = np.arange(count), slopes.cameras
    matrix.reshape(count, blocks.shape[1], count, -1)[each, :, each] += blocks
    return matrix, gradient
