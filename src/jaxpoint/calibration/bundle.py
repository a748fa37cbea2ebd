"""Bundle adjustment of a Euclidean rig: what is unknown, one residual, and the solve.

The parameters of a camera are those of `camera.parameters`. Which of them move is a mask, so that every choice of a
lens's coefficients is one compiled program.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxpoint.calibration.schur import AbstractModel, Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.parameters import lens_parameters, retract, rotations_of, size_of
from jaxpoint.compilation import jit

BLOCK = 128  # points in a block: its Jacobians stay in cache
LEAST_SQUARES = 1e8  # a Cauchy scale (px) at which the loss is a plain square


class CameraModel(AbstractModel):
    """Cameras with one kind of lens; residual is the projected minus the observed pixel (px)."""

    lens: type[AbstractLens] = eqx.field(static=True, default=Brown)
    held: tuple[int, ...] = eqx.field(static=True, default=())  # parameters that never move, left out of every product

    @property
    def camera_size(self) -> int:
        """p of the lens."""
        return size_of(self.lens)

    @property
    def residual_size(self) -> int:
        """A pixel."""
        return 2

    @property
    def moving(self) -> tuple[int, ...]:
        """All that are not held."""
        return tuple(i for i in range(self.camera_size) if i not in self.held)

    def state(self, cameras, constants):
        """Rotation matrices and the remaining parameters; `constants` are the base rotations (C, 3, 3)."""
        return rotations_of(cameras, constants), cameras[:, 3:]

    def residual(self, state, moved, point, pixel):
        """Projected minus observed, px."""
        turn, rest = state
        local = [turn[i, 0] * point[0] + turn[i, 1] * point[1] + turn[i, 2] * point[2] for i in range(3)]
        direction = (
            local[0] + moved[1] * local[2] - moved[2] * local[1] + rest[0] + moved[3],
            local[1] + moved[2] * local[0] - moved[0] * local[2] + rest[1] + moved[4],
            local[2] + moved[0] * local[1] - moved[1] * local[0] + rest[2] + moved[5],
        )
        lens = lens_parameters([rest[3 + i] + moved[6 + i] for i in range(self.camera_size - 6)])
        seen = self.lens.slopes_of(lens, direction, wild=True).pixel
        return jnp.stack([seen[0] - pixel[0], seen[1] - pixel[1]])

    def columns(self, state, point, pixel, xp: Any = jnp):
        """The derivatives of `residual`, written out. With `xp = np` numpy computes the same."""
        turn, rest = state
        arm = [turn[i, 0] * point[0] + turn[i, 1] * point[1] + turn[i, 2] * point[2] for i in range(3)]
        lens = lens_parameters([rest[3 + i] for i in range(self.camera_size - 6)], xp)
        found = self.lens.slopes_of(lens, (arm[0] + rest[0], arm[1] + rest[1], arm[2] + rest[2]), xp, wild=True)
        off_x, off_y = found.pixel[0] - lens[2], found.pixel[1] - lens[3]
        zero, one = xp.zeros_like(off_x), xp.ones_like(off_x)
        by_lens = (off_x, off_x, one, zero), (off_y, zero, zero, one)  # log focal, log aspect, principal point
        for_camera, for_point = [], []
        for (a, b, c), common, bent in zip(found.by_direction, by_lens, found.by_coefficients):
            turning = (c * arm[1] - b * arm[2], a * arm[2] - c * arm[0], b * arm[0] - a * arm[1])
            for_camera.append((*turning, a, b, c, *common, *bent))
            for_point.append(tuple(a * turn[0, j] + b * turn[1, j] + c * turn[2, j] for j in range(3)))
        residual = (found.pixel[0] - pixel[0], found.pixel[1] - pixel[1])
        return residual, tuple(for_camera), tuple(for_point)

    def retract(self, cameras, constants, step):
        """See `camera.parameters.retract`."""
        return retract(cameras, step)


class Adjusted(eqx.Module):
    """Where an adjustment ended."""

    cameras: Float[Array, "C p"]
    points: Float[Array, "NB 3 B"]
    poses: tuple[Float[Array, "_ 12 _"], ...]  # of each target
    cost: Float[Array, ""]
    steps: Array
    settled: Array  # False where the step limit came first


def run_solver(solver: SchurLevenbergMarquardt, start: Unknowns, problem: Problem) -> Adjusted:
    """Run the structured Levenberg-Marquardt through optimistix. One program for every number of steps and loss."""
    options = {"own_residuals": True}
    solution = optx.least_squares(
        solver.model.residuals, solver, start, args=problem, options=options, max_steps=500, throw=False
    )
    value, stats = solution.value, solution.stats
    return Adjusted(value.cameras, value.points, value.poses, stats["cost"], stats["num_steps"], stats["settled"])


solve = jit(run_solver)


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
