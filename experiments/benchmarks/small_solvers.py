"""Do the three small problems with solvers of their own need them, beside optimistix's Levenberg-Marquardt?

The axis of a limb (`fit_axis`), a light's Gaussian (`fit_gaussians`, in numpy) and a triangulated point (`triangulate`)
are each solved by their own solver and by `optimistix.LevenbergMarquardt` (normal equations by Cholesky), vmapped and
compiled, from the same start to the same optimum. The table has medians of repeated calls, in microseconds a problem,
the time of the first call, in which programs are compiled, and by how much the answers differ. A solver that stops
when a batch is done runs as long as the slowest of it, with either.

    python experiments/benchmarks/small_solvers.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import tyro
from jaxtyping import Array
from triangulation import scene_of

from jaxpoint.body import limb_axis as axis
from jaxpoint.compilation import jit
from jaxpoint.detection.light import gaussian as gaussian
from jaxpoint.triangulation import triangulate

LIBRARY = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-8, linear_solver=lx.Normal(lx.Cholesky()))
SPAN = np.array([0.19, 0.39])  # m, behind the tip
SIGMA_PX = 0.8
SLICES = 24


@dataclass(frozen=True)
class Small:
    """Time small problems."""

    axes: int = 64
    """Limbs in a call: those of a hold."""
    lights: int = 2000
    """Patches in a call."""
    points: int = 2**14
    """Points in a call."""
    views: int = 4
    """Cameras."""
    repeats: int = 7
    """Timed calls of each."""
    seed: int = 0
    """Of all that is drawn."""


@dataclass(frozen=True)
class Way:
    """One solver of one problem; `run` gives the answers, one a row."""

    problem: str
    solver: str
    count: int
    run: Callable[[], np.ndarray]


def main(options: Small) -> None:
    """Time all, and print the table."""
    lines = [["problem", "solver", "us a problem", "first call, s", "differs by"], ["---"] * 5]
    for ways in (axes(options), lights(options), points(options)):
        answers = None
        for way in ways:
            seconds, first, found = timed(way, options.repeats)
            apart = "" if answers is None else f"{np.nanmedian(np.linalg.norm(found - answers, axis=1)):.1e} (median)"
            answers = found if answers is None else answers
            lines.append([way.problem, way.solver, f"{1e6 * seconds / way.count:.2f}", f"{first:.1f}", apart])
    sys.stdout.write("".join(f"| {' | '.join(line)} |\n" for line in lines))


def timed(way: Way, repeats: int) -> tuple[float, float, np.ndarray]:
    """Median time of a call and that of the first, s, and the answers."""
    start = time.perf_counter()
    found = way.run()
    first, spent = time.perf_counter() - start, []
    for _ in range(repeats):
        start = time.perf_counter()
        way.run()
        spent.append(time.perf_counter() - start)
    return float(np.median(spent)), first, found


def least_squares(residuals: Callable[..., Array], start: Array, args: Any = None) -> Array:
    """The optimum by the library."""
    return optx.least_squares(residuals, LIBRARY, start, args=args, max_steps=50, throw=False).value


def axes(options: Small) -> list[Way]:
    """Arms before cameras in a ring; the start is some 2 cm and 3 degrees off."""
    rng = np.random.default_rng([options.seed, 1])
    scene = scene_of(options.views, options.axes, rng)
    centres, focal = np.asarray(scene.rig.positions), np.asarray(scene.rig.cameras.focal)[:, 0]
    towards = unit(rng.normal(size=(options.axes, 3)))
    behind = np.linspace(SPAN[0] + 0.005, SPAN[1] - 0.005, SLICES)
    places = scene.points[:, None] - behind[None, :, None] * towards[:, None]
    rays = unit(places[:, None] - centres[None, :, None])
    rays = unit(rays + rng.normal(size=rays.shape) * (SIGMA_PX / focal)[None, :, None, None])
    tips = scene.points + 0.01 * rng.normal(size=scene.points.shape)
    guess = unit(towards + 0.03 * rng.normal(size=towards.shape))
    seen, sigma = np.ones(rays.shape[:3], bool), np.full(options.views, SIGMA_PX)

    def given_of(rays: Array, tip: Array, direction: Array) -> axis._Given:
        known = (jnp.asarray(part) for part in (sigma, SPAN))
        return axis._Given(jnp.asarray(centres), jnp.asarray(focal), rays, tip, direction, *known, seen=seen[0])

    def own(rays: Array, tip: Array, direction: Array) -> Array:
        found = axis._optimum(given_of(rays, tip, direction))
        return jnp.concatenate(found_ends(rays, tip, direction, found))

    def found_ends(rays: Array, tip: Array, direction: Array, offsets: Array) -> tuple[Array, Array]:
        return axis._ends(given_of(rays, tip, direction), offsets)

    def library(rays: Array, tip: Array, direction: Array) -> Array:
        given = given_of(rays, tip, direction)

        def residuals(offsets: Array, held: tuple[Array, Array]) -> Array:
            scale, shares = held
            value = axis._residuals(given, offsets)
            square = (value / scale) ** 2
            safe = jnp.where(square > 0, square, 1.0)
            return value * jnp.sqrt(shares) * jnp.sqrt(jnp.where(square > 0, jnp.log1p(square) / safe, 1.0))

        def narrower(offsets: Array, scale: Array) -> tuple[Array, None]:
            return least_squares(residuals, offsets, (scale, axis._slice_weights(given, offsets))), None

        scales = jnp.asarray([8.0, 2.0, 1.0, 1.0])  # which slices count is found anew before each
        return jnp.concatenate(found_ends(rays, tip, direction, jax.lax.scan(narrower, jnp.zeros(4), scales)[0]))

    given = jnp.asarray(rays), jnp.asarray(tips), jnp.asarray(guess)
    return [
        Way("axis of a limb (m)", name, options.axes, partial(ran, jit(jax.vmap(function)), *given))
        for name, function in (("16 steps of Gauss-Newton, as it is", own), ("optimistix", library))
    ]


def lights(options: Small) -> list[Way]:
    """Round lights of 1.3 px on patches of 9 x 9 px, noise of 2 grey levels."""
    rng = np.random.default_rng([options.seed, 2])
    line = np.arange(9.0) - 4
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    centre = rng.uniform(-0.5, 0.5, (options.lights, 2))
    square = (x - centre[:, :1]) ** 2 + (y - centre[:, 1:]) ** 2
    patches = 20 + 150 * np.exp(-square / (2 * 1.3**2)) + rng.normal(0, 2, square.shape)
    usable = np.ones((options.lights, 9, 9), bool)

    def residuals(state: Array, values: Array) -> Array:
        dx, dy = x - state[0], y - state[1]
        u, v = jnp.exp(state[4]) * dx + state[5] * dy, jnp.exp(state[6]) * dy
        return state[2] * jnp.exp(-0.5 * (u * u + v * v)) + state[3] - values

    fitted = jit(jax.vmap(lambda start, values: least_squares(residuals, start, values)))

    def library() -> np.ndarray:
        start = gaussian._start(patches, np.ones_like(patches), x, y)
        return np.asarray(fitted(start, patches))[:, :2]

    def own() -> np.ndarray:
        return gaussian.fit_gaussians(patches.reshape(-1, 9, 9), usable).center

    problem = "a light's Gaussian (px)"
    return [
        Way(problem, "in numpy, as it is", options.lights, own),
        Way(problem, "optimistix", options.lights, library),
    ]


def points(options: Small) -> list[Way]:
    """Points seen by all cameras of a ring, 0.5 px of noise; the library starts from the linear solution."""
    scene = scene_of(options.views, options.points, np.random.default_rng([options.seed, 3]))
    visible = np.ones(scene.pixels.shape[:2], bool)

    @eqx.filter_jit
    def refined(rig, start: Array, pixels: Array) -> Array:
        def residuals(point: Array, pixels: Array) -> Array:
            return rig.project(point) - pixels

        return jax.vmap(lambda point, pixels: least_squares(residuals, point, pixels))(start, pixels)

    def own() -> np.ndarray:
        return np.asarray(triangulate(scene.rig, scene.pixels, visible, covariance=False).points)

    def library() -> np.ndarray:
        start = triangulate(scene.rig, scene.pixels, visible, covariance=False, refine_steps=0).points
        return np.asarray(refined(scene.rig, start, jnp.asarray(scene.pixels)))

    problem = "a triangulated point (m)"
    return [
        Way(problem, "in blocks, as it is", options.points, own),
        Way(problem, "linear start, then optimistix", options.points, library),
    ]


def ran(function: Callable[..., Array], *given: Array) -> np.ndarray:
    """The answers on the host."""
    return np.asarray(function(*given))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


if __name__ == "__main__":
    with jax.enable_x64(True):
        main(tyro.cli(Small))
