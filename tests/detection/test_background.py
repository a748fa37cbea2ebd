import numpy as np
import pytest

from jaxpoint.detection.background import mean_background, median_background


@pytest.fixture(scope="module")
def frames():
    rng = np.random.default_rng(0)
    return np.clip(rng.normal(100, rng.uniform(0, 20, (1, 12, 17)), (51, 12, 17)), 0, 255).astype(np.uint8)


def test_one_pass_mean_and_deviation_are_numpys(frames):
    background = mean_background(iter(frames))
    np.testing.assert_allclose(background.level, frames.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(background.deviation, np.maximum(frames.std(axis=0), 1), rtol=1e-5)
    assert background.level.dtype == np.float32


def test_median_and_mad_are_numpys_to_half_a_grey_level(frames):
    background = median_background(frames)
    median = np.median(frames, axis=0)
    mad = np.median(np.abs(frames - median), axis=0)
    np.testing.assert_allclose(background.level, median, atol=0.5)
    np.testing.assert_allclose(background.deviation, np.maximum(1.4826 * mad, 1), atol=1.4826 * 0.5)


@pytest.mark.parametrize("noise", [1.5, 2.0, 3.0])
def test_rounding_to_grey_levels_does_not_bias_the_deviation(noise):
    values = np.random.default_rng(1).normal(40.3, noise, (151, 20, 50))
    background = median_background(np.round(values).astype(np.uint8))
    assert np.median(background.deviation) == pytest.approx(noise, rel=0.1)
    assert np.median(background.level) == pytest.approx(40.3, abs=0.05)


def test_a_light_that_rests_in_a_third_of_the_frames_stays_out_of_the_median_only():
    frames = np.full((90, 5, 5), 20, dtype=np.uint8)
    frames[:30, 2, 2] = 220
    median, mean = median_background(frames), mean_background(frames)
    assert median.level[2, 2] == pytest.approx(20, abs=0.5)
    assert median.deviation[2, 2] == 1
    assert mean.level[2, 2] > 80
    assert mean.deviation[2, 2] > 80


@pytest.mark.parametrize("learn", [lambda frames: mean_background(iter(frames)), median_background])
def test_no_frames_is_an_error(learn):
    with pytest.raises(ValueError, match="at least one frame"):
        learn(np.zeros((0, 4, 4), dtype=np.uint8))
