"""Identities of tracks: they are born, get an id, wait while nobody sees them, and end.

A head that continues no track begins one. It gets an id once it was measured in 3 of its first 5 frames (by three views
or more where somebody else is within a metre, since rays to two people cross between them): the id of a track lost
before it began, if both can be the same way of one person (chi-square of position and velocity), else a new one. A lost
track waits for 2 s. So a person who comes out from behind something within that time, about where expected, keeps the
id; one who comes back later is a new person: geometry alone cannot identify anybody.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from jaxpoint.config.track import TrackSettings

BESIDE_M = 1.0  # people nearer than this are beside one another


@dataclass(frozen=True)
class Track:
    """One head's track after the latest frame."""

    key: int  # of this track and no other
    person: int  # id; 0 until the track is confirmed
    frames: int  # since it was born
    hits: int  # of these, how many saw it well enough to confirm it
    born_at: float  # s
    measured_at: float  # s, the last time
    mean: Float[np.ndarray, "6"]  # position (m), velocity (m/s)
    covariance: Float[np.ndarray, "6 6"]

    @staticmethod
    def new(key: int, time: float) -> Track:
        """A track about to begin at this time (s)."""
        return Track(key, 0, 0, 0, time, time, np.zeros(6), np.eye(6))

    def after(
        self, time: float, views: int, beside: bool, mean: Float[np.ndarray, "6"], covariance: Float[np.ndarray, "6 6"]
    ) -> Track:
        """The track after one more frame, at `time` (s), in which so many views saw it.

        Rays of two views to a person `beside` it may meet there, so that these do not help to confirm it.
        """
        return replace(
            self,
            frames=self.frames + 1,
            hits=self.hits + (views >= 3 or (views == 2 and not beside)),
            measured_at=time if views >= 2 else self.measured_at,
            mean=mean,
            covariance=covariance,
        )

    def is_expired(self, time: float, settings: TrackSettings) -> bool:
        """Whether it ends before a frame at this time (s)."""
        wanted, tried = settings.confirm
        misses = self.frames - self.hits
        return time - self.measured_at > settings.occlusion_s or (self.person == 0 and misses > tried - wanted)


def name_tracks(tracks: list[Track], people: int, settings: TrackSettings) -> tuple[list[Track], int]:
    """The tracks, an id given to those that have earned one, and how many ids have been given in all.

    A track that is confirmed takes the id of one that was lost before it began, and ends that, where both can be the
    same way of one person.
    """
    for track in [track for track in tracks if track.person == 0 and track.hits >= settings.confirm[0]]:
        lost = [other for other in tracks if other.person > 0 and other.measured_at < track.born_at]
        before = min(lost, key=lambda other: _unlike(track, other)[0], default=None)
        if before is not None and _unlike(track, before)[1] <= chi2.ppf(settings.gate, 6):
            person = before.person
            tracks = [other for other in tracks if other is not before]
        else:
            person = people = people + 1
        tracks = [replace(other, person=person) if other is track else other for other in tracks]
    return tracks, people


def beside_others(points: Float[np.ndarray, "T 3"], others: Bool[np.ndarray, " T"]) -> Bool[np.ndarray, " T"]:
    """Whether each place (m) has one of the `others` beside it."""
    gaps = np.linalg.norm(points[:, None] - points, axis=-1)
    np.fill_diagonal(gaps, np.inf)
    return ((gaps < BESIDE_M) & others).any(axis=1)


def _unlike(one: Track, other: Track) -> tuple[float, float]:
    """Minus twice the log likelihood that both are one, but for a constant, and the squared Mahalanobis distance."""
    total = one.covariance + other.covariance
    gap = one.mean - other.mean
    distance2 = float(gap @ np.linalg.solve(total, gap))
    return distance2 + float(np.linalg.slogdet(total)[1]), distance2
