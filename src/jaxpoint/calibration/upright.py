"""Whether a rig stands upright and above the floor in its room, and is as large as a room: axes and units.

Three things tell where up is. Images are upright in most cameras, so that their y axes point down and their x axes lie
level. Cameras look down rather than up. And they hang above the floor. Each fails somewhere by right (cameras mounted
upside down, cameras that look straight down, an origin at the ceiling), so that what is refused takes two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.errors import InsufficientDataError

LEVEL = 0.35  # sine of the largest tilt of a camera's x axis, 20 degrees
UPRIGHT = 0.35  # least part of an image's up direction along the room's: cameras that look within 70 degrees of level
LOOKS_UP = 0.1  # sine of the elevation
ABOVE = 0.8  # share of the cameras that must be higher than the landmarks along an axis that is to be up
SMALLEST_M = 0.05  # of cameras and landmarks together
WHOLE_M = 30.0  # wider, and in whole numbers, is no room in metres,
WIDE_M = 60.0  # is worth a warning
NATIONAL_M = 1e5  # unless it is given on a national grid, which is in metres

UNITS = {"mm": 1000.0, "cm": 100.0}  # in a metre
TURNS = {
    "-z": "z points down: turn about x by 180 degrees, (x, y, z) -> (x, -y, -z)",
    "+y": "y points up instead of z: turn about x by 90 degrees, (x, y, z) -> (x, -z, y)",
    "-y": "y points down instead of z up: turn about x by 90 degrees, (x, y, z) -> (x, z, -y)",
    "+x": "x points up instead of z: turn about y by 90 degrees, (x, y, z) -> (-z, y, x)",
    "-x": "x points down instead of z up: turn about y by 90 degrees, (x, y, z) -> (z, y, -x)",
}


@dataclass(frozen=True)
class CameraAxes:
    """How C cameras stand in the room."""

    centres: Float[np.ndarray, "C 3"]  # m
    right: Float[np.ndarray, "C 3"]  # unit, the image's x axis in the room
    up: Float[np.ndarray, "C 3"]  # unit, against the image's y axis
    ahead: Float[np.ndarray, "C 3"]  # unit, the optical axis

    @staticmethod
    def of(centres: Float[np.ndarray, "C 3"], rotations: Float[np.ndarray, "C 3 3"]) -> CameraAxes:
        """From centres (m) and rotations from the room to the cameras."""
        return CameraAxes(centres, rotations[:, 0], -rotations[:, 1], rotations[:, 2])

    def votes(self, axis: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " C"]:
        """The cameras whose images are upright where `axis` points up."""
        return (np.abs(self.right @ axis) < LEVEL) & (self.up @ axis > UPRIGHT)


def check_upright(stand: CameraAxes, known: Float[np.ndarray, "N 3"], right_handed: bool = False) -> tuple[str, ...]:
    """Refuse a room in which the cameras do not stand upright above the floor; warnings where that is in doubt.

    Args:
        stand: of the cameras.
        known: places of the landmarks, m.
        right_handed: that they are is known.

    Raises:
        InsufficientDataError: the message names the axis and the turn that mends it.
    """
    count = len(stand.centres)
    floor = min(0.0, float(known[:, 2].min()))
    below = int((stand.centres[:, 2] < floor).sum())
    looks_up = float(np.median(stand.ahead[:, 2])) > LOOKS_UP
    if _most(stand.votes(np.array([0.0, 0.0, 1.0]))):
        return _lower(stand, known) if 2 * below > count else ()
    other = _other_up(stand, known)
    turn = f"{TURNS['-z']}{'' if right_handed else _OR_MIRROR}, {_remedy('-z')}"
    if other in ("+x", "-x", "+y", "-y"):
        raise InsufficientDataError(
            f"The images of the cameras are upright along the room's {other[1]} axis, not along z. {TURNS[other]}, "
            f"{_remedy(other)}"
        )
    if other == "-z" and (looks_up or 2 * below > count):
        what = _below(below, count, floor) if 2 * below > count else "Most cameras come out looking up"
        raise InsufficientDataError(f"{what}, upside down. {turn}")
    if 2 * below > count and float(np.median(stand.ahead[:, 2])) > -LOOKS_UP:
        raise InsufficientDataError(f"{_below(below, count, floor)}. {turn}")
    return _lower(stand, known)


_OR_MIRROR = "; or the axes are left-handed: (x, y, z) -> (x, -y, z)"
_WORLDS = {"-z": " x,-y,-z", "+y": " opengl", "-y": " opencv", "+x": " z,y,-x", "-x": "=-z,y,x"}  # the same as a flag


def _remedy(up: str) -> str:
    """How the turn that was named is made."""
    return f"in the file of known points, or by --world{_WORLDS[up]}."


def check_centres(centres: Float[np.ndarray, "C 3"], known: Float[np.ndarray, "N 3"]) -> tuple[str, ...]:
    """As `check_upright`, where nothing is known of the cameras but their centres (m).

    Raises:
        InsufficientDataError: most of them are below the floor.
    """
    floor = min(0.0, float(known[:, 2].min()))
    below = int((centres[:, 2] < floor).sum())
    if 2 * below > len(centres):
        raise InsufficientDataError(f"{_below(below, len(centres), floor)}. {TURNS['-z']}{_OR_MIRROR}, {_remedy('-z')}")
    unturned = np.zeros_like(centres)
    return _lower(CameraAxes(centres, unturned, unturned, unturned), known)


def check_size(centres: Float[np.ndarray, "C 3"], known: Float[np.ndarray, "N 3"], largest_m: float) -> tuple[str, ...]:
    """Refuse a room whose size shows that its known places are in another unit than metres; a warning in doubt.

    Args:
        centres: of the cameras, m.
        known: places that were measured, m.
        largest_m: width of a room that is still believed, m.

    Raises:
        InsufficientDataError: the message names the size and the unit that fits.
    """
    width = float(np.ptp(np.concatenate([centres, known]), axis=0).max())
    national = float(np.abs(known).max()) >= NATIONAL_M
    whole = not national and bool((known == np.round(known)).all())
    if width < SMALLEST_M:
        raise InsufficientDataError(
            f"Cameras and known points are {1e3 * width:.2g} mm wide altogether; give the known places in metres "
            "(columns x_m,y_m,z_m), or name the columns by their unit."
        )
    unit = "mm" if width > 1000.0 else "cm"
    wide = f"Cameras and known points are {width:.0f} m wide; in {unit} these would be {width / UNITS[unit]:.2g} m"
    remedy = f"name the columns x_{unit},y_{unit},z_{unit} if the places are in {unit}"
    if width > (min(WHOLE_M, largest_m) if whole else largest_m):
        raise InsufficientDataError(f"{wide}: {remedy}, or raise --max-extent-m if it is so wide.")
    return (f"{wide}: {remedy}.",) if width > WIDE_M and not national else ()


def _most(votes: Bool[np.ndarray, " C"]) -> bool:
    return 2 * int(votes.sum()) > len(votes)


def _other_up(stand: CameraAxes, known: Float[np.ndarray, "N 3"]) -> str | None:
    """The direction other than z along which most images are upright; a level one only with the cameras high on it."""
    for name in TURNS:
        axis = np.zeros(3)
        axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
        high = float((stand.centres @ axis > float((known @ axis).mean())).mean())
        if _most(stand.votes(axis)) and (name == "-z" or high >= ABOVE):
            return name
    return None


def _below(below: int, count: int, floor: float) -> str:
    where = "z = 0" if floor == 0 else f"the lowest known point, z = {floor:.2f} m"
    return f"{below} of {count} cameras come out below the floor ({where})"


def _lower(stand: CameraAxes, known: Float[np.ndarray, "N 3"]) -> tuple[str, ...]:
    """A warning where most cameras are lower than what is known."""
    lower = int((stand.centres[:, 2] < known[:, 2].mean()).sum())
    if 2 * lower > len(stand.centres):
        return (f"{lower} of {len(stand.centres)} cameras come out lower than the landmarks; check that z points up.",)
    return ()
