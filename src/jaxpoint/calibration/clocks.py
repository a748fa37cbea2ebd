"""The clock of every camera from tracks alone: how many frames it is late, at which rate it runs, and how sure that is.

Pairs of cameras in step agree on an epipolar geometry; the largest group of them is the clock. Every other camera is
tried against it at all lags over the whole recording, and at all rates where that does not suffice
(`lag_search`); what is found there is verified and refined by robust geometry (`clock_fit`), and reported as certain
only where it stands out from all other lags.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import numpy as np

from jaxpoint.calibration.clock_fit import Agreement, Clock, Share, refine
from jaxpoint.calibration.lag_search import Candidate, Courses, at_any_rate, at_one_rate, dense_courses, tolerance
from jaxpoint.calibration.offset_search import PairOffset, chosen_pairs, joint_offsets, search_offset
from jaxpoint.calibration.twoview import normalised
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import EpipolarSettings
from jaxpoint.motion import moved_to_clock
from jaxpoint.tracks import Tracks

IN_STEP = 0.7  # share of matches that fit in step: more, and a pair is
ENOUGH = 0.7  # and with a clock of its own: more, and no other rate is looked for
CERTAIN = 0.5  # a smaller share proves nothing,
STANDS_OUT = 0.12  # nor does one that exceeds that of another lag by less
PARTNERS = 3  # cameras of the group with which a camera is compared
MANY = 6  # cameras: of more, not all pairs are tried
LAGS = 4  # candidates of each pair
SLACK = 0.75  # frames: cameras that differ by less count as in step with one another
SEEDS = 3  # groups from which is grown, before the largest is taken


@dataclass(frozen=True)
class CameraClock:
    """How a camera's frames lie in time against those of the largest group of cameras that agree."""

    name: str
    offset_frames: float  # positive where it shows the light late; at the first frame of the tracks
    rate: float  # its frames to one of the group's
    share_before: float  # 0..1, of its matches with others that fit one epipolar geometry, all taken as in step
    share_after: float  # and under the clocks that were found
    certain: bool  # False: no clock makes this camera fit the others well

    @property
    def in_step(self) -> bool:
        """Nothing to be set right: less than half a frame late, at the same rate."""
        return abs(self.offset_frames) < 0.5 and self.rate == 1.0


@dataclass(frozen=True)
class ClockSurvey:
    """The clocks of all cameras, and what pairs of them said."""

    clocks: tuple[CameraClock, ...]
    pairs: tuple[PairOffset, ...]


