"""Epipolar geometry of two views, robustly, in pure JAX.

Coordinates are pixels from the image centre over half the image diagonal, still distorted. The lens is the division
model (Fitzgibbon 2001): a distorted d belongs to the ray (d, 1 + lambda |d|^2). All errors are Sampson distances in
pixels of the distorted image, so that lenses can be compared. F obeys ray_b^T F ray_a = 0.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray

Method = Literal["magsac", "ransac", "lmeds", "8point"]


class View(eqx.Module):
    """One of the two views of a pair."""

    points: Float[Array, "N 2"]  # distorted, over half the image diagonal
    distortion: Float[Array, ""]  # division-model parameter
    half_diagonal: Float[Array, ""]  # px

    @property
    def rays(self) -> Float[Array, "N 3"]:
        """Homogeneous undistorted points."""
        return lift(self.points, self.distortion)

    def slopes(self) -> Float[Array, "N 2 3"]:
        """Derivative of the rays by the pixel."""
        ones = jnp.ones(self.points.shape[0], self.points.dtype)
        zeros = jnp.zeros_like(ones)
        bend = 2.0 * self.distortion * self.points
        rows = [jnp.stack([ones, zeros, bend[:, 0]], axis=1), jnp.stack([zeros, ones, bend[:, 1]], axis=1)]
        return jnp.stack(rows, axis=1) / self.half_diagonal


def lift(points: Float[Array, "... 2"], distortion: Float[Array, "..."]) -> Float[Array, "... 3"]:
    """Homogeneous undistorted coordinates of distorted points under the division model."""
    square = (points**2).sum(axis=-1)
    third = 1.0 + jnp.broadcast_to(distortion, square.shape) * square
    return jnp.concatenate([points, third[..., None]], axis=-1)


def sampson(fundamental: Float[Array, "3 3"], first: View, second: View) -> Float[Array, " N"]:
    """Signed Sampson distance of every match, px of the distorted images."""
    return _sampson(fundamental, first.rays, second.rays, first.slopes(), second.slopes())


def _sampson(fundamental, rays_a, rays_b, slopes_a, slopes_b) -> Float[Array, " N"]:
    line_b = _rows_times(fundamental, rays_a)
    line_a = _rows_times(fundamental.T, rays_b)
    value = (rays_b * line_b).sum(axis=1)
    slope_a = (slopes_a * line_a[:, None]).sum(axis=2)
    slope_b = (slopes_b * line_b[:, None]).sum(axis=2)
    square = (slope_a**2).sum(axis=1) + (slope_b**2).sum(axis=1)
    return value / jnp.sqrt(jnp.maximum(square, 1e-30))


def _rows_times(matrix, rays):
    """matrix @ ray for every ray, written out so that it vectorises over rays."""
    return jnp.stack([(matrix[i][None] * rays).sum(axis=1) for i in range(3)], axis=1)


def eight_point(
    rays_a: Float[Array, "N 3"], rays_b: Float[Array, "N 3"], weights: Float[Array, " N"]
) -> Float[Array, "3 3"]:
    """Weighted linear fit of F with rank 2 enforced (Hartley 1997; at least 8 points with weight)."""
    scale_a, scale_b = _conditioning(rays_a, weights), _conditioning(rays_b, weights)
    unit_a, unit_b = rays_a @ scale_a.T, rays_b @ scale_b.T
    rows = (unit_b[:, :, None] * unit_a[:, None, :]).reshape(-1, 9) * jnp.sqrt(weights)[:, None]
    fit = jnp.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    fundamental = scale_b.T @ rank_two(fit) @ scale_a
    return fundamental / jnp.linalg.norm(fundamental)


def _conditioning(rays, weights) -> Float[Array, "3 3"]:
    """Similarity that moves the points' weighted mean to the origin and their spread to sqrt(2)."""
    third = jnp.where(jnp.abs(rays[:, 2]) < 0.05, 0.05, rays[:, 2])
    plane = rays[:, :2] / third[:, None]
    share = weights / jnp.maximum(weights.sum(), 1e-12)
    mean = (share[:, None] * plane).sum(axis=0)
    spread = jnp.sqrt((share[:, None] * (plane - mean[None]) ** 2).sum() / 2.0)
    size = 1.0 / jnp.maximum(spread, 1e-9)
    return jnp.array([[size, 0.0, -size * mean[0]], [0.0, size, -size * mean[1]], [0.0, 0.0, 1.0]])


