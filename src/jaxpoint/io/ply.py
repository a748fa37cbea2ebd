"""Coloured point clouds as PLY (binary, little endian), as MeshLab, CloudCompare and Open3D read them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.io.files import StrPath, replacing


def write_ply(path: StrPath, points: Float[np.ndarray, "N 3"], colors: UInt8[np.ndarray, "N 3"]) -> None:
    """Write points (m) with their colours (red, green, blue), whole or not at all.

    Raises:
        ValueError: a coordinate is not finite.
        OSError: the folder is missing or not writable.
    """
    if not np.isfinite(points).all():
        raise ValueError(f"{int((~np.isfinite(points)).sum())} coordinates are not finite; leave these points out.")
    kind = [(axis, "<f4") for axis in "xyz"] + [(color, "u1") for color in ("red", "green", "blue")]
    rows = np.empty(len(points), dtype=kind)
    for i, axis in enumerate("xyz"):
        rows[axis] = points[:, i]
    for i, color in enumerate(("red", "green", "blue")):
        rows[color] = colors[:, i]
    properties = [f"property float {axis}" for axis in "xyz"]
    properties += [f"property uchar {color}" for color in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", "comment metres", f"element vertex {len(rows)}", *properties]
    with replacing(path) as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        file.write(rows.tobytes())
