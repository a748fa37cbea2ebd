"""The pixels of an arm that was found by its outlines: slices across the forearm, and the tip."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.body.arm import AbstractArmPixels
from jaxpoint.body.limb_axis import LimbAxis
from jaxpoint.body.predicted_axis import axis_at_optimum
from jaxpoint.body.strips import Strip
from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.limb_slices import SLICES
from jaxpoint.geometry.arrays import AnyArray
from jaxpoint.triangulation import triangulate


class StripPixels(AbstractArmPixels):
    """Slices across the forearm in each view, and the axis that was fitted to them."""

    slices: Float[AnyArray, "C S 2"]  # px, their middles
    width: Float[AnyArray, "C S"]  # px, 0 where a slice is not used
    tip: Float[AnyArray, "C 2"]  # px
    tip_seen: Bool[AnyArray, " C"]
    start: Float[AnyArray, "3"]  # m, on the axis beside the tip
    direction: Float[AnyArray, "3"]  # unit, of the axis
    span: Float[AnyArray, "2"]  # m, in which slices count

    @property
    def held(self) -> Bool[AnyArray, "C S"]:
        """Which slices are used."""
        return self.width > 0

    def strip(self, camera: int) -> Strip:
        """The forearm in one view."""
        return Strip(np.asarray(self.slices[camera]), np.asarray(self.width[camera]))

    def places(
        self, rig: CameraRig, others: Float[AnyArray, "N C 2"], others_seen: Bool[AnyArray, "N C"]
    ) -> tuple[Float[Array, "3 3"], Float[Array, "N 3"]]:
        """Both ends of the axis and the tip, and the other points, m."""
        axis = axis_at_optimum(rig, self.slices, self.held, self.start, self.direction, self.span)
        pixels = jnp.concatenate([jnp.asarray(others), jnp.asarray(self.tip)[None]])
        seen = jnp.concatenate([jnp.asarray(others_seen), jnp.asarray(self.tip_seen)[None]])
        points = triangulate(rig, pixels, seen, covariance=False).points
        return jnp.stack([axis.far, axis.near, points[-1]]), points[:-1]


def stack_strips(strips: Sequence[Strip | None]) -> tuple[Float[np.ndarray, "C S 2"], Float[np.ndarray, "C S"]]:
    """Middles and widths of all views' slices, px; a width is 0 where a slice is missing."""
    pixels, width = np.zeros((len(strips), SLICES, 2)), np.zeros((len(strips), SLICES))
    for camera, strip in enumerate(strips):
        if strip is not None:
            pixels[camera], width[camera] = strip.middle, strip.width
    return pixels, width


def strip_pixels(
    strips: Sequence[Strip | None], tips: Float[np.ndarray, "C 2"], axis: LimbAxis, span: Float[np.ndarray, "2"]
) -> StripPixels:
    """What is kept of a fitted axis.

    Args:
        strips: of the C views that the axis was fitted to; None for the others.
        tips: of the hand in these views, px.
        axis: of the forearm.
        span: behind the tip, m, in which slices count.
    """
    slices, width = stack_strips(strips)
    used = np.array([strip is not None for strip in strips])
    direction = np.asarray(axis.direction)
    start = np.asarray(axis.near) + span[0] * direction
    return StripPixels(slices, width, np.where(used[:, None], tips, 0.0), used, start, direction, span)
