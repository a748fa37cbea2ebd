"""Which views see the room where an arm should be: they contradict it, unless furniture stands before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.evidence.limb_slices import Pixel
from jaxpoint.evidence.person_evidence import AbstractPersonEvidence

THROUGH = 0.3  # of the places along an axis: where fewer lie on the person, the view looks past the arm


def looks_past(
    people: Sequence[AbstractPersonEvidence | None], places: Float[np.ndarray, "C S 2"], sizes: Int[np.ndarray, "C 2"]
) -> Bool[np.ndarray, " C"]:
    """Whether each view has the person, and the whole axis in its image, but the room where the axis lies.

    Args:
        people: what each view shows of the person; None where it shows nothing.
        places: along the axis, px.
        sizes: of the images, px, width and height.
    """
    whole = np.all((places >= 0) & (places <= sizes[:, None] - 1), axis=(1, 2))
    return np.array(
        [
            whole[c]
            and person is not None
            and person.outlined
            and np.mean(person.pixels_at(places[c]) != Pixel.NOTHING) < THROUGH
            for c, person in enumerate(people)
        ]
    )
