"""Identities after a meeting of two people, decided once it is over.

While two people are beside one another most views take them for one, and a track may lose its head to the other's. A
recording knows both ends: each encounter is gone through twice, once as if everybody went on as the tracks do and once
as if they had changed places. Each time the two paths are first bridged by the smoother, then the candidates in between
are given to them anew, the surest first. The hypothesis under which the rays are more likely is the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from jaxpoint.body.tracking.head_association import Predictions, associate, explained_share
from jaxpoint.body.tracking.head_tracks import Status, Tracking, status_of
from jaxpoint.body.tracking.identity import BESIDE_M
from jaxpoint.body.tracking.kalman import State
from jaxpoint.body.tracking.measurement import measure
from jaxpoint.body.tracking.rays import Rays
from jaxpoint.body.tracking.smoothing import HeadPath, smooth_paths
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.track import TrackSettings

_LEAST_VIEWS = (3, 2, 1)  # that a head needs, in each round of bridging and giving the candidates anew
_CONTEXT = 16  # frames before and after an encounter that show how people came and went
_LONGEST = 90  # frames; two people who stand together for longer are left as they are
_CALM = 2  # frames in a row in which both are seen well end an encounter
_STATURE_M = 0.03  # standard deviation of a walking person's height, from one second to the next
_GROWN = 16.0  # the most that unlike heights count
_RETURN_M_S = 2.0  # nobody walks faster while nobody sees him


@dataclass(frozen=True)
class SeenHeads:
    """What the cameras saw, over all frames."""

    rig: CameraRig
    rays: Sequence[Rays]  # of each frame
    pixels: Float[np.ndarray, "F C K 2"]  # px
    sigma_px: Float[np.ndarray, "F C K"]
    bounds: Float[np.ndarray, "2 3"]  # m, of the places of heads


@dataclass(frozen=True)
class Encounter:
    """Two people beside one another."""

    first: int  # frame
    last: int
    pair: tuple[int, int]  # columns


def resolve(tracking: Tracking, seen: SeenHeads, settings: TrackSettings) -> bool:
    """Settle all encounters, in place; whether there was any."""
    after: tuple = (-1,)
    while True:  # places change, so that later encounters are looked for anew
        left = [meeting for meeting in encounters(tracking) if (meeting.first, meeting.pair) > after]
        if not left:
            return len(after) > 1
        after = left[0].first, left[0].pair
        _resolve(tracking, seen, left[0], settings)


def encounters(tracking: Tracking) -> list[Encounter]:
    """Where two people are beside one another and not both are seen by three views, in order."""
    heads, found = tracking.heads, []
    for one in range(len(heads.people)):
        for other in range(one + 1, len(heads.people)):
            pair = [one, other]
            both = heads.present[:, pair].all(axis=1)
            beside = np.linalg.norm(heads.positions[:, one] - heads.positions[:, other], axis=-1) < BESIDE_M
            several = (heads.status[:, pair] == Status.MEASURED).all(axis=1)
            clear = several | (heads.measured[:, pair].all(axis=1) & ~beside)
            calm = np.zeros_like(clear)
            for first, last in _runs(clear):
                calm[first : last + 1] = last - first + 1 >= _CALM
            for first, last in _runs(both & ~calm):
                core = (beside & ~clear)[first : last + 1]
                if core.any() and last - first < _LONGEST:
                    found.append(Encounter(first, last, (one, other)))
    return sorted(found, key=lambda meeting: (meeting.first, meeting.pair))


def rejoin(tracking: Tracking, settings: TrackSettings) -> None:
    """Give a person who appeared beside another the id of the one who vanished there, in place.

    Rays to two people take a track away from its head so that it cannot be taken up again: it ends, and another begins.
    Which of the two people was lost is decided afterwards.
    """
    heads = tracking.heads
    for new in range(len(heads.people)):
        if not heads.measured[:, new].any():
            continue
        start = int(np.argmax(heads.measured[:, new]))
        lost = [old for old in range(len(heads.people)) if old != new and _may_be(tracking, old, new, start, settings)]
        if lost:
            old = max(lost, key=lambda column: int(np.flatnonzero(heads.measured[:, column])[-1]))
            _move(tracking, new, old, start)


def _may_be(tracking: Tracking, old: int, new: int, start: int, settings: TrackSettings) -> bool:
    """Whether a track that starts can be one that ended, somebody else being beside it."""
    heads = tracking.heads
    measured = np.flatnonzero(heads.measured[:, old])
    if start == 0 or not len(measured) or measured[0] >= start or measured[-1] > start + settings.confirm[1]:
        return False
    end = int(measured[measured < start][-1])
    gap = heads.times[start] - heads.times[end]
    distance = np.linalg.norm(heads.positions[start, new] - heads.positions[end, old])
    if gap > 2 * settings.occlusion_s or distance > BESIDE_M + _RETURN_M_S * gap:
        return False
    others = [column for column in range(len(heads.people)) if column not in (old, new)]
    return any(
        heads.present[frame, other] and np.linalg.norm(heads.positions[frame, other] - place) < BESIDE_M
        for other in others
        for frame, place in ((end, heads.positions[end, old]), (start, heads.positions[start, new]))
    )


def _move(tracking: Tracking, source: int, target: int, start: int) -> None:
    """One column's frames from `start` on become another's; the source is left empty."""
    status = tracking.heads.status
    for part in tracking.parts():
        part[start:, target] = part[start:, source]
    status[:, source] = Status.ABSENT
    begin = int(np.argmax(status[:, target] != Status.ABSENT))
    waiting = status[begin:start, target]
    waiting[waiting == Status.ABSENT] = Status.NO_VIEW


def _runs(mask: Bool[np.ndarray, " F"]) -> list[tuple[int, int]]:
    """First and last index of every run of True."""
    edges = np.flatnonzero(np.diff(np.pad(mask.astype(int), 1)))
    return [(int(first), int(end) - 1) for first, end in zip(edges[::2], edges[1::2])]


def _resolve(tracking: Tracking, seen: SeenHeads, meeting: Encounter, settings: TrackSettings) -> None:
    """Give one encounter's frames to the hypothesis that explains them best."""
    trials = [Continuation(tracking, meeting, swap=swap) for swap in (False, True)]
    if not all(trial.begins for trial in trials):
        return
    rays = [_free(tracking, seen.rays[frame], frame, meeting) for frame in range(meeting.first, meeting.last + 1)]
    for trial in trials:
        for least in _LEAST_VIEWS:
            trial.give_anew(seen, rays, least, settings)
    max(trials, key=lambda trial: trial.evidence(rays, settings)).write(tracking)


