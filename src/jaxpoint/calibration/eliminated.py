"""What is eliminated from the normal equations: points of 3 coordinates, or poses of 6 of a target of known shape.

A pose moves in the target's own frame, R exp(w) and t + dt: where a target's points lie on one line through its
origin, a turn about it moves none of them, and its column of the Jacobian is exactly zero.
"""

from __future__ import annotations

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.geometry import rotation as so3

POSE = 12  # numbers of a pose: world_from_target as a rotation matrix, row by row, and a translation


class AbstractEliminated(eqx.Module):
    """B unknowns of one kind; each places K points that cameras see, N = K B of them, the unknowns last."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """d: components of a step."""

    @abc.abstractmethod
    def places(self, values: Float[Array, "n B"]) -> Float[Array, "3 N"]:
        """The points."""

    @abc.abstractmethod
    def by_step(self, values: Float[Array, "n B"], by_point: tuple[Array, ...]) -> tuple[Array, ...]:
        """Derivatives (C, N) of one residual by the d components of a step, from those by the point."""

    @abc.abstractmethod
    def moved(self, values: Float[Array, "n B"], step: Float[Array, "d B"]) -> Float[Array, "n B"]:
        """The unknowns after a step."""

    @abc.abstractmethod
    def spread(self, values: Float[Array, "*rest B"]) -> Float[Array, "*rest N"]:
        """What belongs to an unknown, at each of its points."""

    @abc.abstractmethod
    def summed(self, values: Float[Array, "*rest N"]) -> Float[Array, "*rest B"]:
        """Sums over the points of each unknown."""


class FreePoints(AbstractEliminated):
    """Single points: K = 1."""

    @property
    def size(self) -> int:
        """Three coordinates."""
        return 3

    def places(self, values):
        """Themselves."""
        return values

    def by_step(self, values, by_point):
        """As they are."""
        return by_point

    def moved(self, values, step):
        """The sum."""
        return values + step

    def spread(self, values):
        """As it is."""
        return values

    def summed(self, values):
        """As they are."""
        return values


class TargetPoses(AbstractEliminated):
    """Poses of one target."""

    shape: Float[Array, "K 3"]  # its points, in its own frame

    @property
    def size(self) -> int:
        """A rotation vector in the target's frame, and a translation in the world."""
        return 6

    def places(self, values):
        """R s + t."""
        turned = (self._rotation(values)[:, :, None] * self.shape.T[None, :, :, None]).sum(axis=1)
        return (turned + values[9:, None]).reshape(3, -1)

    def by_step(self, values, by_point):
        """By w: (s x R^T g) where g is the derivative by the point; by dt: g."""
        rotation, (x, y, z) = self._rotation(values), self.shape.T[:, None, :, None]
        slope = [part.reshape(len(part), len(self.shape), -1) for part in by_point]  # (C, K, B) each
        a, b, c = (sum(rotation[i, j][None, None] * slope[i] for i in range(3)) for j in range(3))
        turns = y * c - z * b, z * a - x * c, x * b - y * a
        return (*(part.reshape(len(part), -1) for part in turns), *by_point)

    def moved(self, values, step):
        """R exp(w), t + dt."""
        turn = jax.vmap(so3.exp)(step[:3].T)
        rotation = jnp.einsum("ijb,bjk->ikb", self._rotation(values), turn)
        return jnp.concatenate([rotation.reshape(9, -1), values[9:] + step[3:]])

    def spread(self, values):
        """K times, one after another."""
        return jnp.tile(values, len(self.shape))

    def summed(self, values):
        """Over K."""
        return values.reshape(*values.shape[:-1], len(self.shape), -1).sum(axis=-2)

    @staticmethod
    def _rotation(values: Float[Array, "12 B"]) -> Float[Array, "3 3 B"]:
        return values[:9].reshape(3, 3, -1)


def pose_values(rotation: Float[np.ndarray, "M 3 3"], translation: Float[np.ndarray, "M 3"]) -> np.ndarray:
    """Poses (M, 12) as `TargetPoses` takes them."""
    return np.concatenate([rotation.reshape(-1, 9), translation], axis=1)
