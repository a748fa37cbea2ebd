"""What the pixels of one person in one view show of arms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.person.crop import Crop, PackedCrop
from jaxpoint.detection.person.limb_edges import find_edges, find_tips
from jaxpoint.detection.person.limb_ends import find_limb_ends
from jaxpoint.evidence.limb_slices import LimbEdges, LimbEnd, Pixel
from jaxpoint.evidence.person_evidence import AbstractPersonEvidence


@dataclass(frozen=True)
class SilhouetteEvidence(AbstractPersonEvidence):
    """A person's silhouette, unpacked on first use, with the skin in it."""

    source: Crop | PackedCrop

    outlined: ClassVar[bool] = True

    @cached_property
    def crop(self) -> Crop:
        """The person's pixels."""
        return self.source.unpack() if isinstance(self.source, PackedCrop) else self.source

    @property
    def shows_skin(self) -> bool:
        """Whether any pixel is skin."""
        return bool((self.crop.labels == Pixel.SKIN).any())

    def limb_ends(
        self, pixels_a_metre: float, head: Float[np.ndarray, "2"] | None, head_height_px: float
    ) -> list[LimbEnd]:
        """All long ends, those of the skin first."""
        return find_limb_ends(self.crop, pixels_a_metre, head, head_height_px)

    def edges_along(
        self, axis: Float[np.ndarray, "S 2"], across: Float[np.ndarray, "2"], pixels_a_metre: float
    ) -> LimbEdges:
        """The edges of a limb across a predicted axis, to a fraction of a pixel."""
        return find_edges(self.crop, axis, across, pixels_a_metre)

    def tips_beyond(
        self, start: Float[np.ndarray, "2"], ahead: Float[np.ndarray, "2"], pixels_a_metre: float
    ) -> list[Float[np.ndarray, "2"]]:
        """Where the limb may end, by the skin and by the outline."""
        return find_tips(self.crop, start, ahead, pixels_a_metre)

    def pixels_at(self, places: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """The nearest pixels; NOTHING outside the crop."""
        return self.crop.at(places)
