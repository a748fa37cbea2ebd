"""Drawn lights whose places are known, and a recording made of them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

SIZE = (160, 120)  # px
NOISE = 2.0  # grey levels


def draw_light(x, y, amplitude=150.0, sigma=1.3, size=SIZE, angle=0.0, long=1.0):
    """A Gaussian at pixel (x, y), `long` times longer along `angle` (rad)."""
    rows, columns = np.mgrid[: size[1], : size[0]]
    along = (columns - x) * np.cos(angle) + (rows - y) * np.sin(angle)
    across = -(columns - x) * np.sin(angle) + (rows - y) * np.cos(angle)
    return amplitude * np.exp(-0.5 * ((along / (long * sigma)) ** 2 + (across / sigma) ** 2))


def to_image(light, rng, background=30.0):
    """An 8-bit BGR image: a green light over a noisy grey background."""
    image = np.stack([0.3 * light, light, 0.3 * light], axis=-1) + background
    return np.clip(np.round(image + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Recording:
    """Where the light was drawn in each frame; NaN where it was hidden or spoilt on purpose."""

    folder: Path
    places: np.ndarray  # F 2, px
    spoilt: dict[int, str]  # the reason that each spoilt frame must give


def record_light(folder: Path) -> Recording:
    """120 frames of a light on a path, four of them spoilt, one for each of the thesis's reasons (a) to (d)."""
    rng = np.random.default_rng(1)
    phase = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    places = np.stack([80 + 60 * np.cos(phase), 60 + 40 * np.sin(2 * phase)], axis=1) + rng.uniform(-0.5, 0.5, (120, 2))
    spoilt = {
        20: np.where(np.hypot(*(np.mgrid[:120, :160] - np.array([60, 80])[:, None, None])) < 12, 150.0, 0.0),
        40: draw_light(80, 60, amplitude=5.0),
        60: draw_light(30, 30) + draw_light(120, 80),
        80: draw_light(80, 60, angle=0.6, long=5.0),
    }
    for frame, (x, y) in enumerate(places):
        cv2.imwrite(str(folder / f"shot{frame}.png"), to_image(spoilt.get(frame, draw_light(x, y)), rng))
    places[list(spoilt)] = np.nan
    return Recording(folder, places, {20: "TOO_LARGE", 40: "WEAK", 60: "SEVERAL", 80: "BLURRED"})
