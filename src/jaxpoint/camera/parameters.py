"""The parameters of a camera as an adjustment has them, and the way to and from cameras.

Rotation vector and translation of `cam_from_world` (the rotation relative to a base that is held), log focal (of fy),
log aspect (fx / fy), principal point (px), then the lens's coefficients. Logarithms keep focal lengths positive, and
the aspect apart from what an adjustment of square pixels moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry import rotation

POSE, FOCAL, ASPECT, CENTER, COEFFICIENTS = slice(0, 6), 6, 7, slice(8, 10), slice(10, None)
COMMON = 10  # parameters that cameras of all lenses begin with
MOST_TURN, MOST_FOCAL = 1.0, 0.7  # rad, and of a log focal or log aspect, in one step


def size_of(lens: type[AbstractLens]) -> int:
    """How many parameters a camera with this lens has."""
    return COMMON + len(lens.coefficients)


def chosen_coefficients(lens: type[AbstractLens], names: Sequence[str]) -> Bool[np.ndarray, " k"]:
    """Which coefficients of the lens have one of these names."""
    return np.array([coefficient.name in names for coefficient in lens.coefficients], dtype=bool)


def lens_parameters(adjusted: Any, xp: Any = jnp) -> list[Any]:
    """fx, fy, cx, cy and the coefficients, from log focal onwards; whatever the arrays' shapes."""
    focal_y = xp.exp(adjusted[0])
    return [focal_y * xp.exp(adjusted[1]), focal_y, *(adjusted[i] for i in range(2, len(adjusted)))]


def adjusted_lenses(rig: CameraRig) -> Float[np.ndarray, "C q"]:
    """What an adjustment has of the lenses of a rig, from log focal onwards; q = p - 6."""
    found = np.array(rig.cameras.lens.parameters, dtype=float)
    fx, fy = found[:, 0].copy(), found[:, 1].copy()
    found[:, 0], found[:, 1] = np.log(fy), np.log(fx / fy)
    return found


def adjusted_cameras(rig: CameraRig) -> Float[np.ndarray, "C p"]:
    """The rig's parameters about its own rotations as the base."""
    lenses = adjusted_lenses(rig)
    found = np.zeros((len(rig), FOCAL + lenses.shape[1]))
    found[:, 3:6], found[:, FOCAL:] = rig.cameras.cam_from_world.translation, lenses
    return found


def rig_of_parameters(
    cameras: Float[Any, "C p"],
    rotations: Float[Any, "C 3 3"],
    image_sizes: Any,
    names: tuple[str, ...],
    lens: type[AbstractLens],
) -> CameraRig:
    """The rig of adjusted parameters and whole rotations; works under `jit`."""
    focal = jnp.exp(cameras[:, FOCAL])
    focal = jnp.stack([focal * jnp.exp(cameras[:, ASPECT]), focal], axis=1)
    lenses = cameras[:, CENTER], cameras[:, COEFFICIENTS]
    return CameraRig.from_parameters(focal, *lenses, rotations, cameras[:, 3:6], image_sizes, names, lens)


def rotations_of(cameras: Float[Array, "C p"], base: Float[Array, "C 3 3"]) -> Float[Array, "C 3 3"]:
    """The whole rotations."""
    turned = jax.vmap(rotation.exp)(cameras[:, :3])
    # Sums written out: a batched product of 3 x 3 matrices is slow on a CPU.
    return (turned[:, :, :, None] * base[:, None, :, :]).sum(axis=2)


def retract(cameras: Float[Array, "C p"], step: Float[Array, "C p"]) -> Float[Array, "C p"]:
    """The cameras after a step: a left rotation to first order, everything else added.

    Focal lengths at most double or halve in a step.
    """
    turned = cameras[:, :3] + jax.vmap(lambda old, by: rotation.left_jacobian_inverse(old) @ by)(
        cameras[:, :3], jnp.clip(step[:, :3], -MOST_TURN, MOST_TURN)
    )
    rest = cameras[:, 3:] + step[:, 3:].at[:, 3:5].set(jnp.clip(step[:, 6:8], -MOST_FOCAL, MOST_FOCAL))
    return jnp.concatenate([turned, rest], axis=1)


def change_by_adjusted(rig: CameraRig) -> Float[np.ndarray, "C p p"]:
    """Derivatives of the parameters of `Camera.perturbed` by the adjusted ones: fx and fy by their logarithms."""
    fx, fy = np.asarray(rig.cameras.focal).T
    turn = np.tile(np.eye(rig.camera_size), (len(rig), 1, 1))
    turn[:, FOCAL, FOCAL], turn[:, FOCAL, ASPECT] = fx, fx
    turn[:, ASPECT, FOCAL], turn[:, ASPECT, ASPECT] = fy, 0.0
    return turn
