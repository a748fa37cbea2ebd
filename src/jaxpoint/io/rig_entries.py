"""A rig as it stands in files: its cameras as plain numbers, the unit of its lengths, and the way to and fro."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.result import ReadoutTimes, TimeOffsets
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.mixed import own_coefficients
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import UNITS, StrPath
from jaxpoint.io.lens_entries import common_model, model_of_name, read_coefficients

UNSTATED = "unstated"  # the unit of a file that does not say it

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]


class CameraEntry(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    size: tuple[int, int]
    K: Matrix3
    distortion: list[float]
    rotation: Matrix3 | None = None
    translation: Vector3 | None = None
    lens: str | msgspec.UnsetType = msgspec.UNSET  # the model's name; without it OpenCV's of so many coefficients
    reach_px: float | msgspec.UnsetType = msgspec.UNSET  # from the principal point, where the lens model ends


@dataclass(frozen=True)
class SavedCalibration:
    """A rig as it stood in a file."""

    rig: CameraRig
    unit: str = "m"  # of the translations: "m", "arbitrary" or UNSTATED
    covariance: Float[np.ndarray, "D D"] | None = None  # D = p C, in the order of `Camera.perturbed`
    gauge: str | None = None  # what holds its frame: "free" or "landmarks"
    provenance: dict[str, Any] = field(default_factory=dict)
    time_offsets: TimeOffsets | None = None
    in_room: bool = True  # False where the file says that its metres are of a frame of the solver's own
    posed: bool = True  # False where the file holds lenses alone: the poses of the rig are the identity
    notes: tuple[str, ...] = ()  # what a reader of the file must know, a sentence each
    readout_times: ReadoutTimes | None = None

    def entries(self) -> list[CameraEntry]:
        """The cameras as plain numbers, without poses where there are none.

        Raises:
            ValueError: a number is not finite.
        """
        cameras = entries_of(self.rig)
        return cameras if self.posed else [without_pose(camera) for camera in cameras]


def in_metres(saved: SavedCalibration, unit: str) -> SavedCalibration:
    """A calibration whose lengths are in `unit` (m, cm or mm), in metres."""
    with jax.enable_x64(True):
        rig = saved.rig
        metres = jnp.asarray(np.asarray(rig.cameras.cam_from_world.translation) / UNITS.get(unit, 1.0))
        return replace(
            saved, rig=eqx.tree_at(lambda rig: rig.cameras.cam_from_world.translation, rig, metres), unit="m"
        )


def select_cameras(saved: SavedCalibration, places: Sequence[int]) -> SavedCalibration:
    """Some of the cameras, in the order given, with their part of the covariance and their time offsets."""
    covariance, offsets, chosen = saved.covariance, saved.time_offsets, list(places)
    if covariance is not None:
        size = len(covariance) // len(saved.rig)
        index = np.concatenate([size * place + np.arange(size) for place in chosen])
        covariance = covariance[np.ix_(index, index)]
    if offsets is not None:
        offsets = TimeOffsets(offsets.frames[chosen], offsets.sigma[chosen])
    return replace(saved, rig=saved.rig.select(chosen), covariance=covariance, time_offsets=offsets)


def needs_unit(path: StrPath, saved: SavedCalibration, unit: str | None) -> SavedCalibration:
    """The calibration in metres, where it is or where its unit is given.

    Raises:
        UsageError: its unit is not known, or it has no metric scale at all.
    """
    if saved.unit == UNSTATED and unit is not None:
        return in_metres(saved, unit)
    if saved.unit == UNSTATED:
        raise UsageError(
            f"'{path}' does not say its unit; give --unit mm, cm or m (a .toml may say unit = \"mm\" in [metadata])."
        )
    if saved.unit != "m":
        raise UsageError(
            f"'{path}' has no metric scale (unit '{saved.unit}'); bring it into the room by `jaxpoint align`."
        )
    return saved


def needs_metres(path: StrPath, saved: SavedCalibration, unit: str | None) -> SavedCalibration:
    """The calibration in metres and in the room, where it is or where its unit is given.

    Raises:
        UsageError: its unit is not known, it has no metric scale at all, or its frame is not that of the room.
    """
    saved = needs_unit(path, saved, unit)
    if not saved.in_room:
        raise UsageError(
            f"'{path}' has metres, but neither floor nor up (a target gave its scale, or a camera its frame); bring "
            "it into the room by `jaxpoint align`."
        )
    return saved


def without_pose(camera: CameraEntry) -> CameraEntry:
    """The lens of a camera alone."""
    return msgspec.structs.replace(camera, rotation=None, translation=None)


def tuples(values: np.ndarray) -> Any:
    return tuple(map(tuple, values.tolist())) if values.ndim == 2 else tuple(values.tolist())


def check_entry(where: str, camera: CameraEntry) -> None:
    k, rotation = np.array(camera.K), np.eye(3) if camera.rotation is None else np.array(camera.rotation)
    lens_of_entry(where, camera)
    if min(camera.size) <= 0:
        raise FileFormatError(f"{where}size {list(camera.size)} must be positive.")
    if min(k[0, 0], k[1, 1]) <= 0 or (k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0).any() or k[2, 2] != 1:
        raise FileFormatError(f"{where}K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {k.tolist()}.")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
        raise FileFormatError(f"{where}the rotation is none: R R^T must be the identity and det R = +1.")


def lens_of_entry(where: str, camera: CameraEntry) -> tuple[type[AbstractLens], Float[np.ndarray, " k"]]:
    """The model and coefficients of a camera.

    Raises:
        FileFormatError: the model is not known, or the coefficients are not its own.
    """
    named = None if isinstance(camera.lens, msgspec.UnsetType) else model_of_name(where, camera.lens)
    return read_coefficients(where, camera.distortion, named)


def rig_of_entries(path: StrPath, cameras: list[CameraEntry], poses: bool) -> CameraRig:
    names = tuple(camera.name for camera in cameras)
    if not names or len(set(names)) != len(names):
        raise FileFormatError(f"{path} holds the cameras {list(names)}; it needs one or more with different names.")
    without = [camera.name for camera in cameras if camera.rotation is None or camera.translation is None]
    if poses and without:
        raise FileFormatError(
            f"{path}: camera '{without[0]}' has no rotation and translation, only a lens; calibrate with it "
            "(--intrinsics), and use the calibration that comes out."
        )
    k = np.array([camera.K for camera in cameras])
    model, distortion = common_model(*zip(*(lens_of_entry("", camera) for camera in cameras)))
    reach = np.array([np.inf if isinstance(c.reach_px, msgspec.UnsetType) else c.reach_px for c in cameras])
    with jax.enable_x64(True):
        rig = CameraRig.from_parameters(
            focal=k[:, [0, 1], [0, 1]],
            center=k[:, :2, 2],
            distortion=distortion,
            rotation=np.array([camera.rotation or np.eye(3) for camera in cameras]),
            translation=np.array([camera.translation or np.zeros(3) for camera in cameras]),
            image_sizes=np.array([camera.size for camera in cameras]),
            names=names,
            lens=model,
        )
        return replace(rig, reach=jnp.asarray(reach)) if np.isfinite(reach).any() else rig


def entries_of(rig: CameraRig) -> list[CameraEntry]:
    """The cameras of a rig as plain numbers."""
    cameras = rig.cameras
    count = len(rig)
    focal, center = np.asarray(cameras.focal, float), np.asarray(cameras.center, float)
    k = np.tile(np.eye(3), (count, 1, 1))
    k[:, [0, 1], [0, 1]] = focal
    k[:, :2, 2] = center
    models, given = rig.lens_models, np.asarray(cameras.distortion, float)
    distortion = [own[own_coefficients(type(cameras.lens), model)] for model, own in zip(models, given)]
    rotation = np.asarray(cameras.cam_from_world.rotation, float)
    translation = np.asarray(cameras.cam_from_world.translation, float)
    sizes = np.asarray(rig.image_sizes).astype(int)
    for name, values in (("K", k), ("distortion", given), ("rotation", rotation), ("translation", translation)):
        check_finite_numbers(name, values)
    reach = np.full(count, np.inf) if rig.reach is None else np.asarray(rig.reach, float)
    return [
        CameraEntry(
            name,
            *map(tuples, parts),
            lens=msgspec.UNSET if model is Brown else model.name,
            reach_px=float(end) if np.isfinite(end) else msgspec.UNSET,
        )
        for name, end, model, *parts in zip(rig.names, reach, models, sizes, k, distortion, rotation, translation)
    ]


def check_finite_numbers(name: str, values: Any) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"The {name} of the rig is not finite; a calibration that failed is not written.")
