"""How well a place will be triangulated, before anybody stands there, and what more light would change.

The expected error of a place is the root of the trace of its covariance: what the cameras' errors do to it plus what
the noise of its own pixels does (Foerstner and Wrobel 2016, chapter 15). More light adds rows to the adjustment; with
its points eliminated their effect on the cameras' covariance is that of a Kalman filter's update, in whatever gauge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.middle import far_middle, near
from jaxpoint.calibration.sight import centres, covariance_of_points, cross_terms, derivatives_perturbed, in_view
from jaxpoint.camera.rig import CameraRig
from jaxpoint.triangulation import MIN_PARALLAX

BLOCK = 512  # places at once
ADDED = 100  # positions of the light whose gain is predicted
BOXES = 4  # along the longest side of the volume


@dataclass(frozen=True)
class ExpectedError:
    """Of P places in the room, each seen by all cameras that have it in view; in the rig's unit, squared."""

    seen: Bool[np.ndarray, "P C"]
    calibration: Float[np.ndarray, " P"]  # trace of the covariance, because the cameras are uncertain
    observation: Float[np.ndarray, " P"]  # because the pixels of the place itself are
    parallax: Float[np.ndarray, " P"]  # rad, the largest angle between two lines of sight

    @property
    def known(self) -> Bool[np.ndarray, " P"]:
        """Whether two cameras or more see the place, under 2 degrees or more."""
        return (self.seen.sum(axis=1) >= 2) & (self.parallax >= MIN_PARALLAX)

    @property
    def total(self) -> Float[np.ndarray, " P"]:
        """Root of the mean squared distance from the truth, rig's unit; infinite where the place is not known."""
        return np.where(self.known, np.sqrt(np.maximum(self.calibration, 0.0) + self.observation), np.inf)


def expected_error(
    rig: CameraRig, covariance: Float[np.ndarray, "D D"], sigma_px: float, places: Float[np.ndarray, "P 3"]
) -> ExpectedError:
    """The error to expect at places of the rig's frame.

    Args:
        covariance: of the cameras, D = p C, in the order of `Camera.perturbed`.
        sigma_px: standard deviation of one pixel coordinate of the places' own observations.
    """
    middle = far_middle(places)
    rig, covariance = near(rig, covariance, middle)
    places = places - middle
    seen = in_view(rig, places)
    parts = [moved_by_cameras(rig, places[some], seen[some]) for some in _blocks(len(places))]
    calibration = [_trace(moved, covariance) for moved, _ in parts]
    observation = [sigma_px**2 * np.trace(own, axis1=1, axis2=2) for _, own in parts]
    return ExpectedError(seen, np.concatenate(calibration), np.concatenate(observation), parallax(rig, places, seen))


@dataclass(frozen=True)
class Gain:
    """What more light in one part of the room is predicted to do."""

    part: int  # which of the parts asked about
    cameras: tuple[int, ...]  # that see most of it
    before: float  # mean expected error over the places, rig's unit
    after: float

    @property
    def fraction(self) -> float:
        """By which the mean expected error falls."""
        return 1.0 - self.after / self.before


def gains(
    rig: CameraRig,
    covariance: Float[np.ndarray, "D D"],
    sigma_px: float,
    variance_px2: float,
    places: Float[np.ndarray, "P 3"],
    parts: Float[np.ndarray, "N M 3"],
    added: int = ADDED,
) -> list[Gain]:
    """What `added` more positions of the light in each part of the room would do to the mean expected error.

    A part is M positions that share the number, each seen by the cameras that have it in view. Parts most of which
    fewer than two cameras see are left out. Best first.

    Args:
        variance_px2: of one coordinate of a believed observation of the light, see `uncertainty.variance_px2`.
        places: of the room, over which the mean is taken; those that are not known are left out.
    """
    middle = far_middle(places)
    rig, covariance = near(rig, covariance, middle)
    places, parts = places - middle, parts - middle
    now = expected_error(rig, covariance, sigma_px, places)
    places, before = places[now.known], now.total[now.known]
    if not len(places):
        return []
    moved = np.concatenate([moved_by_cameras(rig, places[b], now.seen[now.known][b])[0] for b in _blocks(len(places))])
    flat, found = moved.reshape(-1, len(covariance)), []
    for part, light in enumerate(parts):
        seen = in_view(rig, light)
        useful = seen.sum(axis=1) >= 2
        if useful.sum() < len(light) / 2:
            continue
        root = covariance_reduction(rig, covariance, light[useful], seen[useful], variance_px2 * useful.sum() / added)
        less = ((flat @ root) ** 2).reshape(len(places), -1).sum(axis=1)
        after = np.sqrt(np.maximum(before**2 - less, 0.0))
        cameras = tuple(np.flatnonzero(seen.mean(axis=0) > 0.5).tolist())
        found.append(Gain(part, cameras, float(before.mean()), float(after.mean())))
    return sorted(found, key=lambda gain: gain.after)


