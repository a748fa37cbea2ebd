"""Lines of pointing: a ray in the room that says where somebody points, and its covariance (thesis 7.3)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.body.joints import Joints
from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.line import Ray, normalise

LineKind = Literal["forearm", "finger", "eye-fingertip", "head-hand", "shoulder-hand"]
KINDS: tuple[LineKind, ...] = get_args(LineKind)


class PointingLine(eqx.Module):
    """A ray from the fingertip (or hand) on, with the covariance of its origin and direction.

    Fields may carry leading axes of equal shape.
    """

    ray: Ray  # origin in m, direction of unit length
    covariance: Float[Array, "*batch 6 6"] = eqx.field(converter=as_float)  # of origin (m) and direction, in that order

    @property
    def direction_covariance(self) -> Float[Array, "*batch 3 3"]:
        """Of the direction; its null vector is the direction itself."""
        return self.covariance[..., 3:, 3:]


def weights_of(kind: str | Mapping[str, float]) -> Float[np.ndarray, "5"]:
    """The weight of each of `KINDS` in a line: one kind alone, or a blend of several.

    Raises:
        ValueError: a kind that does not exist, or no positive weight.
    """
    given = {kind: 1.0} if isinstance(kind, str) else dict(kind)
    unknown = sorted(set(given) - set(KINDS))
    if unknown:
        raise ValueError(f"There is no line of pointing '{unknown[0]}'; choose among {', '.join(KINDS)}.")
    weights = np.array([given.get(name, 0.0) for name in KINDS], float)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.sum() > 0):
        raise ValueError(f"The weights of a blend must be 0 or more and not all 0, but they are {given}.")
    return weights / weights.sum()


def directions(joints: Joints) -> Float[Array, "*batch 5 3"]:
    """The unit directions of all `KINDS`; 0 where both ends of a line coincide."""
    hand = (joints.wrist + joints.tip) / 2
    pairs = (
        (joints.elbow, joints.wrist),
        (joints.wrist, joints.tip),
        (joints.eye, joints.tip),
        (joints.head, hand),
        (joints.shoulder, hand),
    )
    return jnp.stack([normalise(end - start) for start, end in pairs], axis=-2)


def pointing_ray(joints: Joints, weights: Float[AnyArray, "5"]) -> Ray:
    """The ray from the tip in the direction of a blend of `KINDS`; see `weights_of`.

    Every line starts at the fingertip, whichever joints it is drawn through.
    """
    blended = jnp.sum(as_float(weights)[:, None] * directions(joints), axis=-2)
    return Ray(joints.tip, normalise(blended))


@jit
def pointing_lines(
    joints: Joints, covariance: Float[AnyArray, "G 18 18"], weights: Float[AnyArray, "G 5"]
) -> PointingLine:
    """Lines of G gestures with the covariance that their joints' gives them.

    Args:
        joints: with a leading axis G.
        covariance: of `Joints.flat`, m^2.
        weights: of each of `KINDS`, see `weights_of`.
    """

    def numbers(flat: Array, weight: Array) -> Array:
        ray = pointing_ray(Joints.of_flat(flat), weight)
        return jnp.concatenate([ray.origin, ray.direction])

    def one(flat: Array, spread: Array, weight: Array) -> tuple[Array, Array]:
        by_joints = jax.jacfwd(numbers)(flat, weight)
        return numbers(flat, weight), by_joints @ spread @ by_joints.T

    values, spread = jax.vmap(one)(joints.flat, as_float(covariance), as_float(weights))
    return PointingLine(Ray(values[:, :3], values[:, 3:]), spread)
