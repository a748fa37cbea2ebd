"""How well cameras agree under given clocks, and the clock of one camera under which it agrees best with others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.calibration.twoview import (
    FIRST_LENSES,
    LOOSE,
    NormalisedTracks,
    fit_pair,
    normalise_tracks,
    pair_threshold,
)
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import EpipolarSettings
from jaxpoint.epipolar import PairFit
from jaxpoint.motion import Motion, OnClock, frame_step, held_still, motion, on_clock, without_jumps
from jaxpoint.tracks import Tracks

MOST_FRAMES = 2000  # of a longer recording every n-th are compared
SAMPLES = 128  # minimal samples a fit: fewer than for the geometry itself, but there are many fits
STEPS = (2.0, 1.0, 0.5, 0.25)  # by which both ends of a camera's clock are moved, coarse to fine
APART = 0.25  # frames before and after, between which the light's motion is taken
TRIES = 8  # moves at each of these
CHANCE = 0.25  # share of matches that some epipolar geometry fits whatever the clocks, about
HOPEFUL = 0.35  # share of matches where a clock was found: less, and it is not followed farther
DRIFTS = 0.02  # by so much the share must rise before a rate of its own is believed


@dataclass(frozen=True)
class Clock:
    """Which frame of a camera shows a moment of the common clock: one `offset` later, and `rate` to each of its own."""

    offset: float = 0.0  # frames late at the first frame of the tracks
    rate: float = 1.0  # frames of the camera to one of the common clock

    def at(self, frames: float) -> float:
        """Frames late, so many frames after the first of the tracks."""
        return self.offset + (self.rate - 1.0) * frames

    @staticmethod
    def through(first: tuple[float, float], second: tuple[float, float]) -> Clock:
        """From two pairs of frames after the first, and frames late there."""
        slope = (second[1] - first[1]) / (second[0] - first[0])
        return Clock(first[1] - slope * first[0], 1.0 + slope)


@dataclass(frozen=True)
class Share:
    """How many matches of two or more views one epipolar geometry fits."""

    fit: float  # 0..1, near ones counting most
    matches: float

    @property
    def beyond_chance(self) -> float:
        """Matches that fit, over those that fit whatever the clocks."""
        return (self.fit - CHANCE) * self.matches


@dataclass(frozen=True)
class PairView:
    """Two cameras' views on one clock, and the geometry that fits them."""

    first: Float[np.ndarray, "P 2"]  # over half the image diagonal, distorted
    second: Float[np.ndarray, "P 2"]
    seen: Bool[np.ndarray, " P"]  # by both
    rows: Int[np.ndarray, " N"]  # of the tracks; the other places only pad
    fundamental: Float[np.ndarray, "3 3"]
    lenses: Float[np.ndarray, " 2"]  # division-model parameters
    half_diagonals: Float[np.ndarray, " 2"]  # px
    width: float  # px


@dataclass(frozen=True)
class Course:
    """How the light goes through one camera's view."""

    velocity: Float[np.ndarray, "P 2"]  # over half the image diagonal, a frame
    down: Float[np.ndarray, " P"]  # below the image's middle, as a share of its height
    seen: Bool[np.ndarray, " P"]


