"""Cameras as tables of a TOML file: what anipose, caliscope and Pose2Sim have in common."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath
from jaxpoint.io.formats.fields import camera_entry, read_image_size, read_numbers, rotation_of
from jaxpoint.io.rig_entries import CameraEntry, check_entry


def read_toml(path: StrPath, text: str) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        FileFormatError: it is not TOML.
    """
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: {error}; it is not TOML.") from None


def toml_camera(path: StrPath, section: str, table: Mapping[str, Any], name: str, poses: bool) -> CameraEntry:
    """One camera's table: name, size, matrix, distortions, rotation, translation and fisheye.

    Raises:
        FileFormatError: a value is missing or wrong.
    """
    where = f"{path}, [{section}]: "
    if "distortions" not in table:
        raise FileFormatError(f"{where}'distortions' is missing.")
    entry = camera_entry(
        where,
        name,
        toml_size(where, table),
        read_numbers(where, table, "matrix", (3, 3)),
        table["distortions"],
        "fisheye" if table.get("fisheye") is True else "",
        _pose(where, table, poses),
    )
    check_entry(where, entry)
    return entry


def toml_size(where: str, table: Mapping[str, Any]) -> tuple[int, int]:
    """Width and height, px.

    Raises:
        FileFormatError: they are missing or wrong.
    """
    if "size" not in table:
        raise FileFormatError(f"{where}'size' is missing.")
    return read_image_size(where, table["size"])


def _pose(where: str, table: Mapping[str, Any], needed: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """Rotation matrix and translation; none where they are not needed and not there."""
    if not needed and not {"rotation", "translation"} & table.keys():
        return None
    return rotation_of(where, read_numbers(where, table, "rotation")), read_numbers(where, table, "translation", (3,))
