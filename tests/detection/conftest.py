"""Drawn lights and people whose places are known."""

from dataclasses import dataclass
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from lights import NOISE, SIZE, Recording, draw_light, record_light, to_image


@pytest.fixture(scope="session")
def drawing() -> SimpleNamespace:
    """The tools above, for tests that draw their own recordings."""
    return SimpleNamespace(size=SIZE, noise=NOISE, light=draw_light, image=to_image)


@pytest.fixture(scope="session")
def recording(tmp_path_factory) -> Recording:
    """120 frames of a light, four of them spoilt."""
    return record_light(tmp_path_factory.mktemp("spoilt"))


ROOM_SIZE = (640, 360)  # px
SKIN = (128, 158, 205)  # blue, green, red
SHIRT, TROUSERS, SHOES, HAIR = (120, 60, 40), (45, 42, 48), (30, 30, 34), (24, 30, 38)
SHIFT = 4  # bits behind the point in which OpenCV draws


def draw_room(rng, size=ROOM_SIZE):
    """Walls, a floor and furniture of mild colours, without noise; float64."""
    coarse = rng.uniform(90, 190, (size[1] // 60, size[0] // 60, 1)) + rng.uniform(-12, 12, (1, 1, 3))
    image = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    for _ in range(12):
        x, y = rng.integers(0, size[0]), rng.integers(0, size[1])
        w, h = rng.integers(20, 90), rng.integers(20, 90)
        image[y : y + h, x : x + w] = rng.uniform(60, 200) + rng.uniform(-15, 15, 3)
    return image


GRAIN = np.random.default_rng(0).normal(0, 1, (2 * ROOM_SIZE[1], 2 * ROOM_SIZE[0], 3)).astype(np.float32)


def expose(image, rng, noise=2.0, gain=1.0):
    """What a camera makes of it; the noise is a random part of one drawn once, as drawing it takes longest."""
    rows, columns = image.shape[:2]
    top, left = rng.integers(0, GRAIN.shape[0] - rows), rng.integers(0, GRAIN.shape[1] - columns)
    grain = np.float32(noise) * GRAIN[top : top + rows, left : left + columns]
    return cv2.convertScaleAbs(np.maximum(np.float32(gain) * image.astype(np.float32) + grain, 0))


@dataclass(frozen=True)
class Person:
    """An upright person of `height` px whose head's middle is at (x, y); the arm points to `arm` radians, y up."""

    x: float
    y: float
    height: float = 230.0
    arm: float | None = 0.2
    aspect: float = 0.78
    skin: tuple = SKIN
    shirt: tuple = SHIRT
    side: int = 1  # of the arm: 1 to the right

    @property
    def head(self):
        """Height of the head, px."""
        return self.height / 7.2

    @property
    def elbow(self):
        shoulder = np.array([self.x + self.side * 0.1 * self.height, self.y + 0.14 * self.height])
        return shoulder + 0.16 * self.height * self._arm_direction

    @property
    def tip(self):
        return self.elbow + 0.2 * self.height * self._arm_direction

    @property
    def _arm_direction(self):
        return np.array([self.side * np.cos(self.arm), -np.sin(self.arm)])

    def drawn(self, image, mask_only=False):
        """The image with the person, or a mask of it (H, W)."""
        canvas = np.zeros(image.shape[:2], np.uint8) if mask_only else image.copy()
        h = self.height

        def colour(value):
            return 255 if mask_only else value

        def ellipse(x, y, a, b, value):
            center = (round(x * 2**SHIFT), round(y * 2**SHIFT))
            axes = (round(a * 2**SHIFT), round(b * 2**SHIFT))
            cv2.ellipse(canvas, center, axes, 0, 0, 360, colour(value), -1, shift=SHIFT)

        def bar(start, stop, width, value):
            start, stop = np.asarray(start, float), np.asarray(stop, float)
            normal = np.array([start[1] - stop[1], stop[0] - start[0]])
            normal *= width / 2 / np.hypot(*normal)
            corners = np.array([start + normal, stop + normal, stop - normal, start - normal])
            cv2.fillPoly(canvas, [np.round(corners * 2**SHIFT).astype(np.int32)], colour(value), shift=SHIFT)

        x, y, half = self.x, self.y, self.head / 2
        for leg in (-1, 1):
            bar((x + leg * 0.05 * h, y + 0.4 * h), (x + leg * 0.06 * h, y + 0.9 * h), 0.075 * h, TROUSERS)
            ellipse(x + leg * 0.07 * h, y + 0.91 * h, 0.05 * h, 0.02 * h, SHOES)
        bar((x, y + 0.05 * h), (x, y + 0.15 * h), 0.06 * h, self.skin)
        ellipse(x, y + 0.3 * h, 0.1 * h, 0.2 * h, self.shirt)
        bar((x - self.side * 0.1 * h, y + 0.15 * h), (x - self.side * 0.13 * h, y + 0.45 * h), 0.06 * h, self.shirt)
        if self.arm is not None:
            shoulder = self.elbow - 0.16 * h * self._arm_direction
            bar((x, y + 0.16 * h), shoulder, 0.065 * h, self.shirt)
            bar(shoulder, self.elbow, 0.065 * h, self.shirt)
            bar(self.elbow, self.tip, 0.042 * h, self.skin)
        ellipse(x, y, self.aspect * half, half, self.skin)
        return canvas


@pytest.fixture(scope="session")
def drawn() -> SimpleNamespace:
    """Drawn rooms and people."""
    return SimpleNamespace(size=ROOM_SIZE, skin=SKIN, room=draw_room, exposed=expose, Person=Person)
