"""Settings of dense stereo."""

from __future__ import annotations

from dataclasses import dataclass

from jaxpoint.config.types import Count, Positive


@dataclass(frozen=True)
class StereoSettings:
    """How disparities are found, by OpenCV's semi-global matching."""

    disparities: Count = 0
    """Largest disparity, px; 0 takes what the nearest board had and a fifth more, without a board a quarter of the
    image's width."""
    block: Count = 5
    """Side of the blocks that are matched, px, an odd number."""
    agree_px: Positive = 1.0
    """Disparities of both images that differ by more are holes (occlusions and mismatches)."""
    max_depth_m: Positive = 20.0
    """Points farther away are left out of the point cloud."""
