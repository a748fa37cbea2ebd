"""Which candidates of one frame, one a camera at most, are the same head, and which track's; nothing but geometry.

Every pair of rays and every track's prediction is a hypothesis. It gathers the nearest ray of every view within the
gate, is fitted to these (and to the prediction, where it belongs to a track), and gathers anew. Its score is what it
explains beyond chance; the best one takes its candidates and its track, and the others do without them. Where two
people are in view, rays to different heads may meet as well ("ghosts"): a place that two views alone support is
accepted only where it continues a track, or where neither view has another explanation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from jaxpoint.body.tracking.rays import MIN_DEPTH, Rays
from jaxpoint.config.track import TrackSettings

MAX_SIGMA = 0.25  # m; a place known no better, from rays nearly parallel, is not used
_START_RANGE = 3.0  # m, before the distances are known
_ROUNDS = 2  # of fitting and gathering


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
    covariances: Float[np.ndarray, "H 3 3"]  # m^2
    members: Bool[np.ndarray, "H M"]
    tracks: Int[np.ndarray, " H"]  # which each continues; -1 where it is a new head
    score: Float[np.ndarray, " H"]  # twice the log likelihood over that of chance

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

    tracks: Int[np.ndarray, " S"]  # whose; -1 where it is a new head
    candidates: Int[np.ndarray, "S C"]  # index of the candidate of each camera, -1 where none


def associate(
    rays: Rays,
    cameras: int,
    predictions: Predictions,
    settings: TrackSettings,
    bounds: Float[np.ndarray, "2 3"],
) -> Association:
    """The heads of one frame, the best explained first; each candidate and each track is used once.

    Args:
        rays: the candidates.
        cameras: number of cameras, C.
        predictions: where tracks are expected.
        settings: gates.
        bounds: lowest and highest coordinates of a head, m.
    """
    tracks, taken, places = [], [], []
    free = np.ones(len(predictions), bool)
    while len(rays):
        hypotheses = _hypotheses(rays, predictions, free, settings, bounds)
        best = _best(_apart(hypotheses, places, settings), rays)
        if best is None:
            break
        members = best.members[0]
        candidates = np.full(cameras, -1)
        candidates[rays.camera[members]] = rays.candidate[members]
        taken.append(candidates)
        places.append(best.points[0])
        tracks.append(int(best.tracks[0]))
        free[best.tracks[best.tracks >= 0]] = False
        rays = rays.without(members)
    return Association(np.array(tracks, int), np.array(taken, int).reshape(-1, cameras))


@lru_cache
def quantile(share: float, degrees: int) -> float:
    """Of the chi-square distribution."""
    return float(chi2.ppf(share, degrees))


def near_prediction(rays: Rays, predictions: Predictions, settings: TrackSettings) -> Bool[np.ndarray, "T M"]:
    """Which rays pass within the gate of where tracks are expected."""
    return _deviation(rays, predictions.points, predictions.covariances) <= quantile(settings.gate, 2)


def _best(hypotheses: Hypotheses, rays: Rays) -> Hypotheses | None:
    """The hypothesis to accept next, alone; none where all that is left are new heads of two views with rivals.

    A new head has a ray that is not doubtful; what needs more doubtful rays than it does is no rival.
    """
    members = hypotheses.members.astype(int)
    new = hypotheses.tracks < 0
    doubts = members @ rays.doubtful
    rivals = (((members @ members.T) > 0) & new & (doubts <= doubts[:, None])).sum(axis=1) - 1
    sure = (doubts < hypotheses.views) & ((hypotheses.views > 2) | (rivals == 0))
    clear = np.flatnonzero(~new | sure)
    return hypotheses.select(clear[[np.argmax(hypotheses.score[clear])]]) if len(clear) else None


def _apart(hypotheses: Hypotheses, places: list[np.ndarray], settings: TrackSettings) -> Hypotheses:
    """Without those that are too near to a head already found."""
    if not places:
        return hypotheses
    gaps = np.linalg.norm(hypotheses.points[:, None] - np.array(places), axis=-1)
    return hypotheses.select((gaps >= settings.separation_m).all(axis=1))


def _hypotheses(
    rays: Rays,
    predictions: Predictions,
    free: Bool[np.ndarray, " T"],
    settings: TrackSettings,
    bounds: Float[np.ndarray, "2 3"],
) -> Hypotheses:
    """Every place that rays support, as a new head and as the next one of each track that it may be."""
    gate = quantile(settings.gate, 2)
    new = _new_heads(rays, settings, gate, bounds)
    tracks, members = _of_tracks(rays, predictions, np.flatnonzero(free), gate, new)
    prior = Predictions(predictions.points[tracks], predictions.covariances[tracks])
    points, covariances = _fit(rays, members, prior)
    known = np.linalg.slogdet(covariances)[1] - np.linalg.slogdet(prior.covariances)[1]
    gap = points - prior.points
    misfit = np.einsum("hi,hi->h", gap, np.linalg.solve(prior.covariances, gap[..., None])[..., 0])
    score = explained_share(rays, points, members, settings) - misfit + known
    continued = Hypotheses(points, covariances, members, tracks, score).select(score > 0)
    both = (np.concatenate([getattr(part, name) for part in (new, continued)]) for name in new.__dataclass_fields__)
    return _usable(Hypotheses(*both), rays, gate, bounds)


def _new_heads(rays: Rays, settings: TrackSettings, gate: float, bounds: Float[np.ndarray, "2 3"]) -> Hypotheses:
    """Places that rays of two views or more support, of any person."""
    points, covariances = _pairs(rays, gate, bounds)
    members = _nearest(rays, _deviation(rays, points, covariances), gate)
    for _ in range(_ROUNDS):
        points, _ = _fit(rays, _several(members))
        members = _nearest(rays, _deviation(rays, points), gate)
    members = _several(members)
    points, covariances = _fit(rays, members)
    known = np.linalg.slogdet(covariances)[1] + 3 * np.log(2 * np.pi) + 2 * np.log(settings.new_heads_m3)
    score = explained_share(rays, points, members, settings) + known
    return _usable(Hypotheses(points, covariances, members, np.full(len(points), -1), score), rays, gate, bounds)


def _of_tracks(
    rays: Rays, predictions: Predictions, free: Int[np.ndarray, " t"], gate: float, new: Hypotheses
) -> tuple[Int[np.ndarray, " H"], Bool[np.ndarray, "H M"]]:
    """For every free track the rays near its prediction, and those of every new head that may be its own."""
    prior = Predictions(predictions.points[free], predictions.covariances[free])
    members = _nearest(rays, _deviation(rays, prior.points, prior.covariances), gate)
    for _ in range(_ROUNDS):
        members = _nearest(rays, _deviation(rays, _fit(rays, members, prior)[0]), gate)
    gaps = new.points[:, None] - prior.points
    total = new.covariances[:, None] + prior.covariances
    near = np.einsum("hti,hti->ht", gaps, np.linalg.solve(total, gaps[..., None])[..., 0]) <= gate
    head, track = np.nonzero(near)
    tracks = np.concatenate([free, free[track]])
    members = np.concatenate([members, new.members[head]])
    seen = members.any(axis=1)
    tracks, members = tracks[seen], members[seen]
    once = _first_of_each(np.column_stack([tracks[:, None] == free, members]))
    return tracks[once], members[once]


def _usable(hypotheses: Hypotheses, rays: Rays, gate: float, bounds: Float[np.ndarray, "2 3"]) -> Hypotheses:
    """Those inside the bounds, known well enough, with every ray within the gate."""
    points = hypotheses.points
    deviation = np.where(hypotheses.members, _deviation(rays, points), 0.0)
    return hypotheses.select(
        (deviation <= gate).all(axis=1)
        & ((points >= bounds[0]) & (points <= bounds[1])).all(axis=1)
        & (np.linalg.eigvalsh(hypotheses.covariances)[:, -1] <= MAX_SIGMA**2)
    )


def explained_share(
    rays: Rays, points: Float[np.ndarray, "H 3"], members: Bool[np.ndarray, "H M"], settings: TrackSettings
) -> Float[np.ndarray, " H"]:
    """Twice the log likelihood of the rays over that of as many seen by chance."""
    across, _, sigma = rays.across(points)
    by_chance = np.log(2 * np.pi * settings.false_heads_m2 * sigma**2)
    return np.where(members, -2 * by_chance - (across**2).sum(axis=-1) / sigma**2, 0.0).sum(axis=1)


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
        spread = rays.axes @ covariances[:, None] @ rays.axes.swapaxes(1, 2)
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


def _several(members: Bool[np.ndarray, "H M"]) -> Bool[np.ndarray, "G M"]:
    """The sets of two rays or more, each once."""
    return members[_first_of_each(members) & (members.sum(axis=1) >= 2)]


def _first_of_each(rows: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, " H"]:
    """Which rows no earlier one equals."""
    packed = np.ascontiguousarray(np.packbits(rows, axis=1))
    first = np.zeros(len(rows), bool)
    first[np.unique(packed.view(f"V{packed.shape[1]}").ravel(), return_index=True)[1]] = True
    return first


def _fit(
    rays: Rays, members: Bool[np.ndarray, "H M"], prior: Predictions | None = None
) -> tuple[Float[np.ndarray, "H 3"], Float[np.ndarray, "H 3 3"]]:
    """The places nearest to their rays, each distance in its own sigma, and to their priors; and the covariances."""
    planes = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None]
    offsets = np.einsum("mij,mj->mi", planes, rays.origin)
    if prior is None:
        known, expected = np.zeros((3, 3)), np.zeros(3)
        weights = members / (_START_RANGE * rays.sigma) ** 2
    else:
        known = np.linalg.inv(prior.covariances)
        expected = np.einsum("hij,hj->hi", known, prior.points)
        weights = members / rays.across(prior.points)[2] ** 2
    points = covariances = np.zeros((0, 3))
    for _ in range(2):
        covariances = np.linalg.inv((weights @ planes.reshape(-1, 9)).reshape(-1, 3, 3) + known)
        points = np.einsum("hij,hj->hi", covariances, weights @ offsets + expected)
        weights = members / rays.across(points)[2] ** 2
    return points, covariances
