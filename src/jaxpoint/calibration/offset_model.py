"""Cameras that are out of step: a camera and one parameter more, its time offset (frames).

The light is where the camera saw it `offset` frames later than the common clock says; the observation moves there
along its own image velocity and acceleration, which stand beside the pixel: six numbers an observation.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxpoint.calibration.bundle import CameraModel
from jaxpoint.calibration.schur import AbstractModel

MOST_FRAMES = 0.5  # in a step


class OffsetModel(AbstractModel):
    """Residual: the projected pixel minus the observed one moved to the common clock (px)."""

    base: CameraModel = CameraModel()

    @property
    def camera_size(self) -> int:
        """The camera's own, and the offset, which is the last."""
        return self.base.camera_size + 1

    @property
    def residual_size(self) -> int:
        """A pixel."""
        return 2

    def state(self, cameras, constants):
        """The state of the synchronised model, and the offsets."""
        return self.base.state(cameras[:, :-1], constants), cameras[:, -1]

    def residual(self, state, moved, point, pixel):
        """Projected minus moved, px."""
        camera, offset = state
        return self.base.residual(camera, moved[:-1], point, _move_pixel(pixel, offset + moved[-1]))

    def columns(self, state, point, pixel):
        """Those of the synchronised model; an offset takes the velocity from the residual."""
        camera, offset = state
        residual, for_camera, for_point = self.base.columns(camera, point, _move_pixel(pixel, offset))
        velocity = pixel[2:4] + offset * pixel[4:6]
        for_camera = tuple((*row, -velocity[i]) for i, row in enumerate(for_camera))
        return residual, for_camera, for_point

    def retract(self, cameras, constants, step):
        """As the synchronised model; offsets change by half a frame at most."""
        rest = self.base.retract(cameras[:, :-1], constants, step[:, :-1])
        offset = cameras[:, -1:] + jnp.clip(step[:, -1:], -MOST_FRAMES, MOST_FRAMES)
        return jnp.concatenate([rest, offset], axis=1)


def _move_pixel(pixel, frames):
    return pixel[:2] + frames * pixel[2:4] + 0.5 * frames**2 * pixel[4:6]
