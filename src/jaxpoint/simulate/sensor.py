"""From light to 8-bit images: exposure, white balance, vignetting, Poisson and read noise, gamma, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy.random import Generator

from jaxpoint.config.simulation import SensorSettings

LEVELS = 1 << 14  # of the converter before the gamma curve
WHITE = 0.55  # share of the range that the bright parts of a well-exposed room reach
STRIP = 12  # rows developed at once, so that they stay in the processor's cache
MARGIN_PX = 64  # by which a field of noise is larger than the image


@dataclass(frozen=True)
class Sensor:
    """One camera's electronics."""

    response: Float[np.ndarray, "H W 3"]  # share of the range for linear light 1: exposure, white balance, vignetting
    full_well_e: float
    read_noise_e: float
    jpeg_quality: int
    grey: bool = False

    @property
    def variance(self) -> tuple[float, float]:
        """Of a signal s (share of the range): the first times s, plus the second."""
        return 1 / self.full_well_e, (self.read_noise_e / self.full_well_e) ** 2

    def develop(
        self, light: Float[np.ndarray, "H W 3"], noise: Float[np.ndarray, "H W 3"], brightness: float = 1.0
    ) -> UInt8[np.ndarray, "H W 3"]:
        """The 8-bit image of linear light (blue, green, red).

        Args:
            light: what arrives.
            noise: standard normal numbers.
            brightness: of all lamps at this moment.
        """
        image = np.empty(light.shape, np.uint8)
        for top in range(0, len(light), STRIP):
            rows = np.s_[top : top + STRIP]
            image[rows] = self._digits(light[rows], self.response[rows], noise[rows], brightness)
        if self.grey:
            image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        return self.compressed(image)

    def _digits(self, light: np.ndarray, response: np.ndarray, noise: np.ndarray, brightness: float) -> np.ndarray:
        signal = light * response
        signal *= np.float32(brightness * (LEVELS - 1))
        per_signal, constant = self.variance
        deviation = signal * np.float32(per_signal * (LEVELS - 1))
        deviation += np.float32(constant * (LEVELS - 1) ** 2)
        np.sqrt(deviation, out=deviation)
        deviation *= noise
        signal += deviation
        np.clip(signal, 0, LEVELS - 1, out=signal)
        return _GAMMA.take(signal.astype(np.uint16), mode="clip")

    def compressed(self, image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """The image after the camera's JPEG."""
        coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))


def random_sensor(rng: Generator, settings: SensorSettings, room: Float[np.ndarray, "H W 3"]) -> Sensor:
    """A sensor whose exposure suits this picture of the empty room (linear light), as automatic exposure would."""

    def draw(bounds) -> float:
        return float(rng.uniform(bounds.low, bounds.high))

    height, width = room.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    square = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / (width**2 + height**2) * 4
    falloff = 1 - draw(settings.vignetting) * square
    gains = np.array([draw(settings.white_balance), 1.0, draw(settings.white_balance)], np.float32)
    level = WHITE * draw(settings.exposure) / np.percentile(room[::4, ::4].mean(axis=2), 85)
    return Sensor(
        (falloff[..., None] * gains * np.float32(level)).astype(np.float32),
        draw(settings.full_well_e),
        draw(settings.read_noise_e),
        round(draw(settings.jpeg_quality)),
    )


class NoiseField:
    """Standard normal numbers for images of one size: windows of one large field, placed at random.

    Drawing 2.8 million numbers anew for every frame would take longer than all else.
    """

    def __init__(self, rng: Generator, size: tuple[int, int]):
        width, height = size
        self.size = size
        self._field = rng.standard_normal((height + MARGIN_PX, width + MARGIN_PX, 3), dtype=np.float32)

    def window(self, rng: Generator) -> Float[np.ndarray, "H W 3"]:
        """The noise of one frame."""
        x, y = rng.integers(MARGIN_PX, size=2)
        width, height = self.size
        return self._field[y : y + height, x : x + width]


def _gamma() -> np.ndarray:
    """sRGB (IEC 61966-2-1) of every level."""
    light = (np.arange(LEVELS) + 0.5) / LEVELS
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


_GAMMA = _gamma()
