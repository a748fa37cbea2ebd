"""How many lines of pointing a second are brought to objects, and how true are the masses?

A room of 65 rectangles at random, upright or level, and lines from its middle to all sides, all float64. `intersect`
finds what the lines meet, `posterior` the probability of every object; everything is compiled. Then the mass of each
rectangle is held against a Monte Carlo of the whole line, origin and direction, in numpy: the error of the origin makes
the largest difference, where a rectangle is near and seen aslant; its table says by how much. The samples are two sets
of scipy's scrambled Sobol points, so that their difference tells the Monte Carlo's own error.

    python experiments/benchmarks/pointing.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from scipy.stats import norm, qmc

from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.mass import across
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import Behaviour, posterior
from jaxpoint.pointing.shapes import Rectangle

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([6.0, 5.0, 2.5])


@dataclass(frozen=True)
class Pointing:
    """Time pointing."""

    objects: int = 65
    """Rectangles in the room."""
    lines: int = 2**17
    """Lines in a call."""
    repeats: int = 5
    """Timed calls, after one that compiles; the fastest counts."""
    checked: int = 12
    """Lines whose masses are held against Monte Carlo."""
    samples: int = 2**17
    """Of each of two Monte Carlos, a line."""
    origin_sigmas_mm: tuple[float, ...] = (0.0, 5.0, 10.0)
    """Errors of the origin."""
    sigma_deg: float = 4.0
    """Of the direction."""
    seed: int = 0


def main(options: Pointing) -> None:
    """Print speeds and errors."""
    rng = np.random.default_rng(options.seed)
    corners = room(options.objects, rng)
    objects = Objects.of([Thing(str(i), Rectangle(c)) for i, c in enumerate(corners)])
    origin = rng.uniform([1.5, 1.5, 1.0], [4.5, 3.5, 1.7], (options.lines, 3))
    direction = unit(rng.normal(size=(options.lines, 3)) * [1.0, 1.0, 0.4])
    rays = Ray(origin, direction)
    lines = PointingLine(rays, np.tile(np.diag([1e-4] * 3 + [1e-3] * 3), (options.lines, 1, 1)))
    calls: dict[str, Callable] = {"intersect": lambda: intersect(rays, objects)}
    for name, freedom in (("Student's t", 4), ("Gaussian", None)):
        behaviour = Behaviour(freedom=freedom)
        calls[f"posterior, {name}"] = lambda behaviour=behaviour: posterior(lines, objects, behaviour)
    for name, call in calls.items():
        wall, own = fastest(call, options.repeats)
        sys.stdout.write(
            f"{name}: {options.lines / wall:,.0f} lines a second, {options.lines / own:,.0f} a processor second\n"
        )
    sys.stdout.write(
        "\n| origin's error, mm | worst error of a mass | 99th percentile | rms | Monte Carlo's own worst |\n"
    )
    sys.stdout.write("|---|---|---|---|---|\n")
    for sigma in options.origin_sigmas_mm:
        errors = mass_errors(corners, objects, rays, sigma / 1000, options, rng)
        error, own = np.abs(errors.mean(axis=0)), np.abs(errors[0] - errors[1]).max() / 2
        quantile, rms = np.quantile(error, 0.99), np.sqrt(np.mean(error**2))
        sys.stdout.write(f"| {sigma:g} | {error.max():.5f} | {quantile:.5f} | {rms:.5f} | {own:.5f} |\n")


def room(count: int, rng: np.random.Generator) -> np.ndarray:
    """Corners of rectangles along the axes, 0.1 to 1 m wide."""
    found = []
    for _ in range(count):
        base = np.roll(np.eye(3), rng.integers(3), axis=0)
        right, down = base[:2] * rng.uniform(0.1, 1.0, (2, 1))
        corner = rng.uniform(LOW, HIGH) - (right + down) / 2
        found.append(np.stack([corner, corner + right, corner + down, corner + right + down]))
    return np.stack(found)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def fastest(call: Callable, repeats: int) -> tuple[float, float]:
    """Seconds by the clock and of the processors, of the fastest call."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        start, own = time.perf_counter(), time.process_time()
        jax.block_until_ready(call())
        times.append((time.perf_counter() - start, time.process_time() - own))
    wall, own = np.min(times, axis=0)
    return float(wall), float(own)


def mass_errors(
    corners: np.ndarray, objects: Objects, rays: Ray, sigma_m: float, options: Pointing, rng: np.random.Generator
) -> np.ndarray:
    """Of two Monte Carlos, each checked line and rectangle, the mass less the share of sampled lines that meet it."""
    some = Ray(rays.origin[: options.checked], rays.direction[: options.checked])
    covariance = np.tile(np.diag([sigma_m**2] * 3 + [0.0] * 3), (options.checked, 1, 1))
    sigma = float(np.deg2rad(options.sigma_deg))
    found = posterior(PointingLine(some, covariance), objects, Behaviour(sigma, sigma, freedom=None))
    errors = np.empty((2, *found.mass.shape))
    for g, (origin, direction) in enumerate(zip(np.asarray(some.origin), np.asarray(some.direction))):
        base = np.asarray(across(jnp.asarray(direction)))
        for i in range(2):
            points = qmc.Sobol(5, seed=rng)  # pyright: ignore[reportCallIssue]; `rng` from scipy 1.15 on
            drawn = norm.ppf(points.random(options.samples))
            starts, towards = origin + sigma_m * drawn[:, 2:], direction + sigma * drawn[:, :2] @ base
            errors[i, g] = np.asarray(found.mass[g]) - [met(c, starts, towards) for c in corners]
    return errors


def met(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> float:
    """The share of rays that meet a rectangle."""
    right, down = corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(right, down)
    reach = (corners[0] - origins) @ normal / (directions @ normal)
    place = origins + reach[:, None] * directions - corners[0]
    u, v = place @ right / (right @ right), place @ down / (down @ down)
    return float(np.mean((reach > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)))


if __name__ == "__main__":
    with jax.enable_x64(True):
        main(tyro.cli(Pointing, description=__doc__))