def _free(tracking: Tracking, rays: Rays, frame: int, meeting: Encounter) -> Rays:
    """The rays that nobody else uses."""
    others = np.delete(tracking.candidates[frame], meeting.pair, axis=0)
    return rays.without((others[:, rays.camera] == rays.candidate).any(axis=0))


class Continuation:
    """One hypothesis about an encounter: two people who come, and go on as themselves or as one another."""

    def __init__(self, tracking: Tracking, meeting: Encounter, *, swap: bool):
        self.meeting, self.swap = meeting, swap
        low = max(meeting.first - _CONTEXT, 0)
        self.frames = np.arange(low, min(meeting.last + _CONTEXT + 1, len(tracking.heads.times)))
        self.inside = (self.frames >= meeting.first) & (self.frames <= meeting.last)
        came = np.array(meeting.pair)
        goes = np.where(self.frames[:, None] > meeting.last, came[::-1] if swap else came, came)
        rows = self.frames[:, None], goes
        self.times = tracking.heads.times[self.frames]
        self.points = tracking.points[rows]  # (R, 2, 3)
        self.informations = np.where(self.inside[:, None, None, None], 0.0, tracking.informations[rows])
        self.candidates = tracking.candidates[rows]
        measured = tracking.heads.measured[rows] & ~self.inside[:, None]
        self.start = np.argmax(measured, axis=0)  # where each path begins
        self.begins = bool((measured & (self.frames < meeting.first)[:, None]).any(axis=0).all())

    def paths(self, settings: TrackSettings) -> list:
        """Filter and smoother of both."""
        return smooth_paths(
            [
                HeadPath(self.times[start:], self.points[start:, k], self.informations[start:, k])
                for k, start in enumerate(self.start)
            ],
            settings,
        )

    def give_anew(self, seen: SeenHeads, rays: Sequence[Rays], least: int, settings: TrackSettings) -> None:
        """Measure the encounter's frames once more, by the candidates near where the two paths lead.

        Only heads of so many views count: the surest first, as long as the paths are hardly known.
        """
        expected = [self._without_own(k, path[1]) for k, path in enumerate(self.paths(settings))]
        points, squares = (np.stack(part, axis=1) for part in zip(*expected))  # (W, 2, 3), (W, 2, 3, 3)
        candidates = np.full((len(rays), 2, len(seen.rig)), -1)
        for row, free in enumerate(rays):
            found = associate(free, len(seen.rig), Predictions(points[row], squares[row]), settings, seen.bounds)
            known = found.tracks >= 0
            candidates[row, found.tracks[known]] = found.candidates[known]
        candidates[(candidates >= 0).sum(axis=-1) < least] = -1
        measured = _measure(seen, self.frames[self.inside], candidates, points, squares, settings)
        candidates[~measured[2]] = -1
        self.candidates[self.inside] = candidates
        self.points[self.inside], self.informations[self.inside] = measured[:2]

    def _without_own(self, k: int, smooth: State) -> tuple[np.ndarray, np.ndarray]:
        """Where one is expected in each of the encounter's frames by all the others, (W, 3) and (W, 3, 3)."""
        own = np.flatnonzero(self.inside) - self.start[k]
        mean, square = smooth.mean[own, :3], smooth.covariance[own, :3, :3]
        information, point = self.informations[self.inside, k], self.points[self.inside, k]
        precision = np.linalg.inv(square)
        rest = np.linalg.inv(precision - information)
        vector = np.einsum("wij,wj->wi", precision, mean) - np.einsum("wij,wj->wi", information, point)
        return np.einsum("wij,wj->wi", rest, vector), 0.5 * (rest + rest.swapaxes(1, 2))

    def evidence(self, rays: Sequence[Rays], settings: TrackSettings) -> float:
        """Twice the log likelihood of the rays, but for what both hypotheses share."""
        total = 0.0
        for k, (filtered, _) in enumerate(self.paths(settings)):
            total -= self._growth(k)
            spread = filtered.predicted.covariance[1:, :3, :3] @ self.informations[self.start[k] + 1 :, k]
            total -= float(filtered.distance2[1:].sum() + np.linalg.slogdet(np.eye(3) + spread)[1].sum())
            for row, free in zip(np.flatnonzero(self.inside), rays):
                members = self.candidates[row, k][free.camera] == free.candidate
                total += float(explained_share(free, self.points[row, k][None], members[None], settings)[0])
        return total

    def _growth(self, k: int) -> float:
        """By how much the height of one who goes differs from that of the one who came, squared, in its deviations.

        Bounded, since people bend and sit down.
        """
        measured = (self.candidates[:, k] >= 0).sum(axis=1) >= 2
        came, went = (
            self.points[measured & side, k, 2]
            for side in (self.frames < self.meeting.first, self.frames > self.meeting.last)
        )
        if not len(came) or not len(went):
            return 0.0
        return min(((np.median(went) - np.median(came)) / _STATURE_M) ** 2, _GROWN)

    def write(self, tracking: Tracking) -> None:
        """Make this hypothesis the tracks'."""
        came = list(self.meeting.pair)
        if self.swap:
            for part in tracking.parts():
                part[self.meeting.last + 1 :, came] = part[self.meeting.last + 1 :, came[::-1]]
        place = np.arange(self.meeting.first, self.meeting.last + 1)[:, None], np.array(came)
        candidates = self.candidates[self.inside]
        tracking.points[place], tracking.informations[place] = (
            self.points[self.inside],
            self.informations[self.inside],
        )
        tracking.candidates[place] = candidates
        tracking.heads.used[place] = candidates >= 0
        tracking.heads.status[place] = status_of((candidates >= 0).sum(axis=-1))


