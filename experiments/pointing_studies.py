"""Two studies of people who pointed, as pointings at known targets.

Both are recorded left-handed, with x to the right, y up and z forward: (x, y, z) becomes (x, z, y), and azimuths
change their sign. Lines start at the tip of the index finger.
"""

from __future__ import annotations

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import Row, StrPath, natural_key, read_table
from jaxpoint.pointing.bias.pointings import Pointings

_MARKERS = {
    "head": "hmd",
    "shoulder": "rightShoulder",
    "upper-arm": "upperArm",
    "forearm": "forearm",
    "hand": "hand",
    "other-shoulder": "leftShoulder",
}
MOCAP_LINES = tuple(_MARKERS)
EYE_FINGER = "eye-fingertip"


def read_torsalve(folder: StrPath) -> Pointings:
    """Pointings under optical motion capture: lines from a marker on each part of the body through the fingertip.

    Args:
        folder: with `collections.csv` and `targets.csv`.

    Raises:
        FileFormatError: a file or a column is missing, or a gesture has no target.
    """
    folder = Path(folder)
    keys = ("pid", "cid")
    rows = read_table(folder / "collections.csv", (*keys, "indexFinger.X"))
    targets = {
        tuple(row.text(key) for key in keys): _point(row, "target.{}", "XYZ")
        for row in read_table(folder / "targets.csv", (*keys, "target.X", "target.Y", "target.Z"))
    }
    meant = []
    for row in rows:
        key = tuple(row.text(name) for name in keys)
        if key not in targets:
            raise row.error(f"person {key[0]}, gesture {key[1]} is not in targets.csv; add its target.")
        meant.append(targets[key])
    tips = np.array([_point(row, "indexFinger.{}", "XYZ") for row in rows])
    starts = np.array([[_point(row, f"{name}.{{}}", "XYZ") for name in _MARKERS.values()] for row in rows])
    return Pointings(
        tuple(row.text("cid") for row in rows),
        tuple(row.text("pid") for row in rows),
        MOCAP_LINES,
        np.repeat(tips[:, None], len(_MARKERS), axis=1),
        _unit(tips[:, None] - starts),
        np.array(meant),
    )


@dataclass(frozen=True)
class WallPointings:
    """Pointings at a wall from eye over fingertip, and what was recorded with them."""

    pointings: Pointings
    feedback: tuple[str, ...]  # what people saw: cursor, hand or none
    hits: Float[np.ndarray, "G 3"]  # m, where the recorded line met the room


def read_schuetz(folder: StrPath) -> WallPointings:
    """The calibration trials of a study in virtual reality: nine targets on a wall.

    Args:
        folder: with `trials/VRpoint_PERSON_SESSION_*.tsv.gz`.

    Raises:
        FileFormatError: there is no such file, or a column is missing.
    """
    files = sorted(Path(folder).glob("trials/VRpoint_*.tsv.gz"), key=lambda path: natural_key(path.name))
    if not files:
        raise FileFormatError(f"There are no trials/VRpoint_*.tsv.gz in {folder}; check the folder.")
    rows, people, names = [], [], []
    for path in files:
        person, session = path.name.split("_")[1:3]
        with gzip.open(path, "rt", encoding="utf-8", newline="") as file:
            own = [
                Row(path, line, values)
                for line, values in enumerate(csv.DictReader(file, delimiter="\t"), start=2)
                if values.get("type") == "cal"
            ]
        rows += own
        people += [person] * len(own)
        names += [f"{session}-{row.line}" for row in own]
    tips = np.array([_point(row, "index_{}", "xyz") for row in rows])
    directions = np.array([_point(row, "efrc_dir_{}", "xyz") for row in rows])
    wall = 2.0  # m, of z
    targets = np.array([(row.number("tar_x"), wall, row.number("tar_y")) for row in rows])
    lines = Pointings(tuple(names), tuple(people), (EYE_FINGER,), tips[:, None], _unit(directions)[:, None], targets)
    return WallPointings(
        lines,
        tuple(row.text("feedback") for row in rows),
        np.array([_point(row, "efrc_{}", "xyz") for row in rows]),
    )


def _point(row: Row, column: str, axes: str) -> tuple[float, float, float]:
    """A point or direction, right-handed with z up."""
    x, y, z = (row.number(column.format(axis)) for axis in axes)
    return x, z, y


def _unit(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
