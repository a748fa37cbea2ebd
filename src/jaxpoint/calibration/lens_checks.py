"""Does the lens model hold over the whole of each image? Rejections and residuals over the radius say so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.parameters import COEFFICIENTS

RINGS = 10  # of equal width, from the principal point to half an image diagonal
ENOUGH = 25  # observations that a ring needs
LOST = 0.5  # of a ring's observations kept: where fewer are, the lens model has ended
MOST_LOST = 0.05  # of all observations lost there: the rig bends to the lens
HELD = 0.85  # kept within, as it must be for the radius to be the cause
WAVY = 0.5  # rms of the mean radial residual over the noise: the model does not describe the lens
SIGNIFICANT = 25.0  # chi-square a ring of these means


@dataclass(frozen=True)
class LensProfile:
    """Observations over their distance from the principal point; C cameras, RINGS rings."""

    edges: Float[np.ndarray, " R1"]  # of the rings, in half diagonals
    count: Int[np.ndarray, "C R"]
    kept: Int[np.ndarray, "C R"]
    mean: Float[np.ndarray, "C R"]  # px, radial residual of the inliers, outwards
    square: Float[np.ndarray, "C R"]  # px^2, mean square of the radial residual


def lens_profile_of(calibration: Calibration) -> LensProfile:
    """Counts and mean radial residuals of every camera, ring by ring."""
    tracks = calibration.tracks
    away = tracks.pixels - np.asarray(calibration.rig.cameras.center)
    distance = np.linalg.norm(away, axis=-1)
    half = np.hypot(*tracks.image_sizes.T) / 2.0
    outwards = (calibration.residuals * away).sum(axis=-1) / np.maximum(distance, 1e-9)
    edges = np.linspace(0.0, 1.0, RINGS + 1)
    ring = np.clip((distance / half * RINGS).astype(int), 0, RINGS - 1)
    tested = calibration.comparable & (tracks.visible.sum(axis=1) >= 3)[:, None]
    shape = (tracks.cameras, RINGS)

    def summed(chosen: np.ndarray, values: np.ndarray) -> np.ndarray:
        total = np.zeros(shape)
        rows, cameras = np.nonzero(chosen)
        np.add.at(total, (cameras, ring[rows, cameras]), values[rows, cameras])
        return total

    ones, kept = np.ones_like(distance), calibration.kept
    inliers = summed(kept, ones)
    safe = np.maximum(inliers, 1)
    return LensProfile(
        edges,
        summed(tested, ones).astype(int),
        summed(kept & tested, ones).astype(int),
        summed(kept, outwards) / safe,
        summed(kept, outwards**2) / safe,
    )


def lens_findings(calibration: Calibration) -> Iterator[Finding]:
    """Lenses that the model does not reach, or does not describe."""
    if not calibration.sigma_px > 0:
        return
    profile, names = lens_profile_of(calibration), calibration.tracks.names
    ends, wave = _ends(profile), waviness(profile, calibration.sigma_px)
    if np.isfinite(ends).any():
        shown = tuple(name for name, end in zip(names, ends) if np.isfinite(end))
        end = float(ends[np.isfinite(ends)].min())
        beyond = profile.edges[:-1] >= ends[:, None] - 1e-9
        lost = (profile.count - profile.kept)[beyond].sum() / max(profile.count.sum(), 1)
        yield Finding(
            "lens model",
            "bad" if lost > MOST_LOST or wave.max() > WAVY else "care",
            f"The lens model does not reach the edge of the image: beyond {end:.0%} of the half diagonal most "
            f"observations of {', '.join(shown)} are rejected, within it they fit. The lens is wider than the model "
            "can describe.",
            f"{_other_model(calibration)}; places beyond that radius are flagged by `triangulate`",
            shown,
        )
    wavy = tuple(name for name, value in zip(names, wave) if value > WAVY)
    if wavy:
        yield Finding(
            "lens model",
            "bad" if wave.max() > 2 * WAVY else "care",
            f"The residuals of {', '.join(wavy)} follow the distance from the image centre, by "
            f"{wave.max() * calibration.sigma_px:.2f} px (rms): the lens model does not describe this lens.",
            _other_model(calibration),
            wavy,
        )


def _other_model(calibration: Calibration) -> str:
    """The lens model to try next, or what else helps."""
    lens, freedom = type(calibration.rig.cameras.lens), calibration.freedom
    if set(calibration.rig.lens_models) == {KannalaBrandt}:
        return "Give known lenses (--intrinsics), or leave these cameras out"
    if lens is Brown and freedom is not None and not freedom.free[:, COEFFICIENTS].all(axis=1).any():
        return "Allow more terms (--lens.distortion brown), or try a fisheye (--lens.distortion fisheye)"
    return "Try a fisheye (--lens.distortion fisheye)"


def waviness(profile: LensProfile, sigma_px: float) -> Float[np.ndarray, " C"]:
    """Rms of the mean radial residual over the rings, in sigmas, noise taken off; 0 where it is not significant."""
    inliers = np.where(profile.square > 0, np.maximum(profile.count, 1), 0)
    used = inliers >= ENOUGH
    variance = np.maximum(profile.square - profile.mean**2, 1e-12) / np.maximum(inliers, 1)
    chi = np.where(used, profile.mean**2 / variance, 0.0).sum(axis=1)
    rings = np.maximum(used.sum(axis=1), 1)
    wave = np.sqrt(np.maximum(np.where(used, profile.mean**2 - variance, 0.0).sum(axis=1) / rings, 0.0))
    return np.where(chi > SIGNIFICANT * rings, wave / sigma_px, 0.0)


def with_reach(calibration: Calibration) -> Calibration:
    """The calibration, its rig saying how far from the principal points the lens models hold, where they end."""
    ends = _ends(lens_profile_of(calibration))
    if not np.isfinite(ends).any():
        return calibration
    reach = np.hypot(*calibration.tracks.image_sizes.T) / 2.0 * ends
    return replace(calibration, rig=replace(calibration.rig, reach=jnp.asarray(reach)))


def _ends(profile: LensProfile) -> Float[np.ndarray, " C"]:
    """Where each lens model ends, in half diagonals; of all cameras together where each has too little there."""
    ends = np.array([_end(count, kept) for count, kept in zip(profile.count, profile.kept)])
    if np.isfinite(ends).any():
        return ends
    return np.full(len(ends), _end(profile.count.sum(axis=0), profile.kept.sum(axis=0)))


def _end(count: Int[np.ndarray, " R"], kept: Int[np.ndarray, " R"]) -> float:
    """The radius (half diagonals) beyond which most observations are lost while within they are kept, or infinity."""
    for ring in range(1, RINGS):
        outer, inner = slice(ring, None), slice(0, ring)
        if count[outer].sum() < ENOUGH or count[inner].sum() < ENOUGH:
            continue
        if kept[outer].sum() < LOST * count[outer].sum() and kept[inner].sum() > HELD * count[inner].sum():
            return ring / RINGS
    return float("inf")
