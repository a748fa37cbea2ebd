"""Markers of known colour on drawn people, against gates written out with the standard library."""

import colorsys

import cv2
import numpy as np
import pytest
from scipy import stats

from jaxpoint.config.person import MarkerSettings
from jaxpoint.detection.person.marker_regions import (
    MarkerReason,
    find_markers,
    is_mixture,
    marker_ends,
    marker_mask,
    train_marker,
)
from jaxpoint.detection.person.silhouette import Silhouette
from jaxpoint.detection.region import region_of
from jaxpoint.errors import InsufficientDataError

SETTINGS = MarkerSettings()
COLOURS = {"green": (60, 190, 40), "red": (30, 25, 200), "cyan": (200, 190, 20)}


def picked(colour, rng, count=200, spread=8.0):
    shade = rng.uniform(0.8, 1.1, (count, 1))
    return np.clip(shade * colour + rng.normal(0, spread, (count, 3)), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def scene(drawn):
    """A person in a room, without and with the silhouette that goes with it."""
    rng = np.random.default_rng(0)
    person = drawn.Person(250.0, 80.0, arm=0.3)
    image = person.drawn(drawn.room(rng))
    mask = person.drawn(image, mask_only=True) > 0
    region = region_of(mask)
    x, y, width, height = region.box
    return person, image, Silhouette(mask[y : y + height, x : x + width], region.box, region, drawn.size)


@pytest.mark.parametrize("name", COLOURS)
@pytest.mark.parametrize("gates", ["sigma", "fixed"])
def test_the_cap_on_the_finger_is_found(drawn, scene, name, gates):
    person, image, silhouette = scene
    rng = np.random.default_rng(1)
    settings = MarkerSettings(gates=gates)
    model = train_marker(picked(COLOURS[name], rng), settings)
    image = image.copy()
    half = 6 * np.array([np.cos(0.3), -np.sin(0.3)])
    start, stop = person.tip - half, person.tip + half  # half of it beyond the silhouette
    cap = np.zeros(image.shape[:2], np.uint8)
    cv2.line(cap, np.round(start).astype(int).tolist(), np.round(stop).astype(int).tolist(), 255, 5)
    image[cap > 0] = COLOURS[name]
    found = find_markers(drawn.exposed(image, rng), silhouette, model, SETTINGS)
    assert found.reason == MarkerReason.FOUND
    np.testing.assert_allclose(found.regions[0].centroid, person.tip, atol=2.5)
    assert found.regions[0].area > 0.5 * np.count_nonzero(cap)


@pytest.mark.parametrize(("length", "most"), [(8.0, 0.4), (12.0, 0.25), (30.0, 0.25)])
def test_ends_are_found_to_a_fraction_of_a_pixel(length, most):
    rng = np.random.default_rng(7)
    rows, columns = np.mgrid[:60, :60]
    errors = []
    for _ in range(40):
        center, angle = rng.uniform(28, 32, 2), rng.uniform(0, np.pi)
        along = np.array([np.cos(angle), np.sin(angle)])
        x, y = columns - center[0], rows - center[1]
        inside = (np.abs(x * along[0] + y * along[1]) <= length / 2) & (np.abs(-x * along[1] + y * along[0]) <= 2.0)
        far = center + np.sign(along @ (center - [5.0, 50.0])) * length / 2 * along
        ends = marker_ends(region_of(inside), np.array([5.0, 50.0]))
        errors += [ends.tip - far, ends.base - (2 * center - far)]
    assert np.sqrt(np.mean(np.square(errors))) < most  # px


def test_one_reason_for_every_cause(drawn, scene):
    person, image, silhouette = scene
    rng = np.random.default_rng(2)
    model = train_marker(picked(COLOURS["green"], rng), SETTINGS)
    plain = drawn.exposed(image, rng)
    assert find_markers(plain, silhouette, model, SETTINGS).reason == MarkerReason.NO_COLOUR
    x, y = np.round(person.tip).astype(int)
    plain[y : y + 2, x - 4 : x - 2] = COLOURS["green"]
    assert find_markers(plain, silhouette, model, SETTINGS).reason == MarkerReason.TOO_SMALL
    grey = np.repeat(plain.mean(axis=-1, keepdims=True), 3, axis=-1).astype(np.uint8)
    assert find_markers(grey, silhouette, model, SETTINGS).reason == MarkerReason.GREY


def test_the_hue_is_averaged_on_the_circle():
    pixels = picked(COLOURS["red"], np.random.default_rng(3))
    model = train_marker(pixels, SETTINGS)
    hues = cv2.cvtColor(pixels[None], cv2.COLOR_BGR2HSV)[0, :, 0]
    assert {*hues.tolist()} & {178, 179}
    assert {*hues.tolist()} & {0, 1}
    middle = stats.circmean(hues, high=180)
    assert abs((model.hue - middle + 90) % 180 - 90) < 1e-6


def test_clicks_beside_the_marker_change_little():
    rng = np.random.default_rng(8)
    own = picked(COLOURS["cyan"], rng)
    beside = picked(COLOURS["red"], rng, 60)
    clean, spoilt = (train_marker(pixels, SETTINGS) for pixels in (own, np.concatenate([own, beside])))
    assert abs(clean.hue - spoilt.hue) < 0.5
    assert clean.hue_gate == pytest.approx(spoilt.hue_gate, rel=0.2)
    assert clean.saturation == pytest.approx(spoilt.saturation, abs=3)


def test_the_gates_are_written_out():
    model = train_marker(picked(COLOURS["red"], np.random.default_rng(4)), MarkerSettings(gates="fixed"))
    colours = np.random.default_rng(5).integers(0, 256, (40, 50, 3)).astype(np.uint8)
    colours[:20] = np.clip(np.array(COLOURS["red"]) + np.random.default_rng(6).normal(0, 40, (20, 50, 3)), 0, 255)
    expected = np.zeros(colours.shape[:2], bool)
    for row, column in np.ndindex(expected.shape):
        blue, green, red = (colours[row, column] / 255).tolist()
        hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
        away = abs((hue * 180 - model.hue + 90) % 180 - 90)
        expected[row, column] = (
            away <= 10 and abs(saturation * 255 - model.saturation) <= 60 and abs(value * 255 - model.value) <= 70
        )
    found = marker_mask(colours, model)
    assert np.count_nonzero(found != expected) < 0.01 * expected.size  # hues in steps of two degrees
    assert np.count_nonzero(expected) > 100


def test_samples_of_several_colours_are_known():
    several = np.random.default_rng(5).integers((52, 80, 50), (78, 256, 250), (1, 90, 3)).astype(np.uint8)
    mixed = cv2.cvtColor(several, cv2.COLOR_HSV2BGR)[0]
    assert is_mixture(train_marker(mixed, SETTINGS), SETTINGS)
    assert not is_mixture(train_marker(picked(COLOURS["green"], np.random.default_rng(3)), SETTINGS), SETTINGS)
    fixed = MarkerSettings(gates="fixed")
    assert not is_mixture(train_marker(mixed, fixed), fixed)


def test_a_marker_trained_on_nothing_or_on_grey_is_refused():
    with pytest.raises(InsufficientDataError, match="at least 20 pixels, and 0 were picked"):
        train_marker(np.zeros((0, 3), np.uint8), SETTINGS)
    grey = np.full((50, 3), 128, np.uint8)
    with pytest.raises(InsufficientDataError, match="median saturation of 0"):
        train_marker(grey, SETTINGS)
