"""A perfect lens: straight lines stay straight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.camera.image_plane import on_plane
from jaxpoint.camera.lens import AbstractLens, Coefficient, Parameters, Slopes, Vector
from jaxpoint.geometry.arrays import as_float


class Pinhole(AbstractLens):
    """No distortion: x' = fx x / z + cx, y' = fy y / z + cy."""

    parameters: Float[Array, "*batch 4"] = eqx.field(converter=as_float)  # fx, fy, cx, cy (px)
    name: ClassVar[str] = "pinhole"
    coefficients: ClassVar[tuple[Coefficient, ...]] = ()
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"pinhole": ()}
    sees_sideways: ClassVar[bool] = False

    @staticmethod
    def image_of(parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
        """Pixel of a direction before the camera."""
        fx, fy, cx, cy = parameters
        u, v, _ = on_plane(direction)
        return fx * u + cx, fy * v + cy

    @staticmethod
    def direction_of(
        parameters: Parameters, pixel_x: Array, pixel_y: Array, wanted: Array | None = None
    ) -> tuple[tuple[Array, Array, Array], Array]:
        """The direction of any pixel, z = 1."""
        fx, fy, cx, cy = parameters
        u, v = (pixel_x - cx) / fx, (pixel_y - cy) / fy
        return (u, v, jnp.ones_like(u)), jnp.ones_like(u, bool)

    @staticmethod
    def in_range(parameters: Parameters, direction: Vector) -> Array:
        """Whether it points forward."""
        return direction[2] > 0

    @classmethod
    def slopes_of(cls, parameters: Parameters, direction: Vector, xp: Any = jnp, *, wild: bool = False) -> Slopes:
        """Written out."""
        fx, fy, cx, cy = parameters
        u, v, z = on_plane(direction, xp)
        zero, a, b = xp.zeros_like(u), fx / z + 0 * u, fy / z + 0 * v
        return Slopes((fx * u + cx, fy * v + cy), ((a, zero, -a * u), (zero, b, -b * v)), ((), ()))
