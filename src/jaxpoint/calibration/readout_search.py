"""How long rolling shutters take from the first image row to the last, before anything is calibrated.

A pair's epipolar geometry holds for pixels of one moment. Where a lower row is read later, matches miss it along the
light's motion, the more the lower they lie and the faster they move. Each pair says which step of its two cameras'
readout times would mend that, with its geometry and lenses free; all pairs together make the step, and the pixels are
moved to one moment anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.camera_clock import ClockSurvey
from jaxpoint.calibration.clock_fit import Agreement, Clock, moving_only
from jaxpoint.calibration.offset_search import PARTNERS, chosen_pairs
from jaxpoint.calibration.pair_solve import Mover, PairSolution, solve_pair
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import EpipolarSettings
from jaxpoint.motion import moved_to_clock, without_jumps
from jaxpoint.tracks import Tracks

ROUNDS = 8
STILL = 0.01  # frames: readout times that change less no longer move
LONGEST = 1.0  # frames: a camera reads an image before it takes the next
LEAST = 50  # matches of a pair
WIDE = 1.0  # frames: standard deviation of what is known before,
NOTHING = 0.5  # and from which hardly more is


@dataclass(frozen=True)
class PairReadouts:
    """Readout times as pairs of cameras have them."""

    frames: Float[np.ndarray, " C"]  # from the first image row to the last; 0 where nothing is known
    sigma: Float[np.ndarray, " C"]


def search_readouts(
    tracks: Tracks,
    known: Mapping[int, Clock],
    settings: EpipolarSettings,
    seed: int,
    intrinsics: CameraRig | None = None,
) -> PairReadouts:
    """The readout times of the cameras whose clocks are known, to a tenth of a frame or so. Computed in float64."""
    with jax.enable_x64(True):
        moving, usable = moving_only(tracks)
        pairs = [pair for pair in chosen_pairs(moving, settings.min_shared_frames, PARTNERS) if set(pair) <= set(known)]
        found = PairReadouts(np.zeros(tracks.cameras), np.full(tracks.cameras, WIDE))
        for _ in range(ROUNDS):
            agreement = _agreement(moving, usable, found.frames, settings, seed, intrinsics)
            before, found = found, _step({pair: _of_pair(agreement, pair, known) for pair in pairs}, found.frames)
            if np.abs(found.frames - before.frames).max() < STILL:
                break
        return found


def survey_readouts(
    survey: ClockSurvey, tracks: Tracks, settings: EpipolarSettings, seed: int, intrinsics: CameraRig | None = None
) -> ClockSurvey:
    """What `survey_clocks` found, with the readout times of the cameras whose clocks are certain."""
    known = {c: Clock(clock.offset_frames, clock.rate) for c, clock in enumerate(survey.clocks) if clock.certain}
    if len(known) < 2:
        return survey
    found = search_readouts(tracks, known, settings, seed, intrinsics)
    clocks = list(survey.clocks)
    for camera in np.flatnonzero(found.sigma < NOTHING).tolist():
        frames, sigma = float(found.frames[camera]), float(found.sigma[camera])
        clocks[camera] = replace(clocks[camera], readout_frames=frames, readout_sigma=sigma)
    return replace(survey, clocks=tuple(clocks))


def _agreement(moving: Tracks, usable, readouts, settings, seed, intrinsics) -> Agreement:
    """Of the tracks without what is known of their shutters."""
    if readouts.any():
        moving = moved_to_clock(moving, np.zeros(moving.cameras), usable=usable, readouts=readouts)
        widths = moving.image_sizes[:, 0].astype(float)
        usable = without_jumps(moving.pixels, moving.visible, moving.series_ids, widths)
    return Agreement(moving, settings, seed, intrinsics, usable)


def _of_pair(agreement: Agreement, pair: tuple[int, int], known: Mapping[int, Clock]) -> PairSolution | None:
    """Both readout times, first and second, with the pair's offset free; None where too few matches move."""
    members = [(camera, known[camera]) for camera in pair]
    view, (first, second) = agreement.pair(*members), [agreement.course(*one) for one in members]
    seen = view.seen & first.seen & second.seen
    if seen.sum() < LEAST:
        return None
    # A row that is read later shows the light earlier than it would.
    rolling = [
        Mover(side, -(course.down[:, None] * course.velocity)[seen]) for side, course in enumerate((first, second))
    ]
    return solve_pair(view, seen, (Mover(1, second.velocity[seen]),), rolling)


def _step(found: dict[tuple[int, int], PairSolution | None], frames: Float[np.ndarray, " C"]) -> PairReadouts:
    """The readout times after the step on which all pairs agree best."""
    cameras = len(frames)
    matrix, pull = np.eye(cameras) / WIDE**2, -frames / WIDE**2
    uses = np.zeros(cameras)
    for pair, one in found.items():
        if one is not None:
            matrix[np.ix_(pair, pair)] += one.information
            pull[list(pair)] += one.pull
            uses[list(pair)] += 1.0
    covariance = np.linalg.inv(matrix)
    # A pixel counts once for each pair that its camera is of.
    sigma = np.sqrt(np.diag(covariance) * np.maximum(uses, 1.0))
    return PairReadouts(np.clip(frames + covariance @ pull, -LONGEST, LONGEST), sigma)
