"""Which shapes there are, by the names under which files and commands know them."""

from __future__ import annotations

from jaxpoint.pointing.shapes.box import Box
from jaxpoint.pointing.shapes.rectangle import Rectangle
from jaxpoint.pointing.shapes.shape import AbstractShape
from jaxpoint.pointing.shapes.sphere import Sphere

_RESERVED = ("name", "kind", "tags", "unit", "room", "shape")  # in files of objects
_SHAPES: dict[str, type[AbstractShape]] = {shape.name: shape for shape in (Rectangle, Box, Sphere)}


def shapes() -> dict[str, type[AbstractShape]]:
    """All shapes, by name."""
    return dict(_SHAPES)


def register(shape: type[AbstractShape]) -> type[AbstractShape]:
    """Make a shape known to readers, writers, commands and reports; a decorator too.

    Raises:
        ValueError: its name is taken, or one of its names cannot stand in files of objects.
    """
    for name in (shape.name, *(field.name for field in shape.fields)):
        if name in _RESERVED or not name.isidentifier() or name != name.casefold():
            raise ValueError(
                f"The shape '{shape.name}' uses the name '{name}', which cannot stand in files of objects; give "
                "another one, in small letters."
            )
    if shape.name in _SHAPES:
        raise ValueError(f"There is a shape '{shape.name}' already; give the new one another name.")
    _SHAPES[shape.name] = shape
    return shape


def unregister(name: str) -> None:
    """Forget a shape; for tests.

    Raises:
        KeyError: there is none of this name.
    """
    del _SHAPES[name]
