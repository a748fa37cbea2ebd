"""What surfaces look like: small pictures in linear light, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

Colour = tuple[int, int, int]
"""sRGB, 0..255."""


@dataclass(frozen=True)
class Texture:
    """A picture and how large it hangs; where it is smaller than the surface it repeats."""

    image: Float[np.ndarray, "H W 3"]  # linear red, green, blue, 0..1 (more where it shines)
    size_m: tuple[float, float] | None = None  # width and height of one repetition; None: it fills the surface once
    shines: bool = False  # the picture is what it sends out, whatever falls on it


def to_linear(srgb: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Linear light of sRGB values 0..1 (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def plain(colour: Colour) -> Texture:
    """One colour."""
    return _texture(np.full((2, 2, 3), colour, np.float32), None)


def plaster(rng: Generator, colour: Colour) -> Texture:
    """A painted wall: faint clouds and grain."""
    return _texture(_flat(colour, 256, 256) * _clouds(rng, 256, 256, 0.025, 0.012), (1.9, 1.9))


def planks(rng: Generator, colour: Colour) -> Texture:
    """A wooden floor of staggered boards."""
    image = np.empty((480, 600, 3), np.float32)
    for row in range(8):
        start = int(rng.integers(600))
        board = np.concatenate([_grain(rng, _shaded(rng, colour, 0.12), 60, 300) for _ in range(2)], axis=1)
        board[:2], board[:, [0, 300]] = board[:2] * 0.6, board[:, [0, 300]] * 0.6
        image[row * 60 : row * 60 + 60] = np.roll(board, start, axis=1)
    return _texture(image, (2.4, 1.12))


def tiles(rng: Generator, colour: Colour, other: Colour) -> Texture:
    """Square tiles in two colours, or one colour given twice."""
    image = np.empty((256, 256, 3), np.float32)
    for i in range(4):
        place = np.s_[(i // 2) * 128 : (i // 2) * 128 + 128, (i % 2) * 128 : (i % 2) * 128 + 128]
        image[place] = _flat(_shaded(rng, other if i in (1, 2) else colour, 0.03), 128, 128)
    image[::128], image[:, ::128] = image[::128] * 0.75, image[:, ::128] * 0.75
    return _texture(image * _clouds(rng, 256, 256, 0.02, 0.015), (0.66, 0.66))


def carpet(rng: Generator, colour: Colour) -> Texture:
    """A short pile."""
    return _texture(_flat(colour, 256, 256) * _clouds(rng, 256, 256, 0.04, 0.08), (0.9, 0.9))


def wood(rng: Generator, colour: Colour) -> Texture:
    """Grain along the first direction of the surface."""
    return _texture(_grain(rng, colour, 256, 512), (1.6, 0.8))


def fabric(rng: Generator, colour: Colour) -> Texture:
    """A weave, sometimes striped."""
    image = _flat(colour, 128, 128) * _clouds(rng, 128, 128, 0.02, 0.06)
    if rng.random() < 0.4:
        image[:, 40:64] *= rng.uniform(0.6, 0.85)
    return _texture(image, (0.35, 0.35))


def rug(rng: Generator) -> Texture:
    """A bordered carpet with lozenges."""
    dark, light, mark = (_random_colour(rng, low, high) for low, high in ((60, 130), (140, 220), (90, 220)))
    image = np.full((300, 440, 3), light, np.uint8)
    cv2.rectangle(image, (0, 0), (439, 299), dark, 44)
    cv2.rectangle(image, (34, 34), (405, 265), mark, 4)
    for x in range(90, 400, 65):
        for y in range(75, 260, 50):
            diamond = np.array([[x - 22, y], [x, y - 18], [x + 22, y], [x, y + 18]])
            cv2.fillConvexPoly(image, diamond, mark if (x + y) % 2 else dark)
    return _texture(image * _clouds(rng, 300, 440, 0.03, 0.07), None)


def picture(rng: Generator) -> Texture:
    """A framed painting: a landscape, or shapes."""
    image = _landscape(rng) if rng.random() < 0.5 else _shapes(rng)
    cv2.rectangle(image, (0, 0), (image.shape[1] - 1, image.shape[0] - 1), _random_colour(rng, 20, 120), 18)
    return _texture(image, None)


def poster(rng: Generator) -> Texture:
    """Shapes and lettering without a frame."""
    image = _shapes(rng)
    cv2.putText(image, str(rng.choice(["JAZZ", "EXPO", "OPERA", "CINE", "ZOO"])), (24, 60), 0, 2.0, (250, 250, 245), 6)
    return _texture(image, None)


def clock(rng: Generator) -> Texture:
    """A square wall clock."""
    image = np.full((200, 200, 3), _random_colour(rng, 20, 90), np.uint8)
    cv2.circle(image, (100, 100), 88, (240, 240, 235), -1, cv2.LINE_AA)
    for hour in range(12):
        turn = np.array([np.sin(hour * np.pi / 6), -np.cos(hour * np.pi / 6)])
        start, end = (np.round(100 + reach * turn).astype(int).tolist() for reach in (70, 82))
        cv2.line(image, start, end, (20, 20, 20), 5, cv2.LINE_AA)
    for reach, width in ((45, 7), (68, 4)):
        angle = rng.uniform(0, 2 * np.pi)
        end = (round(100 + reach * np.sin(angle)), round(100 - reach * np.cos(angle)))
        cv2.line(image, (100, 100), end, (20, 20, 20), width, cv2.LINE_AA)
    return _texture(image, None)


def books(rng: Generator) -> Texture:
    """A row of spines between dark gaps."""
    image = np.full((160, 520, 3), 25, np.uint8)
    x = 2
    while x < 500:
        width, height = int(rng.integers(9, 26)), int(rng.integers(95, 150))
        colour = _random_colour(rng, 30, 220)
        cv2.rectangle(image, (x, 160 - height), (x + width - 2, 159), colour, -1)
        cv2.line(image, (x + 2, 175 - height), (x + width - 4, 175 - height), tuple(255 - c for c in colour), 2)
        x += width + (int(rng.integers(10, 50)) if rng.random() < 0.12 else 0)
    return _texture(image, None)


def screen(rng: Generator) -> Texture:
    """A monitor or television, switched off or showing windows."""
    image = np.full((225, 400, 3), 14, np.uint8)
    if rng.random() < 0.6:
        image[8:-8, 8:-8] = _random_colour(rng, 30, 90)
        for _ in range(3):
            x, y = int(rng.integers(15, 200)), int(rng.integers(15, 100))
            corner = (x + int(rng.integers(80, 180)), y + int(rng.integers(50, 100)))
            cv2.rectangle(image, (x, y), corner, _random_colour(rng, 90, 220), -1)
            cv2.rectangle(image, (x, y), (corner[0], y + 10), (60, 70, 90), -1)
    return _texture(image, None)


def window(rng: Generator) -> Texture:
    """Daylight over trees, behind a white frame; brighter than white paint."""
    rows = np.linspace(0, 1, 240, dtype=np.float32)[:, None, None]
    sky = (1 - rows) * [150, 190, 235] + rows * [225, 235, 240]
    image = np.repeat(sky, 300, axis=1).astype(np.uint8)
    for _ in range(25):
        at = (int(rng.integers(300)), int(rng.integers(165, 250)))
        cv2.circle(
            image, at, int(rng.integers(15, 45)), (int(rng.integers(40, 80)), int(rng.integers(80, 130)), 50), -1
        )
    linear = 1.6 * to_linear(cv2.GaussianBlur(image, (0, 0), 3).astype(np.float32) / 255)
    for frame in ((0, 0, 300, 12), (0, 228, 300, 12), (0, 0, 12, 240), (288, 0, 12, 240), (144, 0, 12, 240)):
        x, y, width, height = frame
        linear[y : y + height, x : x + width] = 0.6
    return Texture(linear, shines=True)


def door(rng: Generator, colour: Colour) -> Texture:
    """A wooden door with panels and a handle."""
    image = _grain(rng, colour, 200, 400).transpose(1, 0, 2).copy()
    for top, bottom in ((30, 170), (200, 370)):
        cv2.rectangle(image, (30, top), (170, bottom), (0.7 * image.mean(axis=(0, 1))).tolist(), 4)
        cv2.rectangle(image, (34, top + 4), (170, bottom), (1.15 * image.mean(axis=(0, 1))).tolist(), 2)
    cv2.rectangle(image, (176, 205), (192, 212), (190, 190, 185), -1)
    return _texture(image, None)


def drawers(rng: Generator, colour: Colour, columns: int) -> Texture:
    """The front of a cabinet."""
    width = 120 * columns
    image = _grain(rng, colour, 160, width)
    for i in range(columns):
        cv2.rectangle(image, (120 * i + 3, 3), (120 * i + 117, 156), (0.55 * image.mean(axis=(0, 1))).tolist(), 2)
        cv2.circle(image, (120 * i + (104 if i % 2 == 0 else 16), 60), 5, (200, 200, 195), -1)
    return _texture(image, None)


def printed(rng: Generator) -> Texture:
    """A sheet with lines of text, or a book's cover."""
    image = np.full((200, 150, 3), _random_colour(rng, 150, 250), np.uint8)
    ink = _random_colour(rng, 20, 100)
    cv2.rectangle(image, (15, 15), (135, 45), ink, -1)
    for y in range(60, 190, 12):
        cv2.line(image, (15, y), (int(rng.integers(90, 136)), y), ink, 3)
    return _texture(image, None)


