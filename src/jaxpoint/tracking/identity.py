"""Who is who: measured heads go to tracks, tracks are born, confirmed and end.

A head goes to the track that explains it best, all at once (the assignment of least total cost; the cost is minus twice
the log likelihood, so that a track that has been lost for long does not take a head from one that is known well).
Confirmed tracks choose first. A head that no track takes begins one, which counts once it was measured in 3 of its
first 5 frames; one that is not measured for 2 s ends. Whoever comes out from behind something within that time keeps the
id if the place can be reached by the chi-square gate, and is a new person otherwise; so is whoever comes back later:
geometry alone cannot tell who it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from jaxpoint.config.track import TrackSettings
from jaxpoint.tracking.association import Association, Predictions, mahalanobis

_FORBIDDEN = 1e6


@dataclass(frozen=True)
class Track:
    """One head's track after the latest frame."""

    key: int  # of this track and no other
    person: int  # id; 0 until the track is confirmed
    frames: int  # since it was born
    hits: int  # of these, how many measured it
    measured_at: float  # s
    mean: Float[np.ndarray, "6"]  # position (m), velocity (m/s)
    covariance: Float[np.ndarray, "6 6"]

    @staticmethod
    def new(key: int) -> Track:
        """A track about to begin."""
        return Track(key, 0, 0, 0, -np.inf, np.zeros(6), np.eye(6))

    def after(self, time: float | None, mean: Float[np.ndarray, "6"], covariance: Float[np.ndarray, "6 6"]) -> Track:
        """The track after one more frame, `time` (s) if that measured it."""
        hit = time is not None
        at = time if hit else self.measured_at
        return Track(self.key, self.person, self.frames + 1, self.hits + int(hit), at, mean, covariance)

    def outlived(self, time: float, settings: TrackSettings) -> bool:
        """Whether it ends before a frame at this time (s)."""
        wanted, tried = settings.confirm
        misses = self.frames - self.hits
        return time - self.measured_at > settings.occlusion_s or (self.person == 0 and misses > tried - wanted)


def match(
    found: Association, predictions: Predictions, first: Bool[np.ndarray, " T"], settings: TrackSettings
) -> Int[np.ndarray, " T"]:
    """Which of the S heads found is each track's, -1 where none; those marked `first` choose before the others."""
    chosen = np.full(len(predictions), -1)
    if not len(predictions) or not len(found.points):
        return chosen
    distance2, spread = mahalanobis(found.points, found.covariances, predictions)
    cost = np.where(distance2 <= chi2.ppf(settings.gate, 3), distance2 + spread, _FORBIDDEN)
    for group in (first, ~first):
        free = np.setdiff1d(np.arange(len(found.points)), chosen)
        own = np.flatnonzero(group)
        heads, tracks = linear_sum_assignment(cost[np.ix_(free, own)])
        allowed = cost[free[heads], own[tracks]] < _FORBIDDEN
        chosen[own[tracks[allowed]]] = free[heads[allowed]]
    return chosen


def confirmed(tracks: list[Track], people: int, settings: TrackSettings) -> tuple[list[Track], int]:
    """The tracks, new ids given to those that have earned one, and how many ids have been given in all."""
    named = []
    for track in tracks:
        if track.person == 0 and track.hits >= settings.confirm[0]:
            people += 1
            track = replace(track, person=people)
        named.append(track)
    return named, people
