"""Problems of Bundle Adjustment in the Large (Agarwal et al. 2010): their files, and their camera for the engine.

A camera looks along -z and has 9 numbers: rotation vector, translation, focal length (px), k1, k2; pixels count from
the middle of the image, y up. A point X lies at P = R X + t in the camera's frame, p = -P / P_z, and its pixel is
f (1 + k1 |p|^2 + k2 |p|^4) p.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from problem import BundleProblem

from jaxpoint.calibration.schur import AbstractModel
from jaxpoint.errors import FileFormatError
from jaxpoint.geometry import rotation

SIZE = 9


def read_bal(path: Path) -> BundleProblem:
    """A problem as its text file has it.

    Raises:
        FileFormatError: the file is missing, or its counts do not fit what follows them.
    """
    try:
        numbers = np.fromstring(path.read_text(), sep=" ")
    except OSError as error:
        raise FileFormatError(f"'{path}' cannot be read ({error.strerror}); name a BAL problem.") from error
    cameras, points, observations = (int(count) for count in numbers[:3])
    ends = np.cumsum([3, 4 * observations, SIZE * cameras, 3 * points])
    if len(numbers) != ends[-1]:
        raise FileFormatError(f"'{path}' has {len(numbers)} numbers where its counts ask for {ends[-1]}.")
    table, first, places = (numbers[i:j] for i, j in pairwise(ends))
    rows = table.reshape(-1, 4)
    rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
    camera_of, point_of = rows[:, 0].astype(np.int32), rows[:, 1].astype(np.int32)
    return BundleProblem(first.reshape(-1, SIZE), places.reshape(-1, 3), camera_of, point_of, rows[:, 2:])


class BalModel(AbstractModel):
    """BAL's camera; residual is the projected minus the observed pixel (px)."""

    @property
    def camera_size(self) -> int:
        """As the files have them."""
        return SIZE

    @property
    def residual_size(self) -> int:
        """A pixel."""
        return 2

    def state(self, cameras, constants):
        """Rotation matrices and the remaining numbers of the cameras; `constants` are the base rotations (C, 3, 3)."""
        turned = jax.vmap(rotation.exp)(cameras[:, :3])
        return (turned[:, :, :, None] * constants[:, None, :, :]).sum(axis=2), cameras[:, 3:]

    def residual(self, state, moved, point, pixel):
        """Projected minus observed, px."""
        turn, numbers = state
        local = [turn[i, 0] * point[0] + turn[i, 1] * point[1] + turn[i, 2] * point[2] for i in range(3)]
        x = local[0] + moved[1] * local[2] - moved[2] * local[1] + numbers[0] + moved[3]
        y = local[1] + moved[2] * local[0] - moved[0] * local[2] + numbers[1] + moved[4]
        z = local[2] + moved[0] * local[1] - moved[1] * local[0] + numbers[2] + moved[5]
        focal, k1, k2 = (numbers[3 + i] + moved[6 + i] for i in range(3))
        u, v = -x / z, -y / z
        r2 = u * u + v * v
        scale = focal * (1.0 + r2 * (k1 + r2 * k2))
        return jnp.stack([scale * u - pixel[0], scale * v - pixel[1]])

    def retract(self, cameras, constants, step):
        """A left rotation to first order, everything else added."""
        turned = cameras[:, :3] + jax.vmap(lambda old, by: rotation.left_jacobian_inverse(old) @ by)(
            cameras[:, :3], step[:, :3]
        )
        return jnp.concatenate([turned, cameras[:, 3:] + step[:, 3:]], axis=1)
