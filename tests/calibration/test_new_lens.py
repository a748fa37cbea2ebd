"""A lens that jaxpoint does not know, defined here, goes through everything without a change to the package."""

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint import CalibrateSettings, CameraRig, Tracks, calibrate, triangulate, write_report
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.difference import difference
from jaxpoint.calibration.quality import assess
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.lens import AbstractLens, Coefficient
from jaxpoint.camera.lenses import LENSES, register_lens
from jaxpoint.camera.mixed import plain_lens
from jaxpoint.config import LensSettings
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.io.exchange import read_calibration


# A lens of one file, whole: the field-of-view model of Devernay and Faugeras (2001).
class FieldOfView(AbstractLens):
    """r' = atan(2 r tan(w / 2)) / w on the z = 1 plane."""

    parameters: jax.Array  # fx, fy, cx, cy (px), w (rad)
    name: ClassVar = "field_of_view"
    coefficients: ClassVar = (Coefficient("w", 0.5, 0.01, prior_mean=0.6),)
    choices: ClassVar = {"fov": ("w",)}
    sees_sideways: ClassVar = False

    @staticmethod
    def image_of(parameters, direction):
        fx, fy, cx, cy, w = parameters
        x, y, z = direction
        z = jnp.where(jnp.abs(z) < 1e-9, 1e-9, z)
        square = (x * x + y * y) / (z * z)
        off = square > 1e-18
        radius = jnp.sqrt(jnp.where(off, square, 1.0))
        factor = jnp.where(off, jnp.arctan(2 * radius * jnp.tan(w / 2)) / (w * radius), 2 * jnp.tan(w / 2) / w)
        return fx * factor * x / z + cx, fy * factor * y / z + cy

    @staticmethod
    def direction_of(parameters, pixel_x, pixel_y, wanted=None):
        fx, fy, cx, cy, w = parameters
        x, y = (pixel_x - cx) / fx, (pixel_y - cy) / fy
        square = x * x + y * y
        off = square > 1e-18
        bent = jnp.sqrt(jnp.where(off, square, 1.0))
        inside = bent * w < jnp.pi / 2 - 1e-3
        straight = jnp.tan(jnp.where(inside, bent * w, 0.1)) / (2 * jnp.tan(w / 2))
        factor = jnp.where(off, straight / bent, w / (2 * jnp.tan(w / 2)))
        return (factor * x, factor * y, jnp.ones_like(x)), inside | ~off

    @staticmethod
    def in_range(parameters, direction):
        return direction[2] > 0


LIGHT = np.random.default_rng(3).uniform([-1.4, -1.4, 0.0], [1.4, 1.4, 2.0], (400, 3))


@pytest.fixture(scope="module")
def registered():
    register_lens(FieldOfView)
    yield
    del LENSES[FieldOfView.name]


