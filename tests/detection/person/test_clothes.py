"""Shirts of the colour of skin."""

import cv2
import numpy as np
import pytest

from jaxpoint.detection.person.clothes import shirt_like_skin

HEAD = (100.0, 60.0, 50.0)
SKIN = (120, 150, 205)  # blue, green, red
BEIGE = (140, 196, 214)


def drawn(shirt, skin=SKIN, seed=0):
    """A person from the front with an arm before the chest, in uneven light: image, person, arm, chest."""
    image = np.full((300, 200, 3), 90, np.uint8)
    chest = np.zeros((300, 200), np.uint8)
    cv2.rectangle(chest, (65, 95), (135, 230), 1, -1)
    face, arm = np.zeros_like(chest), np.zeros_like(chest)
    cv2.ellipse(face, (100, 64), (20, 28), 0, 0, 360, 1, -1)
    cv2.line(arm, (70, 190), (125, 150), 1, 13)
    for mask, colour in ((chest, shirt), (face, skin), (arm, skin)):
        image[mask > 0] = colour
    light = np.linspace(0.75, 1.1, 300)[:, None, None]
    noisy = image * light + np.random.default_rng(seed).normal(0.0, 2.5, image.shape)
    person = (chest | face | arm) > 0
    return np.clip(noisy, 0, 255).astype(np.uint8), person, arm > 0, (chest > 0) & (arm == 0)


def test_a_beige_shirt_is_told_from_the_arm_before_it():
    image, person, arm, chest = drawn(BEIGE)
    shirt = shirt_like_skin(image, person, person, HEAD)
    assert shirt is not None
    assert shirt[chest].mean() > 0.95
    assert shirt[arm].mean() < 0.05


@pytest.mark.parametrize("case", ["a bare chest", "a shirt that is no skin", "the head is elsewhere"])
def test_where_nothing_can_be_told_nothing_is(case):
    image, person, _, chest = drawn(SKIN if case == "a bare chest" else BEIGE)
    skin = person & ~chest if case == "a shirt that is no skin" else person
    head = (30.0, 20.0, 20.0) if case == "the head is elsewhere" else HEAD
    assert shirt_like_skin(image, person, skin, head) is None
