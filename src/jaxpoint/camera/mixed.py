"""Lenses of several models in one rig: one class that holds them all, with each camera's model among its parameters.

Arrays over cameras need one class of lens. A mixed lens computes every one of its models and takes the camera's own;
the parameters of the others are 0, never move, and change nothing.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.lens import COMMON, AbstractLens, Coefficient, Parameters, Slopes, Vector
from jaxpoint.geometry.arrays import as_float

MODEL = Coefficient("model", 1.0, 1.0)  # the number of the camera's model; never free
STEEPEST = 0.02  # z over the distance from the axis that a lens of the z = 1 plane is shown, at least


class AbstractMixedLens(AbstractLens):
    """What the mixed lenses of all combinations have in common; made by `mixed_lens`."""

    models: eqx.AbstractClassVar[tuple[type[AbstractLens], ...]]


def mixed_lens(models: Iterable[type[AbstractLens]]) -> type[AbstractLens]:
    """The lens class of cameras with these models; the model itself where there is one only.

    Raises:
        ValueError: there is none.
    """
    different = {model.name: model for model in models}
    if not different:
        raise ValueError("A lens needs a model; 0 were given.")
    ordered = tuple(different[name] for name in sorted(different))
    return ordered[0] if len(ordered) == 1 else _mixed(ordered)


def embedded(
    lens: type[AbstractLens], model: type[AbstractLens], coefficients: Sequence[float] | Float[np.ndarray, " k"]
) -> Float[np.ndarray, " n"]:
    """The coefficients of a lens class for a camera with this model of it."""
    if not issubclass(lens, AbstractMixedLens):
        return np.asarray(coefficients, dtype=float)
    found = np.zeros(len(lens.coefficients))
    found[0] = lens.models.index(model)
    found[_part(lens, model)] = coefficients
    return found


def own_coefficients(lens: type[AbstractLens], model: type[AbstractLens]) -> Bool[np.ndarray, " n"]:
    """Which coefficients of a lens class are those of this model of it."""
    found = np.zeros(len(lens.coefficients), bool)
    found[_part(lens, model) if issubclass(lens, AbstractMixedLens) else slice(None)] = True
    return found


def model_of(lens: type[AbstractLens], coefficients: Float[np.ndarray, " n"]) -> type[AbstractLens]:
    """The model of the camera with these coefficients of a lens class."""
    return lens.models[int(coefficients[0])] if issubclass(lens, AbstractMixedLens) else lens


def plain_lens(lens: AbstractLens) -> AbstractLens:
    """The lens of one camera as one of its own model."""
    kind = type(lens)
    model = model_of(kind, np.asarray(lens.parameters)[COMMON:])
    if model is kind:
        return lens
    own = np.concatenate([np.ones(COMMON, bool), own_coefficients(kind, model)])
    return model(lens.parameters[np.flatnonzero(own)])  # pyright: ignore[reportCallIssue]


def _part(lens: type[AbstractMixedLens], model: type[AbstractLens]) -> slice:
    start = 1
    for other in lens.models:
        if other is model:
            return slice(start, start + len(model.coefficients))
        start += len(other.coefficients)
    raise ValueError(f"A lens of {[other.name for other in lens.models]} has no model '{model.name}'.")


@functools.cache
def _mixed(ordered: tuple[type[AbstractLens], ...]) -> type[AbstractMixedLens]:
    """One class for each combination, so that programs are compiled for it once."""
    parts = [Coefficient(f"{m.name}_{c.name}", *c[1:]) for m in ordered for c in m.coefficients]

    class MixedLens(AbstractMixedLens):
        """fx, fy, cx, cy (px), the model's number, then the coefficients of every model."""

        parameters: Float[Array, "*batch p"] = eqx.field(converter=as_float)
        name: ClassVar[str] = " and ".join(m.name for m in ordered)
        models: ClassVar[tuple[type[AbstractLens], ...]] = ordered
        coefficients: ClassVar[tuple[Coefficient, ...]] = (MODEL, *parts)
        choices: ClassVar[dict[str, tuple[str, ...]]] = {}
        sees_sideways: ClassVar[bool] = any(m.sees_sideways for m in ordered)

        @staticmethod
        def image_of(parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
            """Pixel of a direction."""
            return _chosen(
                parameters,
                [m.image_of(own, aim) for m, own, aim in _each(MixedLens, parameters, direction, jnp)],
                jnp,
            )

        @staticmethod
        def direction_of(
            parameters: Parameters, pixel_x: Array, pixel_y: Array, wanted: Array | None = None
        ) -> tuple[tuple[Array, Array, Array], Array]:
            """A direction of a pixel, of any length."""
            found = [
                m.direction_of(_own(MixedLens, number, parameters, jnp), pixel_x, pixel_y, wanted)
                for number, m in enumerate(ordered)
            ]
            *direction, valid = _chosen(parameters, [(*aim, valid) for aim, valid in found], jnp)
            return (direction[0], direction[1], direction[2]), valid

        @staticmethod
        def in_range(parameters: Parameters, direction: Vector) -> Array:
            """Whether the camera's own model is one-to-one as far as this direction."""
            ahead = [
                m.in_range(own, aim) & (m.sees_sideways | (direction[2] > 0))
                for m, own, aim in _each(MixedLens, parameters, direction, jnp)
            ]
            return _chosen(parameters, [(value,) for value in ahead], jnp)[0]

        @classmethod
        def slopes_of(cls, parameters: Parameters, direction: Vector, xp: Any = jnp, *, wild: bool = False) -> Slopes:
            """Those of the camera's own model; 0 by the coefficients of the others."""
            found = [m.slopes_of(own, aim, xp, wild=wild) for m, own, aim in _each(cls, parameters, direction, xp)]
            pixel = _chosen(parameters, [slopes.pixel for slopes in found], xp)
            of_x, of_y = (_chosen(parameters, [slopes.by_direction[row] for slopes in found], xp) for row in range(2))
            bent_x, bent_y = (_by_coefficients(parameters, found, row, xp) for row in range(2))
            return Slopes((pixel[0], pixel[1]), (of_x, of_y), (bent_x, bent_y))

        def __reduce__(self):
            return _restored, (ordered, np.asarray(self.parameters))

    return MixedLens


def _by_coefficients(parameters: Parameters, found: Sequence[Slopes], row: int, xp: Any) -> tuple[Any, ...]:
    """Derivatives of x or of y by the model's number, which are 0, and by the coefficients of every model."""
    parts = [xp.zeros_like(found[0].pixel[row])]
    for number, slopes in enumerate(found):
        parts += [xp.where(parameters[COMMON] == number, part, 0.0) for part in slopes.by_coefficients[row]]
    return tuple(parts)


def _restored(ordered: tuple[type[AbstractLens], ...], parameters: np.ndarray) -> AbstractLens:
    return _mixed(ordered)(parameters)  # pyright: ignore[reportCallIssue]


def _each(lens: type[AbstractMixedLens], parameters: Parameters, direction: Vector, xp: Any):
    """Every model with its parameters, and the direction as it may be shown to it."""
    for number, model in enumerate(lens.models):
        own = _own(lens, number, parameters, xp)
        yield model, own, (direction if model.sees_sideways or not lens.sees_sideways else _before(direction, xp))


def _own(lens: type[AbstractMixedLens], number: int, parameters: Parameters, xp: Any) -> list[Any]:
    """The parameters of one model; plain ones where the camera has another, so that no derivative overflows."""
    part = _part(lens, lens.models[number])
    mine = parameters[COMMON] == number
    own = [parameters[i] for i in (*range(COMMON), *range(COMMON + part.start, COMMON + part.stop))]
    plain = [1.0, 1.0, *[0.0] * (len(own) - 2)]
    return [xp.where(mine, value, other) for value, other in zip(own, plain)]


def _before(direction: Vector, xp: Any) -> Vector:
    """Directions that a lens of the z = 1 plane can be shown: what lies behind it is seen far outside of its image."""
    x, y, z = direction
    square = x * x + y * y
    off = square > 0
    least = STEEPEST * xp.where(off, xp.sqrt(xp.where(off, square, 1.0)), 0.0) + 1e-9 * xp.abs(z)
    return x, y, xp.maximum(z, least)


def _chosen(parameters: Parameters, values: Sequence[Sequence[Any]], xp: Any) -> tuple[Any, ...]:
    """Of the values of every model those of the camera's own."""
    found = values[0]
    for number, other in enumerate(values[1:], start=1):
        found = [xp.where(parameters[COMMON] == number, new, old) for new, old in zip(other, found)]
    return tuple(found)
