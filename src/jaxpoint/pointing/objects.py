"""Things that can be pointed at, where rays meet them, and which are nearest to a ray that meets none (thesis 7.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.geometry.arrays import as_float
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives
from jaxpoint.pointing.shapes.shape import AbstractShape

NOTHING = "nothing"  # the answer where no object is meant, so that no object has this name
PAD = 8  # primitives are padded to multiples of it: few programs are compiled while a database grows
Choice = tuple[Int[Array, " n"], Bool[Array, " n"]] | None  # of primitives of one sort: which, and whether they count

Result = TypeVar("Result")


@dataclass(frozen=True)
class Thing:
    """One entry of the database."""

    name: str
    shape: AbstractShape
    kind: str = ""
    tags: tuple[str, ...] = ()


class Shapes(eqx.Module):
    """The primitives of K objects, padded, in order of their sorts' names: P in all."""

    primitives: tuple[AbstractPrimitives, ...]
    owners: tuple[Int[Array, " _"], ...]  # which object each primitive belongs to; of padding 0

    @property
    def owner(self) -> Int[Array, " P"]:
        """Which object each of all primitives belongs to."""
        return jnp.concatenate(self.owners)

    @property
    def count(self) -> int:
        """P."""
        return sum(len(owner) for owner in self.owners)

    def each(self, ask: Callable[[AbstractPrimitives], Result]) -> Result:
        """What `ask` says of the primitives of each sort, joined along the first axis to that of all P."""
        return jax.tree.map(lambda *rows: jnp.concatenate(rows), *(ask(own) for own in self.primitives))

    def select(self, choices: Sequence[Choice]) -> Shapes:
        """Some primitives of each sort, or all where there is no choice."""
        pairs = [
            (own, owner) if choice is None else (own.select(*choice), owner[choice[0]])
            for own, owner, choice in zip(self.primitives, self.owners, choices)
        ]
        return Shapes(tuple(own for own, _ in pairs), tuple(owner for _, owner in pairs))

    def shrink(self, share: float) -> Shapes:
        """Every object made smaller about its middle, to a share of its size."""
        middle, radius = self.each(lambda own: own.bounding_spheres())
        used = (radius > 0)[:, None].astype(middle.dtype)
        total, number = (jax.ops.segment_sum(part, self.owner, self.count) for part in (used * middle, used))
        about = total / jnp.maximum(number, 1.0)
        small = (own.shrink(about[owner], share) for own, owner in zip(self.primitives, self.owners))
        return Shapes(tuple(small), self.owners)


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
        """From a list.

        Raises:
            ValueError: there is nothing in the list.
        """
        if not things:
            raise ValueError("A database of 0 objects cannot be pointed at; give at least one.")
        return Objects(
            _shapes([thing.shape for thing in things]),
            tuple(thing.name for thing in things),
            tuple(thing.kind for thing in things),
            tuple(thing.tags for thing in things),
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def outlines(self) -> dict[str, list[Float[np.ndarray, "n 3"]]]:
        """For drawing: closed polygons (corners, m) of every object, by its name."""
        found: dict[str, list[np.ndarray]] = {name: [] for name in self.names}
        for own, owners in zip(self.shapes.primitives, self.shapes.owners):
            used = _used(own)
            for polygons, owner in zip(own.outlines()[used], np.asarray(owners)[used]):
                found[self.names[owner]].extend(polygons)
        return found

    @property
    def middles(self) -> Float[np.ndarray, "K 3"]:
        """The mean of the middles of each object's outlines, m."""
        outlines = self.outlines.values()
        return np.array([np.mean([polygon.mean(axis=0) for polygon in own], axis=0) for own in outlines])

    @property
    def bounds(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """The lowest and highest coordinates of all, m."""
        points = np.concatenate([polygon for own in self.outlines.values() for polygon in own])
        return points.min(axis=0), points.max(axis=0)


def _shapes(shapes: Sequence[AbstractShape]) -> Shapes:
    """The primitives of all, joined by their sort and padded."""
    sorts: dict[type[AbstractPrimitives], list[tuple[np.ndarray, ...]]] = {}
    for k, shape in enumerate(shapes):
        sort, rows = shape.primitives()
        sorts.setdefault(sort, []).append((*rows, np.full(len(rows[0]), k)))
    primitives, owners = [], []
    for sort in sorted(sorts, key=lambda sort: sort.__qualname__):
        *arrays, owner = (_join(parts) for parts in zip(*sorts[sort]))
        primitives.append(sort(*arrays))  # pyright: ignore[reportArgumentType]; `most` is no field
        owners.append(owner)
    return Shapes(tuple(primitives), tuple(owners))


def _used(primitives: AbstractPrimitives) -> Bool[np.ndarray, " N"]:
    """Which are no padding, in numpy: nothing is compiled for it."""
    leaves = jax.tree.leaves(primitives)
    return np.any([np.any(np.asarray(leaf) != 0, axis=tuple(range(1, leaf.ndim))) for leaf in leaves], axis=0)


def _join(parts: Sequence[np.ndarray]) -> Array:
    """One after the other, with zeros up to a multiple of PAD rows."""
    rows = np.concatenate(parts)
    padded = np.pad(rows, [(0, -len(rows) % PAD), *[(0, 0)] * (rows.ndim - 1)])
    return as_float(padded) if padded.dtype.kind == "f" else jnp.asarray(padded)
