"""A furnished room at random, for the tests of what is pointed at."""

import numpy as np

from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.shapes import Box, Rectangle, Sphere


def turn(rng) -> np.ndarray:
    """Any orthonormal base, as rows."""
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def rectangle(rng) -> Rectangle:
    base = turn(rng)
    right, down = base[0] * rng.uniform(0.1, 1.2), base[1] * rng.uniform(0.1, 1.2)
    corner = rng.uniform([0, 0, 0], [6, 5, 2.5])
    return Rectangle(np.stack([corner, corner + right, corner + down, corner + right + down]))


def things(seed: int, rectangles=12, boxes=4, spheres=4) -> list[Thing]:
    rng = np.random.default_rng(seed)
    found = [Thing(f"rectangle {i}", rectangle(rng)) for i in range(rectangles)]
    for i in range(boxes):
        found.append(
            Thing(f"box {i}", Box(rng.uniform([0, 0, 0], [6, 5, 2.5]), rng.uniform(0.1, 1, 3), rng.uniform(0, 6)))
        )
    for i in range(spheres):
        found.append(Thing(f"sphere {i}", Sphere(rng.uniform([0, 0, 0], [6, 5, 2.5]), float(rng.uniform(0.1, 0.5)))))
    return found


def room(seed: int, **counts) -> Objects:
    return Objects.of(things(seed, **counts))


def rays(seed: int, count: int) -> Ray:
    rng = np.random.default_rng([seed, 1])
    towards = rng.normal(size=(count, 3))
    return Ray(
        rng.uniform([0.5, 0.5, 0.8], [5.5, 4.5, 1.8], (count, 3)),
        towards / np.linalg.norm(towards, axis=1, keepdims=True),
    )