def grille(rng: Generator) -> Texture:
    """Slats of a ventilator."""
    image = np.full((120, 120, 3), 215, np.uint8)
    image[15:105:12] = image[16:105:12] = image[17:105:12] = int(rng.integers(50, 110))
    return _texture(image, None)


def cardboard(rng: Generator, colour: Colour) -> Texture:
    """A box with a strip of tape."""
    image = _flat(colour, 120, 160) * _clouds(rng, 120, 160, 0.03, 0.02)
    image[54:66] *= [0.86, 0.84, 0.8]
    return _texture(image, None)


def _texture(srgb: np.ndarray, size_m: tuple[float, float] | None) -> Texture:
    return Texture(to_linear(np.clip(np.asarray(srgb, np.float32) / 255, 0.0, 1.0)), size_m)


def _flat(colour, height: int, width: int) -> np.ndarray:
    return np.full((height, width, 3), colour, np.float32)


def _shaded(rng: Generator, colour, spread: float) -> np.ndarray:
    return np.asarray(colour, np.float32) * rng.uniform(1 - spread, 1 + spread)


def _random_colour(rng: Generator, low: int, high: int) -> Colour:
    """Somewhat greyed: pure colours are rare in rooms."""
    drawn = rng.integers(low, high, 3)
    red, green, blue = (int(value) for value in 0.65 * drawn + 0.35 * drawn.mean())
    return red, green, blue


