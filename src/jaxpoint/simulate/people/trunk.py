"""Trunk and head."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.people.simulated_person import Person, Side
from jaxpoint.simulate.people.surface import Surface, corner_normals, loft, mirrored

# Height, half breadth, half depth, and how far forward the middle lies, all over stature.
SECTIONS = np.array(
    [
        [0.472, 0.0, 0.0, 0.000],
        [0.474, 0.025, 0.025, 0.000],
        [0.490, 0.060, 0.042, -0.003],
        [0.515, 0.090, 0.058, -0.005],
        [0.540, 0.100, 0.067, -0.004],
        [0.560, 0.098, 0.066, -0.001],
        [0.580, 0.091, 0.061, 0.003],
        [0.610, 0.085, 0.059, 0.005],
        [0.640, 0.084, 0.060, 0.004],
        [0.670, 0.087, 0.062, 0.002],
        [0.700, 0.092, 0.065, 0.002],
        [0.730, 0.097, 0.067, 0.002],
        [0.755, 0.103, 0.066, 0.000],
        [0.780, 0.107, 0.061, -0.003],
        [0.800, 0.109, 0.054, -0.006],
        [0.816, 0.107, 0.046, -0.008],
        [0.830, 0.094, 0.040, -0.008],
        [0.841, 0.066, 0.036, -0.008],
        [0.850, 0.044, 0.033, -0.006],
        [0.855, 0.0, 0.0, -0.005],
    ]
)
BELT = 0.572  # of stature: shirt above, trousers below
HEM_M = 0.012
# Half axes of the yoke over stature (forwards, up, to the side), and where its middle lies from the shoulder.
YOKE = (0.037, 0.039, 0.042)
YOKE_ASIDE, YOKE_DROP = 0.089, 0.012
# Half axes of the head over stature: depth, breadth, height (chin to crown 0.130).
HEAD = np.array([0.056, 0.0445, 0.065])
EYE = np.array([0.87, 0.40, 0.02])  # of those half axes
AROUND, LEVELS = 24, 17


def trunk_surface(person: Person) -> Surface:
    """From crotch to collar, standing, x forwards; the floor is z = 0."""
    belt = np.array([BELT - 0.0005, BELT + 0.0005])
    heights = np.sort([*SECTIONS[:, 0], *belt])
    breadth, depth, forward = (np.interp(heights, SECTIONS[:, 0], column) for column in SECTIONS[:, 1:].T)
    girth = np.where(heights > 0.79, 0.5 + 0.5 * person.build, person.build)
    half = np.stack([depth * girth, breadth * girth], 1) * person.stature_m
    is_shirt = heights > BELT
    half += np.where(is_shirt & (half[:, 0] > 0) & (heights < 0.80), HEM_M, 0.003)[:, None] * (half > 0)
    colour = np.where(is_shirt[:, None], person.shirt, person.trousers)
    if person.pattern == "stripes":
        dark = np.floor(heights * person.stature_m / 0.055).astype(int) % 2 == 0
        colour = colour * np.where(is_shirt & dark, 0.6, 1.0)[:, None]
    belly = max(person.build - 1.0, 0.0) * 0.10 * np.exp(-(((heights - 0.61) / 0.06) ** 2))
    centers = np.stack([(forward + belly) * person.stature_m, np.zeros(len(heights))], 1)
    return loft(heights * person.stature_m, half, colour, around=24, centers=centers, exponent=2.4)


def yoke_surface(person: Person, side: Side) -> Surface:
    """Where chest and upper arm meet, so that a raised arm leaves no gap; z to the side, in the thorax's frame."""
    size, height = person.proportions, person.stature_m
    shares = np.array([-1.0, -0.9, -0.6, -0.2, 0.2, 0.55, 0.85, 1.0])
    round_ = np.sqrt(np.clip(1 - shares**2, 0.0, 1.0))
    half = np.outer(round_, YOKE[:2]) * height * (0.5 + 0.5 * person.build)
    made = loft(shares * YOKE[2] * height, half, np.tile(person.shirt, (len(shares), 1)), around=14)
    down = size.shoulder_height - size.neck_height - YOKE_DROP * height
    # The loft's z goes to the left, its x forwards, its y down.
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    middle = np.array([-0.002 * height, YOKE_ASIDE * height, down])
    left = Surface(made.vertices @ turn.T + middle, made.normals @ turn.T, made.triangles, made.albedo)
    return left if side == "left" else mirrored(left)


def eyes(person: Person) -> dict[str, Float[np.ndarray, "3"]]:
    """Both eyes in the head's frame, whose origin is its centre: x forwards, y left, z up; m."""
    left = EYE * HEAD * person.stature_m
    return {"left_eye": left, "right_eye": left * [1.0, -1.0, 1.0]}


def head_surface(person: Person) -> Surface:
    """Head with hair, in the head's frame."""
    polar = np.linspace(0.0, np.pi, LEVELS)
    heights = -np.cos(polar)
    rings = loft(
        heights, np.sqrt(np.clip(1 - heights**2, 0, 1))[:, None].repeat(2, 1), np.zeros((LEVELS, 3)), around=AROUND
    )
    ball = rings.vertices
    is_hair = _hair(person, ball)
    shaped = _shaped(ball) * HEAD * person.stature_m
    thick = {"bald": 0.0, "short": 0.05, "long": 0.10}[person.hair_style]
    shaped = shaped * (1 + thick * is_hair[:, None])
    colour = np.where(is_hair[:, None], person.hair, person.skin)
    colour = colour * _features(ball)[:, None]
    return Surface(shaped, corner_normals(shaped, rings.triangles), rings.triangles, colour)


def _shaped(ball: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """The unit ball with a jaw, a flatter face and a nose."""
    x, y, z = ball.T
    low = np.clip(-z, 0.0, 1.0)
    breadth = 1 - 0.30 * low**1.5
    depth = np.where(x < 0, 1 - 0.45 * low**1.3, 1 - 0.06 * low)
    nose = 0.13 * np.exp(-((y / 0.16) ** 2) - ((z + 0.22) / 0.20) ** 2) * (x > 0)
    return np.stack([x * depth + nose, y * breadth, z], 1)


def _hair(person: Person, ball: Float[np.ndarray, "V 3"]) -> np.ndarray:
    if person.hair_style == "bald":
        return np.zeros(len(ball), bool)
    x, _, z = ball.T
    line = np.interp(x, [-1.0, -0.3, 0.25, 0.9], [-0.55, -0.35, 0.25, 0.62])
    if person.hair_style == "long":
        line = np.interp(x, [-1.0, -0.2, 0.25, 0.9], [-0.95, -0.9, 0.1, 0.62])
    return z > line


def _features(ball: Float[np.ndarray, "V 3"]) -> np.ndarray:
    """Darker eyes, brows and mouth."""
    x, y, z = ball.T
    eye = np.exp(-(((np.abs(y) - 0.40) / 0.12) ** 2) - ((z - 0.06) / 0.09) ** 2)
    mouth = 0.4 * np.exp(-((y / 0.22) ** 2) - ((z + 0.55) / 0.07) ** 2)
    return 1 - 0.7 * np.clip((eye + mouth) * (x > 0), 0.0, 1.0)
