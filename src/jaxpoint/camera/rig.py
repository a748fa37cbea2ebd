"""All cameras of a room as one object."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.mixed import model_of
from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint
from jaxpoint.geometry.line import Ray
from jaxpoint.geometry.pose import Pose, Similarity


class CameraRig(eqx.Module):
    """C cameras in one world frame; build one with `CameraRig.from_parameters`.

    `rig[2]` or `rig["door"]` is one `Camera`. Functions with a camera axis have it just before the components:
    pixels (..., C, 2).
    """

    cameras: Camera  # with a leading axis C on every leaf
    image_sizes: Int[Array, "C 2"]  # px, width and height
    names: tuple[str, ...] = eqx.field(static=True)
    reach: Float[Array, " C"] | None = None  # px from the principal point, where the lens models end; None: nowhere

    __hash__ = hash_or_hint

    @staticmethod
    def from_parameters(
        focal: Float[AnyArray, "C 2"],
        center: Float[AnyArray, "C 2"],
        distortion: Float[AnyArray, "C k"],
        rotation: Float[AnyArray, "C 3 3"],
        translation: Float[AnyArray, "C 3"],
        image_sizes: Int[AnyArray, "C 2"],
        names: Sequence[str] = (),
        lens: type[AbstractLens] = Brown,
    ) -> CameraRig:
        """A rig of cameras with one kind of lens, from stacked parameters.

        Args:
            focal: focal lengths in x and y, px.
            center: principal points, px.
            distortion: the lens's coefficients; of `Brown` k1, k2, p1, p2, k3 (OpenCV's order).
            rotation: from world to camera.
            translation: from world to camera, m.
            image_sizes: width and height, px.
            names: one each; cam_0, cam_1, ... if left out.
            lens: of what kind they are.

        Raises:
            ValueError: shapes do not fit, a name is used twice, or float64 would be cut to float32.
        """
        parts = [as_float(part) for part in (focal, center, distortion, rotation, translation)]
        sizes = jnp.asarray(image_sizes, dtype=jnp.int32)
        count = parts[0].shape[0] if parts[0].ndim else 0
        wanted = [(count, *shape) for shape in ((2,), (2,), (len(lens.coefficients),), (3, 3), (3,), (2,))]
        shapes = [part.shape for part in (*parts, sizes)]
        if count == 0 or shapes != wanted:
            raise ValueError(f"The parameters of {count} cameras must have the shapes {wanted}, not {shapes}.")
        names = tuple(names) or tuple(f"cam_{i}" for i in range(count))
        if len(names) != count or len(set(names)) != count:
            raise ValueError(f"{count} cameras need {count} different names, not {list(names)}.")
        focal, center, distortion, rotation, translation = parts
        cameras = Camera(lens.of(focal, center, distortion), jax.vmap(Pose)(rotation, translation))
        return CameraRig(cameras, sizes, names)

    def __len__(self) -> int:
        """Number of cameras, C."""
        return len(self.names)

    def __getitem__(self, camera: int | str) -> Camera:
        """One camera, by its place or its name.

        Raises:
            ValueError: no camera has that name.
            IndexError: the place lies outside the rig.
        """
        if isinstance(camera, str):
            if camera not in self.names:
                raise ValueError(f"No camera is called '{camera}'; the rig has {list(self.names)}.")
            camera = self.names.index(camera)
        if not -len(self) <= camera < len(self):
            raise IndexError(f"Camera {camera} does not exist: the rig has {len(self)}, counted from 0.")
        return jax.tree.map(lambda leaf: leaf[camera], self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        """The cameras, one by one."""
        return (self[i] for i in range(len(self)))

    @property
    def camera_size(self) -> int:
        """p, the number of parameters of each camera; covariances of the rig have p C rows."""
        return self.cameras.size

    @property
    def positions(self) -> Float[Array, "C 3"]:
        """Camera centres in the world, m."""
        return _each(self, _position)

    @property
    def matrices(self) -> Float[Array, "C 3 4"]:
        """P of every camera, from homogeneous world points to pixels of the ideal image."""
        return _each(self, _matrix)

    def project(self, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch C 2"]:
        """Pixels of world points (m) in every camera; only meaningful where `depth` is positive."""
        return _project(self, as_float(points))

    def depth(self, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch C"]:
        """Distance of world points in front of every camera along its axis, m; negative behind."""
        return _depth(self, as_float(points))

    def sees(self, points: Float[AnyArray, "*batch 3"]) -> Bool[Array, "*batch C"]:
        """Whether world points (m) lie where each lens is one-to-one; walls and the images' edges are unknown here."""
        return _sees(self, as_float(points))

    def undistort(
        self, pixels: Float[AnyArray, "*batch C 2"]
    ) -> tuple[Float[Array, "*batch C 2"], Bool[Array, "*batch C"]]:
        """Pixels of the ideal images with the same K, and whether the lens model has one."""
        return _undistort(self, as_float(pixels))

    def rays(self, pixels: Float[AnyArray, "*batch C 2"]) -> Ray:
        """The rays of the world that pixels see; origin and direction (..., C, 3)."""
        return _rays(self, as_float(pixels))

    @property
    def lens_models(self) -> tuple[type[AbstractLens], ...]:
        """The lens model of every camera."""
        lens = type(self.cameras.lens)
        return tuple(model_of(lens, own) for own in np.asarray(self.cameras.distortion))

    def transformed(self, world_from_solver: Similarity) -> CameraRig:
        """The same rig in another world frame: no pixel changes, P' = P S^-1."""
        poses = jax.vmap(world_from_solver.transform_camera)(self.cameras.cam_from_world)
        return eqx.tree_at(lambda rig: rig.cameras.cam_from_world, self, poses)

    def select(self, cameras: Sequence[int]) -> CameraRig:
        """The rig of some of its cameras, in the order given.

        Raises:
            ValueError: none is left, or one is named twice.
        """
        index = list(cameras)
        if not index or len(set(index)) != len(index):
            raise ValueError(f"A rig needs at least one camera and each once, not {index}.")
        chosen = jnp.asarray(index)
        kept = jax.tree.map(lambda leaf: leaf[chosen], self.cameras)
        reach = None if self.reach is None else self.reach[chosen]
        return CameraRig(kept, self.image_sizes[chosen], tuple(self.names[i] for i in index), reach)


