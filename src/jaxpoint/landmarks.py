"""Points and lengths known in the room, and where a calibration puts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.result import Calibration
from jaxpoint.errors import InsufficientDataError
from jaxpoint.triangulation import Triangulation, triangulate

CLICK_SIGMA_PX = 1.0  # standard deviation of a hand-clicked coordinate
MIN_LANDMARKS = 3  # of an alignment
MISCLICK_PX = 10.0  # a click this far from where the others put the point is worth a warning


@dataclass(frozen=True)
class Landmarks:
    """N points whose place in the room is known."""

    names: tuple[str, ...]
    points: Float[np.ndarray, "N 3"]  # m, world
    sigmas: Float[np.ndarray, " N"] | None = None  # m, standard deviation of each coordinate

    def select(self, names: Sequence[str]) -> Landmarks:
        """Some landmarks, in the order given.

        Raises:
            KeyError: there is no landmark of that name.
        """
        places = {name: i for i, name in enumerate(self.names)}
        index = [places[name] for name in names]
        return Landmarks(tuple(names), self.points[index], None if self.sigmas is None else self.sigmas[index])


@dataclass(frozen=True)
class LandmarkPixels:
    """N points clicked in the images of C cameras."""

    names: tuple[str, ...]
    pixels: Float[np.ndarray, "N C 2"]  # px, 0 where not clicked
    visible: Bool[np.ndarray, "N C"]


@dataclass(frozen=True)
class Lengths:
    """L distances measured in the room."""

    names: tuple[str, ...]
    ends: tuple[tuple[str, str], ...]
    length_m: Float[np.ndarray, " L"]


def locate(
    calibration: Calibration, names: Sequence[str], clicks: LandmarkPixels | None = None
) -> tuple[Float[np.ndarray, "N 3"], tuple[str, ...]]:
    """Places of named points in the calibration's frame and unit, and warnings about them.

    A name is, in this order: a point of `clicks` (triangulated), a camera (its centre), or the number of a frame
    (the light in it).

    Raises:
        InsufficientDataError: a name is none of these, is clicked in fewer than two images, or its frame has no point.
    """
    places, missing, warnings = _places(calibration, names, clicks)
    if missing:
        raise InsufficientDataError(next(iter(missing.values())))
    return np.stack([places[name] for name in names]), warnings


def locate_some(
    calibration: Calibration, known: Landmarks, clicks: LandmarkPixels | None = None
) -> tuple[Landmarks, Float[np.ndarray, "N 3"], tuple[str, ...]]:
    """As `locate`, for those landmarks that have a place; the others are left out, and a warning names them.

    Raises:
        InsufficientDataError: fewer than three landmarks, or fewer than half, have a place.
    """
    places, missing, warnings = _places(calibration, known.names, clicks)
    names = [name for name in known.names if name in places]
    if missing and len(names) < max(MIN_LANDMARKS, len(missing)):
        raise InsufficientDataError(
            f"{len(missing)} of {len(known.names)} landmarks have no place in this calibration. "
            f"{next(iter(missing.values()))}"
        )
    if missing:
        warnings += (_left_out(list(missing), len(known.names)),)
    return known.select(names), np.stack([places[name] for name in names]), warnings


def _left_out(missing: Sequence[str], count: int) -> str:
    shown = ", ".join(f"'{name}'" for name in missing[:5]) + (", ..." if len(missing) > 5 else "")
    return (
        f"{len(missing)} of {count} landmarks have no place in this calibration and were left out: {shown}. Each must "
        "be clicked in two images or more, be a camera, or be a frame whose light has a point."
    )


def _places(
    calibration: Calibration, names: Sequence[str], clicks: LandmarkPixels | None
) -> tuple[dict[str, np.ndarray], dict[str, str], tuple[str, ...]]:
    """Places by name, why others have none, and warnings."""
    with jax.enable_x64(True):
        centres = dict(zip(calibration.rig.names, np.asarray(calibration.rig.positions)))
    rows = calibration.tracks.rows_by_name()
    places: dict[str, np.ndarray] = {}
    missing: dict[str, str] = {}
    warnings: tuple[str, ...] = ()
    clicked = {} if clicks is None else dict(zip(clicks.names, clicks.visible.sum(axis=1).tolist()))
    missing.update({name: _once(name, clicked[name]) for name in names if clicked.get(name, 2) < 2})
    if clicks is not None and (chosen := [name for name in names if clicked.get(name, 0) >= 2]):
        found = triangulate_clicks(calibration, clicks, chosen)
        places.update(zip(chosen, np.asarray(found.points)))
        warnings = _misclicks(chosen, np.asarray(found.residuals))
    for name in names:
        if name in places or name in missing:
            continue
        if name in centres:
            places[name] = centres[name]
        elif name in rows and calibration.point_valid[rows[name]]:
            places[name] = calibration.points[rows[name]]
        else:
            missing[name] = _unknown(name, name in rows, clicks is not None)
    return places, missing, warnings


def triangulate_clicks(
    calibration: Calibration, clicks: LandmarkPixels, names: Sequence[str], sigma_px: float = CLICK_SIGMA_PX
) -> Triangulation:
    """Clicked points in the calibration's frame, in the order of `names`.

    Raises:
        InsufficientDataError: a name was not clicked, or in fewer than two images.
    """
    places = {name: i for i, name in enumerate(clicks.names)}
    for name in names:
        views = int(clicks.visible[places[name]].sum()) if name in places else 0
        if views < 2:
            raise InsufficientDataError(_once(name, views))
    index = np.array([places[name] for name in names])
    with jax.enable_x64(True):  # all clicks at once, whichever are asked for: one shape, one compilation
        found = triangulate(calibration.rig, clicks.pixels, clicks.visible, sigma_px=sigma_px)
        return jax.tree.map(lambda leaf: leaf[index], found)


def _once(name: str, views: int) -> str:
    return (
        f"'{name}' is clicked in {views} {'image' if views == 1 else 'images'}; click it in two or more "
        "(landmark_pixels: name,camera,x,y)."
    )


def _misclicks(names: Sequence[str], residuals: Float[np.ndarray, "N C 2"]) -> tuple[str, ...]:
    worst = np.linalg.norm(residuals, axis=-1).max(axis=1)
    return tuple(
        f"The clicks on '{name}' miss each other by {error:.0f} px; look at them again."
        for name, error in zip(names, worst)
        if error > MISCLICK_PX
    )


def _unknown(name: str, is_frame: bool, has_clicks: bool) -> str:
    if is_frame:
        return f"The light of frame {name} has no point in the calibration; take a frame that two cameras saw well."
    source = "clicked point" if has_clicks else "frame number"
    return (
        f"'{name}' is no {source}, camera or frame of this calibration; "
        "click it in two or more images (landmark_pixels: name,camera,x,y)."
    )
