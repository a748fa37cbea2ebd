"""Cameras that have one lens in common: which ones a setting says, and sums over them.

The thesis's "same intrinsics": cameras of one kind, all at one zoom and focus. Of each group the first camera owns the
parameters of the lens; the others have what it has, in the step of an adjustment and in its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.camera.parameters import FOCAL
from jaxpoint.errors import UsageError

ALL = "all"


def lens_owners(
    groups: Sequence[str], names: Sequence[str], image_sizes: Int[np.ndarray, "D 2"]
) -> Int[np.ndarray, " D"] | None:
    """The camera that owns the lens of each camera (D, with padding); None where every camera has its own.

    Args:
        groups: names of cameras with one lens, `cam_0,cam_1`; `all` of all cameras.
        names: of the C cameras.
        image_sizes: px.

    Raises:
        UsageError: a group names an unknown camera, one camera only, one of another group, or images of unlike size.
    """
    if not groups:
        return None
    owner = np.arange(len(image_sizes))
    taken: set[str] = set()
    for group in groups:
        members = list(names) if group.strip() == ALL else [name.strip() for name in group.split(",") if name.strip()]
        unknown = [name for name in members if name not in names]
        if unknown:
            raise UsageError(f"--lens.shared names camera '{unknown[0]}', but the cameras are {', '.join(names)}.")
        if len(members) < 2:
            raise UsageError(f"--lens.shared {group} names 1 camera; a lens is shared by two or more: cam_0,cam_1.")
        twice = [name for name in members if name in taken or members.count(name) > 1]
        if twice:
            raise UsageError(f"--lens.shared names camera '{twice[0]}' twice; a camera has one lens.")
        taken.update(members)
        places = [list(names).index(name) for name in members]
        _check_sizes(members, image_sizes[places])
        owner[places] = places[0]
    return owner


def groups_without(groups: Sequence[str], camera: str) -> tuple[str, ...]:
    """The groups when a camera is left out; of two cameras none is left."""
    rest = [[name for name in group.split(",") if name.strip() != camera] for group in groups]
    return tuple(",".join(members) for members in rest if len(members) > 1 or members == [ALL])


def shares_lens(groups: Sequence[str], name: str) -> bool:
    """Whether some group holds a camera."""
    return any(group.strip() == ALL or name in [member.strip() for member in group.split(",")] for group in groups)


def places_of(owner: Int[np.ndarray, " D"] | None, cameras: int, size: int, extra: int = 0) -> Int[np.ndarray, "D n"]:
    """For each parameter of each camera the place of what owns it, in the flat order of all.

    Args:
        owner: the camera that owns each lens; None where all have their own.
        cameras: D.
        size: parameters of a camera.
        extra: further ones behind these, which are the camera's own; n = size + extra.
    """
    places = np.arange(cameras * (size + extra)).reshape(cameras, size + extra)
    if owner is not None:
        places[:, FOCAL:size] = places[owner, FOCAL:size]
    return places


def with_common_lenses(cameras: Float[np.ndarray, "D p"], owner: Int[np.ndarray, " D"] | None) -> np.ndarray:
    """Parameters of cameras in which shared lenses are their means."""
    if owner is None:
        return cameras
    found = cameras.copy()
    for camera in np.unique(owner):
        found[owner == camera, FOCAL:] = cameras[owner == camera, FOCAL:].mean(axis=0)
    return found


def summed(matrix: Float[np.ndarray, "N N"], places: Int[np.ndarray, " N"]) -> Float[np.ndarray, "N N"]:
    """Rows and columns added to those that own them; the others are 0 afterwards."""
    if (places == np.arange(len(places))).all():
        return matrix
    rows = np.zeros_like(matrix)
    np.add.at(rows, places, matrix)
    columns = np.zeros_like(matrix)
    np.add.at(columns.T, places, rows.T)
    return columns


def _check_sizes(members: Sequence[str], sizes: Int[np.ndarray, "K 2"]) -> None:
    for name, size in zip(members[1:], sizes[1:]):
        if (size != sizes[0]).any():
            raise UsageError(
                f"--lens.shared: images of camera '{members[0]}' are {sizes[0][0]} x {sizes[0][1]} px, those of "
                f"'{name}' {size[0]} x {size[1]} px; one lens goes with one image size."
            )