class Agreement:
    """Shares of matches for cameras under any clocks; what was computed once is kept.

    The light's motion is taken from `usable` observations (as `moving_only` gives), from all where it is not given.
    """

    def __init__(
        self,
        tracks: Tracks,
        settings: EpipolarSettings,
        seed: int,
        intrinsics: CameraRig | None,
        usable: Bool[np.ndarray, "F C"] | None = None,
    ):
        self.tracks = tracks
        self.step = frame_step(tracks.series_ids)
        self.usable = tracks.visible if usable is None else usable
        self._settings = replace(settings, samples=min(settings.samples, SAMPLES))
        self._seed, self._intrinsics = seed, intrinsics
        self._moving = motion(tracks.pixels, self.usable, tracks.series_ids)
        self._columns: dict[tuple[int, Clock, bytes], NormalisedTracks] = {}
        self._shares: dict[tuple, Share] = {}

    def share(
        self, first: tuple[int, Clock], second: tuple[int, Clock], within: Bool[np.ndarray, " F"] | None = None
    ) -> Share:
        """The share of two cameras under two clocks, in some frames of the common clock."""
        key = (first, second, b"" if within is None else within.tobytes())
        if key not in self._shares:
            self._shares[key] = self._fit(*(self._column(*one, within) for one in (first, second)))
        return self._shares[key]

    def shares(self, one: tuple[int, Clock], others: Sequence[tuple[int, Clock]], within=None) -> Share:
        """All matches of one camera with others."""
        each = [self.share(other, one, within) for other in others]
        matches = sum(share.matches for share in each)
        return Share(sum(share.fit * share.matches for share in each) / max(matches, 1.0), matches)

    def _column(self, camera: int, clock: Clock, within) -> NormalisedTracks:
        """One camera's view on the common clock."""
        key = (camera, clock, b"" if within is None else within.tobytes())
        if key not in self._columns:
            moved = self._moved(camera, clock).applied(self.tracks.select_cameras([camera]))
            moved = moved.select_frames(self._rows(within))
            lens = None if self._intrinsics is None else self._intrinsics.select([camera])
            self._columns[key] = normalise_tracks(moved, lens)
        return self._columns[key]

    def _moved(self, camera: int, clock: Clock) -> OnClock:
        alone, moving = self.tracks.select_cameras([camera]), _of_camera(self._moving, camera)
        return on_clock(alone, moving, np.array([clock.offset]), np.array([clock.rate]))

    def course(self, camera: int, clock: Clock) -> Course:
        """How one camera's view moves on the common clock."""
        step = APART * self.step
        before, after = (self._column(camera, replace(clock, offset=clock.offset + by), None) for by in (-step, step))
        seen = (before.visible & after.visible)[:, 0]
        down, rows = np.zeros(len(seen)), self._rows(None)
        down[: len(rows)] = self._moved(camera, clock).down[rows, 0]
        return Course((after.points - before.points)[:, 0] / (2.0 * step), down, seen)

    def _rows(self, within) -> np.ndarray:
        rows = np.arange(self.tracks.frames) if within is None else np.flatnonzero(within)
        return rows[:: max(1, -(-len(rows) // MOST_FRAMES))]

    def pair(self, first: tuple[int, Clock], second: tuple[int, Clock]) -> PairView:
        """Two views on one clock, and their epipolar geometry."""
        views = _side_by_side(self._column(*first, None), self._column(*second, None))
        found = self._geometry(views)
        lens = np.zeros(2) if self._intrinsics is not None else FIRST_LENSES[int(found.choice)]
        points, seen = views.points, np.asarray(views.visible.all(axis=1))
        matrix, width = np.array(found.fundamental), float(views.widths.mean())
        return PairView(points[:, 0], points[:, 1], seen, self._rows(None), matrix, lens, views.half_diagonals, width)

    def _fit(self, first: NormalisedTracks, second: NormalisedTracks) -> Share:
        views = _side_by_side(first, second)
        seen = views.visible.all(axis=1)
        if seen.sum() < self._settings.min_shared_frames:
            return Share(0.0, 0.0)
        threshold = LOOSE * pair_threshold(views, (0, 1), self._settings)
        errors = np.asarray(self._geometry(views).error)[seen]
        return Share(float(np.maximum(0.0, 1.0 - (errors / threshold) ** 2).mean()), float(seen.sum()))

    def _geometry(self, views: NormalisedTracks) -> PairFit:
        threshold = LOOSE * pair_threshold(views, (0, 1), self._settings)
        lenses = FIRST_LENSES if self._intrinsics is None else np.zeros_like(FIRST_LENSES)
        return fit_pair(views, (0, 1), self._settings, np.random.default_rng(self._seed), lenses, threshold)


def _side_by_side(first: NormalisedTracks, second: NormalisedTracks) -> NormalisedTracks:
    return NormalisedTracks(
        np.concatenate([first.points, second.points], axis=1),
        np.concatenate([first.visible, second.visible], axis=1),
        np.concatenate([first.half_diagonals, second.half_diagonals]),
        np.concatenate([first.widths, second.widths]),
        np.concatenate([first.pixel_aspects, second.pixel_aspects]),
    )


def moving_only(tracks: Tracks) -> tuple[Tracks, Bool[np.ndarray, "F C"]]:
    """The tracks without pixels that stand still, which fit any clock, and which of the others are no outliers."""
    moving = _with_visible(tracks, tracks.visible & ~held_still(tracks.pixels, tracks.visible))
    widths = tracks.image_sizes[:, 0].astype(float)
    return moving, without_jumps(moving.pixels, moving.visible, tracks.series_ids, widths)


def _with_visible(tracks: Tracks, visible: Bool[np.ndarray, "F C"]) -> Tracks:
    """The tracks with fewer observations."""
    pixels = np.where(visible[..., None], tracks.pixels, 0.0)
    return replace(tracks, pixels=pixels, visible=visible)


def _of_camera(moving: Motion, camera: int) -> Motion:
    one = slice(camera, camera + 1)
    return Motion(
        moving.velocity[:, one],
        moving.acceleration[:, one],
        moving.velocity_weights[:, one],
        moving.acceleration_weights[:, one],
        moving.known[:, one],
    )


def refine(
    agreement: Agreement,
    camera: int,
    start: Clock,
    others: Sequence[tuple[int, Clock]],
    middle: float = 0.0,
    reach: float = np.inf,
) -> tuple[Clock, Share]:
    """The clock near `start` under which a camera agrees best with others.

    First in the frames within `reach` of `middle`, where `start` was found, then in twice as many and so on: a rate
    that is a little wrong puts the ends of a long recording far off. A rate of its own is kept only where it helps.
    """
    ids = agreement.tracks.frame_ids.astype(float)
    after = ids - ids[0]
    while True:
        within = np.abs(after - middle) <= reach
        ends = float(after[within][0]), float(after[within][-1])
        every = bool(within.all())
        start, share = _search(agreement, camera, start, others, ends, None if every else within)
        if every or share.fit < HOPEFUL:
            return start, share if every else Share(0.0, 0.0)
        reach *= 2.0


def _search(agreement: Agreement, camera, start: Clock, others, ends, within) -> tuple[Clock, Share]:
    together = ((1, 1), (-1, -1))
    apart = (*together, (1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1))
    best = _descend(agreement, camera, start, others, ends, within, together)
    if best[1].fit < HOPEFUL:
        return best
    drifting = _descend(agreement, camera, best[0], others, ends, within, apart)
    return drifting if drifting[1].fit > best[1].fit + DRIFTS else best


def _descend(agreement: Agreement, camera, start: Clock, others, ends, within, moves) -> tuple[Clock, Share]:
    """Move the clock at both ends while the matches that fit become more, in ever smaller steps."""
    late = tuple(start.at(end) for end in ends)
    best = start, agreement.shares((camera, start), others, within)
    for step in STEPS:
        for _ in range(TRIES):
            before = best
            for move in moves:
                moved = tuple(one + step * agreement.step * part for one, part in zip(late, move))
                clock = _through(start, ends, moved, moves)
                share = agreement.shares((camera, clock), others, within)
                if share.beyond_chance > best[1].beyond_chance:
                    best = clock, share
            late = tuple(best[0].at(end) for end in ends)
            if best is before:
                break
    return best


def _through(start: Clock, ends, late, moves) -> Clock:
    """The clock with these delays at the ends; of exactly the rate that it had where only the offset moves."""
    if len(moves) == 2 or ends[0] == ends[1]:
        return Clock(late[0] - (start.rate - 1.0) * ends[0], start.rate)
    return Clock.through((ends[0], late[0]), (ends[1], late[1]))
