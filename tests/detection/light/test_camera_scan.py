"""One camera from image files to positions, on drawn recordings with known truth."""

import cv2
import numpy as np
import pytest

from jaxpoint.config import LedSettings
from jaxpoint.detection.light.blob import Reason
from jaxpoint.detection.light.camera_scan import find_lights
from jaxpoint.errors import FileFormatError, InsufficientDataError


def find(folder, **settings):
    return find_lights(LedSettings(**settings), (folder, None), lambda done, total: None)


@pytest.fixture(scope="module", params=["robust", "thesis"])
def spoilt(request, recording):
    return recording, find(recording.folder, method=request.param)


def test_each_reason_fires_on_its_own_frame_and_nowhere_else(spoilt):
    recording, lights = spoilt
    fired = {int(frame): Reason(lights.reasons[frame]).name for frame in np.flatnonzero(lights.reasons)}
    assert fired == recording.spoilt


def test_positions_are_sharp_and_unbiased(spoilt):
    recording, lights = spoilt
    good = ~np.isnan(recording.places[:, 0])
    errors = lights.pixels[good] - recording.places[good]
    assert np.sqrt((errors**2).mean()) < 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    assert not lights.pixels[~good].any()


def test_the_colour_of_the_light_is_found_and_reported(spoilt, drawing):
    _, lights = spoilt
    assert lights.stats.channel == "green"
    assert lights.stats.found == 116
    assert lights.stats.noise == pytest.approx(drawing.noise, abs=1.0)
    assert lights.stats.brightness == pytest.approx(150, rel=0.1)


@pytest.mark.parametrize("contrast", [20, 60])
def test_a_hidden_light_is_not_found_in_noise_nor_on_a_moving_person(tmp_path, drawing, contrast):
    """Hidden for 40 of 120 frames while a person in textured cloth walks; 10 show a faint reflection."""
    rng = np.random.default_rng(2)
    hidden, reflected = np.arange(120) % 3 == 0, np.arange(120) % 12 == 0
    rows, columns = np.mgrid[: drawing.size[1], : drawing.size[0]]
    cloth = cv2.GaussianBlur(rng.normal(0, contrast, rows.shape), (0, 0), 1.5)
    for frame in range(120):
        person = (np.abs(columns - frame) < 12) & (np.abs(rows - 70) < 35)
        scene = person * (10 + np.roll(cloth, frame, axis=1))
        if not hidden[frame]:
            scene = scene + drawing.light(150 - frame, 20 + 0.6 * frame)
        elif reflected[frame]:
            scene = scene + drawing.light(120, 15, amplitude=15)
        cv2.imwrite(str(tmp_path / f"{frame:04d}.png"), drawing.image(scene, rng))
    lights = find(tmp_path)
    found = lights.reasons == Reason.FOUND
    assert not found[hidden].any()
    assert found[~hidden].mean() > 0.95


def test_too_few_frames_to_learn_a_background(recording):
    with pytest.raises(InsufficientDataError, match=r"120 frames.* at least 121"):
        find(recording.folder, min_frames=121)


def test_an_image_of_another_size_is_named(tmp_path):
    for frame in range(3):
        cv2.imwrite(str(tmp_path / f"{frame}.png"), np.zeros((20, 30 + (frame == 2), 3), np.uint8))
    with pytest.raises(FileFormatError, match=r"2\.png.*31 x 20 px.*0\.png.*30 x 20"):
        find(tmp_path, min_frames=3)


@pytest.mark.parametrize("method", ["robust", "thesis"])
def test_a_recording_without_any_light(tmp_path, drawing, method):
    rng = np.random.default_rng(4)
    for frame in range(100):
        cv2.imwrite(str(tmp_path / f"{frame}.png"), drawing.image(np.zeros(drawing.size[::-1]), rng))
    lights = find(tmp_path, method=method)
    assert not (lights.reasons == Reason.FOUND).any()
    assert lights.stats.found == 0
    assert lights.stats.brightness == 0