def _measure(
    seen: SeenHeads,
    frames: Int[np.ndarray, " W"],
    candidates: Int[np.ndarray, "W 2 C"],
    points: Float[np.ndarray, "W 2 3"],
    squares: Float[np.ndarray, "W 2 3 3"],
    settings: TrackSettings,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, informations, and whether they are accepted."""
    size = 1 << (2 * _LONGEST - 1).bit_length()
    count, cameras = 2 * len(frames), candidates.shape[2]
    chosen = np.zeros((size, cameras), int) - 1
    chosen[:count] = candidates.reshape(count, cameras)
    row = np.zeros(size, int) + frames[0]
    row[:count] = np.repeat(frames, 2)
    mean, square = np.zeros((size, 6)), np.tile(np.eye(6), (size, 1, 1))
    mean[:count, :3], square[:count, :3, :3] = points.reshape(count, 3), squares.reshape(count, 3, 3)
    place = row[:, None], np.arange(cameras), chosen
    found = measure(
        seen.rig,
        State(mean, square),
        np.zeros(size, bool),
        seen.pixels[place],
        chosen >= 0,
        seen.sigma_px[place],
        np.float64(settings.speed_m_s),
        chi2.ppf(settings.gate, (2, 3)),
    )
    found = jax.tree.map(lambda leaf: np.asarray(leaf)[:count].reshape(-1, 2, *leaf.shape[1:]), found)
    return found.points, found.informations, found.accepted
