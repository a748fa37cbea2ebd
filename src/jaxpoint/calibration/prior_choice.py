"""Priors that the recording refutes: images that were cropped, pixels that are not square.

The prior on a principal point stands for images that nobody cropped, and a fixed aspect for square pixels. Where the
observations contradict one (a score test on the normal equations says so without solving anything), the camera's prior
is given up, the rig is solved again, and the solution with the better objective stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from jaxpoint.calibration.aspects import aspect_patterns, aspect_text
from jaxpoint.calibration.assembly import assemble_calibration
from jaxpoint.calibration.normal import NormalEquations, normal_equations
from jaxpoint.calibration.objective import Solution, better_by, solve_with
from jaxpoint.calibration.recording import NOISE_PX, Freedom, Recording, RigState
from jaxpoint.calibration.result import Calibration, Finding, PairTable, Stage
from jaxpoint.camera.parameters import ASPECT, CENTER
from jaxpoint.config import CalibrateSettings
from jaxpoint.tracks import Tracks

REFUTED = 3.0  # sigmas (from the issue of a wrong prior: the field's usual bound)
CHANCE = 1e-4  # of a joint test; 0 of 31 random rooms came below (they reach 0.02)
FREE_CENTER = 0.5  # of the image width: sigma of a principal point whose prior was given up
FREE_ASPECT = 0.3  # sigma of a log aspect that is free: beyond the widest standard, 64/45
WEAKLY_KNOWN = 0.02  # sigma of a log aspect from which a score test has no power: standard aspects are tried instead
ALIKE = (16 / 15, 4 / 3)  # tried for all cameras alike: the smallest and one of the largest
OPEN = 3.0  # an aspect that is worse by less cannot be distinguished from square pixels (of square ones 4/3 is worse by
# 5 to 950, 16/15 by 9 to 23 where it is tried)
LEAST_ASPECT = 0.04  # change of a log aspect worth a trial; the standard nearest to square is at 0.065
WORTH_CENTER, WORTH_ASPECT = 4.0, 9.0  # least fall of the objective for a prior to be given up: 2 and 3 sigmas,
WORTH_EACH = 2.0  # and so much more for every parameter that this frees (Akaike 1974)
COMMON_CHANCE = 0.01  # of one offset of all principal points, as of images that were all cropped alike
SUSPECT, SUSPECTS = 1.5, 2  # sigmas of a principal point from which the worst cameras are tried one by one
PATTERN_WORSE = 12.0  # a pattern of standard aspects may be worse by so much than free aspects, which fit noise too
PATTERN_MARGIN = 6.0  # and must lead the next pattern by so much: 20 to 1
ROUNDS = 3  # one prior after the other


@dataclass(frozen=True)
class Doubts:
    """What the score tests say of the priors as they are."""

    centers: Float[np.ndarray, " C"]  # sigmas by which each camera's principal point contradicts its prior
    centers_chance: float  # of all of them together
    common: Float[np.ndarray, "2"]  # one offset of all of them that explains the most, in image widths
    common_chance: float  # that there is none
    aspects_chance: float  # of the fall of the cost if every pixel aspect were free
    aspects_sigma: float  # the largest of their log, if they were; 0 where they are free or stated

    @property
    def refuted(self) -> Bool[np.ndarray, " C"]:
        """Cameras whose prior on the principal point is given up; all where only their sum contradicts."""
        alone = self.centers > REFUTED
        return alone if alone.any() or self.centers_chance >= CHANCE else np.ones_like(alone)

    @property
    def any_center(self) -> bool:
        """Whether some prior on a principal point is contradicted."""
        return bool((self.centers > REFUTED).any()) or self.centers_chance < CHANCE


def doubts_of(calibration: Calibration, normal: NormalEquations | None = None) -> Doubts | None:
    """Score tests of the priors of a calibration; None where nothing can be said (no free prior, or no normal form)."""
    if calibration.freedom is None or not calibration.sigma_px > 0:
        return None
    normal = normal or normal_equations(calibration)
    freedom = calibration.freedom.at_noise(calibration.sigma_px)
    try:
        centers = _center_tests(normal, freedom, calibration)
        aspects = _aspect_test(normal, freedom, calibration.sigma_px)
    except np.linalg.LinAlgError:
        return None
    return Doubts(*centers, *aspects)


def _center_tests(
    normal: NormalEquations, freedom: Freedom, calibration: Calibration
) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Where principal points would go without their priors, against the priors' own widths: each, all, and alike."""
    cameras = len(calibration.rig)
    if not freedom.free[:, CENTER].any():
        return np.zeros(cameras), 1.0, np.zeros(2), 1.0
    widths = np.asarray(calibration.rig.image_sizes)[:, 0]
    loose = with_free_centers(freedom, np.ones(cameras, bool), widths, calibration.sigma_px)
    step = normal.solve(loose)
    away = normal.parameters[:, CENTER] - freedom.prior_mean[:, CENTER] + step.change[:, CENTER]
    squares, weight, pull = np.zeros(cameras), np.zeros((2, 2)), np.zeros(2)
    for c in range(cameras):
        if (freedom.prior_weight[c, CENTER] > 0).all():
            prior = np.diag(calibration.sigma_px**2 / freedom.prior_weight[c, CENTER])
            inverse = np.linalg.inv(step.block(c, CENTER) + prior)
            squares[c] = away[c] @ inverse @ away[c]
            weight, pull = weight + widths[c] ** 2 * inverse, pull + widths[c] * inverse @ away[c]
    common = np.linalg.solve(weight, pull) if weight.any() else np.zeros(2)
    alike = float(chi2.sf(common @ weight @ common, 2))
    return np.sqrt(squares), float(chi2.sf(squares.sum(), 2 * cameras)), common, alike


