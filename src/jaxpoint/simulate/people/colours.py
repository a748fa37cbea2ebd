"""Colours of skin, hair and cloth, as linear red, green, blue."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Means of CIELAB (D65). Lightest and third: inner and outer skin of Xiao et al., Skin Research and Technology 23
# (2017), four groups, 960 people (inner arm L* 61 to 63, a* 6 to 7, b* 14 to 17; forehead 56 to 59, 12, 15 to 18),
# the lightest at one standard deviation above its mean. Fourth: de Rigal et al., the same journal, 16 (2010) (L* 44 to
# 48, a* 14 to 15, b* 19 to 20). Darkest: the patch "dark skin" of the ColorChecker (38, 14, 14).
TONES = np.array([[38.0, 13.6, 14.1], [46.0, 14.5, 19.5], [57.5, 11.7, 16.5], [62.0, 7.5, 15.5], [68.0, 6.5, 13.5]])
TONE_SD = np.array([1.5, 1.2, 1.5])  # of people of the same tone; about the 1.7 to 2 of Xiao's groups
D65 = np.array([0.95047, 1.0, 1.08883])
SRGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])

HAIR = ("17120f", "241a14", "3b2a1e", "8c8985", "c8c5c0")
LIGHT_HAIR = (*HAIR, "5a4030", "8a6a45", "b89a6a")  # beside light skin
CLOTHES = ("20242c", "33415c", "5b6f8f", "2f5d50", "6e7f5a", "8c2f39", "b0b4ba", "e6e6e2", "4a4a4a", "7a5c8e", "2a7fa0")
CLOTHES_LIKE_SKIN = ("d9b99b", "c99a7a", "e3b7a5", "d8a39a", "a97c5d", "8a5f45", "c4a484", "e0c4a8")
CAPS = ("00c040", "0060ff", "ff00c0", "00c8d8", "ffe000")


def skin_albedo(rng: np.random.Generator, tone: float) -> Float[np.ndarray, "3"]:
    """Albedo of skin of this tone, 0 the darkest and 1 the lightest, with a person's own deviation."""
    steps = np.linspace(0.0, 1.0, len(TONES))
    lab = np.array([np.interp(tone, steps, column) for column in TONES.T])
    return linear_from_lab(lab + rng.normal(0.0, TONE_SD))


def linear_from_lab(lab: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Linear sRGB, 0..1, of CIELAB under D65."""
    y = (lab[0] + 16) / 116
    f = np.array([y + lab[1] / 500, y, y - lab[2] / 200])
    xyz = D65 * np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    return np.clip(SRGB_FROM_XYZ @ xyz, 0.0, 1.0)


def linear_from_hex(code: str) -> Float[np.ndarray, "3"]:
    """Linear sRGB, 0..1, of "rrggbb"."""
    srgb = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
