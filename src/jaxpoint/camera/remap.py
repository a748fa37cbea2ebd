"""Undistorted images: for each pixel of the ideal image, where to look in the real one."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.camera.camera import Camera
from jaxpoint.geometry.arrays import AnyArray, as_float, stack_last


def undistortion_map(
    camera: Camera,
    image_size: tuple[int, int],
    new_intrinsics: Float[AnyArray, "3 3"] | None = None,
    new_from_cam: Float[AnyArray, "3 3"] | None = None,
) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
    """The maps (map_x, map_y) that `cv2.remap` takes, px of the real image, in float32 as it wants them.

    Args:
        camera: whose distortion is taken out; its pose does not matter.
        image_size: width and height of the undistorted image, px.
        new_intrinsics: K of the undistorted image, upper triangular; the camera's own if left out.
        new_from_cam: rotation of the undistorted camera against the real one, as for stereo; none if left out.

    Raises:
        ValueError: the image size is not positive.
    """
    width, height = image_size
    if width <= 0 or height <= 0:
        raise ValueError(f"An undistorted image needs a positive width and height, not {width} x {height}.")
    matrix = camera.intrinsics if new_intrinsics is None else as_float(new_intrinsics)
    turn = jnp.eye(3, dtype=matrix.dtype) if new_from_cam is None else as_float(new_from_cam)
    return _map(camera, matrix, turn, width, height)


@eqx.filter_jit
def _map(
    camera: Camera, matrix: Float[Array, "3 3"], turn: Float[Array, "3 3"], width: int, height: int
) -> tuple[Array, Array]:
    column, row = jnp.meshgrid(jnp.arange(width, dtype=matrix.dtype), jnp.arange(height, dtype=matrix.dtype))
    y = (row - matrix[1, 2]) / matrix[1, 1]
    x = (column - matrix[0, 2] - matrix[0, 1] * y) / matrix[0, 0]
    direction = stack_last(*(turn[0, i] * x + turn[1, i] * y + turn[2, i] for i in range(3)))
    seen = camera.lens.project(direction)
    return seen[..., 0].astype(jnp.float32), seen[..., 1].astype(jnp.float32)
