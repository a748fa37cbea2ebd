"""Each piece of advice is given in the case made for it, and in no other."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.calibration.camera_clock import CameraClock
from jaxpoint.calibration.clock_findings import Timing
from jaxpoint.motion import motion
from jaxpoint.report import advice as adv
from jaxpoint.report.summary import Lens

SIZES = np.array([[640, 480]] * 3)
NAMES = ("left", "middle", "right")
RNG = np.random.default_rng(0)


@pytest.fixture
def pixels():
    return RNG.uniform(0, 1, (400, 3, 2)) * [639, 479]


@pytest.fixture
def visible():
    return np.ones((400, 3), bool)


def texts(found):
    return [f"{item.finding} {item.remedy}" for item in found]


def shared(visible):
    return visible.T.astype(int) @ visible.astype(int)


def test_a_good_calibration_needs_nothing_urgent(summary):
    assert [item for item in adv.advise(summary) if item.urgent] == []


def test_a_good_recording_needs_nothing(pixels, visible):
    assert texts(adv.on_recording(NAMES, pixels, visible, SIZES, shared(visible))) == []
    assert texts(adv.on_views(visible)) == []


def test_a_small_part_of_the_image_is_named_with_its_side(pixels, visible):
    pixels[:, 1, 0] = 400 + 0.3 * pixels[:, 1, 0]
    (text,) = texts(adv.on_recording(NAMES, pixels, visible, SIZES, shared(visible)))
    assert "middle" in text
    assert "nothing in the left part" in text


def test_few_shared_frames_name_the_camera_and_its_partners(pixels, visible):
    visible[25:, 2] = False
    (item,) = adv.on_recording(NAMES, pixels, visible, SIZES, shared(visible))
    assert "right shares too few frames with the others: only 25 with left and 25 with middle" in item.finding
    assert not item.urgent
    visible[10:, 2] = False
    assert next(adv.on_recording(NAMES, pixels, visible, SIZES, shared(visible))).urgent


def test_frames_of_two_views_are_counted(visible):
    visible[::2, 0] = False
    visible[1::2, 2] = False
    assert "0% of the usable frames" in texts(adv.on_views(visible))[0]


def test_outliers_of_one_camera(pixels, visible):
    rejected = np.zeros_like(visible)
    rejected[::7, 1] = True
    found = texts(adv.on_outliers(NAMES, SIZES, pixels, visible, rejected, np.arange(400)))
    assert len(found) == 1
    assert "middle has 14% of its observations rejected" in found[0]
    rejected[::7] = True  # all cameras alike: a noisy recording, not a bad camera
    assert texts(adv.on_outliers(NAMES, SIZES, pixels, visible, rejected, np.arange(400))) == []


def test_outliers_at_one_place_of_the_image(pixels, visible):
    rejected = np.zeros_like(visible)
    rejected[::7, 1] = True
    pixels[::7, 1] = RNG.normal([100, 60], 2, (len(pixels[::7]), 2))
    found = texts(adv.on_outliers(NAMES, SIZES, pixels, visible, rejected, np.arange(400)))
    assert any("near pixel (100, 60)" in text for text in found)


def test_outliers_of_one_time(pixels, visible):
    rejected = np.zeros_like(visible)
    rejected[300:380, 0] = True
    found = list(adv.on_outliers(NAMES, SIZES, pixels, visible, rejected, np.arange(1000, 1400)))
    (item,) = [item for item in found if "almost throughout" in item.finding]
    first, last = (int(word) for word in item.finding.rstrip(".").replace("to ", "").split()[-2:])
    assert abs(first - 1300) < 10
    assert abs(last - 1380) < 10
    assert item.urgent


def test_outliers_that_begin_at_a_radius_mean_the_lens_and_no_touched_camera(pixels, visible):
    radius = np.linalg.norm(pixels[:, 2] - [319.5, 239.5], axis=1)
    rejected = np.zeros_like(visible)
    rejected[:, 2] = (radius > 250) & (RNG.random(400) < 0.9)
    rejected[::50, 2] = True
    late = np.argsort(radius)  # the light goes outwards, so that the outliers gather in time too
    (item,) = adv.on_outliers(NAMES, SIZES, pixels[late], visible, rejected[late], np.arange(400))
    assert "Camera right" in item.finding
    assert "px from the middle of its image" in item.finding
    assert "lens" in item.remedy
    assert "touched" not in item.remedy
    assert item.urgent


def test_a_camera_that_fits_nowhere_was_not_touched(pixels, visible):
    rejected = np.zeros_like(visible)
    rejected[:, 0] = RNG.random(400) < 0.95
    found = texts(adv.on_outliers(NAMES, SIZES, pixels, visible, rejected, np.arange(400)))
    assert "same room and times" in found[-1]
    assert not any("touched" in text for text in found)


def test_outliers_of_a_single_camera_need_no_others(pixels, visible):
    found = texts(adv.on_outliers(NAMES[:1], SIZES[:1], pixels[:, :1], visible[:, :1], visible[:, :1], np.arange(400)))
    assert "100% of its observations rejected" in found[0]


def test_outliers_at_the_edge_of_the_image(pixels, visible):
    rejected = np.zeros_like(visible)
    rejected[::10, 2] = True
    assert texts(adv.on_borders(NAMES, SIZES, pixels, rejected)) == []
    pixels[::10, 2, 1] = 1.0
    assert "100% of those of right" in texts(adv.on_borders(NAMES, SIZES, pixels, rejected))[0]


def test_a_late_camera_is_found_and_the_others_are_not(summary):
    velocity = motion(summary.pixels, summary.visible, summary.frame_ids).velocity
    late = np.zeros(len(summary.names))
    late[2] = 0.8
    moved = replace(summary, residuals=summary.residuals + late[:, None] * velocity)
    (item,) = list(adv.on_timing(moved))
    assert summary.names[2] in item.finding
    assert "frames after the others" in item.finding
    assert "--time-offsets" in item.remedy
    assert item.urgent
    assert list(adv.on_timing(summary)) == []


def test_a_light_on_a_plane(summary):
    assert [text for text in texts(adv.on_space(summary.names, summary.scene)) if "plane" in text] == []
    flat = replace(summary.scene, points=summary.scene.points * [1, 1, 1e-3])
    (item, *_) = adv.on_space(summary.names, flat)
    assert "almost on a plane" in item.finding
    assert item.urgent


def test_an_empty_quarter_of_the_room_names_the_nearest_camera(summary):
    points = RNG.uniform(0, 1, (2000, 3)) * [6, 5, 2]
    scene = replace(
        summary.scene,
        points=points[~((points[:, 0] > 3) & (points[:, 1] > 2.5) & (RNG.uniform(size=2000) > 0.03))],
        centers=np.array([[0.0, 0, 2], [6, 0, 2], [6, 5, 2], [0, 5, 2]]),
    )
    (text,) = texts(adv.on_space(summary.names, scene))
    assert f"nearest camera {summary.names[2]}" in text


def test_a_lens_that_folds_within_the_image():
    lens = Lens(
        np.zeros((3, 2)), np.zeros((3, 2)), np.array([np.inf, 300.0, 500.0]), np.array([400.0] * 3), np.zeros(3)
    )
    (text,) = texts(adv.on_lenses(NAMES, lens))
    assert "middle stops growing 300 px" in text
    assert "wave the light" in text
    (text,) = texts(adv.on_lenses(NAMES, replace(lens, farthest=np.full(3, 290.0))))
    assert "too wide for this model" in text


def test_a_principal_point_far_off():
    center = (SIZES - 1) / 2.0
    assert texts(adv.on_principal_points(NAMES, SIZES, center)) == []
    center[0] += [100, 0]
    assert "left" in texts(adv.on_principal_points(NAMES, SIZES, center))[0]


def test_residuals_with_a_pattern(summary):
    assert list(adv.on_pattern(summary)) == []
    outwards = (summary.pixels - summary.center) / 300.0
    bent = replace(summary, residuals=summary.residuals + 1.5 * outwards * (np.arange(4) == 1)[:, None])
    (item,) = adv.on_pattern(bent)
    assert summary.names[1] in item.finding


def clock(name, late=0.0, rate=1.0, certain=True, even=True):
    return CameraClock(name, late, rate, 0.2, 0.95 if certain else 0.19, certain, even)


def test_late_cameras_are_told_in_flags():
    timing, held = Timing(30.0, 900.0), np.zeros(3)
    in_step = [clock("left", 0.04), clock("middle"), clock("right", -0.1)]
    assert [*adv.on_clocks(in_step, timing, held), *adv.on_offsets(in_step)] == []
    (item,) = adv.on_clocks([clock("left"), clock("the middle", 36.97), clock("right", -2.4)], timing, held)
    assert item.urgent
    assert (
        "Camera the middle shows the light 37 frames late. Camera right shows the light 2.4 frames early."
        in item.finding
    )
    assert "`--offset 'the middle'=37 --offset right=-2.4`" in item.remedy
    (item,) = adv.on_offsets([clock("left"), clock("middle", 0.6), clock("right", -0.4)])
    assert "middle shows the light about 0.6 frames late, right shows the light about 0.4 frames early" in item.finding
    assert "--time-offsets" in item.remedy


def test_rolling_shutters_are_told_where_they_are_sure():
    small, unsure, unknown = clock("a"), clock("b"), clock("c")
    small, unsure = (replace(one, readout_frames=by, readout_sigma=sure) for one, by, sure in (
        (small, 0.08, 0.01), (unsure, 0.5, 0.13)
    ))  # fmt: skip
    assert list(adv.on_readouts([small, unsure, unknown])) == []
    rolling = [replace(clock("up"), readout_frames=0.61, readout_sigma=0.04),
               replace(clock("the other"), readout_frames=-0.6, readout_sigma=0.05)]  # fmt: skip
    (item,) = adv.on_readouts([small, *rolling])
    assert "0.61 ± 0.04 frames after in up, 0.60 ± 0.05 frames before in the other" in item.finding
    assert "`--readout up=0.61 --readout 'the other'=-0.6`" in item.remedy


@pytest.mark.parametrize(
    ("one", "rate", "said", "given"),
    [
        (clock("b", 0.0, 29.83 / 30), 30.0, "runs at 29.83 frames a second beside 30.", "--rate all=30 --rate b=29.83"),
        (
            clock("b", 12.0, 25 / 30),
            30.0,
            "beside 30 and shows the light 12 frames late",
            "--offset b=12 --rate all=30",
        ),
        (clock("b", 0.0, 1.02), None, "runs 1.02 times as fast as the others", "--rate all=30 --rate b=30.6"),
        (clock("b", 0.0, 30 / 29.83, even=False), None, "repeats a frame every 176", "--rate all=30 --rate b=29.83"),
        (clock("b", 0.0, 30 / 30.2, even=False), 30.0, "skips a frame every 150 frames", "--rate all=30 --rate b=30.2"),
    ],
)
def test_rates_are_told_beside_that_of_the_others(one, rate, said, given):
    (item,) = adv.on_clocks([clock("a"), one], Timing(rate, 900.0), np.zeros(2))
    assert said in item.finding
    assert f"`{given}" in item.remedy


def test_a_camera_that_fits_no_other_is_named_with_its_cause():
    clocks = [clock("left"), clock("middle", certain=False)]
    (item,) = adv.on_clocks(clocks, Timing(None, 900.0), np.zeros(2))
    assert "Camera middle fits no other" in item.finding
    assert "19% of its matches" in item.finding
    assert "--leave-out middle" in item.remedy
    (frozen,) = adv.on_clocks([clock("left"), clock("middle")], Timing(None, 900.0), np.array([0.0, 0.5]))
    assert "stands on one pixel in 50% of its frames" in frozen.finding