def _position(camera: Camera) -> Array:
    return camera.position


def _matrix(camera: Camera) -> Array:
    return camera.matrix


def _each(rig: CameraRig, function: Callable[[Camera], Any]) -> Any:
    as_float(rig.cameras.focal)  # a rig of float64 numbers must not be cut either
    return _mapped(rig.cameras, function)


@eqx.filter_jit
def _mapped(cameras: Camera, function: Callable[[Camera], Any]) -> Any:
    return jax.vmap(function)(cameras)


@jit
def _project(rig: CameraRig, points: Array) -> Array:
    return jax.vmap(lambda camera: camera.project(points), out_axes=-2)(rig.cameras)


@jit
def _depth(rig: CameraRig, points: Array) -> Array:
    return jax.vmap(lambda camera: camera.depth(points), out_axes=-1)(rig.cameras)


@jit
def _sees(rig: CameraRig, points: Array) -> Array:
    return jax.vmap(lambda camera: camera.sees(points), out_axes=-1)(rig.cameras)


@jit
def _undistort(rig: CameraRig, pixels: Array) -> tuple[Array, Array]:
    return jax.vmap(Camera.undistort, in_axes=(0, -2), out_axes=(-2, -1))(rig.cameras, pixels)


@jit
def _rays(rig: CameraRig, pixels: Array) -> Ray:
    return jax.vmap(Camera.ray, in_axes=(0, -2), out_axes=-2)(rig.cameras, pixels)