def _clouds(rng: Generator, height: int, width: int, soft: float, fine: float) -> np.ndarray:
    """A factor near 1: large soft clouds and fine grain, each with its standard deviation; it repeats seamlessly."""
    noise = rng.normal(size=(height, width)).astype(np.float32)
    blurred = cv2.GaussianBlur(np.tile(noise, (3, 3)), (0, 0), min(height, width) / 12)[height:-height, width:-width]
    return (1 + soft * blurred / blurred.std() + fine * noise)[..., None]


def _grain(rng: Generator, colour, height: int, width: int) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), sigmaX=width / 9, sigmaY=1.2)
    return _flat(colour, height, width) * (1 + 0.045 * noise / noise.std())[..., None].astype(np.float32)


def _landscape(rng: Generator) -> np.ndarray:
    image = np.full((220, 300, 3), _random_colour(rng, 140, 240), np.uint8)
    for level in range(60, 220, 45):
        x = np.arange(0, 320, 20)
        y = level + 18 * np.sin(x / rng.uniform(20, 60) + rng.uniform(0, 6)) + rng.normal(0, 4, len(x))
        outline = np.stack([x, y], axis=1).astype(np.int32)
        cv2.fillPoly(
            image, [np.concatenate([outline, [[300, 220], [0, 220]]]).astype(np.int32)], _random_colour(rng, 30, 200)
        )
    return image


def _shapes(rng: Generator) -> np.ndarray:
    image = np.full((280, 210, 3), _random_colour(rng, 40, 240), np.uint8)
    for _ in range(7):
        at = (int(rng.integers(210)), int(rng.integers(280)))
        if rng.random() < 0.5:
            cv2.circle(image, at, int(rng.integers(15, 60)), _random_colour(rng, 20, 240), -1, cv2.LINE_AA)
        else:
            corner = (at[0] + int(rng.integers(20, 110)), at[1] + int(rng.integers(20, 110)))
            cv2.rectangle(image, at, corner, _random_colour(rng, 20, 240), -1)
    return image
