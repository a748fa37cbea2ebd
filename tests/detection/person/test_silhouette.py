"""Silhouettes of drawn people against the masks with which they were drawn."""

import cv2
import numpy as np
import pytest

from jaxpoint.config.person import BackgroundSettings, SilhouetteSettings
from jaxpoint.detection.person.silhouette import (
    AdaptiveBackground,
    close_gaps,
    foreground,
    learn_background,
    never_clears,
    silhouettes,
    thicken,
)
from jaxpoint.errors import InsufficientDataError

SETTINGS, SHAPES = BackgroundSettings(), SilhouetteSettings()


@pytest.fixture(scope="module")
def scene(drawn):
    """A room without noise, the background learnt from it, and someone to be in it."""
    rng = np.random.default_rng(0)
    empty = drawn.room(rng)
    return empty, learn_background([drawn.exposed(empty, rng) for _ in range(25)], SETTINGS), drawn.Person(250.0, 70.0)


def overlap(first, second):
    return np.count_nonzero(first & second) / np.count_nonzero(first | second)


@pytest.mark.parametrize("gain", [1.0, 0.9, 1.08])
def test_a_person_is_the_one_silhouette(drawn, scene, gain):
    empty, background, person = scene
    image = drawn.exposed(person.drawn(empty), np.random.default_rng(1), gain=gain)
    (found,) = silhouettes(foreground(image, background, SETTINGS), SHAPES)
    truth = person.drawn(empty, mask_only=True) > 0
    assert overlap(found.full(), truth) > 0.9
    rows, columns = np.nonzero(truth)
    np.testing.assert_allclose(found.region.centroid, [columns.mean(), rows.mean()], atol=1.5)
    assert found.region.area == np.count_nonzero(found.mask)
    assert found.mask.shape == found.box[:1:-1]
    assert not found.at_border


def test_two_people_are_two_and_the_larger_comes_first(drawn, scene):
    empty, background, person = scene
    small = drawn.Person(480.0, 90.0, height=160.0, shirt=(60, 120, 60))
    image = drawn.exposed(small.drawn(person.drawn(empty)), np.random.default_rng(2))
    found = silhouettes(foreground(image, background, SETTINGS), SHAPES)
    assert len(found) == 2
    for silhouette, who in zip(found, (person, small)):
        assert overlap(silhouette.full(), who.drawn(empty, mask_only=True) > 0) > 0.85
    assert len(silhouettes(foreground(image, background, SETTINGS), SilhouetteSettings(people=1))) == 1


def test_an_empty_room_with_flicker_and_drift_is_empty(drawn, scene):
    """One image a second for ten minutes: 3 % of flicker, and the light goes down by a third meanwhile."""
    empty, background, _ = scene
    rng = np.random.default_rng(3)
    for gain in np.linspace(1.0, 0.67, 600)[::12] * rng.uniform(0.97, 1.03, 50):
        assert silhouettes(foreground(drawn.exposed(empty, rng, gain=gain), background, SETTINGS), SHAPES) == []


def test_a_shadow_is_not_the_person(drawn, scene):
    empty, background, person = scene
    shade = np.zeros(drawn.size[::-1], np.float32)
    cv2.ellipse(shade, (330, 290), (90, 22), 0, 0, 360, 1.0, -1)
    shaded = empty * (1 - 0.22 * cv2.GaussianBlur(shade, (0, 0), 6))[..., None]
    image = drawn.exposed(person.drawn(shaded), np.random.default_rng(4))
    truth = person.drawn(empty, mask_only=True) > 0
    with_shadow = foreground(image, background, BackgroundSettings(shadows=False)) > 0
    (found,) = silhouettes(foreground(image, background, SETTINGS), SHAPES)
    assert overlap(with_shadow, truth) < 0.8
    assert overlap(found.full(), truth) > 0.88


def test_half_a_person_touches_the_border(drawn, scene):
    empty, background, _ = scene
    image = drawn.exposed(drawn.Person(4.0, 70.0).drawn(empty), np.random.default_rng(5))
    assert silhouettes(foreground(image, background, SETTINGS), SHAPES)[0].at_border


def test_darkness_and_glare_show_nobody(drawn, scene):
    empty, background, _ = scene
    for level in (0, 255):
        blank = np.full_like(drawn.exposed(empty, np.random.default_rng(0)), level)
        assert not silhouettes(blank[..., 0] * 0, SHAPES)
        found = silhouettes(foreground(blank, background, SETTINGS), SHAPES)
        assert all(silhouette.region.area > 0.5 * drawn.size[0] * drawn.size[1] for silhouette in found)


@pytest.mark.parametrize("method", ["mog2", "knn"])
def test_adaptive_backgrounds_find_a_walker(drawn, scene, method):
    empty, _, person = scene
    rng = np.random.default_rng(6)
    model = AdaptiveBackground(BackgroundSettings(method=method))
    for _ in range(40):
        model.foreground(drawn.exposed(empty, rng))
    mask = model.foreground(drawn.exposed(person.drawn(empty), rng))
    assert overlap(silhouettes(mask, SHAPES)[0].full(), person.drawn(empty, mask_only=True) > 0) > 0.75


def test_one_who_never_leaves_is_noticed_and_one_who_walks_is_not(drawn, scene):
    empty, _, _ = scene
    rng = np.random.default_rng(7)
    swaying = [drawn.Person(250 + 8 * np.sin(0.7 * i), 70.0, arm=0.3 * np.sin(0.5 * i)) for i in range(30)]
    walking = [drawn.Person(40.0 + 18 * i, 70.0) for i in range(30)]
    stays, walks = (
        never_clears([drawn.exposed(who.drawn(empty), rng) for who in people], SETTINGS)
        for people in (swaying, walking)
    )
    assert walks < 0.02
    assert stays > 0.2


def test_thickening_never_joins():
    rng = np.random.default_rng(8)
    mask = np.where(rng.random((60, 80)) < 0.08, np.uint8(255), np.uint8(0))
    before = cv2.connectedComponents(mask, connectivity=8)[0]
    grown = thicken(mask)
    assert cv2.connectedComponents(grown, connectivity=8)[0] == before
    assert np.count_nonzero(grown) > 1.3 * np.count_nonzero(mask)
    assert (grown[mask > 0] > 0).all()
    dot = np.zeros((9, 9), np.uint8)
    dot[4, 4] = 255
    np.testing.assert_array_equal(thicken(dot), cv2.dilate(dot, np.ones((3, 3), np.uint8)))


def test_closing_is_dilation_then_erosion():
    mask = np.zeros((40, 40), np.uint8)
    mask[10:30, 8:18] = mask[10:30, 22:32] = 255  # 4 px apart
    assert (close_gaps(mask, 7)[10:30, 18:22] == 255).all()
    np.testing.assert_array_equal(close_gaps(mask, 3), mask)


def test_too_few_images_and_another_size_are_refused(drawn, scene):
    empty, background, _ = scene
    image = drawn.exposed(empty, np.random.default_rng(9))
    with pytest.raises(InsufficientDataError, match=f"at least {SETTINGS.min_frames} images, and there are 3"):
        learn_background([image] * 3, SETTINGS)
    with pytest.raises(ValueError, match="learn it anew"):
        foreground(image[:100], background, SETTINGS)
