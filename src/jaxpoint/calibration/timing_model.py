"""Cameras out of step and with rolling shutters: a camera and two parameters more, its offset and readout (frames).

The light is where the camera saw it `offset` frames later than the common clock says, and a row that lies the share
`down` of the image's height below the middle was read `readout` * down frames after the middle one (the line delay of
Oth, Furgale, Kneip and Siegwart, "Rolling shutter camera calibration", CVPR 2013, times the number of rows). The
observation moves there along its own image velocity and acceleration: seven numbers an observation.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxpoint.calibration.bundle import CameraModel
from jaxpoint.calibration.schur import AbstractModel

OFFSET, READOUT = -2, -1  # the last parameters of a camera
TIMES = 2  # of them
OBSERVED = 7  # numbers of an observation: pixel, velocity, acceleration, down
MOST_FRAMES = 0.5  # in a step


class TimingModel(AbstractModel):
    """Residual: the projected pixel minus the observed one moved to the common clock (px)."""

    base: CameraModel = CameraModel()

    @property
    def camera_size(self) -> int:
        """The camera's own, the offset and the readout."""
        return self.base.camera_size + TIMES

    @property
    def residual_size(self) -> int:
        """A pixel."""
        return 2

    def state(self, cameras, constants):
        """The state of the synchronised model, and the offsets and readouts."""
        return self.base.state(cameras[:, :-TIMES], constants), cameras[:, -TIMES:]

    def residual(self, state, moved, point, pixel):
        """Projected minus moved, px."""
        camera, times = state
        return self.base.residual(
            camera, moved[:-TIMES], point, _move_pixel(pixel, _late(pixel, times + moved[-TIMES:]))
        )

    def columns(self, state, point, pixel):
        """Those of the synchronised model; an offset takes the velocity from the residual, a readout adds a share."""
        camera, times = state
        late = _late(pixel, times)
        residual, for_camera, for_point = self.base.columns(camera, point, _move_pixel(pixel, late))
        velocity = pixel[2:4] + late * pixel[4:6]
        for_camera = tuple((*row, -velocity[i], pixel[6] * velocity[i]) for i, row in enumerate(for_camera))
        return residual, for_camera, for_point

    def retract(self, cameras, constants, step):
        """As the synchronised model; offsets and readouts change by half a frame at most."""
        rest = self.base.retract(cameras[:, :-TIMES], constants, step[:, :-TIMES])
        times = cameras[:, -TIMES:] + jnp.clip(step[:, -TIMES:], -MOST_FRAMES, MOST_FRAMES)
        return jnp.concatenate([rest, times], axis=1)


def _late(pixel, times):
    """Frames by which the sighting is late: rows that are read later show the light earlier than they would."""
    return times[0] - times[1] * pixel[6]


def _move_pixel(pixel, frames):
    return pixel[:2] + frames * pixel[2:4] + 0.5 * frames**2 * pixel[4:6]
