"""Lines of pointing drawn through measured joints, a bias taken off, with all of the joints' covariance."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.body.joints import Joints, is_left
from jaxpoint.compilation import jit
from jaxpoint.geometry.angles import azimuth_elevation, turn_directions
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.bias.models import AbstractBiasModel
from jaxpoint.pointing.pointing_line import KINDS, LineKind, PointingLine, directions

_MIRROR = np.array([1.0, -1.0, 1.0])


@partial(jit, static_argnames="lines")
def corrected_lines(
    lines: tuple[LineKind, ...], model: AbstractBiasModel, joints: Joints, covariance: Float[AnyArray, "G 18 18"]
) -> PointingLine:
    """The first of the lines that a model of bias reads, from the tip, turned.

    The lines share joints, and a blend weighs them against each other, so their errors are carried through together.
    Biases are those of right arms; a left arm's is its mirror image.

    Args:
        lines: that the model reads.
        model: of their bias.
        joints: with a leading axis G.
        covariance: of `Joints.flat`, m^2.
    """
    places = np.array([KINDS.index(kind) for kind in lines])

    def numbers(flat: Array, side: Array) -> Array:
        own = Joints.of_flat((flat.reshape(-1, 3) * side[None]).ravel())
        read = directions(own)[places]
        straight = turn_directions(read[0], -model.turn(azimuth_elevation(read)))
        return jnp.concatenate([own.tip * side, straight * side])

    def one(joints: Joints, spread: Array) -> tuple[Array, Array]:
        side = jnp.where(is_left(joints), jnp.asarray(_MIRROR, spread.dtype), 1.0)
        by_joints = jax.jacfwd(numbers)(joints.flat, side)
        return numbers(joints.flat, side), by_joints @ spread @ by_joints.T

    values, spread = jax.vmap(one)(joints, as_float(covariance))
    return PointingLine(Ray(values[:, :3], values[:, 3:]), spread)
