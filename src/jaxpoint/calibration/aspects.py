"""Pixel aspects that cameras and video formats have, and which of them a solution may mean."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxpoint.config import LensSettings
from jaxpoint.errors import UsageError
from jaxpoint.tracks import Tracks

STANDARD_ASPECTS = {
    1.0: "1",
    16 / 15: "16/15",  # PAL, 4:3
    64 / 45: "64/45",  # PAL, 16:9
    8 / 9: "8/9",  # NTSC, 4:3
    32 / 27: "32/27",  # NTSC, 16:9
    4 / 3: "4/3",  # HDV and other anamorphic 1440 x 1080
}
"""Width over height of a pixel, and how it is written (from ITU-R BT.601 and HDV)."""
ALIKE = 0.015  # relative: within this, a ratio of two aspects is taken for that of two standard ones
MOST_PATTERNS = 8


def aspect_of(text: str | float) -> float | None:
    """The pixel aspect (width over height) that a setting states; None for `auto`, `fixed` and `free`.

    Raises:
        UsageError: it is none of these words, nor a number or fraction from 0.2 to 5.
    """
    if text in ("auto", "fixed", "free"):
        return None
    try:
        above, _, below = str(text).partition("/")
        value = float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        value = float("nan")
    if not 0.2 <= value <= 5.0:
        raise UsageError(
            f"The pixel aspect '{text}' cannot be used; say auto, fixed, free, or width over height of a pixel as a "
            "number or fraction (16/15 for PAL video)."
        )
    return value


def aspect_text(aspect: float) -> str:
    """An aspect as people write it: a standard one as a fraction, another to three digits."""
    return next((text for value, text in STANDARD_ASPECTS.items() if abs(value / aspect - 1) < 1e-6), f"{aspect:.3f}")


def aspect_patterns(found: Float[np.ndarray, " C"]) -> list[tuple[float, ...]]:
    """Combinations of standard aspects with the ratios between cameras that were found, the likeliest first.

    A recording often tells the ratios well and their common factor badly.
    """
    standard = np.array(sorted(STANDARD_ASPECTS))
    patterns = set()
    for anchor, value in itertools.product(range(len(found)), standard):
        wanted = found * value / found[anchor]
        nearest = np.abs(np.log(wanted[:, None] / standard)).argmin(axis=1)
        if (np.abs(np.log(wanted / standard[nearest])) < ALIKE).all():
            patterns.add(tuple(standard[nearest].tolist()))

    def unlikely(pattern: tuple[float, ...]) -> tuple[int, float]:
        return sum(value != 1.0 for value in pattern), float(np.abs(np.log(found / np.array(pattern))).max())

    return sorted(patterns, key=unlikely)[:MOST_PATTERNS]


def with_stated_aspects(tracks: Tracks, lens: LensSettings) -> Tracks:
    """The tracks with the pixel aspects that hold unless the recording refutes them.

    A number in the settings comes before what the videos state; `fixed` means square pixels.
    """
    stated = aspect_of(lens.aspect)
    if stated is not None:
        aspects = np.full(tracks.cameras, stated)
    elif lens.aspect == "fixed":
        aspects = np.ones(tracks.cameras)
    elif tracks.pixel_aspects is None:
        aspects = None
    else:
        aspects = tracks.pixel_aspects
    return replace(tracks, pixel_aspects=aspects)