def covariance_reduction(
    rig: CameraRig,
    covariance: Float[np.ndarray, "D D"],
    light: Float[np.ndarray, "M 3"],
    seen: Bool[np.ndarray, "M C"],
    variance_px2: float,
) -> Float[np.ndarray, "D R"]:
    """What observing positions of the light takes from the cameras' covariance: B B^T, whatever the gauge.

    The positions are unknown; the part of their pixels that a moved position would explain says nothing.
    """
    by_camera, by_point = derivatives_perturbed(rig, light, seen)
    own, count = covariance_of_points(by_point, seen), len(rig)
    of_point = by_point.reshape(len(light), 2 * count, 3)
    explained = of_point @ own @ np.swapaxes(of_point, 1, 2)
    each = np.arange(count)
    rows = np.zeros((len(light), count, 2, count, by_camera.shape[3]))
    rows[:, each, :, each] = by_camera.transpose(1, 0, 2, 3)
    rows = rows.reshape(len(light), 2 * count, -1)
    rows = (rows - explained @ rows)[np.repeat(seen, 2, axis=1)]
    reach = covariance @ rows.T
    innovation = rows @ reach + variance_px2 * np.eye(len(rows))
    return np.linalg.solve(np.linalg.cholesky(innovation), reach.T).T


def boxes_of(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Float[np.ndarray, "N 2 3"]:
    """A coarse grid of about cubic boxes: their lowest and highest coordinates."""
    counts = np.clip(np.round(BOXES * (high - low) / (high - low).max()), 1, BOXES).astype(int)
    steps = (high - low) / counts
    corners = low + np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3) * steps
    return np.stack([corners, corners + steps], axis=1)


def eighths(boxes: Float[np.ndarray, "N 2 3"]) -> Float[np.ndarray, "N 8 3"]:
    """The middles of the eight parts of every box."""
    corners = np.stack(np.meshgrid(*[[0.25, 0.75]] * 3, indexing="ij"), axis=-1).reshape(1, -1, 3)
    return boxes[:, :1] + corners * (boxes[:, 1:] - boxes[:, :1])


def moved_by_cameras(
    rig: CameraRig, places: Float[np.ndarray, "B 3"], seen: Bool[np.ndarray, "B C"]
) -> tuple[Float[np.ndarray, "B 3 D"], Float[np.ndarray, "B 3 3"]]:
    """Derivatives of triangulated places by the cameras' parameters (B, 3, D), and their covariance for pixels of 1."""
    by_camera, by_point = derivatives_perturbed(rig, places, seen)
    own = covariance_of_points(by_point, seen)
    return -own @ cross_terms(by_camera, by_point), own


def _trace(moved: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    flat = moved.reshape(-1, len(covariance))
    return ((flat @ covariance) * flat).sum(axis=1).reshape(-1, 3).sum(axis=1)


def parallax(
    rig: CameraRig, places: Float[np.ndarray, "B 3"], seen: Bool[np.ndarray, "B C"]
) -> Float[np.ndarray, " B"]:
    """The largest angle between two lines of sight, rad, 0 to pi / 2, as `triangulate` has it."""
    sight = places[:, None] - centres(rig)
    sight /= np.maximum(np.linalg.norm(sight, axis=-1, keepdims=True), 1e-12)
    cosine = np.abs(sight @ np.swapaxes(sight, 1, 2))
    both = seen[:, :, None] & seen[:, None, :]
    return np.arccos(np.clip(np.where(both, cosine, 1.0).min(axis=(1, 2)), 0.0, 1.0))


def _blocks(count: int) -> list[slice]:
    return [slice(start, start + BLOCK) for start in range(0, max(count, 1), BLOCK)]
