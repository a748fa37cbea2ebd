"""The gate turns before the error does: rigs swept through every critical configuration, and refuted priors."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from critical import ring, row, seen, sigmas_off, waved

from jaxpoint.calibration.aspects import aspect_of, aspect_patterns, aspect_text
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.prior_checks import given_up
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import Freedom
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.errors import InsufficientDataError, QualityError, UsageError
from jaxpoint.simulate.rooms import random_room

MOST_SIGMAS = 3.0  # of a calibration called good
SQUARE = CalibrateSettings(lens=LensSettings(aspect="fixed"))  # stated: level cameras in a row leave the aspect open


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def solved(cameras, light, settings=None, **how):
    tracks, truth = seen(cameras, light, **how)
    return with_covariance(calibrate(tracks, settings)), truth


def near(cameras, factor):
    """The cameras moved towards each other along the wall."""
    rotation, centres = cameras
    return rotation, centres * [factor, 1.0, 1.0]


SWEEPS = {
    "parallel axes": [lambda a=angle: (row(a), waved()) for angle in (0.0, 5.0, 20.0, 60.0, 100.0)],
    "cameras in one place": [lambda f=share: (near(row(60.0), f), waved()) for share in (0.02, 0.2, 0.6)],
    "light on a plane": [lambda t=thick: (ring(), waved(extent=(1.8, 1.4, t))) for thick in (0.005, 0.03, 0.1)],
    "light on a line": [lambda t=thick: (ring(), waved(extent=(1.8, t, t))) for thick in (0.005, 0.05, 0.2)],
}


def refusal(build) -> set[str]:
    """The causes for which a rig is refused, before or after it is solved; words of the message where before."""
    try:
        return set(assess(solved(*build())[0]).causes)
    except InsufficientDataError as error:
        return {word for word in ("plane", "line") if word in str(error)}


@pytest.mark.parametrize("cause", SWEEPS)
def test_what_is_called_good_is_right_on_the_way_through_a_critical_configuration(cause):
    """The first rig of every sweep stands at the critical point and is refused by name; the rest are right if good."""
    critical, *others = SWEEPS[cause]
    assert refusal(critical) & {cause, "plane", "line", "light on a plane"}  # a line lies on planes
    for build in others:
        found, truth = solved(*build(), SQUARE)
        quality = assess(found)
        assert not quality.passed or sigmas_off(found, truth) <= MOST_SIGMAS
    assert quality.passed


@pytest.mark.parametrize("aspect", [1.0, 16 / 15])
def test_level_cameras_in_a_row_leave_the_pixel_aspect_open(aspect):
    found, _ = solved(row(100.0), waved(), aspect=aspect)
    quality = assess(found)
    assert quality.causes == ("pixel aspect",)
    assert "--lens.aspect fixed" in str(quality.failure)


def test_parallel_axes_name_the_cure_and_known_lenses_cure_it():
    found, _ = solved(row(0.0), waved())
    failure = assess(found).failure
    assert isinstance(failure, QualityError)
    assert "parallel" in str(failure)
    assert "--lens.known hold" in str(failure)


@pytest.mark.parametrize(
    ("cameras", "aspect"), [(ring(height=1.2), 4 / 3), (ring(height=2.6), [4 / 3, 1, 1, 1, 1]), (ring(), 1.0)]
)
def test_pixel_aspects_are_found_where_the_recording_tells_them(cameras, aspect):
    found, truth = solved(cameras, waved(), aspect=aspect)
    quality = assess(found)
    assert quality.passed
    assert sigmas_off(found, truth) <= MOST_SIGMAS
    named = {name for item in quality.findings if item.cause == "pixel aspect" for name in item.cameras}
    assert named == {name for name, one in zip(found.rig.names, np.broadcast_to(aspect, 5)) if one != 1}


def test_a_stated_aspect_is_taken():
    settings = CalibrateSettings(lens=LensSettings(aspect="4/3"))
    found, truth = solved(ring(), waved(), settings, aspect=4 / 3)
    assert assess(found).passed
    assert sigmas_off(found, truth) <= MOST_SIGMAS
    ratio = np.asarray(found.rig.cameras.focal)[:, 1] / np.asarray(found.rig.cameras.focal)[:, 0]
    np.testing.assert_allclose(ratio, 4 / 3)


def test_a_cropped_camera_is_named_and_does_not_bend_the_others():
    cameras = ring(height=1.8)
    found, truth = solved(cameras, waved(), crop=(420, 160))
    quality = assess(found)
    assert quality.passed
    assert sigmas_off(found, truth) <= MOST_SIGMAS
    cropped = [item for item in quality.findings if item.cause == "cropped image"]
    assert [item.cameras for item in cropped] == [("cam_0",)]


@pytest.mark.parametrize(("fault", "cause"), [("mirror", "mirrored images"), ("other", "contradicting camera")])
def test_a_camera_that_contradicts_the_others_is_left_out_and_named(fault, cause):
    tracks, truth = seen(ring(), waved())
    pixels = np.where(tracks.visible[..., None], tracks.pixels, np.nan)
    if fault == "mirror":
        pixels[:, 2, 0] = tracks.image_sizes[2, 0] - 1 - pixels[:, 2, 0]
    else:
        other, _ = seen(ring(), waved(seed=5))
        pixels[:, 2] = np.where(other.visible[:, 2, None], other.pixels[:, 2], np.nan)
    found = with_covariance(calibrate(type(tracks).from_pixels(pixels, tracks.image_sizes)))
    quality = assess(found)
    assert found.rig.names == ("cam_0", "cam_1", "cam_3", "cam_4")
    assert cause in quality.causes
    assert "cam_2" in str(quality.failure)
    assert sigmas_off(found, truth) <= MOST_SIGMAS
    rest = replace(found, findings=())
    assert assess(rest).passed


def test_aspects_are_read_as_numbers_fractions_or_words():
    assert aspect_of("16/15") == pytest.approx(16 / 15)
    assert aspect_of(1.0667) == pytest.approx(1.0667)
    assert aspect_of("auto") is None
    assert aspect_text(64 / 45) == "64/45"
    for wrong in ("pal", "0", "1/0", "nan", "9"):
        with pytest.raises(UsageError, match="cannot be used"):
            aspect_of(wrong)


def test_patterns_of_aspects_keep_the_ratios_that_were_found():
    patterns = aspect_patterns(0.95 * np.array([4 / 3, 1.0, 1.0]))
    assert patterns[0] == pytest.approx((4 / 3, 1.0, 1.0))
    assert all(pattern[0] / pattern[1] == pytest.approx(4 / 3, rel=0.02) for pattern in patterns)


@pytest.mark.parametrize("choice", ["pinhole", "none"])
def test_a_lens_model_that_is_too_poor_is_refused(choice):
    """The misfit passes for noise; k1 of -0.24 in one of four cameras moves focal lengths by 8 %."""
    settings = CalibrateSettings(lens=LensSettings(distortion=choice))
    quality = assess(with_covariance(calibrate(random_room(3, cameras=4, frames=300).tracks, settings)), settings)
    assert "lens model" in quality.causes
    assert "--lens.distortion auto" in str(quality.failure)


def test_a_rig_that_refutes_two_priors_is_not_called_good(free_room):
    """Starts far off ended so with focal lengths 6 to 20 % wrong: what one prior would show, the other's loss hides."""
    calibration = free_room[1]
    before, rig = calibration.freedom, calibration.rig
    cropped, weight = before.prior_mean.copy(), before.prior_weight.copy()
    weight[0, 8:10] = 0.0
    wide = np.asarray(rig.cameras.focal) * np.array([1.0, 16.0 / 15.0])
    stretched = eqx.tree_at(lambda rig: rig.cameras.lens, rig, replace_focal(rig.cameras.lens, wide))
    after = Freedom(before.free, cropped, weight)
    levels = [
        {item.cause: item.level for item in given_up(before, end, shape, another_lens)}
        for end, shape, another_lens in (
            (after, rig, True),
            (before, stretched, False),
            (after, stretched, False),
            (before, stretched, True),
        )
    ]
    assert levels == [
        {"cropped image": "care"},
        {"pixel aspect": "care"},
        {"cropped image": "care", "pixel aspect": "bad"},
        {"pixel aspect": "bad"},
    ]


def replace_focal(lens, focal):
    return type(lens)(jnp.asarray(lens.parameters).at[:, :2].set(focal))
