"""Sightings of one camera at one and the same pixel: a stand-in for "not seen", or a hot pixel, and no light.

A light that is held still repeats its pixel too, at least where pixels are whole numbers; but it stays there. What is
refused here comes and goes: the camera jumps to that pixel and away again, many times more often than to any other.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxpoint.errors import InsufficientDataError
from jaxpoint.tracks import Tracks

STAND_INS = ((0.0, 0.0), (-1.0, -1.0), (-2.0, -2.0))  # "not seen" as many write it, pixels counted from 0 or 1
MIN_STAND_INS = 5  # sightings at such a pixel
MIN_VISITS = 10  # at any other, from afar
BEYOND = 5.0  # and so many times as often as the other pixels
FAR = 0.02  # of the image's width; a jump, and no light that trembles


def refuse_stuck(tracks: Tracks) -> None:
    """Refuse tracks in which a camera has many sightings at one and the same pixel.

    Raises:
        InsufficientDataError: it does; the message names the camera, the pixel and the remedy.
    """
    found = [(name, *stuck) for c, name in enumerate(tracks.names) if (stuck := _stuck(tracks, c)) is not None]
    if not found:
        return
    name, place, count = max(found, key=lambda one: one[2])
    seen = int(tracks.visible[:, tracks.names.index(name)].sum())
    others = f", and so have {', '.join(who for who, *_ in found if who != name)}" if len(found) > 1 else ""
    raise InsufficientDataError(
        f"Camera '{name}' has {count} of {seen} sightings at one and the same pixel, ({place[0]:g}, {place[1]:g})"
        f"{others}; that is no light, so leave the cells of x and y empty (or NaN) where it was not seen."
    )


def _stuck(tracks: Tracks, camera: int) -> tuple[Float[np.ndarray, "2"], int] | None:
    """The pixel that is no light, and how often it stands there."""
    seen = tracks.pixels[tracks.visible[:, camera], camera]
    if len(seen) < MIN_STAND_INS:
        return None
    places, which, counts = np.unique(seen, axis=0, return_inverse=True, return_counts=True)
    if len(places) < 2:
        return None  # a camera that stands still altogether is another matter
    which = which.ravel()
    visits = _visits(seen, which, len(places), FAR * float(tracks.image_sizes[camera, 0]))
    often = visits >= max(MIN_VISITS, BEYOND * np.quantile(visits, 0.95))
    for place in STAND_INS:
        at = (places == np.array(place)).all(axis=1)
        often |= at & (counts >= MIN_STAND_INS) & ((visits >= 1) | (min(place) < 0))
    worst = int(np.where(often, counts, 0).argmax())
    return (places[worst], int(counts[worst])) if often[worst] else None


def _visits(seen: Float[np.ndarray, "N 2"], which: np.ndarray, places: int, far: float) -> np.ndarray:
    """How often the camera jumps to each place and away again; frames in a row count once."""
    first = np.flatnonzero(np.r_[True, which[1:] != which[:-1]])
    jump = np.linalg.norm(np.diff(seen[first], axis=0), axis=1) > far
    both = np.r_[True, jump] & np.r_[jump, True]
    return np.bincount(which[first[both]], minlength=places)
