"""A fitted bias: a model, what it leaves, and what it was fitted on."""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
from jaxtyping import Array, Float

from jaxpoint.compilation import jit
from jaxpoint.geometry.angles import azimuth_elevation, turn_directions
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint
from jaxpoint.pointing.bias.models import AbstractBiasModel
from jaxpoint.pointing.bias.spread import Spread


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
    model: AbstractBiasModel
    spread: Spread
    between: Float[Array, "2 2"] = eqx.field(converter=as_float)  # covariance of people's offsets, rad^2
    within: Spread
    fitted: Fitted = eqx.field(static=True)

    __hash__ = hash_or_hint

    def correct(self, directions: Float[AnyArray, "*batch L 3"]) -> Float[Array, "*batch 3"]:
        """The direction of the first line, turned; differentiable, batched over leading axes.

        Args:
            directions: of all `lines`, in that order; their length does not matter, the first one's is kept.
        """
        return _turned(self.model, as_float(directions))


@jit
def _turned(model: AbstractBiasModel, directions: Array) -> Array:
    return turn_directions(directions[..., 0, :], -model.turn(azimuth_elevation(directions)))
