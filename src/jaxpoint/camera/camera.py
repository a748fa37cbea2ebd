"""One camera: how a point of the room becomes a pixel, and the ray back."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.camera.distortion import AbstractDistortion, Brown
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint, stack_last
from jaxpoint.geometry.line import Ray, normalised
from jaxpoint.geometry.pose import Pose

PARAMETERS = 15  # of a camera with a Brown lens, in the order of `Camera.perturbed`


class Camera(eqx.Module):
    """One camera of the room: x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.

    Its functions take one point or pixel, or any leading axes of them.
    """

    focal: Float[Array, "2"] = eqx.field(converter=as_float)  # px, in x and y
    center: Float[Array, "2"] = eqx.field(converter=as_float)  # px, principal point
    distortion: AbstractDistortion
    cam_from_world: Pose

    __hash__ = hash_or_hint

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
        """Pixel of a world point (m). Finite everywhere, but only meaningful where `depth` is positive."""
        local = self.cam_from_world @ point_world
        depth = local[..., 2]
        tiny = jnp.finfo(depth.dtype).eps
        safe = jnp.where(jnp.abs(depth) < tiny, tiny, depth)
        return self.to_pixel(self.distortion.distort(stack_last(local[..., 0] / safe, local[..., 1] / safe)))

    def depth(self, point_world: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
        """Distance of a world point in front of the camera along its optical axis, m; negative behind."""
        return (self.cam_from_world @ point_world)[..., 2]

    def undistort(self, pixel: Float[AnyArray, "*batch 2"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Where a perfect lens with the same K would see this pixel's ray, px, and whether the lens model has one."""
        ideal, valid = self.distortion.undistort(self.from_pixel(pixel))
        return self.to_pixel(ideal), valid

    def ray(self, pixel: Float[AnyArray, "*batch 2"]) -> Ray:
        """The ray of the world that a pixel sees. Meaningless where `undistort` says that the model has none."""
        ideal, _ = self.distortion.undistort(self.from_pixel(pixel))
        x, y = ideal[..., 0], ideal[..., 1]
        direction = so3.rotate(self.cam_from_world.rotation.T, normalised(stack_last(x, y, jnp.ones_like(x))))
        return Ray(jnp.broadcast_to(self.position, direction.shape), direction)

    def perturbed(self, change: Float[AnyArray, "15"]) -> Camera:
        """This camera with its 15 numbers changed a little; covariances of cameras are in this order.

        A rotation vector w (rad) that acts from the left, R -> exp(w) R; then added: translation (3, m), fx, fy, cx,
        cy (px), k1, k2, p1, p2, k3.

        Raises:
            ValueError: the lens is not a `Brown`.
        """
        if not isinstance(self.distortion, Brown):
            raise ValueError(f"A camera has 15 numbers only with a Brown lens, and this one's is {self.distortion}.")
        change, pose = as_float(change), self.cam_from_world
        return Camera(
            self.focal + change[6:8],
            self.center + change[8:10],
            Brown(self.distortion.coefficients + change[10:15]),
            Pose(so3.rotate(so3.exp(change[:3]), pose.rotation.T).T, pose.translation + change[3:6]),
        )

    def to_pixel(self, xy: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Pixel of a place on the z = 1 plane that the lens has already distorted."""
        return stack_last(*(self.focal[i] * xy[..., i] + self.center[i] for i in range(2)))

    def from_pixel(self, pixel: Float[AnyArray, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """The (still distorted) place of a pixel on the z = 1 plane."""
        pixel = as_float(pixel)
        return stack_last(*((pixel[..., i] - self.center[i]) / self.focal[i] for i in range(2)))
