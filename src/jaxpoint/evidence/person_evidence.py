"""What one view shows of one person in one frame, whoever found it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxpoint.evidence.limb_slices import LimbEdges, LimbEnd, Pixel

_SIDED = ("eye", "ear", "shoulder", "elbow", "wrist", "index")
JOINTS = ("head", "nose", *(f"{side}_{part}" for side in ("left", "right") for part in _SIDED))
"""Names of joints, in the order of landmarks; an index is the fingertip."""
PLACE_OF = {name: place for place, name in enumerate(JOINTS)}


@dataclass(frozen=True)
class SeenJoints:
    """The joints of one person in one view, in the order of `JOINTS`; hidden pixels never matter."""

    pixels: Float[np.ndarray, "J 2"]  # px
    seen: Bool[np.ndarray, " J"]

    @staticmethod
    def of(places: Mapping[str, Float[np.ndarray, "2"] | Sequence[float]]) -> SeenJoints:
        """Joints by their names in `JOINTS`, px.

        Raises:
            ValueError: a joint of another name.
        """
        unknown = sorted(set(places) - set(JOINTS))
        if unknown:
            raise ValueError(f"There is no joint '{unknown[0]}'; name them as {', '.join(JOINTS)}.")
        seen = np.array([name in places for name in JOINTS])
        return SeenJoints(np.array([places.get(name, (0.0, 0.0)) for name in JOINTS], float), seen)


class AbstractPersonEvidence:
    """What one view shows of one person in one frame.

    A detector overrides what it knows: joints, or outlines, or both. Arms are found from the joints where two views
    have them, and else from the outlines. Pixels are those of the whole image.
    """

    outlined: ClassVar[bool] = False  # whether limbs and pixels of the person are known

    def joints(self) -> SeenJoints | None:
        """The joints; None where the detector knows none."""
        return None

    @property
    def shows_skin(self) -> bool:
        """Whether any pixel of the person was recognised as skin; False where the image has no colour."""
        return False

    def limb_ends(
        self, pixels_a_metre: float, head: Float[np.ndarray, "2"] | None, head_height_px: float
    ) -> list[LimbEnd]:
        """All long ends of the person, those of the skin first.

        Args:
            pixels_a_metre: how large the person appears, focal length over distance.
            head: centre of the head, px, which is not a limb; None where it is unknown.
            head_height_px: height of the head.
        """
        return []

    def edges_along(
        self, axis: Float[np.ndarray, "S 2"], across: Float[np.ndarray, "2"], pixels_a_metre: float
    ) -> LimbEdges | None:
        """The edges of a limb across a predicted axis; None where the detector knows no outline.

        Args:
            axis: places along the axis, px.
            across: unit vector across it in the image.
            pixels_a_metre: how large the person appears there.
        """
        return None

    def tips_beyond(
        self, start: Float[np.ndarray, "2"], ahead: Float[np.ndarray, "2"], pixels_a_metre: float
    ) -> list[Float[np.ndarray, "2"]]:
        """Where the limb may end beyond a place on its axis, px.

        Args:
            start: a place on the axis before the wrist, px.
            ahead: unit vector along the axis towards the tip.
            pixels_a_metre: how large the person appears there.
        """
        return []

    def pixels_at(self, places: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """The `Pixel`s nearest to places (px); asked of outlined evidence only."""
        return np.full(len(places), Pixel.NOTHING, np.uint8)
