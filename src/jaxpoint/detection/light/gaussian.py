"""Sub-pixel position of small lights: a batched least-squares Gaussian, and the thesis's template correlation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

MAX_STEPS = 40
STEP_TOLERANCE = 1e-4  # px and log-px


@dataclass(frozen=True)
class GaussianFit:
    """N elliptical Gaussians on constant backgrounds, each fitted to one square patch."""

    center: Float[np.ndarray, "N 2"]  # px (x, y) from the centre of the patch's middle pixel
    covariance: Float[np.ndarray, "N 2 2"]  # px^2, of the centre
    radii: Float[np.ndarray, "N 2"]  # px, standard deviations along the axes, larger first
    amplitude: Float[np.ndarray, " N"]  # grey levels
    significance: Float[np.ndarray, " N"]  # amplitude over its own standard deviation
    converged: Bool[np.ndarray, " N"]


def fit_gaussians(
    patches: Float[np.ndarray, "N S S"],
    usable: Bool[np.ndarray, "N S S"],
    noise: Float[np.ndarray, " N"] | float = 1.0,
    radius: float | None = None,
) -> GaussianFit:
    """Least-squares fit of offset + amplitude exp(-|L^T (p - centre)|^2 / 2) to each patch, by Levenberg-Marquardt.

    Args:
        patches: grey levels, S odd, the light near the middle.
        usable: pixels that count; leave out saturated ones and those outside the image.
        noise: smallest standard deviation of a grey level that is assumed; the residuals may show a larger one.
        radius: a known standard deviation of round spots, px, that is then not fitted.

    The covariance of the centre is the inverse normal matrix times the larger of the residual variance and `noise`
    squared. Fits of fewer than 8 usable pixels, and those that run away, are not `converged`.
    """
    size = patches.shape[-1]
    half = size // 2
    axis = np.arange(size, dtype=np.float64) - half
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    weight = usable.reshape(len(patches), size * size).astype(np.float64)
    values = np.where(weight > 0, patches.reshape(weight.shape), 0.0)
    state = _start(values, weight, x, y)
    free = np.ones(7)
    if radius is not None:
        state[:, [4, 6]], free[4:] = -np.log(radius), 0.0
    state, normal, cost, converged = _minimise(state, free, values, weight, x, y)

    count = weight.sum(axis=1)
    variance = np.maximum(cost / np.maximum(count - free.sum(), 1), np.square(noise))
    inverse = np.linalg.inv(normal + 1e-9 * np.eye(7)) * variance[:, None, None]
    shape = np.zeros((len(patches), 2, 2))
    shape[:, 0, 0], shape[:, 1, 0], shape[:, 1, 1] = np.exp(state[:, 4]), state[:, 5], np.exp(state[:, 6])
    radii = 1.0 / np.linalg.svd(shape, compute_uv=False)[:, ::-1]
    amplitude = state[:, 2]
    return GaussianFit(
        center=state[:, :2],
        covariance=inverse[:, :2, :2],
        radii=radii,
        amplitude=amplitude,
        significance=amplitude / np.sqrt(inverse[:, 2, 2]),
        converged=converged & (count >= 8) & (amplitude > 0) & (np.abs(state[:, :2]) < half).all(axis=1),
    )


def _start(values: np.ndarray, weight: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Centre, amplitude, offset and width from the brightest part of each patch."""
    count = np.maximum(weight.sum(axis=1), 1)
    low = np.where(weight > 0, values, np.inf).min(axis=1)
    low = np.where(np.isfinite(low), low, 0.0)
    offset = np.minimum((weight * values).sum(axis=1) / count, 0.5 * (low + values.max(axis=1)))
    height = np.maximum(values.max(axis=1) - offset, 1e-3)
    # Masked (saturated) pixels are at least as bright as the brightest kept one.
    light = np.where(weight > 0, np.maximum(values - offset[:, None] - 0.3 * height[:, None], 0.0), 0.0)
    total = np.maximum(light.sum(axis=1), 1e-9)
    state = np.zeros((len(values), 7))
    state[:, 0], state[:, 1] = light @ x / total, light @ y / total
    moment = (light * (np.square(x - state[:, :1]) + np.square(y - state[:, 1:2]))).sum(axis=1) / total / 2
    state[:, 2], state[:, 3] = height, offset
    state[:, 4] = state[:, 6] = -0.5 * np.log(np.clip(moment, 0.5, None))
    return state


