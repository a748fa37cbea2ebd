"""Noise as asked for, gamma, and faults of clocks."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.config.simulation import FaultSettings, SensorSettings, SimulationSettings, ViewpointSettings
from jaxpoint.simulate.camera_clocks import make_clocks
from jaxpoint.simulate.sensor import NoiseField, Sensor, random_sensor

SIZE = (320, 200)


def flat_sensor(**parts) -> Sensor:
    return replace(Sensor(np.ones((SIZE[1], SIZE[0], 3), np.float32), 2000.0, 8.0, 100), **parts)


def linear(image):
    srgb = image / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("level", [0.05, 0.2, 0.6])
def test_noise_has_the_variance_of_photons_and_electronics(level):
    rng = np.random.default_rng(0)
    field = NoiseField(rng, SIZE)
    light = np.full((SIZE[1], SIZE[0], 3), level, np.float32)
    # One noise for all colours: JPEG keeps fewer pixels of colour than of brightness.
    noises = [np.repeat(field.window(rng)[..., :1], 3, axis=2) for _ in range(4)]
    images = np.stack([linear(flat_sensor().develop(light, noise)) for noise in noises])
    electrons = rng.poisson(2000.0 * level, 200_000) + rng.normal(0.0, 8.0, 200_000)
    assert images.mean() == pytest.approx(electrons.mean() / 2000, rel=0.01)
    assert images[..., 1].std() == pytest.approx(electrons.std() / 2000, rel=0.1)
    # Each frame has its own noise.
    assert abs(np.corrcoef(images[0, ..., 1].ravel(), images[1, ..., 1].ravel())[0, 1]) < 0.03


def test_exposure_puts_the_bright_part_of_the_room_where_it_belongs():
    room = np.random.default_rng(1).uniform(0.0, 3.0, (SIZE[1], SIZE[0], 3)).astype(np.float32)
    settings = SensorSettings()
    for seed in range(5):
        sensor = random_sensor(np.random.default_rng(seed), settings, room)
        image = linear(sensor.develop(room, np.zeros_like(room)))
        assert 0.3 < np.percentile(image, 85) < 0.8
        assert 75 <= sensor.jpeg_quality <= 95


def test_a_grey_camera_has_no_colour_and_a_dark_one_no_light():
    light = np.random.default_rng(2).uniform(0.0, 1.0, (SIZE[1] // 8, SIZE[0] // 8, 3)).astype(np.float32)
    light = np.kron(light, np.ones((8, 8, 1), np.float32))
    still = np.zeros_like(light)
    grey = flat_sensor(grey=True).develop(light, still).astype(int)
    assert np.ptp(grey, axis=2).max() <= 1
    dark = flat_sensor(response=np.full_like(light, 0.002)).develop(light, still)
    assert dark.max() < 10 < flat_sensor().develop(light, still).max()


def clocks_of(**faults):
    settings = SimulationSettings(viewpoints=ViewpointSettings(cameras=3), faults=FaultSettings(**faults))
    return make_clocks(np.random.default_rng(0), settings, 400)


def test_without_faults_all_cameras_are_in_step():
    clocks = clocks_of()
    assert clocks.present.all()
    np.testing.assert_array_equal(clocks.frame_index, np.repeat(np.arange(400)[:, None], 3, axis=1))
    np.testing.assert_allclose(clocks.shown_s, np.repeat(np.arange(400)[:, None] / 12.5, 3, axis=1))


def test_frames_are_dropped_and_repeated_as_often_as_asked():
    clocks = clocks_of(dropped=0.1, doubled=0.2)
    assert clocks.present.mean() == pytest.approx(0.9, abs=0.03)
    assert (np.diff(clocks.shown_s, axis=0) == 0).mean() == pytest.approx(0.2, abs=0.04)
    own = clocks.frame_index[:, 1]
    np.testing.assert_array_equal(own[own >= 0], np.arange((own >= 0).sum()))


def test_a_camera_stops_another_is_slow_and_clocks_are_late():
    clocks = clocks_of(stops=((1, 10.0),), half_rate=(2,), clock_offset_s=0.5, clock_drift=0.01)
    assert clocks.present[:, 0].all()
    assert clocks.present[:, 1].sum() == 125
    np.testing.assert_array_equal(clocks.present[:, 2], np.arange(400) % 2 == 0)
    late = clocks.shown_s - clocks.stamped_s
    assert (late[0] > 0).all()
    assert (late[0] < 0.5).all()
    assert np.abs(late[-1] - late[0]).max() == pytest.approx(0.16, abs=0.16)
    assert len(np.unique(np.round(late[-1] - late[0], 6))) == 3
