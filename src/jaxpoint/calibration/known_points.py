"""Known points that the observations contradict."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxpoint.calibration.result import Calibration, Finding

FAR = 5.0  # standard deviations from where a point is known to be
SHOWN = 5  # points that a message names


def known_point_findings(calibration: Calibration) -> Iterator[Finding]:
    """Points that come out elsewhere than they are known to be, or whose observations do not fit there."""
    prior, hold, tracks = calibration.tracks.prior, calibration.hold, calibration.tracks
    if prior is None or hold is None or hold.open_freedoms > 0:
        return
    known = np.isfinite(prior.sigmas)
    away = np.linalg.norm(calibration.points - prior.points, axis=1)
    moved = known & calibration.point_valid & (away > FAR * np.where(known, prior.sigmas, 1.0))
    refused = (
        known & (tracks.visible.sum(axis=1) >= 2) & (2 * calibration.kept.sum(axis=1) < tracks.visible.sum(axis=1))
    )
    wrong = np.flatnonzero(moved | refused)
    if not len(wrong):
        return
    ids = np.arange(tracks.frames) if tracks.point_ids is None else tracks.point_ids
    named = ", ".join(f"{ids[row]} (frame {tracks.frame_ids[row]})" for row in wrong[:SHOWN])
    more = ", ..." if len(wrong) > SHOWN else ""
    yield Finding(
        "known point",
        "bad",
        f"{len(wrong)} of {known.sum()} known points are seen elsewhere than they are said to be: point {named}{more}.",
        "Measure them again, look whether their names were exchanged, or state larger sigmas",
    )
