"""Where one camera may show a coloured marker, over a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class MarkerViews:
    """F frames of one camera, and M places in them that may be the marker, the largest of a frame first."""

    reasons: Int[np.ndarray, " F"]  # values of `FrameReason`
    markers: Int[np.ndarray, " F"]  # values of `MarkerReason`, where there is somebody
    frame: Int[np.ndarray, " M"]  # place among the F frames, rising
    area: Int[np.ndarray, " M"]  # px
    centroid: Float[np.ndarray, "M 2"]  # px
    tip: Float[np.ndarray, "M 2"]  # px, the end far from the person
    base: Float[np.ndarray, "M 2"]  # px
    person: Float[np.ndarray, "M 2"]  # px, centroid of the silhouette
    notes: tuple[str, ...] = ()

    def of(self, frame: int) -> range:
        """The places of one frame."""
        first, last = np.searchsorted(self.frame, [frame, frame + 1])
        return range(int(first), int(last))
