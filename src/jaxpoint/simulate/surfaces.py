"""Surfaces of the room: textured meshes, put together from rectangles, boxes and tapered tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.simulate.textures import Texture

Vector = Sequence[float] | Float[np.ndarray, " N"]

STEP_M = 0.1  # edge of the triangles: fine enough for soft shadows that are computed at their corners


@dataclass(frozen=True)
class Surfaces:
    """V corners, T triangles (counter-clockwise seen from outside), and the texture of each triangle."""

    vertices: Float[np.ndarray, "V 3"]  # m
    normals: Float[np.ndarray, "V 3"]
    uv: Float[np.ndarray, "V 2"]  # place on the texture: 0..1 is one repetition, from its top left
    triangles: Int[np.ndarray, "T 3"]
    texture: Int[np.ndarray, " T"]  # index into `textures`
    textures: tuple[Texture, ...]


@dataclass
class Builder:
    """Collects surfaces; `build` joins them."""

    _parts: list[tuple[np.ndarray, ...]] = field(default_factory=list)
    _textures: list[Texture] = field(default_factory=list)
    boxes: list[np.ndarray] = field(default_factory=list)  # lowest and highest corner of what stands in the way, m

    def quad(self, corners: Float[np.ndarray, "4 3"], texture: Texture) -> None:
        """A rectangle from its left-top, right-top, left-bottom, right-bottom corners, seen from its front."""
        left_top, right_top, left_bottom, _ = np.asarray(corners, float)
        across, down = right_top - left_top, left_bottom - left_top
        width, height = np.linalg.norm(across), np.linalg.norm(down)
        columns, rows = (max(1, round(side / STEP_M)) for side in (width, height))
        u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
        points = left_top + u[..., None] * across + v[..., None] * down
        normal = np.cross(down, across)
        normals = np.broadcast_to(normal / np.linalg.norm(normal), points.shape)
        scale = np.array([1.0, 1.0]) if texture.size_m is None else np.array([width, height]) / texture.size_m
        self._add(points, normals, np.stack([u, v], axis=-1) * scale, texture)

    def box(self, center: Vector, size: Vector, texture: Texture, yaw: float = 0.0, **faces) -> None:
        """A box about its centre, m, turned by `yaw` (rad) about the vertical.

        `faces` gives front (-y of the box), back, left (-x), right, top or bottom a texture of its own; None leaves
        the face out.
        """
        for name, corners in box_faces(center, size, yaw).items():
            chosen = faces.get(name, texture)
            if chosen is not None:
                self.quad(corners, chosen)
        spread = np.abs(_turn(yaw)) @ np.asarray(size, float) / 2
        self.boxes.append(np.stack([np.asarray(center) - spread, np.asarray(center) + spread]))

    def tube(self, base: Vector, radii: tuple[float, float], height: float, texture: Texture) -> None:
        """An upright tube from its lower to its upper radius, m, seen from outside and from above."""
        sides = max(8, round(2 * np.pi * max(radii) / 0.05))
        angle, level = np.meshgrid(np.linspace(0, 2 * np.pi, sides + 1), np.linspace(1, 0, max(2, round(height / 0.1))))
        around = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        radius = radii[0] + (radii[1] - radii[0]) * level
        points = np.asarray(base) + radius[..., None] * around + (height * level)[..., None] * [0.0, 0.0, 1.0]
        self._add(points, around, np.stack([angle / (2 * np.pi), 1 - level], axis=-1), texture)
        lid = np.stack([points[0], np.broadcast_to(points[0].mean(axis=0), points[0].shape)])[::-1]
        self._add(lid, np.broadcast_to([0.0, 0.0, 1.0], lid.shape), np.zeros((*lid.shape[:2], 2)), texture)

    def sheet(self, points: Float[np.ndarray, "R C 3"], texture: Texture) -> None:
        """A curved sheet of rows and columns of points, left to right and top to bottom seen from its front."""
        down, across = np.gradient(points, axis=(0, 1))
        normals = np.cross(down, across)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        u, v = np.meshgrid(np.linspace(0, 1, points.shape[1]), np.linspace(0, 1, points.shape[0]))
        self._add(points, normals, np.stack([u, v], axis=-1), texture)

    def build(self) -> Surfaces:
        """All of it as one mesh."""
        vertices, normals, uv, triangles, texture = zip(*self._parts)
        starts = np.cumsum([0, *(len(part) for part in vertices)])
        return Surfaces(
            np.concatenate(vertices),
            np.concatenate(normals),
            np.concatenate(uv).astype(np.float32),
            np.concatenate([part + start for part, start in zip(triangles, starts)]),
            np.concatenate(texture),
            tuple(self._textures),
        )

    def _add(self, points: np.ndarray, normals: np.ndarray, uv: np.ndarray, texture: Texture) -> None:
        """A grid of rows (downwards) and columns (to the right)."""
        rows, columns = points.shape[:2]
        place = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = place[:-1, :-1], place[:-1, 1:], place[1:, :-1], place[1:, 1:]
        triangles = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
        if not any(texture is known for known in self._textures):
            self._textures.append(texture)
        index = next(i for i, known in enumerate(self._textures) if known is texture)
        self._parts.append(
            (
                points.reshape(-1, 3),
                normals.reshape(-1, 3),
                uv.reshape(-1, 2),
                triangles,
                np.full(len(triangles), index, np.int16),
            )
        )


def box_faces(center: Vector, size: Vector, yaw: float = 0.0) -> dict[str, np.ndarray]:
    """The faces of a box by name, each as left-top, right-top, left-bottom, right-bottom seen from outside."""
    x, y, z = np.asarray(size, float) / 2
    faces = {
        "front": [(-x, -y, z), (x, -y, z), (-x, -y, -z), (x, -y, -z)],
        "back": [(x, y, z), (-x, y, z), (x, y, -z), (-x, y, -z)],
        "left": [(-x, y, z), (-x, -y, z), (-x, y, -z), (-x, -y, -z)],
        "right": [(x, -y, z), (x, y, z), (x, -y, -z), (x, y, -z)],
        "top": [(-x, y, z), (x, y, z), (-x, -y, z), (x, -y, z)],
        "bottom": [(-x, -y, -z), (x, -y, -z), (-x, y, -z), (x, y, -z)],
    }
    turned = _turn(yaw)
    return {name: np.asarray(corners) @ turned.T + np.asarray(center, float) for name, corners in faces.items()}


def _turn(yaw: float) -> np.ndarray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