def _aspect_test(normal, freedom: Freedom, sigma_px: float) -> tuple[float, float]:
    """The chance that square pixels explain the gradient, and the largest sigma of an aspect that is free."""
    held = ~freedom.free[:, ASPECT]
    if not held.any() or not freedom.free[:, CENTER.stop - 1].any():
        return 1.0, 0.0
    step = normal.solve(with_free_aspects(freedom, held, sigma_px))
    sigma = float(step.sigmas[:, ASPECT].max())
    if np.abs(step.change[:, ASPECT]).max() < LEAST_ASPECT:
        return 1.0, sigma  # an imperfect lens model asks for odd aspects too (real recordings: up to 0.02)
    return float(chi2.sf(step.gain, int(held.sum()))), sigma


def with_free_centers(freedom: Freedom, chosen: np.ndarray, widths: np.ndarray, noise_px: float = NOISE_PX) -> Freedom:
    """The freedom with hardly a prior on the principal points of some cameras."""
    weight = freedom.prior_weight.copy()
    some = np.flatnonzero(chosen)
    weight[some, CENTER] = ((noise_px / (FREE_CENTER * widths[some])) ** 2)[:, None]
    return replace(freedom, prior_weight=weight).with_shared_priors()


def with_moved_centers(freedom: Freedom, offset: Float[np.ndarray, "2"], recording: Recording) -> Freedom:
    """The freedom with the priors of all principal points moved alike, by an offset in image widths."""
    mean = freedom.prior_mean.copy()
    mean[recording.exists, CENTER] += recording.image_sizes[recording.exists, :1] * offset
    return replace(freedom, prior_mean=mean)


def with_free_aspects(freedom: Freedom, chosen: np.ndarray, noise_px: float = NOISE_PX) -> Freedom:
    """The freedom with the pixel aspects of some cameras unknown."""
    free, weight = freedom.free.copy(), freedom.prior_weight.copy()
    some = np.flatnonzero(chosen)
    free[some, ASPECT], weight[some, ASPECT] = True, (noise_px / FREE_ASPECT) ** 2
    return replace(freedom, free=free, prior_weight=weight).with_shared_priors()


