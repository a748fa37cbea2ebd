"""Which candidates of one frame, one a camera at most, are the same head; nothing but geometry decides.

Every pair of rays and every track's prediction is a hypothesis. It gathers the rays of all views that pass near it, is
fitted to them, and gathers anew; the best one takes its candidates, and the others do without them. Where two people are
in view, rays to different heads may meet as well ("ghosts"): a place that two views alone support is believed only
where it continues a track, or where neither view has another explanation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from jaxpoint.config.track import TrackSettings
from jaxpoint.tracking.rays import MIN_DEPTH, Rays

MAX_SIGMA = 0.25  # m; a place known no better, from rays nearly parallel, is none
_START_RANGE = 3.0  # m, before the distances are known


@dataclass(frozen=True)
class Predictions:
    """Where T tracks are expected."""

    points: Float[np.ndarray, "T 3"]  # m
    covariances: Float[np.ndarray, "T 3 3"]  # m^2

    def __len__(self) -> int:
        """Number of tracks, T."""
        return len(self.points)


@dataclass(frozen=True)
class Hypotheses:
    """H places of heads and the rays that support each, one a camera at most."""

    points: Float[np.ndarray, "H 3"]  # m
    covariances: Float[np.ndarray, "H 3 3"]  # m^2, from the rays
    members: Bool[np.ndarray, "H M"]
    score: Float[np.ndarray, " H"]  # how far inside its gate each ray lies, summed; a track adds its own
    continues: Bool[np.ndarray, " H"]  # whether a track was expected there

    @property
    def views(self) -> Int[np.ndarray, " H"]:
        """Number of supporting views."""
        return self.members.sum(axis=1)

    def select(self, index: np.ndarray) -> Hypotheses:
        """Some of them."""
        return Hypotheses(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Association:
    """The heads of one frame."""

    points: Float[np.ndarray, "S 3"]  # m
    covariances: Float[np.ndarray, "S 3 3"]  # m^2
    candidates: Int[np.ndarray, "S C"]  # index of the candidate of each camera, -1 where none
    ambiguous: Float[np.ndarray, "A 3"]  # m, places that two views support and that were not believed


def associate(
    rays: Rays,
    cameras: int,
    predictions: Predictions,
    settings: TrackSettings,
    bounds: Float[np.ndarray, "2 3"],
) -> Association:
    """The heads of one frame, best supported first, each candidate used once.

    Args:
        rays: the candidates.
        cameras: number of cameras, C.
        predictions: where tracks are expected.
        settings: gates.
        bounds: lowest and highest coordinates of a head, m.
    """
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    ambiguous: list[np.ndarray] = []
    hypotheses = None
    while len(rays) >= 2:
        if hypotheses is None or hypotheses.members.shape[1] != len(rays):
            hypotheses = _all_hypotheses(rays, predictions, settings, bounds)
            hypotheses = _apart(hypotheses, [point for point, _, _ in found], settings)
        best, unclear = _best(hypotheses)
        if best is None:
            ambiguous += list(hypotheses.points[unclear])
            break
        members = hypotheses.members[best]
        candidates = np.full(cameras, -1)
        candidates[rays.camera[members]] = rays.candidate[members]
        found.append((hypotheses.points[best], hypotheses.covariances[best], candidates))
        rays = rays.without(members)
    return Association(
        np.array([point for point, _, _ in found]).reshape(-1, 3),
        np.array([square for _, square, _ in found]).reshape(-1, 3, 3),
        np.array([candidates for _, _, candidates in found], dtype=int).reshape(-1, cameras),
        np.array(ambiguous).reshape(-1, 3),
    )


def near_prediction(
    rays: Rays, predictions: Predictions, settings: TrackSettings
) -> Bool[np.ndarray, "T M"]:
    """Which rays pass within the gate of where tracks are expected."""
    return _deviation(rays, predictions.points, predictions.covariances) <= chi2.ppf(settings.gate, 2)


def _best(hypotheses: Hypotheses) -> tuple[int | None, Bool[np.ndarray, " H"]]:
    """The hypothesis to believe next, and those of two views that have rivals for a candidate of theirs."""
    members = hypotheses.members.astype(int)
    rivals = ((members @ members.T) > 0).sum(axis=1) - 1
    unclear = (hypotheses.views == 2) & ~hypotheses.continues & (rivals > 0)
    clear = np.flatnonzero(~unclear)
    best = int(clear[np.argmax(hypotheses.score[clear])]) if len(clear) else None
    return best, unclear


def _apart(hypotheses: Hypotheses, points: list[np.ndarray], settings: TrackSettings) -> Hypotheses:
    """Without those that are too near to a head already found."""
    if not points:
        return hypotheses
    gaps = np.linalg.norm(hypotheses.points[:, None] - np.array(points), axis=-1)
    return hypotheses.select((gaps >= settings.separation_m).all(axis=1))


def _all_hypotheses(
    rays: Rays, predictions: Predictions, settings: TrackSettings, bounds: Float[np.ndarray, "2 3"]
) -> Hypotheses:
    """Every place that rays of two views or more support, once."""
    gate = chi2.ppf(settings.gate, 2)
    points, covariances = _pairs(rays, gate, bounds)
    points = np.concatenate([points, predictions.points])
    covariances = np.concatenate([covariances, predictions.covariances])
    members = _nearest(rays, _deviation(rays, points, covariances), gate)
    for _ in range(2):
        members = np.unique(members[members.sum(axis=1) >= 2], axis=0)
        points, covariances = _fit(rays, members)
        members = _nearest(rays, _deviation(rays, points), gate)
    members = np.unique(members[members.sum(axis=1) >= 2], axis=0)
    points, covariances = _fit(rays, members)
    deviation = np.where(members, _deviation(rays, points), 0.0)
    score = np.where(members, gate - deviation, 0.0).sum(axis=1)
    support = _support(points, covariances, predictions, settings)
    usable = (
        (deviation <= gate).all(axis=1)
        & ((points >= bounds[0]) & (points <= bounds[1])).all(axis=1)
        & (np.linalg.eigvalsh(covariances)[:, -1] <= MAX_SIGMA**2)
    )
    return Hypotheses(points, covariances, members, score + support, support > 0).select(usable)


def _pairs(
    rays: Rays, gate: float, bounds: Float[np.ndarray, "2 3"]
) -> tuple[Float[np.ndarray, "H 3"], Float[np.ndarray, "H 3 3"]]:
    """Where rays of two views meet, within the gate and not far outside of the bounds."""
    one, other = np.nonzero(rays.camera[:, None] < rays.camera)
    members = np.zeros((len(one), len(rays)), bool)
    rows = np.arange(len(one))
    members[rows, one] = members[rows, other] = True
    sine = np.linalg.norm(np.cross(rays.direction[one], rays.direction[other]), axis=-1)
    members = members[sine > 3 * np.maximum(rays.sigma[one], rays.sigma[other])]
    points, covariances = _fit(rays, members)
    near = (np.where(members, _deviation(rays, points), 0.0) <= gate).all(axis=1)
    reach = 3 * np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    inside = ((points >= bounds[0] - reach) & (points <= bounds[1] + reach)).all(axis=1)
    return points[near & inside], covariances[near & inside]


def _support(
    points: Float[np.ndarray, "H 3"],
    covariances: Float[np.ndarray, "H 3 3"],
    predictions: Predictions,
    settings: TrackSettings,
) -> Float[np.ndarray, " H"]:
    """How far inside the gate of the nearest track each place lies; 0 where it is outside of all."""
    if not len(predictions):
        return np.zeros(len(points))
    distance2 = mahalanobis(points, covariances, predictions)[0].min(axis=1)
    return np.maximum(chi2.ppf(settings.gate, 3) - distance2, 0.0)


def mahalanobis(
    points: Float[np.ndarray, "S 3"], covariances: Float[np.ndarray, "S 3 3"], predictions: Predictions
) -> tuple[Float[np.ndarray, "S T"], Float[np.ndarray, "S T"]]:
    """Squared distance of every point from every track in standard deviations, and the log determinant of these."""
    total = covariances[:, None] + predictions.covariances
    offset = points[:, None] - predictions.points
    distance2 = np.einsum("sti,sti->st", offset, np.linalg.solve(total, offset[..., None])[..., 0])
    return distance2, np.linalg.slogdet(total)[1]


def _deviation(
    rays: Rays, points: Float[np.ndarray, "H 3"], covariances: Float[np.ndarray, "H 3 3"] | None = None
) -> Float[np.ndarray, "H M"]:
    """Squared distance of every ray from every place in standard deviations: chi-square of 2 degrees of freedom.

    Infinite where the place is behind the camera. Without `covariances` (m^2) the places are taken as exact.
    """
    across, along, sigma = rays.across(points)
    if covariances is None:
        deviation = (across**2).sum(axis=-1) / sigma**2
    else:
        spread = np.einsum("mai,hij,mbj->hmab", rays.axes, covariances, rays.axes, optimize=True)
        xx, xy, yy = spread[..., 0, 0] + sigma**2, spread[..., 0, 1], spread[..., 1, 1] + sigma**2
        x, y = across[..., 0], across[..., 1]
        deviation = (yy * x**2 - 2 * xy * x * y + xx * y**2) / (xx * yy - xy**2)
    return np.where(along > MIN_DEPTH, deviation, np.inf)


def _nearest(rays: Rays, deviation: Float[np.ndarray, "H M"], gate: float) -> Bool[np.ndarray, "H M"]:
    """The nearest ray of each camera, where it is within the gate."""
    members = np.zeros(deviation.shape, bool)
    rows = np.arange(len(deviation))
    for camera in np.unique(rays.camera):
        own = np.flatnonzero(rays.camera == camera)
        nearest = own[np.argmin(deviation[:, own], axis=1)]
        members[rows, nearest] = deviation[rows, nearest] <= gate
    return members


def _fit(
    rays: Rays, members: Bool[np.ndarray, "H M"]
) -> tuple[Float[np.ndarray, "H 3"], Float[np.ndarray, "H 3 3"]]:
    """The places nearest to their rays, each distance in its own sigma, and their covariances."""
    planes = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None]
    offsets = np.einsum("mij,mj->mi", planes, rays.origin)
    weights = members / (_START_RANGE * rays.sigma) ** 2
    points = covariances = np.zeros((0, 3))
    for _ in range(2):
        covariances = np.linalg.inv((weights @ planes.reshape(-1, 9)).reshape(-1, 3, 3))
        points = np.einsum("hij,hj->hi", covariances, weights @ offsets)
        weights = members / rays.across(points)[2] ** 2
    return points, covariances
