"""A fitted bias: a model, what it leaves, and what it was fitted on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.compilation import jit
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.angles import azimuth_elevation, turned
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.bias.models import AbstractModel
from jaxpoint.pointing.bias.spread import Spread
from jaxpoint.pointing.line import PointingLine


@dataclass(frozen=True)
class Fitted:
    """What a bias was fitted on, and how well it does there."""

    source: str  # what the gestures are
    people: int
    gestures: int
    targets: int  # different ones
    loss_deg: float | None  # scale of the Cauchy loss; None: least squares
    median_deg: float | None  # great-circle error on people left out; None: one person alone


class Bias(eqx.Module):
    """Turns lines of pointing back by what people usually err, and says what remains.

    `spread` is that of somebody who was not fitted: differences between people are in it. `between` is the part of
    them, `within` what one person's gestures do about their own middle.
    """

    lines: tuple[str, ...] = eqx.field(static=True)  # kinds that it reads; the first is the one that is turned
    model: AbstractModel
    spread: Spread
    between: Float[Array, "2 2"] = eqx.field(converter=as_float)  # covariance of people's offsets, rad^2
    within: Spread
    fitted: Fitted = eqx.field(static=True)

    def correct(self, directions: Float[AnyArray, "*batch L 3"]) -> Float[Array, "*batch 3"]:
        """The direction of the first line, turned; differentiable, batched over leading axes.

        Args:
            directions: of all `lines`, in that order; their length does not matter, the first one's is kept.
        """
        return _turned(self.model, as_float(directions))


def corrected(bias: Bias, lines: Mapping[str, PointingLine]) -> PointingLine:
    """The first of a bias's lines, turned together with its covariance.

    The spread of people is not added: it is `bias.spread`, for whoever asks what is meant.

    Args:
        lines: by kind, with leading axes of equal shape; kinds that the bias does not read are not looked at. Where a
            blend reads several, the errors of the others count as none.

    Raises:
        InsufficientDataError: a line that the bias reads is missing.
    """
    missing = [kind for kind in bias.lines if kind not in lines]
    if missing:
        raise InsufficientDataError(
            f"The bias reads the line '{missing[0]}', but there are only {', '.join(lines) or 'none'}; "
            "draw that line too, or take another bias."
        )
    first = lines[bias.lines[0]]
    directions = jnp.stack([lines[kind].ray.direction for kind in bias.lines], axis=-2)
    direction, covariance = _turned_with_covariance(bias.model, directions, first.covariance)
    return PointingLine(Ray(first.ray.origin, direction), covariance)


@jit
def _turned(model: AbstractModel, directions: Array) -> Array:
    return turned(directions[..., 0, :], -model.turn(azimuth_elevation(directions)))


@jit
def _turned_with_covariance(model: AbstractModel, directions: Array, covariance: Array) -> tuple[Array, Array]:
    def one(directions: Array, covariance: Array) -> tuple[Array, Array]:
        def by_first(first: Array) -> Array:
            return _turned(model, directions.at[0].set(first))

        change = jnp.eye(6, dtype=directions.dtype).at[3:, 3:].set(jax.jacfwd(by_first)(directions[0]))
        return _turned(model, directions), change @ covariance @ change.T

    batch = directions.shape[:-2]
    flat = jax.vmap(one)(directions.reshape(-1, *directions.shape[-2:]), covariance.reshape(-1, 6, 6))
    return flat[0].reshape(*batch, 3), flat[1].reshape(*batch, 6, 6)
