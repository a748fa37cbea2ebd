"""The fisheye lens of Kannala and Brandt (2006), as OpenCV's `fisheye` and Kalibr's `equi` use it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxpoint.camera.lens import AbstractLens, Coefficient, Parameters, Slopes, Vector
from jaxpoint.geometry.arrays import as_float

_SAMPLES, _HALVINGS, _STEPS = 64, 40, 12


class KannalaBrandt(AbstractLens):
    """A direction at an angle t from the axis is seen at the radius f t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).

    It may see more than 180 degrees. Equidistant lenses have no coefficients; equisolid, orthographic, stereographic
    and perspective ones small ones.
    """

    parameters: Float[Array, "*batch 8"] = eqx.field(converter=as_float)  # fx, fy, cx, cy (px), k1, k2, k3, k4
    name: ClassVar[str] = "kannala_brandt"
    coefficients: ClassVar[tuple[Coefficient, ...]] = tuple(
        Coefficient(name, 0.5, 0.01) for name in ("k1", "k2", "k3", "k4")
    )
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"fisheye": ("k1", "k2", "k3", "k4")}
    sees_sideways: ClassVar[bool] = True

    @staticmethod
    def image_of(parameters: Parameters, direction: Vector) -> tuple[Array, Array]:
        """Pixel of a direction."""
        fx, fy, cx, cy, *coefficients = parameters
        x, y, z = direction
        off, safe, angle = _angle(x, y, z, jnp)
        scale = jnp.where(off, _bent(coefficients, angle) / safe, 1.0 / _ahead(z, jnp))
        return fx * scale * x + cx, fy * scale * y + cy

    @staticmethod
    def direction_of(
        parameters: Parameters, pixel_x: Array, pixel_y: Array, wanted: Array | None = None
    ) -> tuple[tuple[Array, Array, Array], Array]:
        """The unit direction of a pixel."""
        fx, fy, cx, cy, *coefficients = parameters
        x, y = (pixel_x - cx) / fx, (pixel_y - cy) / fy
        if wanted is not None:
            x, y = jnp.where(wanted, x, 0.0), jnp.where(wanted, y, 0.0)
        square = x * x + y * y
        off = square > 0
        radius = jnp.sqrt(jnp.where(off, square, 1.0))
        coefficients = jnp.stack(coefficients)
        angle = _unbend(coefficients, jnp.where(off, radius, 0.0))
        valid = _fits(coefficients, angle, jnp.where(off, radius, 0.0))
        x, y, radius, angle = (jnp.where(valid, part, jax.lax.stop_gradient(part)) for part in (x, y, radius, angle))
        sideways = jnp.where(off, jnp.sin(angle) / radius, 1.0)
        return (sideways * x, sideways * y, jnp.where(off, jnp.cos(angle), 1.0)), valid

    @staticmethod
    def in_range(parameters: Parameters, direction: Vector) -> Array:
        """Whether the radius grows all the way from the axis to this direction."""
        x, y, z = direction
        _, _, angle = _angle(x, y, z, jnp)
        return angle <= _reach(jnp.stack([jnp.asarray(value) for value in parameters[4:]]))

    @classmethod
    def slopes_of(cls, parameters: Parameters, direction: Vector, xp: Any = jnp, *, wild: bool = False) -> Slopes:
        """Written out: with s the scale of (x, y), dx'/dx = f (s + x ds/dx), and likewise."""
        fx, fy, cx, cy, k1, k2, k3, k4 = parameters
        x, y, z = direction
        off, safe, angle = _angle(x, y, z, xp)
        t2, ahead = angle * angle, _ahead(z, xp)
        bent = angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        grows = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        length2 = safe * safe + z * z
        scale = xp.where(off, bent / safe, 1.0 / ahead)
        # d s / d rho over rho, and d s / d z
        around = xp.where(off, (grows * z / length2 - bent / safe) / (safe * safe), 0.0)
        along = xp.where(off, -grows / length2, -1.0 / (ahead * ahead))
        across = x * y * around
        power = xp.where(off, angle / safe, 1.0 / ahead) * t2
        turns = [power, power * t2, power * t2 * t2, power * t2 * t2 * t2]
        return Slopes(
            (fx * (scale * x) + cx, fy * (scale * y) + cy),
            (
                (fx * (scale + x * x * around), fx * across, fx * x * along),
                (fy * across, fy * (scale + y * y * around), fy * y * along),
            ),
            (tuple(fx * x * turn for turn in turns), tuple(fy * y * turn for turn in turns)),
        )


