"""Limbs in one view: long ends of a person, and edges across a predicted axis. Both are sampled in slices."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float

SLICES = 24  # across a limb, from its tip inwards
SLICE_M = 0.025  # from one slice to the next
REACH_M = SLICES * SLICE_M  # how far a limb is looked at from its tip


class Pixel(IntEnum):
    """What a pixel shows of a person."""

    NOTHING = 0
    PERSON = 1
    SKIN = 2


@dataclass(frozen=True)
class LimbEnd:
    """A long end in one view; S slices from the tip inwards. Pixels of the whole image."""

    tip: Float[np.ndarray, "2"]  # px
    direction: Float[np.ndarray, "2"]  # unit length, from the body to the tip
    middle: Float[np.ndarray, "S 2"]  # px, middle of each slice
    width: Float[np.ndarray, " S"]  # px, 0 where a slice holds nothing
    area: int  # px, within reach of the tip
    from_skin: bool  # else from the outline
    cut: bool  # it leaves the image at its tip

    @property
    def base(self) -> Float[np.ndarray, "2"]:
        """Middle of the slice farthest from the tip, px."""
        return self.middle[np.flatnonzero(self.width > 0)[-1]]


@dataclass(frozen=True)
class LimbEdges:
    """Both ends of the run across a predicted axis at S places along it: first of the skin, then of the outline."""

    axis: Float[np.ndarray, "S 2"]  # px, of the whole image
    across: Float[np.ndarray, "2"]  # unit
    low: Float[np.ndarray, "2 S"]  # px from the axis; both 0 where nothing lies across it
    high: Float[np.ndarray, "2 S"]
    half: float  # px, half the width of the corridor that was looked at
    pixels_a_metre: float

    def at(self, offsets: Float[np.ndarray, " S"]) -> Float[np.ndarray, "S 2"]:
        """Pixels of the whole image at distances from the axis."""
        return self.axis + offsets[:, None] * self.across
