"""The clock of every camera from tracks alone: how many frames it is late, at which rate it runs, and how sure that is.

Pairs of cameras in step agree on an epipolar geometry; the largest group of them is the clock. Every other camera is
tried against it at all lags over the whole recording, and at all rates where that does not suffice
(`lag_search`); what is found there is verified and refined by robust geometry (`clock_fit`), and reported as certain
only where it stands out from all other lags.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import jax
import numpy as np

from jaxpoint.calibration.camera_clock import CameraClock, ClockSurvey
from jaxpoint.calibration.clock_fit import DRIFTS, Agreement, Clock, Share, moving_only, refine
from jaxpoint.calibration.clock_polish import polish
from jaxpoint.calibration.lag_search import (
    Candidate,
    Courses,
    Known,
    at_any_rate,
    at_near_rates,
    at_one_rate,
    dense_courses,
    stretches,
    tolerance,
)
from jaxpoint.calibration.offset_search import PairOffset, chosen_pairs, joint_offsets, search_offset
from jaxpoint.calibration.twoview import normalise_tracks
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import EpipolarSettings
from jaxpoint.motion import moved_to_clock, without_jumps
from jaxpoint.repeats import regular_steps, without_steps
from jaxpoint.tracks import Tracks

IN_STEP = 0.7  # share of matches that fit in step: more, and a pair is
ENOUGH = 0.7  # and with a clock of its own: more, and no other rate is looked for
CERTAIN = 0.5  # a smaller share proves nothing;
CERTAIN_OF_FEW = 0.9  # nor does this, where less than
OVERLAP = 0.5  # of the frames can be compared.
STANDS_OUT = 1.3  # times the matches beyond chance of any other lag must fit at a clock
LIKELY = 1.3  # times the score of the next best candidate: less, and it is chance
PROMISING = 0.27  # share of matches at a candidate from which the right clock is looked for,
PROMISING_OF_FEW = 0.6  # where few frames can be compared,
NEARLY = 0.35  # and in step
PARTNERS = 3  # cameras of the group with which a camera is compared
MANY = 6  # cameras: of more, not all pairs are tried
LAGS = 4  # candidates of each pair
LEAST_DRIFT = 0.3  # frames, from the middle of the first half to that of the second
SLACK = 0.75  # frames: cameras that differ by less count as in step with one another
SEARCHES = 12  # at all rates, each a second or two, before cameras that fit nothing are given up
SEEDS = 3  # groups from which is grown, before the largest is taken


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
        found = _Survey(tracks, settings, seed, intrinsics, progress).run()
        return _without_steps(found, tracks, settings, seed, intrinsics)


def _without_steps(found: ClockSurvey, tracks: Tracks, settings, seed, intrinsics) -> ClockSurvey:
    """The survey, looked at anew without the frames that cameras repeat (or with those that they skip) regularly."""
    steps = {}
    usable = without_jumps(tracks.pixels, tracks.visible, tracks.series_ids, tracks.image_sizes[:, 0].astype(float))
    for camera, clock in enumerate(found.clocks):
        if clock.rate != 1.0 and (own := regular_steps(tracks, camera, usable, clock.rate)) is not None:
            steps[camera] = own
            tracks = without_steps(tracks, camera, own)
    if not steps:
        return found
    again = _Survey(tracks, settings, seed, intrinsics, None).run()
    clocks = list(found.clocks)
    for camera, own in steps.items():
        if again.clocks[camera].certain and again.clocks[camera].rate == 1.0:
            clocks[camera] = replace(
                again.clocks[camera], rate=own.rate, even=False, share_before=found.clocks[camera].share_before
            )
    return replace(found, clocks=tuple(clocks))


class _Survey:
    def __init__(self, tracks: Tracks, settings, seed, intrinsics, progress):
        self.tracks, usable = moving_only(tracks)
        tracks = self.tracks
        self.agreement = Agreement(tracks, settings, seed, intrinsics, usable)
        self.courses = _courses(tracks, self.agreement, intrinsics)
        self.half = np.hypot(*tracks.image_sizes.T.astype(float)) / 2.0
        self.least = settings.min_shared_frames
        self.searches = SEARCHES
        self.progress = progress or (lambda done, total: None)

    def run(self) -> ClockSurvey:
        if self.tracks.frames < 2 or self.tracks.cameras < 2:
            return ClockSurvey(tuple(CameraClock(name, 0.0, 1.0, 0.0, 0.0, False) for name in self.tracks.names), ())
        known = self._with_rates(self._largest(self._groups_in_step()))
        pairs = self._pairs(known)
        clocks = self._against_group(self._shifted(known, pairs))
        before, after = self._shares(known)
        return ClockSurvey(
            tuple(
                CameraClock(
                    name,
                    float(clocks[c].offset),
                    float(clocks[c].rate),
                    before[c],
                    after[c],
                    bool(c in known and after[c] >= CERTAIN),
                )
                for c, name in enumerate(self.tracks.names)
            ),
            tuple(self._total(pair, known) for pair in pairs),
        )

    # Which cameras agree as they are.

    def _groups_in_step(self) -> list[list[int]]:
        """Cameras linked by pairs that agree in step; the largest group first, of equal ones the first camera's."""
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
        for other in at_one_rate(self.courses, Known(first, 0.0, 1.0), second, 1):
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
        best = Clock(), Share(0.0, 0.0)
        for candidates in self._candidates(camera, partners):
            found = self._best(camera, partners, candidates, tried)
            best = found if found[1].beyond_chance > best[1].beyond_chance else best
            if self._explains(camera, partners, best[1]):
                break
        return best[0] if self._stands_out(camera, partners, *best, tried) else None

    def _candidates(self, camera: int, partners) -> Iterator[list[Candidate]]:
        """Clocks to try, the likely ones first, each list the more laborious to find."""
        others = [Known(other, clock.offset / self.courses.step, clock.rate) for other, clock in partners]
        alike = [found for one in others for found in at_one_rate(self.courses, one, camera, LAGS)]
        yield [Candidate(0.0, 1.0, 0.0), *alike]
        if not self.courses.whole:
            return
        for one in others[:2]:
            yield at_near_rates(self.courses, one, camera, self._tolerance(one.camera, camera), LAGS)
        for one in others[:2]:
            steps = self._tolerance(one.camera, camera)
            for window in stretches(self.courses.visible[:, one.camera], steps):
                if self.searches:
                    self.searches -= 1
                    yield at_any_rate(self.courses, one, camera, steps, window, LAGS)

    def _tolerance(self, first: int, second: int) -> float:
        return tolerance(self.courses, first, second, self.tracks.image_sizes[:, 0].astype(float), self.half)

    def _explains(self, camera: int, partners, share: Share) -> bool:
        """So many matches fit that no other rate need be tried."""
        return share.fit >= ENOUGH and share.matches >= OVERLAP * self._most(camera, partners)

    def _most(self, camera: int, partners) -> float:
        """Matches with the partners, if all frames of the one with fewer were matches."""
        seen = self.agreement.usable.sum(axis=0)
        return float(sum(min(seen[camera], seen[other]) for other, _ in partners))

    def _best(self, camera, partners, candidates: list[Candidate], tried: dict[Clock, Share]) -> tuple[Clock, Share]:
        """The two likeliest candidates, refined; the better of them."""
        ranked = []
        for one in candidates:
            clock = Clock(one.offset, one.rate)
            tried[clock] = self.agreement.shares((camera, clock), partners, self._within(one))
            least = PROMISING if one.score > 0 else NEARLY
            if np.isinf(one.reach) and tried[clock].matches < OVERLAP * self._most(camera, partners):
                least = PROMISING_OF_FEW
            if one.margin >= LIKELY and tried[clock].fit > least:
                ranked.append((tried[clock].beyond_chance, clock, one))
        ranked.sort(key=lambda item: -item[0])
        best = Clock(), Share(0.0, 0.0)
        for clock, one in {clock: one for _, clock, one in ranked[:2]}.items():
            found = refine(self.agreement, camera, clock, partners, one.middle, one.reach)
            best = found if found[1].beyond_chance > best[1].beyond_chance else best
        return best

    def _within(self, one: Candidate):
        if not np.isfinite(one.reach):
            return None
        return np.abs(self.tracks.frame_ids - self.tracks.frame_ids.min() - one.middle) <= one.reach

    def _stands_out(self, camera: int, partners, clock: Clock, share: Share, tried: dict[Clock, Share]) -> bool:
        """No other lag comes near it; where few frames overlap chance fits better, and more is asked for."""
        middle = float(np.ptp(self.tracks.frame_ids)) / 2
        apart = 8.0 * self.agreement.step
        rivals = [other.beyond_chance for one, other in tried.items() if abs(one.at(middle) - clock.at(middle)) > apart]
        few = share.matches < OVERLAP * self._most(camera, partners)
        enough = share.fit >= (CERTAIN_OF_FEW if few else CERTAIN)
        return enough and share.beyond_chance >= STANDS_OUT * max(rivals, default=0.0)

    def _partners(self, camera: int, known: dict[int, Clock]) -> list[tuple[int, Clock]]:
        """The cameras with known clocks with which this one shares most frames, or that saw the light most."""
        usable = self.agreement.usable
        shared = [(usable[:, camera] & usable[:, other]).sum() + usable[:, other].sum() for other in known]
        order = np.argsort(-np.array(shared), kind="stable")[:PARTNERS]
        others = list(known.items())
        return [others[i] for i in order]

    # What is reported.

    def _with_rates(self, known: dict[int, Clock]) -> dict[int, Clock]:
        """The clocks with slow rates of their own: cameras that fit better when they drift.

        Drift is what the offsets in the second half of the recording exceed those in the first half by.
        """
        after = (self.tracks.frame_ids - self.tracks.frame_ids.min()).astype(float)
        halves = [after <= after[-1] / 2, after > after[-1] / 2]
        pairs = [pair for pair in chosen_pairs(self._moved(known), self.least, 1) if set(pair) <= set(known)]
        early, late = (
            joint_offsets(
                [search_offset(self.agreement, (i, known[i]), (j, known[j]), half) for i, j in pairs],
                self.tracks.cameras,
            )
            for half in halves
        )
        members = sorted(known)
        drift = late - early
        drift -= np.median(drift[members])
        for camera in sorted(members, key=lambda c: -abs(drift[c])):
            if abs(drift[camera]) < LEAST_DRIFT * self.agreement.step:
                break
            clock = known[camera]
            slope = drift[camera] / (after[-1] / 2)
            turned = Clock(clock.offset + early[camera] - slope * after[-1] / 4, clock.rate + slope)
            partners = self._partners(camera, {c: one for c, one in known.items() if c != camera})
            found = refine(self.agreement, camera, turned, partners)
            if found[1].fit > self.agreement.shares((camera, clock), partners).fit + DRIFTS:
                known = known | {camera: found[0]}
        for camera in [c for c, clock in known.items() if clock.rate != 1.0]:
            partners = self._partners(camera, {c: one for c, one in known.items() if c != camera})
            turned = polish(self.agreement, camera, known[camera], partners)
            slow = abs(turned.rate - 1.0) * after[-1] < LEAST_DRIFT * self.agreement.step
            known = known | {camera: Clock(turned.at(after[-1] / 2)) if slow else turned}
        return known

    def _pairs(self, known: dict[int, Clock]) -> list[PairOffset]:
        """What is left of the offset between neighbours once the clocks are known."""
        moved = self._moved(known)
        partners = 2 if self.tracks.cameras <= MANY else 1
        return [
            search_offset(self.agreement, (i, known.get(i, Clock())), (j, known.get(j, Clock())))
            for i, j in chosen_pairs(moved, self.least, partners)
        ]

    def _moved(self, known: dict[int, Clock]) -> Tracks:
        """The tracks on the common clock."""
        each = [known.get(c, Clock()) for c in range(self.tracks.cameras)]
        offsets, rates = np.array([clock.offset for clock in each]), np.array([clock.rate for clock in each])
        return moved_to_clock(self.tracks, offsets, rates, self.agreement.usable)

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
        span = float(np.ptp(self.tracks.frame_ids))
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
    data = normalise_tracks(tracks, intrinsics)
    visible = data.visible[: tracks.frames] & agreement.usable
    return dense_courses(data.points[: tracks.frames], visible, tracks.frame_ids, agreement.step)