@pytest.fixture(scope="module")
def room(registered):
    """Four cameras around a light, and what they see of it."""
    rng, count = np.random.default_rng(4), 4
    centres = np.array([[3.0, 0.3, 2.0], [0.2, 3.1, 2.3], [-2.9, -0.4, 2.5], [-0.3, -3.0, 1.8]])
    aims = rng.uniform([-0.3, -0.3, 0.7], [0.3, 0.3, 1.3], (count, 3))
    forward = (aims - centres) / np.linalg.norm(aims - centres, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    rotation = Rotation.from_rotvec(rng.normal(0, 0.1, (count, 3))).as_matrix() @ rotation
    focal, center = np.tile(rng.uniform(650, 800, (count, 1)), 2), rng.normal([639.5, 479.5], 8, (count, 2))
    rig = CameraRig.from_parameters(
        focal, center,
        rng.uniform(0.75, 0.9, (count, 1)), rotation, -np.einsum("cij,cj->ci", rotation, centres),
        np.tile([1280, 960], (count, 1)), lens=FieldOfView,
    )  # fmt: skip
    pixels = np.asarray(rig.project(LIGHT)) + rng.normal(0, 0.3, (400, count, 2))
    inside = ((pixels > 0) & (pixels < [1279, 959])).all(axis=-1)
    return rig, Tracks.from_pixels(pixels, np.tile([1280, 960], (count, 1)), inside)


def test_it_is_calibrated_compared_written_and_shown(room, tmp_path):
    rig, tracks = room
    settings = CalibrateSettings(lens=LensSettings(distortion="fov"))
    found = with_covariance(calibrate(tracks, settings))
    assert type(found.rig.cameras.lens) is FieldOfView
    assert assess(found, settings).passed
    error = np.asarray(found.rig.cameras.lens.parameters) - np.asarray(rig.cameras.lens.parameters)
    sigmas = np.sqrt(np.diagonal(found.camera_covariance)).reshape(4, 11)[:, 6:]
    assert np.abs(error / sigmas).max() < 4.5
    assert found.errors[found.kept].mean() < 0.5

    fewer = replace(tracks, visible=tracks.visible & (np.arange(400) % 5 > 0)[:, None])
    again = with_covariance(calibrate(fewer, settings))
    apart = difference(found.rig, again.rig, found.points[:100], (found.camera_covariance, again.camera_covariance))
    assert apart.pixels.max() < 1.0
    assert apart.allowed is not None

    write_calibration_json(
        tmp_path / "calibration.json", found.rig, unit="arbitrary", covariance=found.camera_covariance, gauge="free"
    )
    saved = read_calibration(tmp_path / "calibration.json").rig
    points = [triangulate(one, tracks.pixels, found.kept).points[found.point_valid] for one in (saved, found.rig)]
    np.testing.assert_allclose(*points, atol=1e-9)
    write_report(tmp_path / "report.html", found, settings=settings)
    assert (tmp_path / "report.html").stat().st_size > 1e5


@pytest.mark.usefixtures("registered")
def test_lenses_of_two_kinds_are_calibrated_in_one_rig(room, tmp_path):
    """The same room with two fisheyes that see what the plane does not show."""
    rig, tracks = room
    fisheye = KannalaBrandt.of(0.6 * rig.cameras.focal, rig.cameras.center, np.tile([-0.02, 0.01, -0.004, 0.0], (4, 1)))
    seen = np.asarray(replace(rig, cameras=Camera(fisheye, rig.cameras.cam_from_world)).project(LIGHT))
    pixels, visible = tracks.pixels.copy(), tracks.visible.copy()
    pixels[:, :2] = seen[:, :2] + np.random.default_rng(5).normal(0, 0.3, (400, 2, 2))
    visible[:, :2] = ((pixels[:, :2] > 0) & (pixels[:, :2] < [1279, 959])).all(axis=-1)
    settings = CalibrateSettings(lens=LensSettings(distortion="fisheye,cam_2=fov,cam_3=fov"))
    found = with_covariance(calibrate(replace(tracks, pixels=pixels, visible=visible), settings))
    assert found.rig.lens_models == (KannalaBrandt, KannalaBrandt, FieldOfView, FieldOfView)
    assert assess(found, settings).passed
    lenses = [plain_lens(camera.lens) for camera in found.rig]
    np.testing.assert_allclose(
        [lens.focal[0] for lens in lenses[:2]], 0.6 * np.asarray(rig.cameras.focal)[:2, 0], rtol=0.01
    )
    np.testing.assert_allclose([lens.focal[0] for lens in lenses[2:]], np.asarray(rig.cameras.focal)[2:, 0], rtol=0.02)
    sigmas = np.sqrt(np.diagonal(found.camera_covariance)).reshape(4, -1)
    assert sigmas[:, 10].tolist() == [0.0] * 4  # which model it is
    write_report(tmp_path / "report.html", found, settings=settings)
    assert "fisheye: " in (tmp_path / "report.html").read_text()