@dataclass(frozen=True)
class PriorChoice:
    """Solves with other priors where the recording asks for it."""

    recording: Recording
    tracks: Tracks
    pairs: PairTable
    settings: CalibrateSettings
    findings: list[Finding] = field(default_factory=list)  # met on the way

    def choose(self, solution: Solution) -> tuple[Solution, tuple[Stage, ...]]:
        """The better solution, and the trials for the report."""
        stages: list[Stage] = []
        for _ in range(ROUNDS):
            calibration = self._assembled(solution)
            doubts = doubts_of(calibration)
            if doubts is None:
                break
            trials = list(self._trials(solution, doubts))
            if not trials:
                break
            gains = [better_by(trial, solution) - _price(trial, solution) for trial in trials]
            stages.append(self._stage(doubts, trials, solution))
            if max(gains) < 0:
                self.findings.extend(self._open_aspect(trials, solution))
                break
            best = trials[int(np.argmax(gains))]
            if best.freedom.free[:, ASPECT].any():
                best = self._standard(best)
            if not doubts.any_center and best.freedom.free[:, ASPECT].any():
                # Lenses that no model describes ask for odd aspects too, and precisely (strawlab2010: 0.95).
                if doubts.aspects_sigma > WEAKLY_KNOWN:
                    self.findings.append(self._undecided_aspect("refutes square pixels, and several others fit"))
                break
            solution = best
        return solution, tuple(stages)

    def _trials(self, solution: Solution, doubts: Doubts) -> Iterator[Solution]:
        """Solutions without the priors that are in doubt."""
        real = self.recording.exists
        freedom, state = solution.freedom, solution.settled.judged.state
        if doubts.any_center and self.settings.lens.principal_point == "prior":
            chosen = np.zeros_like(real)
            chosen[: len(doubts.refuted)] = doubts.refuted
            yield self._solved(state, with_free_centers(freedom, chosen, self.recording.image_sizes[:, 0]))
        elif self.settings.lens.principal_point == "prior":
            for camera in np.argsort(-doubts.centers)[:SUSPECTS]:
                if doubts.centers[camera] > SUSPECT:
                    alone = np.arange(len(real)) == camera
                    yield self._solved(state, with_free_centers(freedom, alone, self.recording.image_sizes[:, 0]))
            if doubts.common_chance < COMMON_CHANCE:
                yield self._solved(state, with_moved_centers(freedom, doubts.common, self.recording))
        held = real & ~freedom.free[:, ASPECT] & ~_cameras_with_known_aspect(freedom)
        doubted = doubts.any_center or doubts.aspects_chance < CHANCE
        if self.settings.lens.aspect != "auto" or not held.any():
            return
        if doubted:
            yield self._solved(state, with_free_aspects(freedom, held))
        elif doubts.aspects_sigma > WEAKLY_KNOWN and (self.recording.pixel_aspects == 1.0).all():
            for aspect in ALIKE:
                yield self._with_aspects(solution, (aspect,) * self.recording.cameras)

    def _open_aspect(self, trials: list[Solution], solution: Solution) -> Iterator[Finding]:
        """That anamorphic pixels would fit as well as square ones."""
        for trial in trials:
            new = _cameras_with_known_aspect(trial.freedom) & ~_cameras_with_known_aspect(solution.freedom)
            if new.any() and better_by(trial, solution) > -OPEN:
                aspect = float(np.exp(-trial.freedom.prior_mean[new, ASPECT][0]))
                yield self._undecided_aspect(
                    f"does not tell the pixel aspect: pixels {aspect_text(aspect)} times as wide as high fit as well "
                    "as square ones"
                )
                return

    def _undecided_aspect(self, why: str) -> Finding:
        return Finding(
            "pixel aspect",
            "bad",
            f"The recording {why}; cameras that stand upright and look level, or too few of them, leave it open.",
            "State the aspect (--lens.aspect fixed where the pixels are square, as in nearly all cameras; 16/15 for "
            "PAL video), or record again with one camera turned on its side",
            self.tracks.names,
        )

    def _solved(self, state: RigState, freedom: Freedom) -> Solution:
        return solve_with(self.recording, state, freedom, self.settings.outliers)

    def _standard(self, free: Solution) -> Solution:
        """Standard aspects where one pattern of them fits as well as free ones and no other does."""
        cameras = self.recording.cameras
        found = np.exp(-free.settled.judged.state.cameras[:cameras, ASPECT])
        patterns = aspect_patterns(found)
        tried = [self._with_aspects(free, pattern) for pattern in patterns]
        worse = np.array([-better_by(trial, free) for trial in tried])
        if not len(worse):
            return free
        order = np.argsort(worse)
        alone = len(order) == 1 or worse[order[1]] - worse[order[0]] >= PATTERN_MARGIN
        return tried[order[0]] if worse[order[0]] <= PATTERN_WORSE and alone else free

    def _with_aspects(self, solution: Solution, aspects: tuple[float, ...]) -> Solution:
        """The solution with these pixel aspects held."""
        cameras = self.recording.cameras
        state, freedom = solution.settled.judged.state, solution.freedom
        numbers, free, mean = state.cameras.copy(), freedom.free.copy(), freedom.prior_mean.copy()
        numbers[:cameras, ASPECT] = mean[:cameras, ASPECT] = -np.log(aspects)
        free[:cameras, ASPECT] = False
        held = replace(freedom, free=free, prior_mean=mean)
        return self._solved(replace(state, cameras=numbers), held)

    def _assembled(self, solution: Solution) -> Calibration:
        return assemble_calibration(
            self.tracks, self.recording, solution.settled, solution.freedom, self.settings, self.pairs
        )

    def _stage(self, doubts: Doubts, trials: list[Solution], solution: Solution) -> Stage:
        names = self.tracks.names
        return Stage(
            "Priors in doubt",
            {
                "principal_point_sigmas": {name: round(float(z), 1) for name, z in zip(names, doubts.centers)},
                "chance_of_square_pixels": f"{doubts.aspects_chance:.1g}",
                "objective_falls_by": [round(better_by(trial, solution), 1) for trial in trials],
            },
        )


def _cameras_with_known_aspect(freedom: Freedom) -> Bool[np.ndarray, " D"]:
    """Cameras whose aspect was found to be another than 1 already."""
    return freedom.prior_mean[:, ASPECT] != 0


def _price(trial: Solution, before: Solution) -> float:
    """What the parameters that a trial frees must bring."""
    freed = trial.freedom.free & ((trial.freedom.prior_weight < before.freedom.prior_weight) | ~before.freedom.free)
    aspects = trial.freedom.free[:, ASPECT] != before.freedom.free[:, ASPECT]
    pinned = trial.freedom.prior_mean[:, ASPECT] != before.freedom.prior_mean[:, ASPECT]
    moved = (trial.freedom.prior_mean[:, CENTER] != before.freedom.prior_mean[:, CENTER]).any()
    base = WORTH_ASPECT if aspects.any() or pinned.any() else WORTH_CENTER
    return base + WORTH_EACH * float(freed.sum() + 2 * moved)