def rank_two(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The nearest matrix of rank 2."""
    u, s, vt = jnp.linalg.svd(matrix)
    return (u[:, :2] * s[None, :2]) @ vt[:2]


def seven_point(rays_a: Float[Array, "S 7 3"], rays_b: Float[Array, "S 7 3"]) -> Float[Array, "S 3 3 3"]:
    """The up to three F of seven matches, for S samples at once (the real roots; a lone root stands three times).

    The null space comes from Gauss-Jordan elimination over all samples together: thousands of calls of a linear
    algebra library on tiny matrices would take longer than everything else.
    """
    rows = (rays_b[..., :, None] * rays_a[..., None, :]).reshape(*rays_a.shape[:2], 9)
    rows = _echelon_form(rows)
    ones, zeros = jnp.ones_like(rows[:, 0, 0]), jnp.zeros_like(rows[:, 0, 0])
    first = jnp.concatenate([-rows[:, :, 7], jnp.stack([ones, zeros], axis=1)], axis=1)
    second = jnp.concatenate([-rows[:, :, 8], jnp.stack([zeros, ones], axis=1)], axis=1)
    first = (first / jnp.linalg.norm(first, axis=1, keepdims=True)).reshape(-1, 3, 3)
    second = (second / jnp.linalg.norm(second, axis=1, keepdims=True)).reshape(-1, 3, 3)
    constant, cubic = _det(first), _det(second)
    plus, minus = _det(first + second), _det(first - second)
    quadratic = (plus + minus) / 2.0 - constant
    linear = (plus - minus) / 2.0 - cubic
    roots = _real_roots(cubic, quadratic, linear, constant)
    return first[:, None] + roots[..., None, None] * second[:, None]


def _echelon_form(rows: Float[Array, "S 7 9"]) -> Float[Array, "S 7 9"]:
    """Reduced row echelon form of the first seven columns, with partial pivoting."""

    def eliminate(column, rows):
        candidates = jnp.where(jnp.arange(7)[None] >= column, jnp.abs(rows[:, :, column]), -1.0)
        pivot = jnp.argmax(candidates, axis=1)
        chosen = jnp.take_along_axis(rows, pivot[:, None, None], axis=1)[:, 0]
        here = rows[:, column]
        is_pivot = jnp.arange(7)[None] == pivot[:, None]
        rows = jnp.where(is_pivot[:, :, None], here[:, None], rows)
        value = chosen[:, column]
        chosen = chosen / jnp.where(jnp.abs(value) < 1e-14, 1e-14, value)[:, None]
        rows = rows - rows[:, :, column][:, :, None] * chosen[:, None]
        return rows.at[:, column].set(chosen)

    return jax.lax.fori_loop(0, 7, eliminate, rows)


def _det(m: Float[Array, "S 3 3"]) -> Float[Array, " S"]:
    return (
        m[:, 0, 0] * (m[:, 1, 1] * m[:, 2, 2] - m[:, 1, 2] * m[:, 2, 1])
        - m[:, 0, 1] * (m[:, 1, 0] * m[:, 2, 2] - m[:, 1, 2] * m[:, 2, 0])
        + m[:, 0, 2] * (m[:, 1, 0] * m[:, 2, 1] - m[:, 1, 1] * m[:, 2, 0])
    )


def _real_roots(a, b, c, d) -> Float[Array, "S 3"]:
    """Real roots of a t^3 + b t^2 + c t + d; where there is one only, it stands three times."""
    a = jnp.where(jnp.abs(a) < 1e-14, 1e-14, a)
    shift = b / (3.0 * a)
    p = c / a - 3.0 * shift**2
    q = 2.0 * shift**3 - shift * c / a + d / a
    disc = q**2 / 4.0 + p**3 / 27.0
    three = (disc < 0) & (p < 0)
    size = 2.0 * jnp.sqrt(jnp.where(three, -p / 3.0, 1.0))
    cosine = jnp.where(three, 3.0 * q / (jnp.where(three, p, -1.0) * size), 0.0)
    angle = jnp.arccos(jnp.clip(cosine, -1.0, 1.0)) / 3.0
    many = size[:, None] * jnp.cos(angle[:, None] - 2.0 * jnp.pi / 3.0 * jnp.arange(3)[None])
    root = jnp.sqrt(jnp.maximum(disc, 0.0))
    lone = jnp.cbrt(-q / 2.0 + root) + jnp.cbrt(-q / 2.0 - root)
    return jnp.where(three[:, None], many, lone[:, None]) - shift[:, None]


def magsac_weight(error: Float[Array, "..."], largest_sigma: Float[Array, ""]) -> Float[Array, "..."]:
    """Weight of an error when the noise level is unknown up to `largest_sigma` (MAGSAC++; Barath et al. 2020).

    The marginal over all levels of a chi distribution with 4 degrees of freedom cut at its 0.99 quantile
    (3.64 sigma), scaled to 1 at error 0.
    """
    cut = 3.64
    half = error**2 / (2.0 * largest_sigma**2)

    def upper_gamma(x):  # Gamma(3/2, x)
        root = jnp.sqrt(jnp.maximum(x, 1e-30))
        return 0.5 * jnp.sqrt(jnp.pi) * jax.scipy.special.erfc(root) + root * jnp.exp(-x)

    floor = upper_gamma(jnp.asarray(cut**2 / 2.0, half.dtype))
    weight = (upper_gamma(half) - floor) / (0.5 * jnp.sqrt(jnp.pi) - floor)
    return jnp.where(jnp.abs(error) < cut * largest_sigma, weight, 0.0)


def _score(error: Float[Array, "H M"], seen: Bool[Array, " M"], threshold, method: Method) -> Float[Array, " H"]:
    """How well hypotheses explain the matches; higher is better."""
    error = jnp.where(jnp.isfinite(error), jnp.abs(error), 1e9)
    if method == "lmeds":
        return -jnp.nanmedian(jnp.where(seen[None], error, jnp.nan), axis=1)
    counted = method == "ransac"
    value = (error < threshold).astype(error.dtype) if counted else magsac_weight(error, threshold / 3.64)
    return jnp.where(seen[None], value, 0.0).sum(axis=1)


SCORED = 192  # matches on which hypotheses are compared


class Samples(eqx.Module):
    """Indices of random matches; now and then one stands twice in a minimal sample, which then scores badly."""

    minimal: Int[AnyArray, "L S 7"]
    scored: Int[AnyArray, " M"]


class PairFit(eqx.Module):
    """Robust epipolar geometry of one pair."""

    fundamental: Float[Array, "3 3"]
    error: Float[Array, " N"]  # px, absolute Sampson distance
    inlier: Bool[Array, " N"]
    choice: Int[Array, ""]  # which of the offered lens pairs was best


def draw_samples(rng: np.random.Generator, seen: Bool[np.ndarray, " N"], lenses: int, samples: int) -> Samples:
    """Random matches for `robust_fundamental`, drawn outside of JAX: its generators take seconds to compile."""
    visible = np.flatnonzero(seen)
    if len(visible) == 0:
        return Samples(np.zeros((lenses, samples, 7), int), np.zeros(SCORED, int))
    return Samples(rng.choice(visible, (lenses, samples, 7)), np.resize(rng.permutation(visible), SCORED))


@partial(jit, static_argnames="method")
def robust_fundamental(
    draws: Samples,
    points_a: Float[Array, "N 2"],
    points_b: Float[Array, "N 2"],
    seen: Bool[Array, " N"],
    half_diagonals: Float[Array, "2"],
    lenses: Float[Array, "L 2"],
    threshold: Float[Array, ""],
    method: Method = "magsac",
) -> PairFit:
    """Robust F of one pair: seven-point samples under each offered lens pair, then reweighted eight-point fits.

    Args:
        draws: random matches, from `draw_samples`.
        points_a, points_b: distorted, over half the image diagonal.
        seen: which matches exist; hidden ones never matter.
        half_diagonals: of both images, px.
        lenses: candidates of the two division-model parameters.
        threshold: largest inlier error, px.
        method: `magsac` (default), `ransac` (the thesis's), `lmeds`, or `8point` (all matches, then reweighted).
    """
    subset = draws.scored
    scored = jnp.arange(SCORED) < seen.sum()

    def candidate(lens, index):
        first = View(points_a, lens[0], half_diagonals[0])
        second = View(points_b, lens[1], half_diagonals[1])
        rays_a, rays_b = first.rays, second.rays
        if method == "8point":
            hypotheses = eight_point(rays_a, rays_b, seen.astype(rays_a.dtype))[None]
        else:
            hypotheses = seven_point(rays_a[index], rays_b[index]).reshape(-1, 3, 3)
        few = (rays_a[subset], rays_b[subset], first.slopes()[subset], second.slopes()[subset])
        errors = jax.vmap(lambda f: _sampson(f, *few))(hypotheses)
        score = _score(errors, scored, threshold, method)
        best = jnp.argmax(score)
        return hypotheses[best], score[best]

    fits, scores = jax.lax.map(lambda pair: candidate(*pair), (lenses, draws.minimal))
    choice = jnp.argmax(scores)
    first = View(points_a, lenses[choice, 0], half_diagonals[0])
    second = View(points_b, lenses[choice, 1], half_diagonals[1])
    fundamental = _polish(fits[choice], first, second, seen, threshold)
    error = jnp.abs(sampson(fundamental, first, second))
    return PairFit(fundamental, error, seen & (error < threshold), choice)


def _polish(fundamental, first: View, second: View, seen, threshold) -> Float[Array, "3 3"]:
    """Iteratively reweighted eight-point fits with MAGSAC weights; a fit that explains less is not taken."""
    rays_a, rays_b, slopes_a, slopes_b = first.rays, second.rays, first.slopes(), second.slopes()

    def again(carry, _):
        fit, best_fit, best = carry
        error = _sampson(fit, rays_a, rays_b, slopes_a, slopes_b)
        weight = jnp.where(seen, magsac_weight(error, threshold / 3.64), 0.0)
        better = weight.sum() > best
        best_fit, best = jnp.where(better, fit, best_fit), jnp.where(better, weight.sum(), best)
        new = eight_point(rays_a, rays_b, weight / _gradient2(fit, rays_a, rays_b, slopes_a, slopes_b))
        return (new, best_fit, best), None

    start = (fundamental, fundamental, jnp.asarray(0.0, rays_a.dtype))
    return jax.lax.scan(again, start, None, length=7)[0][1]


def _gradient2(fundamental, rays_a, rays_b, slopes_a, slopes_b) -> Float[Array, " N"]:
    """Squared length of the gradient of the epipolar form by the pixels: turns algebraic into pixel errors."""
    line_b, line_a = _rows_times(fundamental, rays_a), _rows_times(fundamental.T, rays_b)
    slope_a = (slopes_a * line_a[:, None]).sum(axis=2)
    slope_b = (slopes_b * line_b[:, None]).sum(axis=2)
    return jnp.maximum((slope_a**2).sum(axis=1) + (slope_b**2).sum(axis=1), 1e-20)


@jit
def lens_table(
    points_a: Float[Array, "N 2"],
    points_b: Float[Array, "N 2"],
    weights: Float[Array, " N"],
    half_diagonals: Float[Array, "2"],
    grid: Float[Array, " G"],
    scale: Float[Array, ""],
) -> Float[Array, "G G"]:
    """Robust epipolar cost of a pair for every two division-model parameters of a grid.

    Args:
        weights: 1 for matches that are believed loosely, 0 for others.
        scale: px, the error at which a match begins to count as an outlier.

    Returns:
        Mean of log(1 + (error / scale)^2) over the weighted matches.
    """

    def cell(lenses):
        first = View(points_a, lenses[0], half_diagonals[0])
        second = View(points_b, lenses[1], half_diagonals[1])
        parts = (first.rays, second.rays, first.slopes(), second.slopes())

        def again(weight, _):
            fit = eight_point(parts[0], parts[1], weight)
            error = _sampson(fit, *parts)
            return weights / (1.0 + (error / scale) ** 2) / _gradient2(fit, *parts), error

        error = jax.lax.scan(again, weights, None, length=4)[1][-1]
        return (weights * jnp.log1p((error / scale) ** 2)).sum() / jnp.maximum(weights.sum(), 1.0)

    pairs = jnp.stack(jnp.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    return jax.lax.map(cell, pairs).reshape(grid.shape[0], grid.shape[0])
