"""Models of the bias of pointing: from the lines of a gesture to what is wrong with the first of them.

Each is linear in its numbers. None knows where the room's axes lie: azimuths count relative to one another only, and
elevations are those of lines. The constant elevation is the thesis's (7.4).
"""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.geometry.angles import wrap_angle
from jaxpoint.geometry.arrays import AnyArray, as_float

PRIOR = 0.5  # standard deviation of a blend's weight and of a polynomial's slope, before any data


class AbstractBiasModel(eqx.Module):
    """What a bias may look like."""

    @abc.abstractmethod
    def turn(self, angles: Float[AnyArray, "*batch L 2"]) -> Float[Array, "*batch 2"]:
        """By how much the first line points too far left and too high: azimuth and elevation, rad.

        Args:
            angles: azimuth and elevation of every line, rad.
        """

    def prior(self) -> Float[Array, " n"]:
        """Numbers that are small a priori, in units of their standard deviation."""
        return jnp.zeros(0)


class ConstantElevation(AbstractBiasModel):
    """Every line is too high by the same angle: the thesis's model."""

    elevation: Float[Array, ""] = eqx.field(converter=as_float)  # rad

    def turn(self, angles: Float[AnyArray, "*batch L 2"]) -> Float[Array, "*batch 2"]:
        high = jnp.broadcast_to(self.elevation, as_float(angles)[..., 0, 0].shape)
        return jnp.stack([jnp.zeros_like(high), high], axis=-1)


class Constant(AbstractBiasModel):
    """Every line is too far left and too high by the same two angles."""

    offset: Float[Array, "2"] = eqx.field(converter=as_float)  # rad

    def turn(self, angles: Float[AnyArray, "*batch L 2"]) -> Float[Array, "*batch 2"]:
        return jnp.broadcast_to(self.offset, as_float(angles)[..., 0, :].shape)


class Polynomial(AbstractBiasModel):
    """Both angles follow the elevation of the line: people err otherwise where they point up than where down.

    Of the azimuth nothing can follow: which way somebody faces is not known of one line.
    """

    coefficients: Float[Array, "2 degree_and_1"] = eqx.field(converter=as_float)  # rad, of powers of elevation (rad)

    def turn(self, angles: Float[AnyArray, "*batch L 2"]) -> Float[Array, "*batch 2"]:
        elevation = as_float(angles)[..., 0, 1:]
        powers = jnp.concatenate([elevation**k for k in range(self.coefficients.shape[1])], axis=-1)
        return powers @ self.coefficients.T

    def prior(self) -> Float[Array, " n"]:
        return self.coefficients[:, 1:].ravel() / PRIOR


class Blend(AbstractBiasModel):
    """The first line, drawn towards the others: weighted means of azimuths and of elevations, plus a constant.

    The first line has what the weights of the others leave of 1. A weight may be negative: the gap between two lines
    tells how an arm is bent.
    """

    offset: Float[Array, "2"] = eqx.field(converter=as_float)  # rad
    weights: Float[Array, "2 others"] = eqx.field(converter=as_float)  # of azimuth and of elevation
    used: Bool[Array, " others"] = eqx.field(converter=jnp.asarray)  # lines that take part

    def turn(self, angles: Float[AnyArray, "*batch L 2"]) -> Float[Array, "*batch 2"]:
        angles = as_float(angles)
        apart = angles[..., 1:, :] - angles[..., :1, :]
        apart = jnp.stack([wrap_angle(apart[..., 0]), apart[..., 1]], axis=-1)
        weights = jnp.where(self.used, self.weights, 0.0).astype(angles.dtype)
        drawn = jnp.einsum("...oc,co->...c", apart, weights)
        return jnp.broadcast_to(self.offset, drawn.shape) - drawn

    def prior(self) -> Float[Array, " n"]:
        return self.weights.ravel() / PRIOR


class Personal(AbstractBiasModel):
    """A shared model, and by how much one person's lines are farther left and higher than it says."""

    shared: AbstractBiasModel
    offset: Float[Array, "2"] = eqx.field(converter=as_float)  # rad

    def turn(self, angles: Float[AnyArray, "*batch L 2"]) -> Float[Array, "*batch 2"]:
        return (shared := self.shared.turn(angles)) + jnp.broadcast_to(self.offset, shared.shape)
