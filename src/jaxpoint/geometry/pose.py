"""Rigid poses and similarities.

Names chain: `cam_from_world @ points_world` are the points in the camera's frame.
"""

from __future__ import annotations

from typing import Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint, stack_last


class Pose(eqx.Module):
    """A rotation, then a translation: x -> R x + t."""

    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    translation: Float[Array, "3"] = eqx.field(converter=as_float)

    __hash__ = hash_or_hint

    @staticmethod
    def identity() -> Pose:
        """The pose that changes nothing, in JAX's default precision."""
        return Pose(jnp.eye(3), jnp.zeros(3))

    @staticmethod
    def exp(tangent: Float[AnyArray, "6"]) -> Pose:
        """The pose of a twist: 3 numbers of translation, then a rotation vector (rad)."""
        tangent = as_float(tangent)
        rotvec = tangent[3:]
        return Pose(so3.exp(rotvec), so3.rotate(so3.left_jacobian(rotvec), tangent[:3]))

    def log(self) -> Float[Array, "6"]:
        """The twist of which this pose is the exponential; the rotation vector's length is at most pi."""
        rotvec = so3.log(self.rotation)
        return jnp.concatenate([so3.rotate(so3.left_jacobian_inverse(rotvec), self.translation), rotvec])

    def inverse(self) -> Pose:
        """The pose that undoes this one."""
        back = self.rotation.T
        return Pose(back, -so3.rotate(back, self.translation))

    @overload
    def __matmul__(self, other: Pose) -> Pose: ...
    @overload
    def __matmul__(self, other: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 3"]: ...
    def __matmul__(self, other: Any) -> Any:
        """This pose after another one, or of points (..., 3)."""
        if isinstance(other, Pose):
            # The columns of the product are the rotated columns of the second rotation.
            turned = so3.rotate(self.rotation, other.rotation.T).T
            return Pose(turned, self @ other.translation)
        return _shift(so3.rotate(self.rotation, other), self.translation)


class Similarity(eqx.Module):
    """Scale, rotation, translation: x -> s R x + t, as between the solver's frame and the room."""

    scale: Float[Array, ""] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    translation: Float[Array, "3"] = eqx.field(converter=as_float)

    __hash__ = hash_or_hint

    @staticmethod
    def identity() -> Similarity:
        """The similarity that changes nothing, in JAX's default precision."""
        return Similarity(jnp.ones(()), jnp.eye(3), jnp.zeros(3))

    @staticmethod
    def exp(tangent: Float[AnyArray, "7"]) -> Similarity:
        """From 3 numbers of translation, a rotation vector (rad) and the logarithm of the scale."""
        tangent = as_float(tangent)
        rotvec, log_scale = tangent[3:6], tangent[6]
        translation = so3.rotate(_translation_matrix(rotvec, log_scale), tangent[:3])
        return Similarity(jnp.exp(log_scale), so3.exp(rotvec), translation)

    def log(self) -> Float[Array, "7"]:
        """The tangent of which this similarity is the exponential; its rotation is at most pi."""
        rotvec, log_scale = so3.log(self.rotation), jnp.log(self.scale)
        moved = jnp.linalg.solve(_translation_matrix(rotvec, log_scale), self.translation)
        return jnp.concatenate([moved, rotvec, log_scale[None]])

    def inverse(self) -> Similarity:
        """The similarity that undoes this one."""
        back = self.rotation.T
        return Similarity(1 / self.scale, back, -so3.rotate(back, self.translation) / self.scale)

    def transform_camera(self, cam_from_world: Pose) -> Pose:
        """The pose of a camera after the world, and the camera in it, went through this similarity.

        Every pixel stays: the new pose maps `self @ point` to `scale` times the old camera point.
        """
        turned = so3.rotate(cam_from_world.rotation, self.rotation).T  # R_cam R^T
        return Pose(turned, self.scale * cam_from_world.translation - so3.rotate(turned, self.translation))

    @overload
    def __matmul__(self, other: Similarity) -> Similarity: ...
    @overload
    def __matmul__(self, other: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 3"]: ...
    def __matmul__(self, other: Any) -> Any:
        """This similarity after another one, or of points (..., 3)."""
        if isinstance(other, Similarity):
            turned = so3.rotate(self.rotation, other.rotation.T).T
            return Similarity(self.scale * other.scale, turned, self @ other.translation)
        return _shift(self.scale * so3.rotate(self.rotation, other), self.translation)


def gimbal(
    pan: Float[AnyArray, ""] | float,
    tilt: Float[AnyArray, ""] | float,
    gimbal_center: Float[AnyArray, "3"],
    camera_offset: Float[AnyArray, "3"],
    lens_distance: Float[AnyArray, ""] | float = 0.0,
) -> Pose:
    """`cam_from_world` of a camera on a gimbal (thesis eqs. 2.5 to 2.8; entry (3, 3) of eq. 2.6 is cos(tilt)).

    With no pan and no tilt the camera looks along the world's z axis; pan turns it about z, tilt about its own x axis,
    counter-clockwise positive: at tilt pi/2 and pan 0 it looks along -y, level.

    The thesis's image plane lies behind the lens and its image is upside down, so this pose adds the half turn about
    the optical axis that gives our axes (x right, y down, z forward). The thesis's image coordinates are then
    `lens_distance * (x, y) / z` of the camera point (x, y, z).

    Args:
        pan: angle about the world's z axis, rad.
        tilt: angle between the world's z axis and the optical axis, rad.
        gimbal_center: centre of the gimbal in the world, m (w0 of eq. 2.5).
        camera_offset: from the gimbal's centre to the camera's image plane, in camera axes of the thesis, m (eq. 2.7).
        lens_distance: from the image plane to the lens, lambda of eq. 2.1, m.
    """
    pan, tilt = as_float(pan), as_float(tilt)
    offset = as_float(camera_offset)
    (cp, sp), (ct, st) = (jnp.cos(pan), jnp.sin(pan)), (jnp.cos(tilt), jnp.sin(tilt))
    zero = jnp.zeros_like(cp * ct)
    rotation = jnp.stack([cp + zero, sp + zero, zero, -sp * ct, cp * ct, st + zero, sp * st, -cp * st, ct + zero])
    rotation = rotation.reshape(3, 3)
    moved = so3.rotate(rotation, as_float(gimbal_center)) + offset
    lens = jnp.stack([zero, zero, as_float(lens_distance) + zero])
    half_turn = jnp.asarray([-1.0, -1.0, 1.0], dtype=rotation.dtype)
    return Pose(half_turn[:, None] * rotation, -half_turn * (moved + lens))


def _shift(points: Float[Array, "*batch 3"], translation: Float[Array, "3"]) -> Float[Array, "*batch 3"]:
    return stack_last(*(points[..., i] + translation[i] for i in range(3)))


def _translation_matrix(rotvec: Float[Array, "3"], log_scale: Float[Array, ""]) -> Float[Array, "3 3"]:
    """The integral of exp(u log_scale) exp(u rotvec) over u in [0, 1].

    The closed form has singular points in both arguments; Gauss-Legendre with 16 nodes has none and is exact to the
    last digits for angles up to pi and scales from 1e-3 to 1e3.
    """
    nodes, weights = np.polynomial.legendre.leggauss(16)
    moments = jnp.asarray(nodes / 2 + 0.5, dtype=rotvec.dtype)
    weights = jnp.asarray(weights / 2, dtype=rotvec.dtype) * jnp.exp(moments * log_scale)
    turns = jax.vmap(so3.exp)(moments[:, None] * rotvec[None, :])
    return jnp.sum(weights[:, None, None] * turns, axis=0)
