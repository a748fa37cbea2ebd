"""The thesis's own line of pointing: endpoints of skin regions in the two best views (7.2, 7.3), as the baseline."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

from jaxpoint.camera.rig import CameraRig
from jaxpoint.detection.person.thesis_regions import ThesisRegion
from jaxpoint.geometry.line import Ray
from jaxpoint.triangulation import triangulate

VIEWS = 2


def thesis_line(rig: CameraRig, regions: Sequence[ThesisRegion]) -> Ray | None:
    """From the triangulated base to the triangulated tip; None where fewer than two views have a region.

    The views are those of highest eccentricity and most pixels: of the largest eccentricity * log(area).

    Args:
        rig: the cameras, m.
        regions: of each camera, what `thesis_forearm` or `thesis_finger` gave.
    """
    worth = np.array(
        [-1.0 if one.region is None else one.region.eccentricity * np.log(one.region.area) for one in regions]
    )
    best = np.argsort(-worth, kind="stable")[:VIEWS]
    if len(best) < VIEWS or (worth[best] < 0).any():
        return None
    pixels, visible = np.zeros((2, len(rig), 2)), np.zeros((2, len(rig)), bool)
    for camera in best:
        ends = regions[camera].endpoints
        assert ends is not None, "a region that was found has ends"
        pixels[:, camera], visible[:, camera] = (ends.base, ends.tip), True
    with jax.enable_x64(True):
        base, tip = np.asarray(triangulate(rig, pixels, visible, covariance=False).points)
        return Ray(tip, (tip - base) / max(float(np.linalg.norm(tip - base)), 1e-9))
