"""What every shape of an object offers: how a user describes it, whether it can be used, and what rays meet of it."""

from __future__ import annotations

import abc
import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float

from jaxpoint.geometry.world_axes import World
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives

MIN_SIDE_M = 0.001
Rows: TypeAlias = tuple[type[AbstractPrimitives], tuple[np.ndarray, ...]]  # a sort, and its arrays of N rows each


@dataclass(frozen=True)
class Field:
    """One value that describes a shape: a key in TOML, one or more columns in CSV, a word of `objects add`.

    Lengths are in the file's unit there and in m in a shape; angles in degrees there and in rad in a shape.
    """

    name: str
    size: tuple[int, ...] = ()  # of the array: (), (3,) or (number of points, 3)
    points: tuple[str, ...] = ()  # short names of the points, where it is several
    angle: bool = False
    default: float | None = None  # in the file's unit; None: it must be given

    @property
    def columns(self) -> tuple[str, ...]:
        """Of a CSV file, one a number, without the unit of lengths."""
        if not self.size:
            return (self.name,)
        return tuple(f"{one}_{axis}" for one in self.points or (self.name,) for axis in "xyz")

    def from_file(self, value: Any, scale: float) -> Any:
        """The shape's value: m or rad. `scale` is the file's unit in m."""
        numbers = np.deg2rad(value) if self.angle else scale * np.asarray(value, float)
        return numbers if self.size else float(numbers)

    def to_file(self, value: Any, scale: float) -> Any:
        """The inverse, rounded to what can be measured: a number or lists of numbers."""
        if self.angle:
            return round(float(np.rad2deg(value)), 3)
        return np.round(np.asarray(value) / scale, 5).tolist()


def length(name: str) -> Field:
    """One length."""
    return Field(name)


def vector(name: str) -> Field:
    """A point or a size: three lengths, along x, y and z."""
    return Field(name, (3,))


def points(name: str, *labels: str) -> Field:
    """Several points, which a user may click in images by their labels."""
    return Field(name, (len(labels), 3), labels)


def angle(name: str, default: float | None = None) -> Field:
    """An angle, degrees in files."""
    return Field(name, angle=True, default=default)


class AbstractShape(abc.ABC):
    """What a user describes: a frozen dataclass whose fields stand in the order of `fields`, lengths in m, angles rad.

    A final class is registered by `registry.register`; readers, writers, checks, hits, posteriors, reports and
    pictures then know it.
    """

    name: ClassVar[str]  # in files, such as "rectangle"
    fields: ClassVar[tuple[Field, ...]]

    @abc.abstractmethod
    def primitives(self) -> Rows:
        """What rays meet of it: one or more primitives of one sort."""

    @property
    @abc.abstractmethod
    def sides(self) -> tuple[float, ...]:
        """Its lengths as a person states them, m: width and height, three sides, a diameter."""

    @property
    @abc.abstractmethod
    def bounds(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Its lowest and highest coordinates, m."""

    @property
    def residual(self) -> float:
        """Rms distance of what was measured from the shape, m; 0 where no more is measured than the shape takes."""
        return 0.0

    def fault(self) -> str | None:
        """What keeps rays from meeting it, such as "has a side of 0 mm; ...", with the remedy; None: nothing."""
        return too_small("side", min(self.sides))

    def to_room(self, world: World) -> AbstractShape | None:
        """It in the axes of the room, where it was described in those of another world; None: it cannot be."""
        return None

    def doubt(self, name: str) -> str | None:
        """A sentence about what was probably measured wrong on the object of this name; None: nothing."""
        return None

    @property
    def values(self) -> tuple[Any, ...]:
        """Of `fields`, m and rad."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))  # pyright: ignore[reportArgumentType]

    @property
    def numbers(self) -> Float[np.ndarray, " n"]:
        """All lengths (m) and angles (rad)."""
        return np.concatenate([np.ravel(value).astype(float) for value in self.values])


def too_small(what: str, smallest: float) -> str | None:
    """The fault of a shape whose smallest extent (m) nobody can point at."""
    smallest = round(smallest, 6)
    if smallest >= MIN_SIDE_M:
        return None
    return (
        f"has a {what} of {1000 * smallest:g} mm; an object needs at least {1000 * MIN_SIDE_M:.0f} mm, so correct the "
        "unit, or measure it again."
    )
