"""By how much cameras are out of step, before anything is calibrated: the offsets at which pairs of views agree.

A pair's epipolar geometry holds for pixels of the same moment only, so the share of matches that fit it is highest
at the right offset (Albl et al., "On the two-view geometry of unsynchronized cameras", CVPR 2017, solve for both at
once; here offsets are tried on a grid, which cannot end in a wrong minimum nearby).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.clock_fit import Agreement, Clock
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import EpipolarSettings
from jaxpoint.tracks import Tracks

REACH = 5  # frames: pairs are tried from as much before to as much after
PARTNERS = 3  # pairs tried for each camera: those that share most frames with it
ROUNDS = 20  # of reweighting


@dataclass(frozen=True)
class PairOffset:
    """How much later camera `second` shows the light than camera `first`, as their epipolar geometry has it."""

    first: int
    second: int
    frames: float
    fit: float  # 0..1, share of the matches that fit there, near ones counting most
    fit_in_step: float  # and without any offset


def pair_offsets(
    tracks: Tracks,
    settings: EpipolarSettings,
    seed: int,
    intrinsics: CameraRig | None = None,
    partners: int = PARTNERS,
    progress: Callable[[int, int], None] | None = None,
) -> list[PairOffset]:
    """The offset of every camera against those with which it shares most frames. Computed in float64.

    Args:
        partners: with how many others each camera is tried; with 1 each is reached once, the fastest way.
    """
    with jax.enable_x64(True):
        return _pair_offsets(tracks.of_one_point(), settings, seed, intrinsics, partners, progress or _silent)


def _silent(done: int, total: int) -> None:
    """No progress is shown."""


def _pair_offsets(tracks: Tracks, settings, seed, intrinsics, partners, progress) -> list[PairOffset]:
    pairs = chosen_pairs(tracks, settings.min_shared_frames, partners)
    agreement = Agreement(tracks, settings, seed, intrinsics)
    found = []
    for number, (first, second) in enumerate(pairs):
        found.append(search_offset(agreement, (first, Clock()), (second, Clock())))
        progress(number + 1, len(pairs))
    return found


def chosen_pairs(tracks: Tracks, least: int, partners: int) -> list[tuple[int, int]]:
    """A tree of the pairs that share most frames, which reaches every camera, and every camera's best partners."""
    shared = tracks.visible.T.astype(int) @ tracks.visible.astype(int)
    np.fill_diagonal(shared, 0)
    best = np.argsort(-shared, axis=1, kind="stable")[:, :partners]
    pairs = {(min(i, int(j)), max(i, int(j))) for i, row in enumerate(best) for j in row} if partners > 1 else set()
    reached = {0}
    while len(reached) < tracks.cameras:
        edges = [(shared[i, j], -i, -j) for i in reached for j in range(tracks.cameras) if j not in reached]
        _, i, j = max(edges)
        reached.add(-j)
        pairs.add((min(-i, -j), max(-i, -j)))
    return sorted(pair for pair in pairs if shared[pair] >= least)


def search_offset(
    agreement: Agreement,
    first: tuple[int, Clock],
    second: tuple[int, Clock],
    within: Bool[np.ndarray, " F"] | None = None,
) -> PairOffset:
    """What the second camera is late beyond its clock.

    Whole frames first, then halves and quarters about the best, then the top of the parabola through three.
    """
    camera, clock = second

    def fit(offset: float) -> float:
        return agreement.share(first, (camera, replace(clock, offset=clock.offset + clock.rate * offset)), within).fit

    best = max((float(k) for k in range(-REACH, REACH + 1)), key=fit)
    for step in (0.5, 0.25):
        best = max((best - step, best, best + step), key=fit)
    left, middle, right = fit(best - 0.25), fit(best), fit(best + 0.25)
    bend = left - 2.0 * middle + right
    top = best + 0.25 * float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0 else best
    return PairOffset(first[0], camera, top, middle, fit(0.0))


def joint_offsets(found: list[PairOffset], cameras: int) -> Float[np.ndarray, " C"]:
    """The offsets (frames) against the first camera on which the pairs agree best; least absolute differences.

    A camera that no pair reaches stands at 0.
    """
    if not found:
        return np.zeros(cameras)
    rows = np.arange(len(found))
    design = np.zeros((len(found), cameras))
    design[rows, [pair.second for pair in found]] = 1.0
    design[rows, [pair.first for pair in found]] = -1.0
    wanted, fits = np.array([pair.frames for pair in found]), np.array([pair.fit for pair in found])
    weights, offsets = fits, np.zeros(cameras)
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        offsets = np.linalg.lstsq(design * root[:, None], wanted * root, rcond=None)[0]
        weights = fits / np.maximum(np.abs(design @ offsets - wanted), 0.05)
    return offsets - offsets[0]
