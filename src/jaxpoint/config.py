"""Settings of every command: one dataclass each, at once a TOML file and command-line flags.

Plain Python on purpose: `jaxpoint --help` reads this module and must not import jax.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class LedSettings:
    """How the light is found in images (thesis 5.3.1)."""

    method: Literal["robust", "thesis"] = "robust"
    """`robust`: median/MAD background and a Gaussian fit; `thesis`: mean/std background and template correlation."""
    channel: Literal["auto", "red", "green", "blue", "grey"] = "auto"
    """Colour channel of the light; `auto` takes the one with the strongest light."""
    led_radius_px: float = 3.0
    """Radius of the light in the image, 2 to 5 px as a rule; larger blobs are rejected."""
    threshold_fraction: float = 0.8
    """Pixels above this fraction of the frame's largest difference belong to the light."""
    min_deviations: float = 5.0
    """The largest difference must exceed this many background deviations."""
    max_eccentricity: float = 0.8
    """Blobs more elongated than this are motion blur."""
    min_frames: int = 100
    """Fewest frames from which a background is learnt."""
    workers: int = 0
    """Processes used, one camera each; 0 takes one per core."""


@dataclass(frozen=True)
class EpipolarSettings:
    """Robust two-view geometry of every pair of cameras."""

    method: Literal["magsac", "ransac", "lmeds", "8point"] = "magsac"
    """Robust estimator; `ransac` is the thesis's 7-point RANSAC with a fixed threshold."""
    threshold_px: float = 3.0
    """Inlier threshold at an image width of 1280 px; it scales with the width."""
    samples: int = 512
    """Minimal samples drawn for each pair."""
    min_shared_frames: int = 20
    """Pairs that share fewer frames are not used."""
    division_model: bool = True
    """Estimate one distortion parameter a camera before anything else."""


@dataclass(frozen=True)
class LensSettings:
    """What is unknown in a camera."""

    distortion: Literal["auto", "none", "radial1", "radial2", "brown"] = "auto"
    """`radial2` frees k1 and k2, `brown` also p1, p2, k3; `auto` takes `brown` only where held-out error falls."""
    aspect: Literal["fixed", "free"] = "fixed"
    """`fixed`: fx = fy."""
    principal_point: Literal["prior", "fixed", "free"] = "prior"
    """`prior`: drawn to the image centre; holding it there costs 2 to 35 times in camera position."""
    principal_point_sigma: float = 0.05
    """Standard deviation of that prior, as a fraction of the image width."""
    known: Literal["none", "refine", "hold"] = "none"
    """With a file of known intrinsics: `hold` them or `refine` them from there."""


@dataclass(frozen=True)
class OutlierSettings:
    """Which observations are believed."""

    loss: Literal["cauchy", "none"] = "cauchy"
    """Robust loss of the adjustment."""
    sigmas: float = 4.0
    """An observation is kept within this many robust standard deviations."""
    floor_px: float = 1.0
    """It is always kept within this distance."""
    max_rounds: int = 20
    """Bound on the rounds of rejecting and readmitting."""


@dataclass(frozen=True)
class CalibrateSettings:
    """How a calibration is made from tracks."""

    init: Literal["auto", "factorisation", "thesis", "essential"] = "auto"
    """First solution; `auto` lets all compete and keeps the one with the lowest robust cost."""
    epipolar: EpipolarSettings = field(default_factory=EpipolarSettings)
    lens: LensSettings = field(default_factory=LensSettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    held_out: float = 0.1
    """Fraction of the frames kept aside to judge the distortion model; all are used in the last adjustment."""
    max_mean_px: float = 1.0
    """Quality gate: a mean reprojection error above this fails the calibration (results are kept and marked)."""
    min_kept: float = 0.7
    """Quality gate: a smaller fraction of kept observations fails the calibration."""
    seed: int = 0
