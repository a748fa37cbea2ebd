"""How long rolling shutters take from the first image row to the last, before anything is calibrated.

A pair's epipolar geometry holds for pixels of one moment. Where a lower row is read later, matches miss it along the
light's motion, the more the lower they lie and the faster they move. Each pair says what that does to its two cameras
with its geometry and lenses free; what all pairs say is put together.
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
from jaxpoint.tracks import Tracks

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
        agreement = Agreement(moving, settings, seed, intrinsics, usable)
        pairs = [pair for pair in chosen_pairs(moving, settings.min_shared_frames, PARTNERS) if set(pair) <= set(known)]
        return _together({pair: _of_pair(agreement, pair, known) for pair in pairs}, tracks.cameras)


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
    return solve_pair(view, seen, (*rolling, Mover(1, second.velocity[seen])))


def _together(found: dict[tuple[int, int], PairSolution | None], cameras: int) -> PairReadouts:
    """The readout times on which the pairs agree best."""
    matrix, pull = np.eye(cameras) / WIDE**2, np.zeros(cameras)
    uses = np.zeros(cameras)
    for pair, one in found.items():
        if one is not None:
            inverse = np.linalg.pinv(one.information)[:2, :2]  # the offset is free
            own = np.linalg.pinv(inverse)
            matrix[np.ix_(pair, pair)] += own
            pull[list(pair)] += own @ one.values[:2]
            uses[list(pair)] += 1.0
    covariance = np.linalg.inv(matrix)
    # A pixel counts once for each pair that its camera is of.
    return PairReadouts(covariance @ pull, np.sqrt(np.diag(covariance) * np.maximum(uses, 1.0)))
