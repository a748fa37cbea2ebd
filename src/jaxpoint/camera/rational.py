"""OpenCV's rational lens: Brown's with a denominator, for lenses that bend more than a polynomial can follow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxpoint.camera.image_plane import (
    MAX_R2,
    PlaneModel,
    image_on_plane,
    in_reach,
    plane_jacobian,
    tangential,
    undistort,
)
from jaxpoint.camera.lens import AbstractLens, Coefficient, Parameters, Vector
from jaxpoint.geometry.arrays import as_float

_SAMPLES, _HALVINGS = 128, 40  # where the radius is looked at, from 1e-3 to 1e3, and how the end of its growth is found


class Rational(AbstractLens):
    """x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + tangential part, on the z = 1 plane.

    The coefficients are in OpenCV's order (`CALIB_RATIONAL_MODEL`).
    """

    parameters: Float[Array, "*batch 12"] = eqx.field(converter=as_float)  # fx, fy, cx, cy (px), the coefficients
    name: ClassVar[str] = "rational"
    coefficients: ClassVar[tuple[Coefficient, ...]] = (
        Coefficient("k1", 1.0, 0.03),
        Coefficient("k2", 1.0, 0.03),
        Coefficient("p1", 0.005, 0.002),
        Coefficient("p2", 0.005, 0.002),
        *(Coefficient(name, 1.0, 0.03) for name in ("k3", "k4", "k5", "k6")),
    )
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")}
    sees_sideways: ClassVar[bool] = False

    @staticmethod
    def image_of(parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
        """Pixel of a direction before the camera."""
        return image_on_plane(MODEL, parameters, direction)

    @staticmethod
    def direction_of(
        parameters: Parameters, pixel_x: Array, pixel_y: Array, wanted: Array | None = None
    ) -> tuple[tuple[Array, Array, Array], Array]:
        """The direction of a pixel, z = 1."""
        fx, fy, cx, cy, *coefficients = parameters
        u, v, valid = undistort(MODEL, jnp.stack(coefficients), (pixel_x - cx) / fx, (pixel_y - cy) / fy)
        return (u, v, jnp.ones_like(u)), valid

    @staticmethod
    def in_range(parameters: Parameters, direction: Vector) -> Array:
        """Whether the radial part grows all the way from the axis to this direction."""
        return in_reach(MODEL, parameters, direction)


def _factor(coefficients: Parameters, r2: Array) -> tuple[Array, Array]:
    """The radial factor and its derivative by r^2; the denominator never 0."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    top = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    below = jnp.where(jnp.abs(below) < 1e-9, 1e-9, below)
    by_top = k1 + r2 * (2 * k2 + r2 * 3 * k3)
    by_below = k4 + r2 * (2 * k5 + r2 * 3 * k6)
    return top / below, (by_top - by_below * (top / below)) / below


def _distort(coefficients: Parameters, x: Array, y: Array) -> tuple[Array, Array]:
    radial, _ = _factor(coefficients, jnp.minimum(x * x + y * y, MAX_R2))
    off_x, off_y = _tangential(coefficients, x, y)
    return x * radial + off_x, y * radial + off_y


def _tangential(coefficients: Parameters, x: Array, y: Array) -> Float[Array, "2 *batch"]:
    return tangential(coefficients[2], coefficients[3], x, y)


def _jacobian(coefficients: Parameters, x: Array, y: Array) -> tuple[Array, Array, Array]:
    return plane_jacobian(*_factor(coefficients, x * x + y * y), coefficients[2], coefficients[3], x, y)


def _radius(coefficients: Parameters, radius: Array) -> tuple[Array, Array]:
    radial, by_square = _factor(coefficients, radius * radius)
    return radius * radial, radial + 2 * radius * radius * by_square


def _reach2(coefficients: Parameters) -> Array:
    """Squared radius up to which the distorted one grows: the first sample where it falls, refined by halving."""
    grid = jnp.geomspace(1e-3, 1e3, _SAMPLES).astype(coefficients[0].dtype)
    rows, radius = [row[None] for row in coefficients], grid.reshape(_SAMPLES, *(1,) * coefficients[0].ndim)
    falls = ~(_radius(rows, radius)[1] > 0) | ~(_below(rows, radius) > 0)
    first = jnp.argmax(falls, axis=0)
    low, high = grid[jnp.maximum(first - 1, 0)], grid[first]

    def halve(_: Int[Array, ""], bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) / 2
        grows = _radius(coefficients, middle)[1] > 0
        return jnp.where(grows, middle, low), jnp.where(grows, high, middle)

    end = jax.lax.fori_loop(0, _HALVINGS, halve, (low, high))[0]
    return jnp.where(falls.any(axis=0), end * end, MAX_R2)


def _below(coefficients: Parameters, radius: Array) -> Array:
    k4, k5, k6 = coefficients[5], coefficients[6], coefficients[7]
    r2 = radius * radius
    return 1 + r2 * (k4 + r2 * (k5 + r2 * k6))


MODEL = PlaneModel(_distort, _jacobian, _tangential, _radius, _reach2)
