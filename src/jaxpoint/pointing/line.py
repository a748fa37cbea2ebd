"""Lines of pointing: a ray in the room that says where somebody points, and how far to trust it (SPEC 6)."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import as_float
from jaxpoint.geometry.line import Ray


class PointingLine(eqx.Module):
    """A ray from the fingertip (or hand) on, with the covariance of both its numbers.

    Fields may carry leading axes of equal shape.
    """

    ray: Ray  # origin in m, direction of unit length
    covariance: Float[Array, "*batch 6 6"] = eqx.field(converter=as_float)  # of origin (m) and direction, in that order

    @property
    def direction_covariance(self) -> Float[Array, "*batch 3 3"]:
        """Of the direction; its null vector is the direction itself."""
        return self.covariance[..., 3:, 3:]

    @property
    def origin_covariance(self) -> Float[Array, "*batch 3 3"]:
        """Of the origin, m^2."""
        return self.covariance[..., :3, :3]
