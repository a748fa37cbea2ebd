"""What one residual of a projective camera is: for the factorisation that works from anywhere, and its adjustment.

Image coordinates are pixels from the image centre over half the image diagonal. The lens is the division model: a
distorted point d belongs to the undistorted d / (1 + lambda |d|^2).
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxpoint.calibration.schur import AbstractModel


def _project(numbers, point):
    """The three homogeneous coordinates of P (x, y, z, 1); `numbers` are the rows of P."""
    return [
        numbers[4 * i] * point[0] + numbers[4 * i + 1] * point[1] + numbers[4 * i + 2] * point[2] + numbers[4 * i + 3]
        for i in range(3)
    ]


class ProjectiveModel(AbstractModel):
    """A projective camera: the 12 entries of P and the division-model lambda of its lens.

    One residual for both stages, so that one program is compiled. `constants` are half the image diagonals (px) and
    a flag a camera:

    - flag 1: pseudo object-space error (pOSE; Hong & Zach 2018) of undistorted pixels m. With X = P (x, 1) the
      residuals are sqrt(1 - eta) (X12 - X3 m) and sqrt(eta) (X12 - m): bilinear, so that factorisation converges from
      anywhere; the second part keeps depths near one and away from trivial solutions. Units of the normalised image.
    - flag 0: projected minus observed pixel of the distorted image (px), then two zeros.
    """

    @property
    def camera_size(self) -> int:
        """P row by row, then lambda."""
        return 13

    @property
    def residual_size(self) -> int:
        """See the class."""
        return 4

    eta: float = 0.05

    def state(self, cameras, constants):
        """Projection matrices with lambda; size of the image and flag."""
        return cameras, *constants

    def residual(self, state, moved, point, pixel):
        """Four residuals, see the class."""
        numbers, half_diagonal, object_space = state
        numbers = numbers + moved
        a, b, c = _project(numbers, point)
        near, far = (1.0 - self.eta) ** 0.5, self.eta**0.5
        x, y = near * (a - c * pixel[0]), near * (b - c * pixel[1])
        third = jnp.where(jnp.abs(c) < 1e-9, 1e-9, c)
        u, v = a / third, b / third
        # Inverse of the division model in closed form; what lies beyond its reach is held at the rim.
        inner = jnp.maximum(1.0 - 4.0 * numbers[12] * (u * u + v * v), 1e-4)
        shrink = 2.0 / (1.0 + jnp.sqrt(inner))
        bilinear = object_space > 0
        return jnp.stack(
            [
                jnp.where(bilinear, x, half_diagonal * (u * shrink - pixel[0])),
                jnp.where(bilinear, y, half_diagonal * (v * shrink - pixel[1])),
                jnp.where(bilinear, far * (a - pixel[0]), 0.0),
                jnp.where(bilinear, far * (b - pixel[1]), 0.0),
            ]
        )

    def columns(self, state, point, pixel):
        """The derivatives of `residual`, written out; see `Brown.slopes_of` for the divisions."""
        numbers, half_diagonal, object_space = state
        a, b, c = _project(numbers, point)
        near, far = (1.0 - self.eta) ** 0.5, self.eta**0.5
        third = jnp.where(jnp.abs(c) < 1e-9, 1e-9, c)
        u, v = a / third, b / third
        square = u * u + v * v
        inner = 1.0 - 4.0 * numbers[12] * square
        root = jnp.sqrt(jnp.maximum(inner, 1e-4))
        shrink = 2.0 / (1.0 + root)
        slope = jnp.where(inner > 1e-4, shrink * shrink, 0.0) / root
        by_square, by_lens = slope * numbers[12], slope * square
        bilinear, zero = object_space > 0, jnp.zeros_like(u)
        scale = half_diagonal / third
        cross = scale * 2.0 * u * v * by_square
        along_u = scale * (shrink + 2.0 * u * u * by_square)
        along_v = scale * (shrink + 2.0 * v * v * by_square)
        # Residuals, and their derivatives by a, b, c and the lens: of the factorisation, and of the adjustment.
        factorisation = (
            (near * (a - c * pixel[0]), near, zero, -near * pixel[0], zero),
            (near * (b - c * pixel[1]), zero, near, -near * pixel[1], zero),
            (far * (a - pixel[0]), far, zero, zero, zero),
            (far * (b - pixel[1]), zero, far, zero, zero),
        )
        adjustment = (
            (half_diagonal * (u * shrink - pixel[0]), along_u, cross, -(along_u * u + cross * v), u * by_lens),
            (half_diagonal * (v * shrink - pixel[1]), cross, along_v, -(cross * u + along_v * v), v * by_lens),
            (zero,) * 5,
            (zero,) * 5,
        )
        residual, for_camera, for_point = [], [], []
        for linear, bent in zip(factorisation, adjustment):
            value, *by_row, lens = (jnp.where(bilinear, first, second) for first, second in zip(linear, bent))
            residual.append(value)
            homogeneous = (point[0], point[1], point[2], 1.0)
            for_camera.append((*(by * x for by in by_row for x in homogeneous), half_diagonal * lens))
            for_point.append(tuple(sum(by * numbers[4 * i + j] for i, by in enumerate(by_row)) for j in range(3)))
        return tuple(residual), tuple(for_camera), tuple(for_point)

    def retract(self, cameras, constants, step):
        """Plain addition; lambda moves at most 0.1 a step."""
        return cameras + step.at[:, 12].set(jnp.clip(step[:, 12], -0.1, 0.1))