def find_clocks(
    tracks: Tracks,
    settings: EpipolarSettings,
    seed: int,
    intrinsics: CameraRig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[CameraClock, ...]:
    """The clock of every camera, in the order of the tracks; see `survey_clocks`."""
    return survey_clocks(tracks, settings, seed, intrinsics, progress).clocks


def survey_clocks(
    tracks: Tracks,
    settings: EpipolarSettings,
    seed: int,
    intrinsics: CameraRig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ClockSurvey:
    """Offsets of any size and rates of all cameras, from tracks alone. Computed in float64, the same every time.

    A camera that fits no other under any clock stands at 0 and rate 1, not certain.

    Args:
        progress: called with the number of cameras done, and of all.
    """
    with jax.enable_x64(True):
        return _Survey(tracks, settings, seed, intrinsics, progress).run()


class _Survey:
    def __init__(self, tracks: Tracks, settings, seed, intrinsics, progress):
        self.tracks = tracks
        self.agreement = Agreement(tracks, settings, seed, intrinsics)
        self.courses = _courses(tracks, self.agreement, intrinsics)
        self.half = np.hypot(*tracks.image_sizes.T.astype(float)) / 2.0
        self.least = settings.min_shared_frames
        self.progress = progress or (lambda done, total: None)

    def run(self) -> ClockSurvey:
        if self.tracks.frames < 2 or self.tracks.cameras < 2:
            return ClockSurvey(tuple(CameraClock(name, 0.0, 1.0, 0.0, 0.0, False) for name in self.tracks.names), ())
        known = self._largest(self._groups_in_step())
        pairs = self._pairs(known)
        clocks = self._against_group(self._shifted(known, pairs))
        before, after = self._shares(known)
        total = tuple(self._total(pair, known) for pair in pairs)
        return ClockSurvey(
            tuple(
                CameraClock(
                    name, clocks[c].offset, clocks[c].rate, before[c], after[c], c in known and after[c] >= CERTAIN
                )
                for c, name in enumerate(self.tracks.names)
            ),
            total,
        )

    # Which cameras agree as they are.

    def _groups_in_step(self) -> list[list[int]]:
        """Cameras linked by pairs that agree in step; the largest group first, that of the first camera before others."""
        group = list(range(self.tracks.cameras))
        for first, second in self._tried():
            if self._agree_in_step(first, second):
                old, new = group[second], group[first]
                group = [new if label == old else label for label in group]
        groups = [[c for c, label in enumerate(group) if label == one] for one in sorted(set(group))]
        return sorted(groups, key=lambda members: (-len(members), members[0]))

    def _tried(self) -> list[tuple[int, int]]:
        cameras = self.tracks.cameras
        if cameras <= MANY:
            return [(i, j) for i in range(cameras) for j in range(i + 1, cameras)]
        return chosen_pairs(self.tracks, self.least, PARTNERS + 1)

    def _agree_in_step(self, first: int, second: int) -> bool:
        share = self.agreement.share((first, Clock()), (second, Clock()))
        if share.fit < IN_STEP:
            return False
        # A slow light fits nearly as well a few frames late; the lag at which it fits best is looked at too.
        for other in at_one_rate(self.courses, first, 0.0, 1.0, second, 1):
            late = self.agreement.share((first, Clock()), (second, Clock(other.offset)))
            if (
                abs(other.offset) > 2.0 * self.agreement.step
                and late.beyond_chance > share.beyond_chance + 0.03 * share.matches
            ):
                return False
        return True

    # The clocks of the others.

    def _largest(self, groups: list[list[int]]) -> dict[int, Clock]:
        """The clocks of the most cameras that agree under some clocks, grown from one of the groups."""
        best: dict[int, Clock] = {}
        left = list(groups)
        for _ in range(SEEDS):
            left = [members for members in left if not set(members) & set(best)]
            if not left or 2 * len(best) > self.tracks.cameras:
                break
            grown = self._grow(left.pop(0))
            best = grown if len(grown) > len(best) else best
        return best

    def _grow(self, members: list[int]) -> dict[int, Clock]:
        known = {camera: Clock() for camera in members}
        waiting = [c for c in range(self.tracks.cameras) if c not in known]
        self.progress(len(known), self.tracks.cameras)
        while waiting:
            found = {}
            for camera in waiting:
                clock = self._place(camera, known | found)
                if clock is not None:
                    found[camera] = clock
                    self.progress(len(known) + len(found), self.tracks.cameras)
            known |= found
            waiting = [c for c in waiting if c not in found]
            if not found:
                break
        self.progress(self.tracks.cameras, self.tracks.cameras)
        return known

    def _place(self, camera: int, known: dict[int, Clock]) -> Clock | None:
        """The clock of one camera against those known; None where none stands out."""
        partners = self._partners(camera, known)
        tried: dict[Clock, Share] = {}
        candidates = [Candidate(0.0, 1.0, 0.0, 0.0, np.inf)]
        for partner, clock in partners:
            late = clock.offset / self.courses.step
            candidates += at_one_rate(self.courses, partner, late, clock.rate, camera, LAGS)
        found = self._best(camera, partners, candidates, tried)
        if found[1].fit < ENOUGH and self.courses.whole:
            candidates = []
            for partner, clock in partners[:2]:
                steps = tolerance(self.courses, partner, camera, self.tracks.image_sizes[:, 0].astype(float), self.half)
                late = clock.offset / self.courses.step
                candidates += at_any_rate(self.courses, partner, late, clock.rate, camera, steps, LAGS)
            other = self._best(camera, partners, candidates, tried)
            found = other if other[1].beyond_chance > found[1].beyond_chance else found
        return found[0] if self._stands_out(*found, tried) else None

    def _best(self, camera, partners, candidates: list[Candidate], tried: dict[Clock, Share]) -> tuple[Clock, Share]:
        """The two candidates with which most matches fit, refined; the better of them."""
        ranked = []
        for one in candidates:
            clock = Clock(one.offset, one.rate)
            within = self._within(one)
            tried[clock] = self.agreement.shares((camera, clock), partners, within)
            ranked.append((tried[clock].beyond_chance, clock, one))
        ranked.sort(key=lambda item: -item[0])
        best = Clock(), Share(0.0, 0.0)
        for _, clock, one in ranked[:2]:
            found = refine(
                self.agreement, camera, clock, partners, one.middle if np.isfinite(one.reach) else None, one.reach
            )
            best = found if found[1].beyond_chance > best[1].beyond_chance else best
        return best

    def _within(self, one: Candidate):
        if not np.isfinite(one.reach):
            return None
        return np.abs(self.tracks.frame_ids - self.tracks.frame_ids[0] - one.middle) <= one.reach

    def _stands_out(self, clock: Clock, share: Share, tried: dict[Clock, Share]) -> bool:
        """No other lag comes near it."""
        middle = float(self.tracks.frame_ids[-1] - self.tracks.frame_ids[0]) / 2
        apart = 8.0 * self.agreement.step
        rivals = [other.fit for one, other in tried.items() if abs(one.at(middle) - clock.at(middle)) > apart]
        return share.fit >= CERTAIN and share.fit >= max(rivals, default=0.0) + STANDS_OUT

    def _partners(self, camera: int, known: dict[int, Clock]) -> list[tuple[int, Clock]]:
        """The cameras with known clocks with which this one shares most frames, or that saw the light most."""
        usable = self.agreement.usable
        shared = [(usable[:, camera] & usable[:, other]).sum() + usable[:, other].sum() for other in known]
        order = np.argsort(-np.array(shared), kind="stable")[:PARTNERS]
        others = list(known.items())
        return [others[i] for i in order]

    # What is reported.

    def _pairs(self, known: dict[int, Clock]) -> list[PairOffset]:
        """What is left of the offset between neighbours once the clocks are known."""
        offsets, rates = self._arrays(known)
        moved = moved_to_clock(self.tracks, offsets, rates, self.agreement.usable)
        partners = 2 if self.tracks.cameras <= MANY else 1
        return [
            search_offset(self.agreement, (i, known.get(i, Clock())), (j, known.get(j, Clock())))
            for i, j in chosen_pairs(moved, self.least, partners)
        ]

    def _arrays(self, known: dict[int, Clock]):
        each = [known.get(c, Clock()) for c in range(self.tracks.cameras)]
        return np.array([clock.offset for clock in each]), np.array([clock.rate for clock in each])

    def _shifted(self, known: dict[int, Clock], pairs: list[PairOffset]) -> list[Clock]:
        """The clocks, with the fractions of a frame on which pairs of known ones agree."""
        among = [pair for pair in pairs if pair.first in known and pair.second in known]
        more = joint_offsets(among, self.tracks.cameras)
        each = [known.get(c, Clock()) for c in range(self.tracks.cameras)]
        return [
            replace(clock, offset=clock.offset + by) if c in known else clock
            for c, (clock, by) in enumerate(zip(each, more))
        ]

    def _against_group(self, clocks: list[Clock]) -> list[Clock]:
        """The clocks against that of the most cameras in step with one another; the first of them is the reference."""
        span = float(self.tracks.frame_ids[-1] - self.tracks.frame_ids[0])
        ends = np.array([[clock.at(0.0), clock.at(span)] for clock in clocks])
        near = (np.abs(ends[:, None] - ends[None]) < SLACK * self.agreement.step).all(axis=2)
        zero = clocks[int(near.sum(axis=1).argmax())]
        return [_relative(clock, zero) for clock in clocks]

    def _shares(self, known: dict[int, Clock]) -> tuple[list[float], list[float]]:
        """Of each camera's matches with the best partners, those that fit in step, and under the clocks."""
        before, after = [], []
        for camera in range(self.tracks.cameras):
            others = {c: clock for c, clock in known.items() if c != camera}
            partners = self._partners(camera, others) if others else []
            own = known.get(camera, Clock())
            before.append(self.agreement.shares((camera, Clock()), [(c, Clock()) for c, _ in partners]).fit)
            after.append(self.agreement.shares((camera, own), partners).fit)
        return before, after

    def _total(self, pair: PairOffset, known: dict[int, Clock]) -> PairOffset:
        """The offset of a pair as recorded."""
        first, second = known.get(pair.first, Clock()), known.get(pair.second, Clock())
        in_step = self.agreement.share((pair.first, Clock()), (pair.second, Clock())).fit
        return replace(pair, frames=pair.frames + second.offset - first.offset, fit_in_step=in_step)


def _relative(clock: Clock, zero: Clock) -> Clock:
    """A clock against another one instead of the common one."""
    rate = clock.rate / zero.rate
    return Clock(clock.offset - rate * zero.offset, rate)


def _courses(tracks: Tracks, agreement: Agreement, intrinsics: CameraRig | None) -> Courses:
    data = normalised(tracks, intrinsics)
    visible = data.visible[: tracks.frames] & agreement.usable
    return dense_courses(data.points[: tracks.frames], visible, tracks.frame_ids, agreement.step)
