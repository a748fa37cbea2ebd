"""Bundle adjustment of a Euclidean rig: what is unknown, one residual, and the solve.

A camera has 15 numbers: rotation vector and translation of `cam_from_world` (the rotation relative to a base that is
held in the constants), log focal, log aspect (fx / fy), principal point (px), k1, k2, p1, p2, k3. Which of them move
is a mask, so that every lens model is one compiled program.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxpoint.calibration.schur import AbstractModel, Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.compilation import jit
from jaxpoint.geometry import rotation

POSE, FOCAL, ASPECT, CENTER, RADIAL, TANGENTIAL, K3 = slice(0, 6), 6, 7, slice(8, 10), slice(10, 12), slice(12, 14), 14
SIZE = 15
MAX_RADIUS2 = 9.0  # on the z = 1 plane; beyond it the polynomial means nothing and only overflows
BLOCK = 128  # points in a block: its Jacobians stay in cache
LEAST_SQUARES = 1e8  # a Cauchy scale (px) at which the loss is a plain square


class BrownModel(AbstractModel):
    """Pinhole camera with Brown distortion; residual is the projected minus the observed pixel (px)."""

    camera_size: ClassVar[int] = SIZE
    residual_size: ClassVar[int] = 2
    held: tuple[int, ...] = eqx.field(static=True, default=())  # parameters that never move, left out of every product

    @property
    def moving(self) -> tuple[int, ...]:
        """All that are not held."""
        return tuple(i for i in range(SIZE) if i not in self.held)

    def state(self, cameras, constants):
        """Rotation matrices and the remaining numbers of the cameras; `constants` are the base rotations (C, 3, 3)."""
        turned = jax.vmap(rotation.exp)(cameras[:, :3])
        # Sums written out: a batched product of 3 x 3 matrices is slow on a CPU.
        return (turned[:, :, :, None] * constants[:, None, :, :]).sum(axis=2), cameras[:, 3:]

    def residual(self, state, moved, point, pixel):
        """Projected minus observed, px."""
        turn, numbers = state
        local = [turn[i, 0] * point[0] + turn[i, 1] * point[1] + turn[i, 2] * point[2] for i in range(3)]
        x = local[0] + moved[1] * local[2] - moved[2] * local[1] + numbers[0] + moved[3]
        y = local[1] + moved[2] * local[0] - moved[0] * local[2] + numbers[1] + moved[4]
        z = local[2] + moved[0] * local[1] - moved[1] * local[0] + numbers[2] + moved[5]
        z = jnp.where(jnp.abs(z) < 1e-9, 1e-9, z)
        log_focal, log_aspect, cx, cy, k1, k2, p1, p2, k3 = (numbers[3 + i] + moved[6 + i] for i in range(9))
        u, v = x / z, y / z
        r2 = u * u + v * v
        r2 = jnp.minimum(r2, MAX_RADIUS2)
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent_u = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u)
        bent_v = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v
        focal = jnp.exp(log_focal)
        return jnp.stack([focal * jnp.exp(log_aspect) * bent_u + cx - pixel[0], focal * bent_v + cy - pixel[1]])

    def columns(self, state, point, pixel, xp: Any = jnp):
        """The derivatives of `residual`, written out.

        What many entries share ends in a division: a compiler that recomputes cheap operations for every entry, as
        XLA does on a CPU, keeps the result of a division. That halves the time. With `xp = np` numpy computes the same.
        """
        turn, numbers = state
        arm = [turn[i, 0] * point[0] + turn[i, 1] * point[1] + turn[i, 2] * point[2] for i in range(3)]
        z = arm[2] + numbers[2]
        z = xp.where(xp.abs(z) < 1e-9, 1e-9, z)
        u, v = (arm[0] + numbers[0]) / z, (arm[1] + numbers[1]) / z
        focal_y = xp.exp(numbers[3])
        focal_x = focal_y * xp.exp(numbers[4])
        k1, k2, p1, p2, k3 = (numbers[7 + i] for i in range(5))
        full = u * u + v * v
        grows = xp.where(full < MAX_RADIUS2, 2.0, 0.0)  # d r2 / d u = grows u
        r2 = xp.minimum(full, MAX_RADIUS2)
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = grows * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        twice, wide_u, wide_v = 2.0 * u * v, r2 + 2.0 * u * u, r2 + 2.0 * v * v
        bent_u = focal_x * (u * radial + p1 * twice + p2 * wide_u)
        bent_v = focal_y * (v * radial + p1 * wide_v + p2 * twice)
        by_u = (
            focal_x * (radial + u * u * slope + 2.0 * p1 * v + p2 * u * (4.0 + grows)) / z,
            focal_y * (u * v * slope + p1 * u * grows + 2.0 * p2 * v) / z,
        )
        by_v = (
            focal_x * (u * v * slope + 2.0 * p1 * u + p2 * v * grows) / z,
            focal_y * (radial + v * v * slope + p1 * v * (4.0 + grows) + 2.0 * p2 * u) / z,
        )
        zero, one = xp.zeros_like(u), xp.ones_like(u)
        x2, y2 = focal_x * u * r2, focal_y * v * r2
        lens = (
            (bent_u, bent_u, one, zero, x2, x2 * r2, focal_x * twice, focal_x * wide_u, x2 * r2 * r2),
            (bent_v, zero, zero, one, y2, y2 * r2, focal_y * wide_v, focal_y * twice, y2 * r2 * r2),
        )
        for_camera, for_point = [], []
        for a, b, rest in zip(by_u, by_v, lens):
            c = -(a * u + b * v)
            turning = (c * arm[1] - b * arm[2], a * arm[2] - c * arm[0], b * arm[0] - a * arm[1])
            for_camera.append((*turning, a, b, c, *rest))
            for_point.append(tuple(a * turn[0, j] + b * turn[1, j] + c * turn[2, j] for j in range(3)))
        residual = (bent_u + numbers[5] - pixel[0], bent_v + numbers[6] - pixel[1])
        return residual, tuple(for_camera), tuple(for_point)

    def retract(self, cameras, constants, step):
        """A left rotation to first order, everything else added; focal lengths at most double or halve in a step."""
        turned = cameras[:, :3] + jax.vmap(lambda old, by: rotation.left_jacobian_inverse(old) @ by)(
            cameras[:, :3], jnp.clip(step[:, :3], -1.0, 1.0)
        )
        rest = cameras[:, 3:] + step[:, 3:].at[:, 3:5].set(jnp.clip(step[:, 6:8], -0.7, 0.7))
        return jnp.concatenate([turned, rest], axis=1)


class Adjusted(eqx.Module):
    """Where an adjustment ended."""

    cameras: Float[Array, "C p"]
    points: Float[Array, "NB 3 B"]
    cost: Float[Array, ""]
    steps: Array
    settled: Array  # False where the step limit came first


def solved(solver: SchurLevenbergMarquardt, start: Unknowns, problem: Problem) -> Adjusted:
    """Run the structured Levenberg-Marquardt through optimistix. One program for every number of steps and loss."""
    options = {"own_residuals": True}
    solution = optx.least_squares(
        solver.model.residuals, solver, start, args=problem, options=options, max_steps=500, throw=False
    )
    value, stats = solution.value, solution.stats
    return Adjusted(value.cameras, value.points, stats["cost"], stats["num_steps"], stats["settled"])


solve = jit(solved)


def to_blocks(values: np.ndarray, block: int = BLOCK) -> np.ndarray:
    """(F, ...) to (NB, ..., B), F a multiple of the block."""
    frames = values.shape[0]
    split = values.reshape(frames // block, block, *values.shape[1:])
    return np.ascontiguousarray(np.moveaxis(split, 1, -1))


def from_blocks(values: Array | np.ndarray) -> np.ndarray:
    """(NB, ..., B) to (F, ...)."""
    values = np.moveaxis(np.asarray(values), -1, 1)
    return values.reshape(-1, *values.shape[2:])


def padded_frames(frames: int, block: int = BLOCK) -> int:
    """The few lengths that recordings are padded to: 512, 768, 1024, 1536, 2048, ..."""
    size = 512
    while size < frames:
        size = size * 3 // 2 if (size & (size - 1)) == 0 else size * 4 // 3
    return max(size, block)
