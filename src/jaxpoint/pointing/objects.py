"""Things that can be pointed at, where rays meet them, and which are nearest to a ray that meets none (thesis 7.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.geometry.arrays import AnyArray, as_float

NOTHING = "nothing"  # the answer where no object is meant, so that no object has this name
PAD = 8  # shapes are padded to multiples of it: few programs are compiled while a database grows


@dataclass(frozen=True)
class Rectangle:
    """A rectangle (or parallelogram), met from both sides."""

    corners: Float[np.ndarray, "4 3"]  # m: left-top, right-top, left-bottom, right-bottom


@dataclass(frozen=True)
class Box:
    """A box, met from outside."""

    center: Float[np.ndarray, "3"]  # m
    size: Float[np.ndarray, "3"]  # m, along its own axes
    yaw: float = 0.0  # rad, by which it is turned about the vertical


@dataclass(frozen=True)
class Sphere:
    """A sphere, met from outside."""

    center: Float[np.ndarray, "3"]  # m
    radius: float  # m


Shape: TypeAlias = Rectangle | Box | Sphere


@dataclass(frozen=True)
class Thing:
    """One entry of the database."""

    name: str
    shape: Shape
    kind: str = ""
    tags: tuple[str, ...] = ()


class Shapes(eqx.Module):
    """The numbers of K objects: F faces and S spheres, both padded: with faces and spheres of no size."""

    corner: Float[Array, "F 3"]  # m, left-top
    right: Float[Array, "F 3"]  # m, from left-top to right-top
    down: Float[Array, "F 3"]  # m, from left-top to left-bottom
    solid: Bool[Array, " F"]  # of a box: met from the side from which its corners are in order
    center: Float[Array, "S 3"]  # m
    radius: Float[Array, " S"]  # m
    owner: Int[Array, " F+S"]  # which object each face, and then each sphere, belongs to


class Objects(eqx.Module):
    """K objects that can be pointed at.

    Only `shapes` is traced: databases of one padded size share their compiled programs.
    """

    shapes: Shapes
    names: tuple[str, ...] = eqx.field(static=True)
    kinds: tuple[str, ...] = eqx.field(static=True)
    tags: tuple[tuple[str, ...], ...] = eqx.field(static=True)

    @staticmethod
    def of(things: Sequence[Thing]) -> Objects:
        """From a list; a measured rectangle becomes the nearest that is plane.

        Raises:
            ValueError: there is nothing in the list.
        """
        if not things:
            raise ValueError("A database of 0 objects cannot be pointed at; give at least one.")
        faces, face_owner, spheres, sphere_owner = [], [], [], []
        for k, thing in enumerate(things):
            if isinstance(thing.shape, Sphere):
                spheres.append((*thing.shape.center, thing.shape.radius))
                sphere_owner.append(k)
            else:
                found = _faces(thing.shape)
                faces += found
                face_owner += [k] * len(found)
        face = _padded(np.array([row for row, _ in faces]).reshape(-1, 9), PAD)  # a minimum over no face has no value
        sphere = _padded(np.array(spheres).reshape(-1, 4))
        owner = np.concatenate([_padded(np.array(face_owner, int), PAD), _padded(np.array(sphere_owner, int))])
        corner, right, down = (as_float(face[:, i : i + 3]) for i in (0, 3, 6))
        shapes = Shapes(
            corner,
            right,
            down,
            jnp.asarray(_padded(np.array([solid for _, solid in faces], bool), PAD)),
            as_float(sphere[:, :3]),
            as_float(sphere[:, 3]),
            jnp.asarray(owner),
        )
        return Objects(
            shapes,
            tuple(thing.name for thing in things),
            tuple(thing.kind for thing in things),
            tuple(thing.tags for thing in things),
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def bounds(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """The lowest and highest coordinates of all, m."""
        s = self.shapes
        used = np.asarray(jnp.any(s.right != 0, axis=1))
        corners = np.asarray(face_corners(s))[used].reshape(-1, 3)
        center, radius = np.asarray(s.center), np.asarray(s.radius)[:, None]
        center, radius = center[radius[:, 0] > 0], radius[radius[:, 0] > 0]
        points = np.concatenate([corners, center - radius, center + radius])
        return points.min(axis=0), points.max(axis=0)


def face_corners(shapes: Shapes, origin: Float[Array, "3"] | None = None) -> Float[Array, "F 4 3"]:
    """Corners of every face, around it: left-top, right-top, right-bottom, left-bottom, m, from a place."""
    a, u, v = shapes.corner, shapes.right, shapes.down
    a = a if origin is None else a - origin[None]
    return jnp.stack([a, a + u, a + u + v, a + v], axis=1)


def middle_part(shapes: Shapes, share: float) -> Shapes:
    """Every object made smaller about its middle, to a share of its size."""
    count, faces = shapes.owner.shape[0], shapes.corner.shape[0]
    used = jnp.any(shapes.right != 0, axis=1)[:, None]
    middles = jnp.where(used, shapes.corner + (shapes.right + shapes.down) / 2, 0.0)
    owner = shapes.owner[:faces]
    total, number = (jax.ops.segment_sum(part, owner, count) for part in (middles, used.astype(middles.dtype)))
    middle = (total / jnp.maximum(number, 1.0))[owner]
    return Shapes(
        middle + share * (shapes.corner - middle),
        share * shapes.right,
        share * shapes.down,
        shapes.solid,
        shapes.center,
        share * shapes.radius,
        shapes.owner,
    )


def flat_rectangle(corners: Float[AnyArray, "4 3"]) -> tuple[np.ndarray, float]:
    """Left-top, right side and left side (m, rows) of the rectangle nearest to measured corners, and the rms distance
    (m) of these from a common plane."""
    corners = np.asarray(corners, float)
    center = corners.mean(axis=0)
    normal = np.linalg.svd(corners - center)[2][-1]
    off = (corners - center) @ normal
    left_top, right_top, left_bottom, right_bottom = corners - off[:, None] * normal
    right = (right_top - left_top + right_bottom - left_bottom) / 2
    down = (left_bottom - left_top + right_bottom - right_top) / 2
    return np.stack([center - right / 2 - down / 2, right, down]), float(np.sqrt(np.mean(off**2)))


def _faces(shape: Rectangle | Box) -> list[tuple[np.ndarray, bool]]:
    """Left-top, right, down of each face, nine numbers, and whether it is met from one side only."""
    if isinstance(shape, Rectangle):
        return [(flat_rectangle(shape.corners)[0].ravel(), False)]
    cos, sin = np.cos(shape.yaw), np.sin(shape.yaw)
    axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) * np.asarray(shape.size, float)[:, None]
    x, y, z = axes
    faces = []
    for sign in (1.0, -1.0):  # down x right looks out of the box
        for out, right, down in ((x, sign * y, -z), (y, -sign * x, -z), (z, sign * x, -y)):
            corner = np.asarray(shape.center, float) + (sign * out - right - down) / 2
            faces.append((np.concatenate([corner, right, down]), True))
    return faces


def _padded(rows: np.ndarray, least: int = 0) -> np.ndarray:
    """With zeros up to a multiple of PAD rows; nothing stays nothing, unless there are to be so many at least."""
    count = max(least, len(rows) + -len(rows) % PAD)
    return np.pad(rows, [(0, count - len(rows)), *[(0, 0)] * (rows.ndim - 1)])