def _model(state: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (N, M) and derivatives (N, M, 7) by x, y, amplitude, offset, log L11, L21, log L22."""
    dx, dy = x - state[:, :1], y - state[:, 1:2]
    l11, l21, l22 = np.exp(state[:, 4:5]), state[:, 5:6], np.exp(state[:, 6:7])
    u, v = l11 * dx + l21 * dy, l22 * dy
    bell = np.exp(-0.5 * (u * u + v * v))
    lit = state[:, 2:3] * bell
    columns = [lit * u * l11, lit * (u * l21 + v * l22), bell, np.ones_like(bell)]
    columns += [-lit * u * l11 * dx, -lit * u * dy, -lit * v * v]
    return lit + state[:, 3:4], np.stack(columns, axis=-1)


def _minimise(
    state: np.ndarray, free: np.ndarray, values: np.ndarray, weight: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State, normal matrix, cost and whether the steps became small; parameters that are not `free` stay.

    In numpy: optimistix's Levenberg-Marquardt ends at the same centres to 1e-6 px, takes 4 times as long (270 us a
    patch of a batch of 2000 in place of 68; experiments/benchmarks/small_solvers.py), and would bring JAX into every
    process that looks for lights.
    """
    count = len(state)
    damping = np.full(count, 1e-2)
    converged = np.zeros(count, dtype=bool)
    predicted, jacobian = _model(state, x, y)
    residual = weight * (predicted - values)
    cost = np.square(residual).sum(axis=1)
    diagonal = np.arange(7)
    for _ in range(MAX_STEPS):
        weighted = jacobian * weight[..., None] * free
        normal = weighted.transpose(0, 2, 1) @ weighted
        gradient = (weighted.transpose(0, 2, 1) @ residual[..., None])[..., 0]
        damped = normal.copy()
        damped[:, diagonal, diagonal] = damped[:, diagonal, diagonal] * (1 + damping[:, None]) + 1e-9
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        step[:, [0, 1]] = np.clip(step[:, [0, 1]], -1.0, 1.0)
        step[:, [4, 6]] = np.clip(step[:, [4, 6]], -0.5, 0.5)
        trial = np.where(converged[:, None], state, state + step)
        trial[:, [4, 6]] = np.clip(trial[:, [4, 6]], -4.0, 3.0)
        new_predicted, new_jacobian = _model(trial, x, y)
        new_residual = weight * (new_predicted - values)
        new_cost = np.square(new_residual).sum(axis=1)
        better = (new_cost <= cost) & ~converged
        damping = np.where(better, damping * 0.1, damping * 4.0)
        converged |= (np.abs(step[:, [0, 1, 4, 6]]).max(axis=1) < STEP_TOLERANCE) & (better | (damping > 1e6))
        state = np.where(better[:, None], trial, state)
        jacobian = np.where(better[:, None, None], new_jacobian, jacobian)
        residual = np.where(better[:, None], new_residual, residual)
        cost = np.where(better, new_cost, cost)
        if converged.all():
            break
    weighted = jacobian * weight[..., None] * free
    return state, weighted.transpose(0, 2, 1) @ weighted, cost, converged


def correlate_template(patch: Float[np.ndarray, "S S"], sigma: float, scale: int = 5) -> Float[np.ndarray, "2"]:
    """Thesis 5.3.1: bicubic resampling by `scale`, correlation with a Gaussian of `sigma` px, the highest place.

    Returns x, y in px from the centre of the patch's middle pixel, on a grid of 1 / scale px.
    """
    large = cv2.resize(np.asarray(patch, np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    score = cv2.GaussianBlur(large, (0, 0), sigma * scale, borderType=cv2.BORDER_REPLICATE)
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    half = patch.shape[0] // 2
    # Half a pixel: the centre of the first fine pixel lies at 0.5 / scale - 0.5 of a coarse one.
    return (np.array([column, row]) + 0.5) / scale - 0.5 - half
