"""What the renderer draws: triangles whose every corner knows which part of whom it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int, UInt8

PARTS_A_PERSON = 32


class Part(IntEnum):
    """Whose pixel it is: the value in the masks of `truth/`, plus `PARTS_A_PERSON` times the person's number."""

    ROOM = 0
    BODY = 1  # torso, legs, feet, whatever is none of the others
    HEAD = 2
    NECK = 3
    LEFT_UPPER_ARM = 4
    LEFT_FOREARM = 5
    LEFT_HAND = 6
    LEFT_FINGER = 7  # the index finger
    RIGHT_UPPER_ARM = 8
    RIGHT_FOREARM = 9
    RIGHT_HAND = 10
    RIGHT_FINGER = 11


@dataclass(frozen=True)
class Mesh:
    """V corners and T triangles; counter-clockwise seen from outside. Metres, world z up."""

    vertices: Float[np.ndarray, "V 3"]  # m
    normals: Float[np.ndarray, "V 3"]  # unit length, outward
    triangles: Int[np.ndarray, "T 3"]
    parts: UInt8[np.ndarray, " V"]  # values of `Part`, plus PARTS_A_PERSON times the person
    albedo: Float[np.ndarray, "V 3"]  # linear red, green, blue, 0..1

    @staticmethod
    def joined(meshes: Sequence[Mesh]) -> Mesh:
        """One mesh of several.

        Raises:
            ValueError: there are none.
        """
        if not meshes:
            raise ValueError("A mesh is joined of at least one.")
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        return Mesh(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.normals for mesh in meshes]),
            np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts)]),
            np.concatenate([mesh.parts for mesh in meshes]),
            np.concatenate([mesh.albedo for mesh in meshes]),
        )
