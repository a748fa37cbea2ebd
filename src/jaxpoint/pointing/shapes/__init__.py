"""The shapes of objects: one file each, all of one interface (`AbstractShape`), known by name through the registry."""

from jaxpoint.pointing.shapes.box import Box
from jaxpoint.pointing.shapes.rectangle import Rectangle
from jaxpoint.pointing.shapes.registry import register, shapes, unregister
from jaxpoint.pointing.shapes.shape import AbstractShape, Field
from jaxpoint.pointing.shapes.sphere import Sphere

__all__ = ["AbstractShape", "Box", "Field", "Rectangle", "Sphere", "register", "shapes", "unregister"]
