"""Boards whose size is not the stated one: seen by two cameras or more beside another target, the two disagree."""

from __future__ import annotations

import numpy as np

from jaxpoint.calibration.recording import Recording
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.calibration.shapes import LEAST_FRAMES, size_contradictions
from jaxpoint.triangulation import triangulate

LEAST_POINTS = 3  # of a target in one frame


def size_findings(calibration: Calibration, recording: Recording) -> tuple[Finding, ...]:
    """What is to be said of the sizes of targets, each point placed by its own pixels alone."""
    tracks = calibration.tracks
    if len(tracks.targets) < 2 or tracks.cameras < 2:
        return ()
    placed = calibration.kept.sum(axis=1) >= 2
    points = np.asarray(triangulate(calibration.rig, tracks.pixels, calibration.kept).points)
    sizes = []
    for number, target in enumerate(tracks.targets):
        found = []
        for rows in tracks.rows_of_target(number, placed):
            own = np.flatnonzero(rows >= 0)
            if len(own) >= LEAST_POINTS:
                seen, stated = points[rows[own]], target.points[own]
                found.append(np.linalg.norm(seen - seen.mean(axis=0)) / np.linalg.norm(stated - stated.mean(axis=0)))
        sizes.append(np.array(found))
    if min(len(found) for found in sizes) < LEAST_FRAMES:
        return ()
    ratios = np.array([np.median(found) for found in sizes])
    return tuple(size_contradictions(recording, ratios, sizes))
