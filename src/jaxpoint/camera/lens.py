"""What every lens is: how a direction in the camera's frame becomes a pixel, and back.

A new lens is one file with one final class, and one entry in `lenses`. All else in the package (adjustment,
covariances, triangulation, files, reports) knows lenses by this interface only.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.compilation import jit_once
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint, safe_norm, stack_last

Parameters: TypeAlias = Any  # p arrays, or one with p entries on its first axis, that broadcast with the directions
Vector: TypeAlias = tuple[Any, ...]  # x, y, z
COMMON = 4  # parameters that all lenses begin with: fx, fy, cx, cy (px)


class Coefficient(NamedTuple):
    """One parameter of a lens beyond focal lengths and principal point."""

    name: str
    prior_sigma: float  # of self-calibration: weak, it only holds what nothing else determines
    known_sigma: float  # how far a careful calibration with a board leaves it open
    prior_mean: float = 0.0


class Slopes(NamedTuple):
    """A pixel and its derivatives; every entry has the shape of the directions."""

    pixel: tuple[Any, Any]
    by_direction: tuple[Vector, Vector]  # of x, then of y, by the three components
    by_coefficients: tuple[tuple[Any, ...], tuple[Any, ...]]


class AbstractLens(eqx.Module):
    """How a direction in the camera's frame (x right, y down, z forward) becomes a pixel, and back.

    A lens is final: it implements the abstract functions and nothing inherits from it. These work component by
    component on arrays of any shapes that broadcast, so that one text serves one pixel, many, and many cameras.
    """

    parameters: eqx.AbstractVar[Float[Array, "*batch p"]]  # fx, fy, cx, cy (px), then the coefficients
    name: eqx.AbstractClassVar[str]  # in files
    coefficients: eqx.AbstractClassVar[tuple[Coefficient, ...]]
    choices: eqx.AbstractClassVar[Mapping[str, tuple[str, ...]]]  # setting -> the coefficients that are free under it
    sees_sideways: eqx.AbstractClassVar[bool]  # whether directions at 90 degrees to the axis and more have pixels

    __hash__ = hash_or_hint

    @staticmethod
    @abc.abstractmethod
    def image_of(parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
        """Pixel of a direction of any length; finite everywhere, meaningful where `in_range`."""

    @staticmethod
    @abc.abstractmethod
    def direction_of(
        parameters: Parameters, pixel_x: Array, pixel_y: Array, wanted: Array | None = None
    ) -> tuple[tuple[Array, Array, Array], Array]:
        """A direction of any length that has this pixel (z = 1 unless `sees_sideways`), and whether there is one.

        Where there is none it is finite but meaningless. With `wanted` pixels many are asked for at once, and only
        these matter: a lens may take a quicker way.
        """

    @staticmethod
    @abc.abstractmethod
    def in_range(parameters: Parameters, direction: Vector) -> Array:
        """Whether the lens is one-to-one from the axis as far as this direction."""

    @classmethod
    def slopes_of(cls, parameters: Parameters, direction: Vector, xp: Any = jnp, *, wild: bool = False) -> Slopes:
        """The pixel and its derivatives, by numpy with `xp = np`.

        By forward differentiation; a lens whose derivatives are worth writing out overrides it.

        Args:
            wild: directions may be anything, as in an adjustment far from its end; beyond its range the lens may give
                way to something that grows slowly.
        """
        if xp is np:
            with jax.enable_x64(True):
                return jax.tree.map(np.asarray, _differentiate_once(cls, list(parameters), tuple(direction)))
        return _differentiate(cls, parameters, direction)

    @classmethod
    def of(
        cls,
        focal: Float[AnyArray, "*batch 2"] | Sequence[float],
        center: Float[AnyArray, "*batch 2"] | Sequence[float],
        coefficients: Float[AnyArray, "*batch k"] | Sequence[float] | None = None,
    ) -> AbstractLens:
        """A lens of its focal lengths and principal point (px); coefficients that are left out are 0."""
        focal, center = as_float(focal), as_float(center)
        rest = jnp.zeros((*focal.shape[:-1], len(cls.coefficients)), focal.dtype)
        rest = rest if coefficients is None else as_float(coefficients)
        return cls(jnp.concatenate([focal, center, rest], axis=-1))  # pyright: ignore[reportCallIssue]

    @classmethod
    def parameter_names(cls) -> tuple[str, ...]:
        """Of all its parameters, in order."""
        return ("fx", "fy", "cx", "cy", *(coefficient.name for coefficient in cls.coefficients))

    @property
    def focal(self) -> Float[Array, "*batch 2"]:
        """Focal lengths in x and y, px."""
        return self.parameters[..., :2]

    @property
    def center(self) -> Float[Array, "*batch 2"]:
        """The principal point, px."""
        return self.parameters[..., 2:COMMON]

    @property
    def distortion(self) -> Float[Array, "*batch k"]:
        """The coefficients."""
        return self.parameters[..., COMMON:]

    def project(self, direction: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Pixels of directions of any length; finite everywhere, meaningful where `reaches`."""
        return stack_last(*self.image_of(self.parameters, split(as_float(direction))))

    def unproject(self, pixel: Float[AnyArray, "*batch 2"]) -> tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
        """Unit directions of pixels, and whether the lens has them; its derivatives are 0 where it has not."""
        pixel = as_float(pixel)
        direction, valid = self.direction_of(self.parameters, pixel[..., 0], pixel[..., 1])
        direction = stack_last(*direction)
        return direction / safe_norm(direction)[..., None], jnp.broadcast_to(valid, direction.shape[:-1])

    def reaches(self, direction: Float[AnyArray, "*batch 3"]) -> Bool[Array, "*batch"]:
        """Whether directions lie where the lens is one-to-one."""
        return self.in_range(self.parameters, split(as_float(direction)))


def split(direction: Float[Array, "*batch 3"]) -> tuple[Array, Array, Array]:
    """The three components of directions."""
    return direction[..., 0], direction[..., 1], direction[..., 2]


@partial(jit_once, static_argnums=0)
def _differentiate_once(lens: type[AbstractLens], parameters: Parameters, direction: Vector) -> Slopes:
    return _differentiate(lens, parameters, direction)


def _differentiate(lens: type[AbstractLens], parameters: Parameters, direction: Vector) -> Slopes:
    parameters = [jnp.asarray(value) for value in parameters]
    shape = jnp.broadcast_shapes(*(jnp.shape(value) for value in (*parameters, *direction)))
    direction = tuple(jnp.broadcast_to(jnp.asarray(value), shape) for value in direction)
    one, zero = jnp.ones_like(direction[0]), jnp.zeros_like(direction[0])

    def by(function, values, chosen: int) -> tuple[Array, Array]:
        tangents = tuple(jnp.broadcast_to(one if i == chosen else zero, jnp.shape(v)) for i, v in enumerate(values))
        return jax.jvp(lambda *moved: function(moved), tuple(values), tangents)[1]

    own = [jnp.broadcast_to(value, shape) for value in parameters]
    directed = [by(lambda moved: lens.image_of(parameters, moved), direction, i) for i in range(3)]
    bent = [by(lambda moved: lens.image_of(moved, direction), own, i) for i in range(COMMON, len(own))]
    return Slopes(
        lens.image_of(parameters, direction),
        (tuple(part[0] for part in directed), tuple(part[1] for part in directed)),
        (tuple(part[0] for part in bent), tuple(part[1] for part in bent)),
    )
