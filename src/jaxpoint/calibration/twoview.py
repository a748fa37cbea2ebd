"""All pairs of cameras at once: lenses, epipolar geometry, and a vote on every observation (thesis 5.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxpoint.calibration.bundle import padded_frames
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import EpipolarSettings
from jaxpoint.epipolar import draw_samples, lens_table, robust_fundamental
from jaxpoint.tracks import Tracks

LENS_GRID = np.linspace(-0.6, 0.2, 9)  # division-model parameters per half diagonal
# Where the first samples are drawn: two mild, two medium, two strong lenses, and one of each.
FIRST_LENSES = np.array([[-0.05, -0.05], [-0.2, -0.2], [-0.45, -0.45], [-0.45, -0.05], [-0.05, -0.45]])
LOOSE = 8.0 / 3.0  # the first pass, before the lenses are known, is this much more generous
PARTNERS = 8  # of each camera, whose pairs tell the lenses; of a large rig all would take long and tell no more
FEW_MATCHES = 256  # pairs are padded to these, or to the lengths of recordings
PRIOR_MEAN, PRIOR_SIGMA = -0.15, 0.4  # of a division-model parameter, weak


@dataclass(frozen=True)
class NormalisedTracks:
    """Tracks padded to one of few lengths, in units of half the image diagonal from the image centre."""

    points: np.ndarray  # (N, C, 2), still distorted
    visible: np.ndarray  # (N, C)
    half_diagonals: np.ndarray  # (C,) px
    widths: np.ndarray  # (C,) px
    pixel_aspects: np.ndarray  # (C,) width over height of a pixel; the points are those of square pixels


@dataclass(frozen=True)
class TwoViewGeometry:
    """What pairs of cameras say."""

    lenses: np.ndarray  # (C,) division-model parameters
    fundamentals: dict[tuple[int, int], np.ndarray]  # (i, j), i < j: ray_j^T F ray_i = 0
    shared: np.ndarray  # (C, C) frames seen by both
    inliers: np.ndarray  # (C, C) of those, the ones that fit
    votes: np.ndarray  # (N, C) fraction of an observation's pairs in which it is an inlier; 1 where it has none


def normalise_tracks(tracks: Tracks, intrinsics: CameraRig | None = None) -> NormalisedTracks:
    """Tracks as the projective stages want them; with known intrinsics already undistorted, of square pixels."""
    half = np.hypot(*tracks.image_sizes.T.astype(float)) / 2.0
    aspects = np.ones(tracks.cameras) if tracks.pixel_aspects is None else tracks.pixel_aspects
    size = padded_frames(tracks.frames)
    points = np.zeros((size, tracks.cameras, 2))
    visible = np.zeros((size, tracks.cameras), dtype=bool)
    visible[: tracks.frames] = tracks.visible
    if intrinsics is None:
        straight = tracks.pixels - (tracks.image_sizes - 1) / 2.0
        straight[..., 0] *= aspects
    else:
        pixels, valid = intrinsics.undistort(jnp.asarray(tracks.pixels))
        focal = np.asarray(intrinsics.cameras.focal)
        straight = (np.asarray(pixels) - np.asarray(intrinsics.cameras.center)) * (focal[:, :1] / focal)
        visible[: tracks.frames] &= np.asarray(valid)
    points[: tracks.frames] = straight / half[:, None]
    points = np.where(visible[..., None], points, 0.0)
    return NormalisedTracks(points, visible, half, tracks.image_sizes[:, 0].astype(float), aspects)


def two_view_geometry(
    data: NormalisedTracks, settings: EpipolarSettings, seed: int, progress: Callable[[int, int], None] | None = None
) -> TwoViewGeometry:
    """Division-model lenses from all pairs together, then every pair's F, then the vote (DESIGN "Self-calibration")."""
    shared = _shared_frames(data)
    pairs = _usable_pairs(shared, settings.min_shared_frames)
    rng = np.random.default_rng(seed)
    cameras = data.points.shape[1]
    lenses = np.zeros(cameras)
    telling = _telling_pairs(shared, pairs) if settings.division_model else []
    total = len(pairs) + len(telling)
    if telling:
        tables = {}
        for number, pair in enumerate(telling):
            tables[pair] = _pair_lens_table(_matches(data, pair, shared), settings, rng)
            if progress:
                progress(number + 1, total)
        lenses = joint_lenses(tables, cameras)
    return _with_lenses(data, shared, pairs, lenses, settings, rng, progress, total)


def _shared_frames(data: NormalisedTracks) -> np.ndarray:
    """Frames (C, C) that two cameras share."""
    visible = data.visible.astype(int)
    return visible.T @ visible


def _usable_pairs(shared: np.ndarray, least: int) -> list[tuple[int, int]]:
    cameras = len(shared)
    return [(i, j) for i in range(cameras) for j in range(i + 1, cameras) if shared[i, j] >= least]