def _angle(x: Any, y: Any, z: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Whether a direction is off the axis, its distance from it (1 on it), and its angle, rad."""
    square = x * x + y * y
    off = square > 0
    safe = xp.sqrt(xp.where(off, square, 1.0))
    return off, safe, xp.where(off, xp.arctan2(safe, xp.where(off, z, 1.0)), xp.where(z < 0, xp.pi, 0.0))


def _ahead(z: Any, xp: Any) -> Any:
    """z, never 0."""
    return xp.where(xp.abs(z) < 1e-12, 1e-12, z)


def _bent(coefficients: Parameters, angle: Array) -> Array:
    """The radius over the focal length."""
    k1, k2, k3, k4 = coefficients
    t2 = angle * angle
    return angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def _grows(coefficients: Parameters, angle: Array) -> Array:
    """Derivative of the radius by the angle."""
    k1, k2, k3, k4 = coefficients
    t2 = angle * angle
    return 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))


def _reach(coefficients: Parameters) -> Array:
    """The angle up to which the radius grows, pi at most."""
    grid = jnp.linspace(0.0, jnp.pi, _SAMPLES + 1)[1:].astype(coefficients[0].dtype)
    rows = [row[None] for row in coefficients]
    falls = ~(_grows(rows, grid.reshape(_SAMPLES, *(1,) * coefficients[0].ndim)) > 0)
    first = jnp.argmax(falls, axis=0)
    high = grid[first]

    def halve(_: Int[Array, ""], bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) / 2
        rising = _grows(coefficients, middle) > 0
        return jnp.where(rising, middle, low), jnp.where(rising, high, middle)

    end = jax.lax.fori_loop(0, _HALVINGS, halve, (high - jnp.pi / _SAMPLES, high))[0]
    return jnp.where(falls.any(axis=0), end, jnp.asarray(jnp.pi, end.dtype))


def _fits(coefficients: Float[Array, "4 ..."], angle: Array, radius: Array) -> Array:
    """Whether the angle has this radius, to rounding."""
    return jnp.abs(_bent(coefficients, angle) - radius) < 200 * jnp.finfo(radius.dtype).eps * (1 + radius)


@jax.custom_jvp
@jax.jit
def _unbend(coefficients: Float[Array, "4 ..."], radius: Array) -> Array:
    """The angle of a radius: Newton steps that fall back on halving, within the range where the radius grows."""
    reach = _reach(coefficients)

    def step(_: Int[Array, ""], state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        angle, low, high = state
        excess, slope = _bent(coefficients, angle) - radius, _grows(coefficients, angle)
        low, high = jnp.where(excess <= 0, angle, low), jnp.where(excess > 0, angle, high)
        newton = angle - excess / jnp.where(slope > 0, slope, 1.0)
        return jnp.where((slope > 0) & (newton >= low) & (newton <= high), newton, (low + high) / 2), low, high

    start = jnp.minimum(radius, reach)
    return jax.lax.fori_loop(0, _STEPS, step, (start, jnp.zeros_like(start), jnp.zeros_like(start) + reach))[0]


@_unbend.defjvp
def _unbend_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """The radius stays: grows * d angle = d radius - what the coefficients do to it."""
    coefficients, radius = primals
    angle = _unbend(coefficients, radius)
    _, by_lens = jax.jvp(lambda c: _bent(c, angle), (coefficients,), (tangents[0],))
    slope = _grows(coefficients, angle)
    usable = _fits(coefficients, angle, radius) & (slope > 0)
    return angle, jnp.where(usable, (tangents[1] - by_lens) / jnp.where(usable, slope, 1.0), 0.0)
