"""The numbers of a model, by Levenberg-Marquardt: of many models, over many choices of gestures, in one program."""

from __future__ import annotations

from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxpoint.compilation import jit
from jaxpoint.geometry.angles import azimuth_elevation, wrap_angle
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.pointing.bias.models import AbstractBiasModel
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.spread import Spread

Model = TypeVar("Model", bound=AbstractBiasModel)

LEAST_SQUARES = 1e6  # a scale of the loss at which it is a sum of squares, rad
_NARROWING = (4.0, 1.0)  # the loss starts wide: a start far off must not take the good gestures for gross misses
_STEPS = 100
_UNIT = np.deg2rad(1.5)  # of a miss beside a number's distance from what it is a priori


class Observed(eqx.Module):
    """Gestures as the solver takes them."""

    angles: Float[Array, "G L 2"] = eqx.field(converter=as_float)  # rad
    errors: Float[Array, "G 2"] = eqx.field(converter=as_float)  # rad, of the first line, as it was drawn
    level: Float[Array, " G"] = eqx.field(converter=as_float)  # by how much an error of azimuth counts

    @staticmethod
    def at_targets(directions: Float[AnyArray, "G L 3"], to_targets: Float[AnyArray, "G 3"]) -> Observed:
        """Lines of any length, and the directions from the first line's origin to its target."""
        angles, meant = azimuth_elevation(directions), azimuth_elevation(to_targets)
        left, up = jnp.moveaxis(angles[:, 0] - meant, -1, 0)
        return Observed(angles, jnp.stack([wrap_angle(left), up], axis=-1), jnp.cos(meant[:, 1]))

    @staticmethod
    def of(pointings: Pointings) -> Observed:
        """Pointings with targets, padded."""
        size = power_of_two(len(pointings), 64)
        return Observed(*(pad(x, size) for x in (pointings.angles, pointings.errors, pointings.level)))

    def misses(self, model: AbstractBiasModel) -> Float[Array, "G 2"]:
        """By how much corrected lines point to the left of their targets and above, rad."""
        left, up = jnp.moveaxis(self.errors - model.turn(self.angles), -1, 0)
        return jnp.stack([left * self.level, up], axis=-1)


def solve(models: Model, pointings: Pointings, weights: Float[np.ndarray, "N G"], loss_rad: float | None) -> Model:
    """`fit_models` of pointings, padded so that few programs are compiled.

    Args:
        models: where to start, with a leading axis N on all leaves.
        pointings: with targets.
        weights: of each gesture in each fit; 0 leaves it out.
        loss_rad: scale of the loss; None: least squares.
    """
    rows, observed = len(weights), Observed.of(pointings)
    more = power_of_two(rows, 8) - rows
    models = jax.tree.map(lambda leaf: jnp.concatenate([leaf, *[leaf[:1]] * more]), models)
    chosen = pad(pad(weights.T, len(observed.level)).T, rows + more)
    scale = np.float64(LEAST_SQUARES if loss_rad is None else loss_rad)
    return jax.tree.map(lambda leaf: leaf[:rows], fit_models(models, observed, chosen, scale))


def offsets(
    model: AbstractBiasModel,
    pointings: Pointings,
    weights: Float[np.ndarray, "N G"],
    between: Float[AnyArray, "2 2"],
    within: Spread,
) -> Float[np.ndarray, "N 2"]:
    """By how much one person points farther left and higher than a shared model says, rad; the likeliest, N times.

    The person is one of a crowd whose offsets have the covariance `between`, so a few gestures move the answer only as
    far as they are worth.
    """
    rows, observed = len(weights), Observed.of(pointings)
    chosen = pad(pad(weights.T, len(observed.level)).T, power_of_two(rows, 1))
    return np.asarray(_offsets(model, observed, chosen, jnp.asarray(between), within))[:rows]


def cauchy(vectors: Float[Array, "*batch 2"], scale: Float[Array, ""]) -> Float[Array, "*batch 2"]:
    """Vectors along the given ones whose squared lengths are scale^2 log(1 + |vector|^2 / scale^2)."""
    squared = jnp.sum(vectors**2, axis=-1, keepdims=True) / scale**2
    small = squared < 1e-12
    shrink = jnp.sqrt(jnp.log1p(jnp.where(small, 1.0, squared)) / jnp.where(small, 1.0, squared))
    return vectors * jnp.where(small, 1.0, shrink)


@jit
def fit_models(models: Model, observed: Observed, weights: Float[Array, "N G"], loss_rad: Float[Array, ""]) -> Model:
    """N fits of a model, one for each row of weights: pure, for `jit`, `vmap` and `grad`.

    Minimises a Cauchy loss of the angles by which lines miss their targets, to the left and up.

    Args:
        models: where to start, with a leading axis N on all leaves.
        weights: of each gesture in each fit; 0 leaves it out.
        loss_rad: scale of the loss; `LEAST_SQUARES` for a sum of squares.
    """

    def one(model: Model, weights: Array) -> Any:
        numbers, rest = eqx.partition(model, eqx.is_inexact_array)

        def residuals(numbers: AbstractBiasModel, width: Array) -> tuple[Array, Array]:
            own = eqx.combine(numbers, rest)
            misses = cauchy(observed.misses(own), width * loss_rad)
            return jnp.sqrt(weights)[:, None] * misses / _UNIT, own.prior()

        solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-5, linear_solver=lx.Normal(lx.Cholesky()))

        def narrower(numbers: AbstractBiasModel, width: Array) -> tuple[AbstractBiasModel, None]:
            found = optx.least_squares(residuals, solver, numbers, args=width, max_steps=_STEPS, throw=False)
            return found.value, None

        return eqx.combine(jax.lax.scan(narrower, numbers, jnp.asarray(_NARROWING, loss_rad.dtype))[0], rest)

    return jax.vmap(one)(models, weights)


@jit
def _offsets(model: AbstractBiasModel, observed: Observed, weights: Array, between: Array, within: Spread) -> Array:
    white = jnp.linalg.inv(jnp.linalg.cholesky(within.scale))
    tight = jnp.linalg.inv(jnp.linalg.cholesky(between))
    shared = observed.misses(model)

    def one(weights: Array) -> Array:
        def residuals(offset: Array, _: None) -> tuple[Array, Array]:
            own = shared - jnp.stack([observed.level * offset[0], jnp.broadcast_to(offset[1], observed.level.shape)], 1)
            student = cauchy(own @ white.T, jnp.sqrt(within.freedom.astype(own.dtype)))
            likelihood = jnp.sqrt((within.freedom + 2) / within.freedom * weights)
            return likelihood[:, None] * student, tight @ offset

        solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-5, linear_solver=lx.Normal(lx.Cholesky()))
        return optx.least_squares(residuals, solver, jnp.zeros_like(shared[0]), max_steps=_STEPS, throw=False).value

    return jax.vmap(one)(weights)


def power_of_two(count: int, least: int) -> int:
    """The smallest one that is neither below `count` nor below `least`."""
    return max(least, 1 << max(count - 1, 0).bit_length())


def pad(values: np.ndarray, size: int) -> np.ndarray:
    """With zeros at the end, `size` rows."""
    return np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]))])
