"""A calibration as the plain arrays of the report: where the cameras are, and how their lenses bend."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.mixed import plain_lens
from jaxpoint.compilation import jit_once
from jaxpoint.report.summary import Lens, RigScene, Summary

_STEPS = 400
_DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)


def summarise(calibration: Calibration) -> Summary:
    """A calibration as plain arrays."""
    tracks, cameras = calibration.tracks, calibration.rig.cameras
    pose, valid = cameras.cam_from_world, np.asarray(calibration.point_valid)
    rotation, translation = np.asarray(pose.rotation), np.asarray(pose.translation)
    focal, center = np.asarray(cameras.focal), np.asarray(cameras.center)
    lenses = [plain_lens(camera.lens) for camera in calibration.rig]
    scene = RigScene(
        centers=-np.einsum("cji,cj->ci", rotation, translation),
        world_from_cam=np.swapaxes(rotation, 1, 2),
        points=np.asarray(calibration.points)[valid],
        unit=calibration.unit,
        in_room=calibration.in_room,
    )

    def distort(places: np.ndarray) -> np.ndarray:
        with jax.enable_x64(True):
            return np.asarray(_distort(cameras.lens, jnp.asarray(places)))

    return Summary(
        names=tracks.names,
        sizes=tracks.image_sizes,
        frame_ids=tracks.frame_ids,
        times=tracks.times,
        pixels=tracks.pixels,
        visible=tracks.visible,
        residuals=np.asarray(calibration.residuals),
        slopes=pixel_slopes(rotation, translation, focal, np.asarray(calibration.points)),
        verdicts=np.asarray(calibration.verdicts),
        point_valid=valid,
        sigma_px=float(calibration.sigma_px),
        shared=np.asarray(calibration.pairs.shared),
        focal=focal,
        center=center,
        distortion=tuple(np.asarray(lens.distortion) for lens in lenses),
        lens_models=tuple(lens.name for lens in lenses),
        view_deg=_views_deg(cameras.lens, tracks.image_sizes),
        scene=scene,
        lens=lens_profile(distort, focal, center, tracks.image_sizes, tracks.pixels, calibration.kept),
    )


@jit_once
def _distort(lenses: AbstractLens, places: Float[Array, "C N 2"]) -> Float[Array, "C N 2"]:
    """Where places on the z = 1 planes are seen, in focal lengths from the principal points."""

    def one(lens: AbstractLens, xy: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
        seen = lens.project(jnp.concatenate([xy, jnp.ones_like(xy[:, :1])], axis=1))
        return (seen - lens.center[None]) / lens.focal[None]

    return jax.vmap(one)(lenses, places)


def _views_deg(lenses: AbstractLens, sizes: Int[np.ndarray, "C 2"]) -> Float[np.ndarray, " C"]:
    """The angle of view of each camera across its image, deg."""
    with jax.enable_x64(True):
        left, right = (
            np.asarray(_edge_directions(lenses, jnp.asarray(x))) for x in (0.0 * sizes[:, 0], sizes[:, 0] - 1.0)
        )
    off = np.arctan2(np.stack([-left[:, 0], right[:, 0]]), np.stack([left[:, 2], right[:, 2]]))
    return np.rad2deg(off.sum(axis=0))


@jit_once
def _edge_directions(lenses: AbstractLens, columns: Float[Array, " C"]) -> Float[Array, "C 3"]:
    """What each camera sees in a column, at the height of its principal point."""
    return jax.vmap(lambda lens, x: lens.unproject(jnp.stack([x, lens.center[1]]))[0])(lenses, columns)


def pixel_slopes(
    rotation: Float[np.ndarray, "C 3 3"],
    translation: Float[np.ndarray, "C 3"],
    focal: Float[np.ndarray, "C 2"],
    points: Float[np.ndarray, "F 3"],
) -> Float[np.ndarray, "F C 2 3"]:
    """Derivatives of the pixels by the point, without the lens's bending; zero in the camera's own plane."""
    local = np.einsum("cij,fj->fci", rotation, points) + translation
    near = np.abs(local[..., 2:]) < 1e-9
    depth = np.where(near, 1.0, local[..., 2:])
    scale = np.where(near, 0.0, focal / depth)  # (F, C, 2)
    towards = local[..., :2] / depth
    return scale[..., None] * (rotation[:, :2] - towards[..., None] * rotation[:, 2:])


def before_alignment(scene: RigScene, similarity) -> RigScene:
    """The scene in the solver's own frame, given the similarity (`geometry.pose.Similarity`) that led it out of it."""
    scale, rotation = float(similarity.scale), np.asarray(similarity.rotation)
    translation = np.asarray(similarity.translation)
    return scene.moved(1 / scale, rotation.T, -rotation.T @ translation / scale, "arbitrary")


def lens_profile(
    distort: Callable[[np.ndarray], np.ndarray],
    focal: Float[np.ndarray, "C 2"],
    center: Float[np.ndarray, "C 2"],
    sizes: Int[np.ndarray, "C 2"],
    pixels: Float[np.ndarray, "F C 2"],
    kept: Bool[np.ndarray, "F C"],
) -> Lens:
    """The radial behaviour of each lens, averaged over eight directions so that decentring cancels.

    Args:
        distort: maps points (C, N, 2) on the z = 1 plane of each camera to distorted ones.
        focal: px.
        center: principal points, px.
        sizes: width and height of the images, px.
        pixels: observations, px.
        kept: those that the calibration believes.
    """
    edges = np.stack([np.full_like(sizes, -0.5, dtype=float), sizes - 0.5], axis=1)  # (C, 2 ends, 2 axes)
    far = np.abs(edges - center[:, None]).max(axis=1) / focal
    corner = np.linalg.norm(far, axis=1)
    seen = (np.linalg.norm((pixels - center) / focal, axis=2) * kept).max(axis=0, initial=0.0)
    radius = corner[:, None] * np.linspace(0.0, 2.5, _STEPS)
    places = radius[..., None, None] * _DIRECTIONS
    bent = distort(places.reshape(len(sizes), -1, 2)).reshape(places.shape)
    outwards = np.einsum("cnkj,kj->cn", bent, _DIRECTIONS) / len(_DIRECTIONS)
    marks = np.array([_marks(*camera) for camera in zip(radius, outwards, corner, seen)])
    px = focal.mean(axis=1)
    return Lens(radius * px[:, None], (outwards - radius) * px[:, None], *(marks * px[:, None]).T)


def _marks(radius, outwards, corner: float, seen: float) -> tuple[float, float, float]:
    """Undistorted radius of the turning point, of the corner and of the farthest observation (given distorted)."""
    falling = np.flatnonzero(np.diff(outwards) <= 0)
    last = int(falling[0]) if falling.size else len(radius) - 1
    turning = radius[last] if falling.size else np.inf
    # Pixels are distorted: their radius is led back along the rising part of the curve.
    back = np.interp([corner, seen], outwards[: last + 1], radius[: last + 1], right=np.inf)
    if not falling.size:  # a lens that sees sideways reaches corners that no place on the plane has
        back = np.minimum(back, radius[-1])
    return turning, back[0], back[1]
