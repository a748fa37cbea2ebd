"""What cameras see of heads in one frame, as rays: what fits them needs no lens model any more."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit_once

MIN_DEPTH = 0.2  # m; nobody is nearer to a camera


@dataclass(frozen=True)
class Rays:
    """M candidates of heads in one frame, in the order of their cameras."""

    camera: Int[np.ndarray, " M"]
    candidate: Int[np.ndarray, " M"]  # its place among those of its camera
    origin: Float[np.ndarray, "M 3"]  # m
    direction: Float[np.ndarray, "M 3"]  # unit length
    sigma: Float[np.ndarray, " M"]  # rad, standard deviation in each of the two directions across
    doubtful: Bool[np.ndarray, " M"]  # it may well be no head

    def __len__(self) -> int:
        """Number of candidates, M."""
        return len(self.camera)

    def without(self, taken: Bool[np.ndarray, " M"]) -> Rays:
        """Those that are still free."""
        kept = ~taken
        return Rays(*(getattr(self, field.name)[kept] for field in fields(self)))

    @cached_property
    def axes(self) -> Float[np.ndarray, "M 2 3"]:
        """Two directions at right angles to each ray and to each other."""
        helper = np.eye(3)[np.argmin(np.abs(self.direction), axis=1)]
        one = np.cross(self.direction, helper)
        one /= np.linalg.norm(one, axis=1, keepdims=True)
        return np.stack([one, np.cross(self.direction, one)], axis=1)

    def across(
        self, points: Float[np.ndarray, "H 3"]
    ) -> tuple[Float[np.ndarray, "H M 2"], Float[np.ndarray, "H M"], Float[np.ndarray, "H M"]]:
        """From every ray to every point along `axes` (m), distance along the ray, and one sigma there (m)."""
        offset = points[:, None] - self.origin
        along = np.einsum("hmi,mi->hm", offset, self.direction)
        reach = np.maximum(np.linalg.norm(offset, axis=-1), MIN_DEPTH)
        return np.einsum("hmi,mji->hmj", offset, self.axes), along, reach * self.sigma


@jit_once
def look(
    cameras: Camera, pixels: Float[Array, "F C K 2"], sigma_px: Float[Array, "F C K"]
) -> tuple[Float[Array, "C 3"], Float[Array, "F C K 3"], Float[Array, "F C K"], Bool[Array, "F C K"]]:
    """Where cameras stand, the directions that pixels look in, their sd (rad), and whether the lens has the pixel."""

    def one(camera: Camera, pixel: Array, sigma: Array) -> tuple[Array, Array, Array]:
        def direction(moved: Array) -> Array:
            return camera.ray(pixel + moved[None, None]).direction

        ahead = direction(jnp.zeros(2, pixel.dtype))
        by_pixel = jax.jacfwd(direction)(jnp.zeros(2, pixel.dtype))  # (F, K, 3, 2)
        area = jnp.cross(by_pixel[..., 0], by_pixel[..., 1])  # rad^2 that one pixel covers
        squared = jnp.sum(area**2, axis=-1)
        spread = jnp.where(squared > 0, squared, 1.0) ** 0.25
        return ahead, spread * sigma, camera.undistort(pixel)[1]

    direction, sigma, known = jax.vmap(one, in_axes=(0, 1, 1), out_axes=1)(cameras, pixels, sigma_px)
    return jax.vmap(lambda camera: camera.position)(cameras), direction, sigma, known


def rays_of_frames(
    rig: CameraRig,
    pixels: Float[np.ndarray, "F C K 2"],
    valid: Bool[np.ndarray, "F C K"],
    sigma_px: Float[np.ndarray, "F C K"],
    doubtful: Bool[np.ndarray, "F C K"] | None = None,
) -> list[Rays]:
    """The rays of each frame's valid candidates; those where the lens model has no ray are left out."""
    doubtful = np.zeros(valid.shape, bool) if doubtful is None else doubtful
    safe = np.where(valid[..., None], pixels, np.asarray(rig.cameras.center)[:, None])
    positions, direction, sigma, known = map(np.asarray, look(rig.cameras, safe, sigma_px))
    usable = valid & known
    found = []
    for frame in range(len(pixels)):
        camera, candidate = np.nonzero(usable[frame])
        place = frame, camera, candidate
        found.append(Rays(camera, candidate, positions[camera], direction[place], sigma[place], doubtful[place]))
    return found