def _telling_pairs(shared: np.ndarray, pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The pairs that tell the lenses: those of each camera with the partners that share most with it."""
    chosen: set[tuple[int, int]] = set()
    for camera in range(len(shared)):
        own = [pair for pair in pairs if camera in pair]
        chosen.update(sorted(own, key=lambda pair: (-shared[pair], pair))[:PARTNERS])
    return [pair for pair in pairs if pair in chosen]


def _matches(data: NormalisedTracks, pair: tuple[int, int], shared: np.ndarray) -> NormalisedTracks:
    """The matches of one pair alone, padded to what the pair that shares most has."""
    both = data.visible[:, pair[0]] & data.visible[:, pair[1]]
    most = int(np.triu(shared, 1).max())
    size = min(FEW_MATCHES if most <= FEW_MATCHES else padded_frames(most), len(both))
    points, visible = np.zeros((size, 2, 2)), np.zeros((size, 2), bool)
    points[: both.sum()], visible[: both.sum()] = data.points[both][:, pair], True
    return NormalisedTracks(
        points, visible, data.half_diagonals[list(pair)], data.widths[list(pair)], data.pixel_aspects[list(pair)]
    )


def pair_threshold(data: NormalisedTracks, pair, settings: EpipolarSettings) -> float:
    return settings.threshold_px * float(data.widths[list(pair)].mean()) / 1280.0


def fit_pair(data, pair, settings, rng, lenses, threshold):
    i, j = pair
    seen = data.visible[:, i] & data.visible[:, j]
    return robust_fundamental(
        draw_samples(rng, seen, len(FIRST_LENSES), -(-settings.samples // len(FIRST_LENSES))),
        data.points[:, i],
        data.points[:, j],
        seen,
        data.half_diagonals[[i, j]],
        lenses,
        np.float64(threshold),
        method=settings.method,
    )


def _pair_lens_table(matches: NormalisedTracks, settings: EpipolarSettings, rng: np.random.Generator) -> np.ndarray:
    """Summed robust cost of a pair for every two lenses of the grid."""
    threshold = pair_threshold(matches, (0, 1), settings)
    loose = np.asarray(fit_pair(matches, (0, 1), settings, rng, FIRST_LENSES, LOOSE * threshold).inlier)
    table = lens_table(
        matches.points[:, 0],
        matches.points[:, 1],
        loose.astype(float),
        matches.half_diagonals,
        LENS_GRID,
        np.float64(threshold * 2.0 / 3.0),
    )
    return np.asarray(table) * loose.sum()


def joint_lenses(tables: dict[tuple[int, int], np.ndarray], cameras: int) -> np.ndarray:
    """The lens of every camera that all pairs together like best."""
    prior = 0.5 * ((LENS_GRID - PRIOR_MEAN) / PRIOR_SIGMA) ** 2
    _, costs = joint_choice(tables, prior, np.full(cameras, np.abs(LENS_GRID).argmin()))
    return np.array([_parabola_minimum(cost) for cost in costs])


def joint_choice(
    tables: dict[tuple[int, int], np.ndarray], prior: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """One of G values for each of C cameras, all pairs agreeing as well as they can: coordinate descent.

    Args:
        tables: cost (G, G) of every two values of a pair of cameras.
        prior: (G,) cost of every value by itself.
        start: (C,) the values to begin with.

    Returns:
        What is chosen (C,), and the cost (C, G) of every value while the other cameras keep theirs.
    """
    chosen, costs = np.array(start), np.tile(prior, (len(start), 1))
    for _ in range(50):
        before = chosen.copy()
        for camera in range(len(chosen)):
            costs[camera] = prior
            for (i, j), table in tables.items():
                if i == camera:
                    costs[camera] += table[:, chosen[j]]
                elif j == camera:
                    costs[camera] += table[chosen[i]]
            chosen[camera] = costs[camera].argmin()
        if (before == chosen).all():
            break
    return chosen, costs


def _parabola_minimum(cost: np.ndarray) -> float:
    """Minimum between the grid's points."""
    best = int(np.clip(cost.argmin(), 1, len(cost) - 2))
    left, middle, right = cost[best - 1 : best + 2]
    bend = left - 2 * middle + right
    offset = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return float(LENS_GRID[best] + np.clip(offset, -1.0, 1.0) * (LENS_GRID[1] - LENS_GRID[0]))


def _with_lenses(data, shared, pairs, lenses, settings, rng, progress, total) -> TwoViewGeometry:
    cameras = data.points.shape[1]
    fundamentals, agree, count = {}, np.zeros(data.visible.shape), np.zeros(data.visible.shape)
    used, inliers = np.zeros((cameras, cameras), int), np.zeros((cameras, cameras), int)
    for number, (i, j) in enumerate(pairs):
        matches, both = _matches(data, (i, j), shared), data.visible[:, i] & data.visible[:, j]
        offered = np.tile(lenses[[i, j]], (len(FIRST_LENSES), 1))
        fit = fit_pair(matches, (0, 1), settings, rng, offered, pair_threshold(matches, (0, 1), settings))
        good = np.zeros(len(both), bool)
        good[both] = np.asarray(fit.inlier)[: both.sum()]
        fundamentals[i, j] = np.asarray(fit.fundamental)
        used[i, j] = used[j, i] = both.sum()
        inliers[i, j] = inliers[j, i] = good.sum()
        agree[:, [i, j]] += good[:, None]
        count[:, [i, j]] += both[:, None]
        if progress:
            progress(total - len(pairs) + number + 1, total)
    votes = np.where(count > 0, agree / np.maximum(count, 1), 1.0)
    return TwoViewGeometry(lenses, fundamentals, used, inliers, votes)


def undistort_points(points: np.ndarray, lenses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undistorted points (N, C, 2), and how much one distorted unit is worth there (N, C), at most 1.

    Points beyond the reach of the division model get a weight of 0.
    """
    third = 1.0 + lenses * (points**2).sum(axis=-1)
    inside = third > 0.1
    safe = np.where(inside, third, 1.0)
    return points / safe[..., None], np.where(inside, np.minimum(safe, 1.0), 0.0)


def fundamental(geometry: TwoViewGeometry, first: int, second: int) -> np.ndarray:
    """F with ray_second^T F ray_first = 0."""
    if first < second:
        return geometry.fundamentals[first, second]
    return geometry.fundamentals[second, first].T
