"""Recordings that public users' situations led to: each comes out right, or is not called good and its cause named."""

import jax
import numpy as np
import pytest

from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.io.track_files import read_tracks
from jaxpoint.triangulation import Flag, triangulate


@pytest.fixture(scope="module")
def solve(data_folder):
    """The calibration of a case and what is decided of it."""

    def solved(name, **lens):
        settings = CalibrateSettings(lens=LensSettings(**lens))
        with jax.enable_x64(True):
            found = with_covariance(calibrate(read_tracks(data_folder.parent / "cases" / name), settings))
            return found, assess(found, settings)

    return solved


@pytest.mark.parametrize("name", ["parallel", "tilted2"])
def test_parallel_axes_are_refused_by_name(solve, name):
    _, quality = solve(f"05-parallel-axes/{name}.csv")
    assert quality.causes == ("parallel axes",)
    assert "--lens.known hold" in str(quality.failure)


@pytest.mark.parametrize(("name", "aspects"), [("pal", [16 / 15] * 5), ("mixed", [4 / 3, 1, 1, 1, 1])])
def test_pixel_aspects_are_found(solve, name, aspects):
    found, quality = solve(f"02-pixel-aspect/{name}.csv")
    assert quality.passed
    assert any(item.cause == "pixel aspect" for item in quality.findings)
    focal = np.asarray(found.rig.cameras.focal)
    np.testing.assert_allclose(focal[:, 1] / focal[:, 0], aspects)
    off = np.asarray(found.rig.cameras.center) - (found.tracks.image_sizes - 1) / 2
    assert np.abs(off).max() < 30  # truth: 0; 113 to 771 px with square pixels


def test_the_prior_of_a_cropped_camera_is_given_up(solve):
    found, quality = solve("03-cropped/one.csv")
    assert quality.passed
    (cropped,) = [item for item in quality.findings if item.cause == "cropped image"]
    assert cropped.cameras == ("cam_0",)
    assert np.abs(np.asarray(found.rig.cameras.focal)[:, 0] / 900 - 1).max() < 0.08  # sigma 3.5 %
    assert np.abs(np.asarray(found.rig.cameras.center)[0] - [310, 260]).max() < 40


def test_a_late_camera_is_left_out_and_the_flag_given(solve):
    found, quality = solve("10-late-and-drift/lag41.csv")
    assert "cam_2" not in found.rig.names
    assert quality.causes == ("out of step",)
    assert "--offset cam_2=41" in str(quality.failure)


def test_wide_lenses_come_right_as_fisheyes(solve):
    found, quality = solve("01-wide-lenses/ceil150.csv")
    assert quality.passed
    assert type(found.rig.cameras.lens) is KannalaBrandt
    assert found.rig.reach is None
    np.testing.assert_allclose(found.rig.cameras.focal, 640 / np.deg2rad(75), rtol=0.005)  # equidistant, 150 degrees
    assert found.kept.sum() > 0.98 * found.tracks.visible.sum()  # 2 % are gross outliers


def test_a_lens_wider_than_the_model_is_named_and_places_beyond_it_are_flagged(solve):
    found, quality = solve("01-wide-lenses/ceil150.csv", distortion="radial2")
    assert quality.causes == ("lens model",)
    assert found.rig.reach is not None
    with jax.enable_x64(True):
        points = triangulate(found.rig, found.tracks.pixels, found.tracks.visible)
    away = np.linalg.norm(found.tracks.pixels - np.asarray(found.rig.cameras.center), axis=-1)
    beyond = (found.tracks.visible & (away > np.asarray(found.rig.reach))).any(axis=1)
    assert beyond.any()
    np.testing.assert_array_equal((np.asarray(points.flags) & Flag.BEYOND_REACH) > 0, beyond)
    assert not np.asarray(points.valid)[beyond].any()
