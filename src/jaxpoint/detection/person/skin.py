"""Which pixels have the colour of skin (thesis 6.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from jaxpoint.config.person import SkinSettings
from jaxpoint.detection.colour import Image, is_grey, scale_channels

CR = (133, 173)
CB = (77, 127)
HUE_DEG = (3.6, 36.0)  # 0.01 to 0.10 of the circle
RED_WRAP_DEG = 339.0  # hues from here on are red as well; not the thesis's
MIN_SATURATION = 40 / 255  # a grey pixel's hue is noise
MIN_VALUE = 40 / 255
MIN_SAMPLES = 50
VARIANCE_FLOOR = 1.0  # grey levels^2: what rounding leaves
GAINS = (0.5, 2.0)


@dataclass(frozen=True)
class ColourGaussian:
    """A normal distribution of (Cr, Cb), grey levels."""

    mean: tuple[float, float]
    covariance: tuple[float, float, float]  # of Cr; of Cr with Cb; of Cb

    def log_density(self, colours: Float[np.ndarray, "*N 2"]) -> Float[np.ndarray, "*N"]:
        """Natural logarithm of the density at (Cr, Cb), each in grey levels."""
        a, b, c = self.covariance
        determinant = a * c - b * b
        cr, cb = colours[..., 0] - self.mean[0], colours[..., 1] - self.mean[1]
        distance = (c * cr**2 - 2 * b * cr * cb + a * cb**2) / determinant
        return -0.5 * (distance + np.log(determinant)) - np.log(2 * np.pi)


# Fitted by `experiments/skin_models.py`: the first to the skin of UCI Skin Segmentation (50,859 pixels of many faces
# of several ages and tones), the second to the hands of 20 images of EgoHands and HandOverFace, the rest to UCI's other
# pixels.
SKIN = (
    ColourGaussian((159.4, 101.9), (37.3, -40.7, 81.5)),
    ColourGaussian((146.6, 114.0), (56.4, -50.7, 70.5)),
)
OTHER = (ColourGaussian((114.7, 132.1), (592.0, -172.7, 293.7)),)


@dataclass(frozen=True)
class SkinModel:
    """Colours of skin. `fitted`: equal parts of Gaussians of skin against equal parts of those of the rest."""

    kind: Literal["fitted", "box", "thesis"] = "fitted"
    skin: tuple[ColourGaussian, ...] = ()
    other: tuple[ColourGaussian, ...] = ()
    threshold: float = 0.0  # nats; `fitted` only
    red_wrap: bool = False  # `thesis` only: hues just below red count as well, which the thesis leaves out


def skin_model(settings: SkinSettings) -> SkinModel:
    """The model that is asked for, with the numbers shipped."""
    if settings.model == "fitted":
        return SkinModel("fitted", SKIN, OTHER, settings.threshold)
    return SkinModel(settings.model, red_wrap=settings.red_wrap)


def skin_mask(image: Image, model: SkinModel) -> Bool[np.ndarray, "H W"]:
    """Pixels that have the colour of skin.

    Raises:
        ValueError: a fitted model without Gaussians.
    """
    if model.kind == "fitted":
        return skin_likelihood(image, model) >= model.threshold
    in_colour = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    mask = cv2.inRange(in_colour, (0, CR[0], CB[0]), (255, CR[1], CB[1])) > 0
    return mask & _skin_hue(image, model.red_wrap) if model.kind == "thesis" else mask


def skin_likelihood(image: Image, model: SkinModel) -> Float32[np.ndarray, "H W"]:
    """Logarithm of how much likelier a pixel's colour is on skin than elsewhere, nats.

    A function of Cr and Cb alone, so that it holds in the light and in the shade; it is looked up in a table.

    Raises:
        ValueError: the model has no Gaussians.
    """
    if not (model.skin and model.other):
        raise ValueError(f"A skin model of kind '{model.kind}' has no likelihood; fit one with `fit_skin`.")
    in_colour = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    index = np.bitwise_or(in_colour[..., 1].astype(np.uint16) << 8, in_colour[..., 2])
    return _table(model.skin, model.other).take(index)


def fit_skin(
    skin_bgr: Sequence[UInt8[np.ndarray, "_ 3"]] | UInt8[np.ndarray, "_ 3"],
    other_bgr: Sequence[UInt8[np.ndarray, "_ 3"]] | UInt8[np.ndarray, "_ 3"],
) -> SkinModel:
    """A model from pixels of skin and of anything else; several sets of pixels make a Gaussian each, of equal weight.

    Raises:
        ValueError: fewer than 50 pixels in a set, or pixels without colour.
    """
    return SkinModel("fitted", _gaussians(skin_bgr, "skin"), _gaussians(other_bgr, "anything else"))


def white_gains(image: Image) -> Float[np.ndarray, "3"]:
    """Gains of blue, green, red that make the 6-norm of the image grey (Finlayson & Trezzi's shades of grey).

    Take them from the empty room: a person near the camera is no sample of its light. Green's gain is 1.
    """
    some = image[::4, ::4].reshape(-1, 3)
    usable = some[(some.max(axis=1) < 250) & (some.max(axis=1) > 20)].astype(float)
    if len(usable) < MIN_SAMPLES:
        return np.ones(3)
    strength = (usable**6).mean(axis=0) ** (1 / 6)
    return np.clip(strength[1] / np.maximum(strength, 1e-6), *GAINS)


def white_balance(image: Image, gains: Float[np.ndarray, "3"] | None = None) -> Image:
    """The image with its channels times `gains`, by default its own `white_gains`."""
    factors = white_gains(image) if gains is None else gains
    return scale_channels(image, factors)


def _skin_hue(image: Image, red_wrap: bool) -> Bool[np.ndarray, "H W"]:
    hue, saturation, value = cv2.split(cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_BGR2HSV))
    red = (hue >= HUE_DEG[0]) & (hue <= HUE_DEG[1])
    if red_wrap:
        red |= hue >= RED_WRAP_DEG
    return red & (saturation >= MIN_SATURATION) & (value >= MIN_VALUE)


def _gaussians(sets: Sequence[np.ndarray] | np.ndarray, what: str) -> tuple[ColourGaussian, ...]:
    return tuple(_gaussian(pixels, what) for pixels in ([sets] if isinstance(sets, np.ndarray) else sets))


def _gaussian(pixels: UInt8[np.ndarray, "N 3"], what: str) -> ColourGaussian:
    if len(pixels) < MIN_SAMPLES:
        raise ValueError(f"{len(pixels)} pixels of {what} are too few; give at least {MIN_SAMPLES}.")
    if is_grey(pixels[:, None]):
        raise ValueError(f"The pixels of {what} are grey; skin is recognised by its colour.")
    colours = cv2.cvtColor(pixels[None], cv2.COLOR_BGR2YCrCb)[0, :, 1:].astype(float)
    (a, b), (_, c) = (np.cov(colours.T) + VARIANCE_FLOOR * np.eye(2)).tolist()
    cr, cb = colours.mean(axis=0).tolist()
    return ColourGaussian((cr, cb), (a, b, c))


@lru_cache(maxsize=8)
def _table(skin: tuple[ColourGaussian, ...], other: tuple[ColourGaussian, ...]) -> Float32[np.ndarray, " 65536"]:
    """Log-likelihood ratio of every Cr (high byte) and Cb (low byte)."""
    colours = np.stack(np.meshgrid(np.arange(256.0), np.arange(256.0), indexing="ij"), axis=-1)
    parts = [
        np.logaddexp.reduce([gaussian.log_density(colours) for gaussian in mixture]) - np.log(len(mixture))
        for mixture in (skin, other)
    ]
    return (parts[0] - parts[1]).astype(np.float32).ravel()
