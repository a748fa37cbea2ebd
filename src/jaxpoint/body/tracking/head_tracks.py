"""What the tracker gives: where each person was in every frame, and why where nobody was found."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from jaxpoint.body.tracking.identity import Track


class Status(IntEnum):
    """How a person's head is known in a frame."""

    ABSENT = 0  # before the person's first frame or after the last
    MEASURED = 1  # three views or more
    TWO_VIEWS = 2  # two: nothing checks that they saw the same head but the track
    ONE_VIEW = 3  # one: along its line of sight the track alone
    NO_VIEW = 4  # the track alone: no view saw a head where it was expected
    AMBIGUOUS = 5  # the track alone: views did, but they do not agree, or another person explains them


REASONS = {
    Status.ABSENT: "not in the room",
    Status.MEASURED: "measured",
    Status.TWO_VIEWS: "two views only",
    Status.ONE_VIEW: "one view only",
    Status.NO_VIEW: "no view",
    Status.AMBIGUOUS: "views do not agree",
}


def status_of(views: Int[np.ndarray, "*batch"]) -> Int[np.ndarray, "*batch"]:
    """`Status` by the number of views that measured a head."""
    return np.array([Status.NO_VIEW, Status.ONE_VIEW, Status.TWO_VIEWS, Status.MEASURED])[np.minimum(views, 3)]


@dataclass(frozen=True)
class FrameHeads:
    """The T heads that are followed in one frame, known from this frame and those before it."""

    tracks: tuple[Track, ...]
    status: Int[np.ndarray, " T"]  # values of `Status`
    candidates: Int[np.ndarray, "T C"]  # index of the candidate of each camera; -1 where none was used
    points: Float[np.ndarray, "T 3"]  # m, as the views of this frame alone see it
    informations: Float[np.ndarray, "T 3 3"]  # of the points, 1/m^2; 0 where no view does, rank 2 where one does
    innovations2: Float[np.ndarray, " T"]  # squared distance of measured from predicted, in standard deviations

    def select(self, kept: Bool[np.ndarray, " T"]) -> FrameHeads:
        """Some of the heads."""
        arrays = [getattr(self, field.name)[kept] for field in fields(self)[1:]]
        return FrameHeads(tuple(track for track, keep in zip(self.tracks, kept) if keep), *arrays)


@dataclass(frozen=True)
class HeadTracks:
    """The heads of N people over F frames by C cameras; zeros where `status` is ABSENT. `heads.csv` holds this."""

    frame_ids: Int[np.ndarray, " F"]  # number of the frame in the recording (sync_index)
    times: Float[np.ndarray, " F"]  # s
    people: Int[np.ndarray, " N"]  # ids, from 1
    positions: Float[np.ndarray, "F N 3"]  # m, world z up
    sigma: Float[np.ndarray, "F N"]  # m, standard deviation in the worst direction
    used: Bool[np.ndarray, "F N C"]  # views that measured it
    status: Int[np.ndarray, "F N"]  # values of `Status`
    cameras: tuple[str, ...]  # names

    @property
    def present(self) -> Bool[np.ndarray, "F N"]:
        """Where a person has a place."""
        return self.status != Status.ABSENT

    @property
    def measured(self) -> Bool[np.ndarray, "F N"]:
        """Where two views of the frame itself or more saw it."""
        return (self.status == Status.MEASURED) | (self.status == Status.TWO_VIEWS)


@dataclass(frozen=True)
class Tracking:
    """The tracks and all that the smoother knows of them; zeros where a person is ABSENT."""

    heads: HeadTracks
    velocities: Float[np.ndarray, "F N 3"]  # m/s
    covariances: Float[np.ndarray, "F N 6 6"]  # of position and velocity, m and s
    candidates: Int[np.ndarray, "F N C"]  # which candidate of each camera is this person; -1 where none was used
    points: Float[np.ndarray, "F N 3"]  # m, as the views of a frame alone see it
    informations: Float[np.ndarray, "F N 3 3"]  # of the points, 1/m^2; 0 where no view does, rank 2 where one does
    innovations2: Float[
        np.ndarray, "F N"
    ]  # squared distance from the prediction, in standard deviations: chi-square of 3

    def parts(self) -> list[Shaped[np.ndarray, "F N ..."]]:
        """All arrays that are about people, to be changed in place."""
        about = [getattr(self.heads, name) for name in ("positions", "sigma", "used", "status")]
        return about + [getattr(self, field.name) for field in fields(self)[1:]]

    def without_the_absent(self) -> Tracking:
        """Only the people who are there in some frame."""
        kept = self.heads.present.any(axis=0)
        names = ("positions", "sigma", "used", "status")
        heads = replace(
            self.heads, people=self.heads.people[kept], **{name: getattr(self.heads, name)[:, kept] for name in names}
        )
        return Tracking(heads, *(getattr(self, field.name)[:, kept] for field in fields(self)[1:]))
