"""Projective cameras: the pseudo object-space error that factorises from anywhere, and the projective adjustment.

Image coordinates are pixels from the image centre over half the image diagonal. The lens is the division model: a
distorted point d belongs to the undistorted d / (1 + lambda |d|^2).
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

from jaxpoint.calibration.schur import AbstractModel


def _project(numbers, point):
    """The three homogeneous coordinates of P (x, y, z, 1); `numbers` are the rows of P."""
    return [
        numbers[4 * i] * point[0] + numbers[4 * i + 1] * point[1] + numbers[4 * i + 2] * point[2] + numbers[4 * i + 3]
        for i in range(3)
    ]


class PoseModel(AbstractModel):
    """Pseudo object-space error (pOSE; Hong & Zach 2018): bilinear, with a wide basin of convergence.

    Of undistorted pixel m and X = P (x, 1): sqrt(1 - eta) (X12 - X3 m) and sqrt(eta) (X12 - m). The second part
    keeps depths near one and so the factorisation away from its trivial solutions.
    """

    camera_size: ClassVar[int] = 12
    residual_size: ClassVar[int] = 4
    eta: float = 0.05

    def state(self, cameras, constants):
        """The projection matrices, row by row."""
        return cameras

    def residual(self, state, moved, point, pixel):
        """Two object-space and two affine residuals, units of the normalised image."""
        a, b, c = _project(state + moved, point)
        near, far = (1.0 - self.eta) ** 0.5, self.eta**0.5
        return jnp.stack(
            [near * (a - c * pixel[0]), near * (b - c * pixel[1]), far * (a - pixel[0]), far * (b - pixel[1])]
        )

    def retract(self, cameras, constants, step):
        """Plain addition."""
        return cameras + step


class ProjectiveModel(AbstractModel):
    """Projective camera with a division-model lens; residual in pixels of the distorted image.

    A camera is the 12 entries of P and lambda; `constants` are half the image diagonals (px).
    """

    camera_size: ClassVar[int] = 13
    residual_size: ClassVar[int] = 2

    def state(self, cameras, constants):
        """Projection matrices with lambda, and the size of the image."""
        return cameras, constants

    def residual(self, state, moved, point, pixel):
        """Projected minus observed, px."""
        numbers, half_diagonal = state
        numbers = numbers + moved
        a, b, c = _project(numbers, point)
        c = jnp.where(jnp.abs(c) < 1e-9, 1e-9, c)
        u, v = a / c, b / c
        # Inverse of the division model in closed form; what lies beyond its reach is held at the rim.
        inner = jnp.maximum(1.0 - 4.0 * numbers[12] * (u * u + v * v), 1e-4)
        shrink = 2.0 / (1.0 + jnp.sqrt(inner))
        return half_diagonal * jnp.stack([u * shrink - pixel[0], v * shrink - pixel[1]])

    def retract(self, cameras, constants, step):
        """Plain addition; lambda moves at most 0.1 a step."""
        return cameras + step.at[:, 12].set(jnp.clip(step[:, 12], -0.1, 0.1))
