"""One camera: how a point of the room becomes a pixel, and the ray back."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.lens import AbstractLens
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint, stack_last
from jaxpoint.geometry.line import Ray
from jaxpoint.geometry.pose import Pose

POSE_NAMES = ("rotation_x", "rotation_y", "rotation_z", "translation_x", "translation_y", "translation_z")


class Camera(eqx.Module):
    """One camera of the room: x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.

    Its functions take one point or pixel, or any leading axes of them.
    """

    lens: AbstractLens
    cam_from_world: Pose

    __hash__ = hash_or_hint

    @property
    def focal(self) -> Float[Array, "*batch 2"]:
        """Focal lengths in x and y, px."""
        return self.lens.focal

    @property
    def center(self) -> Float[Array, "*batch 2"]:
        """The principal point, px."""
        return self.lens.center

    @property
    def distortion(self) -> Float[Array, "*batch k"]:
        """The lens's coefficients beyond focal lengths and principal point."""
        return self.lens.distortion

    @property
    def size(self) -> int:
        """How many parameters the camera has: p of the pose and the lens, see `perturbed`."""
        return len(POSE_NAMES) + self.lens.parameters.shape[-1]

    @property
    def intrinsics(self) -> Float[Array, "3 3"]:
        """The matrix K, px."""
        zero, one = jnp.zeros_like(self.focal[0]), jnp.ones_like(self.focal[0])
        return jnp.stack(
            [self.focal[0], zero, self.center[0], zero, self.focal[1], self.center[1], zero, zero, one]
        ).reshape(3, 3)

    @property
    def matrix(self) -> Float[Array, "3 4"]:
        """P = K [R | t], which maps homogeneous world points to pixels of the ideal (undistorted) image."""
        pose = self.cam_from_world
        camera = jnp.concatenate([pose.rotation, pose.translation[:, None]], axis=1)
        last = camera[2]
        return jnp.stack(
            [self.focal[0] * camera[0] + self.center[0] * last, self.focal[1] * camera[1] + self.center[1] * last, last]
        )

    @property
    def position(self) -> Float[Array, "3"]:
        """The centre of the lens in the world, m."""
        return self.cam_from_world.inverse().translation

    def project(self, point_world: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Pixel of a world point (m). Finite everywhere, but only meaningful where the camera `sees` it."""
        return self.lens.project(self.cam_from_world @ point_world)

    def sees(self, point_world: Float[AnyArray, "*batch 3"]) -> Bool[Array, "*batch"]:
        """Whether a world point lies where the lens is one-to-one; walls and the image's edge are unknown here."""
        return self.lens.reaches(self.cam_from_world @ point_world)

    def depth(self, point_world: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
        """Distance of a world point in front of the camera along its optical axis, m; negative behind."""
        return (self.cam_from_world @ point_world)[..., 2]

    def undistort(self, pixel: Float[AnyArray, "*batch 2"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Where a perfect lens with the same K would see this pixel's ray, px, and whether there is such a place."""
        pixel = as_float(pixel)
        (x, y, z), valid = self.lens.direction_of(self.lens.parameters, pixel[..., 0], pixel[..., 1])
        ahead = z > 1e-6
        z = jnp.where(ahead, z, 1.0)
        ideal = stack_last(*(self.focal[i] * part / z + self.center[i] for i, part in enumerate((x, y))))
        return ideal, jnp.broadcast_to(valid & ahead, ideal.shape[:-1])

    def ray(self, pixel: Float[AnyArray, "*batch 2"]) -> Ray:
        """The ray of the world that a pixel sees. Meaningless where the lens has none (`lens.unproject`)."""
        direction = so3.rotate(self.cam_from_world.rotation.T, self.lens.unproject(pixel)[0])
        return Ray(jnp.broadcast_to(self.position, direction.shape), direction)

    def perturbed(self, change: Float[AnyArray, " p"]) -> Camera:
        """This camera with its parameters changed a little; covariances of cameras are in this order.

        A rotation vector w (rad) that acts from the left, R -> exp(w) R; then added: translation (3, m), fx, fy, cx,
        cy (px), and the lens's coefficients: `parameter_names`.

        Raises:
            ValueError: the change has another number of entries.
        """
        change, pose = as_float(change), self.cam_from_world
        if change.shape != (self.size,):
            raise ValueError(f"This camera has {self.size} parameters; the change has the shape {change.shape}.")
        return Camera(
            type(self.lens)(self.lens.parameters + change[len(POSE_NAMES) :]),  # pyright: ignore[reportCallIssue]
            Pose(so3.rotate(so3.exp(change[:3]), pose.rotation.T).T, pose.translation + change[3:6]),
        )

    def parameter_names(self) -> tuple[str, ...]:
        """Of all parameters in the order of `perturbed`."""
        return (*POSE_NAMES, *self.lens.parameter_names())
