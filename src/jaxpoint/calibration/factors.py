"""Projective cameras and points from all views at once: pure functions, for `jit`, `vmap` and `grad`.

`factorise` works from anywhere, `adjust_projective` goes on from there. Derivatives are those of the optimum by the
implicit function theorem; the gauge is free, so only what no projective map changes has one that means something.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.calibration.bundle import BLOCK, LEAST_SQUARES, run_solver
from jaxpoint.calibration.implicit import half_cost, optimum
from jaxpoint.calibration.projective import ProjectiveModel
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.geometry.arrays import AnyArray, promote

LENS_SIGMA = 0.1  # of a division-model parameter in the projective adjustment
STEPS = 100
SOLVER = SchurLevenbergMarquardt(model=ProjectiveModel(), rtol=1e-5, start_damping=1e-2, project_points=True)
_TO_THE_END = replace(SOLVER, rtol=1e-12, xtol=1e-8)  # derivatives are those of an optimum


class Factors(eqx.Module):
    """A projective reconstruction in normalised image coordinates: pixels over half the diagonal, from the middle."""

    cameras: Float[Array, "C 3 4"]  # of any scale and sign
    points: Float[Array, "N 3"]  # their fourth coordinate is 1; meaningless where fewer than two cameras see one
    lenses: Float[Array, " C"]  # division-model parameters
    cost: Float[Array, ""]


def factorise(
    points: Float[AnyArray, "N C 2"], weights: Float[AnyArray, "N C"], start: Float[AnyArray, "C 3 4"]
) -> Factors:
    """Rank-4 factorisation under a mask, by the pseudo object-space error (Hong & Zach 2018). No lenses, no poses.

    Args:
        points: undistorted, in normalised image coordinates.
        weights: 0 hides an observation, whatever stands there; frames with fewer than two others are left out.
        start: cameras, which may be random.

    Raises:
        ValueError: float64 would be cut to float32.
    """
    pixels, shares, cameras = promote(points, weights, start)
    ones = jnp.ones_like(cameras[:, 0, 0])
    places = jnp.zeros_like(pixels[:, 0, :1]).repeat(3, axis=1)
    return fit_projective(
        pixels, shares, cameras, 0.0 * ones, places, ones, ones, jnp.full_like(ones[0], LEAST_SQUARES)
    )


def adjust_projective(
    points: Float[AnyArray, "N C 2"],
    weights: Float[AnyArray, "N C"],
    start: Factors,
    half_diagonals: Float[AnyArray, " C"],
    loss_px: Float[AnyArray, ""],
) -> Factors:
    """Projective bundle adjustment: cameras, points and one lens parameter a camera, which is drawn to its start.

    Args:
        points: in normalised image coordinates, as the lens distorts them.
        weights: as of `factorise`.
        half_diagonals: of the images, px.
        loss_px: scale of the Cauchy loss of residuals in pixels of the distorted image.

    Raises:
        ValueError: float64 would be cut to float32.
    """
    pixels, shares, first, half, loss = promote(points, weights, start, half_diagonals, loss_px)
    return fit_projective(pixels, shares, first.cameras, first.lenses, first.points, half, jnp.zeros_like(half), loss)


def fit_projective(
    points: Float[Array, "N C 2"],
    weights: Float[Array, "N C"],
    cameras: Float[Array, "C 3 4"],
    lenses: Float[Array, " C"],
    places: Float[Array, "N 3"],
    half_diagonals: Float[Array, " C"],
    object_space: Float[Array, " C"],
    loss: Float[Array, ""],
) -> Factors:
    """The factorisation where `object_space` is 1, the adjustment where it is 0: one program for both."""
    count, frames = len(cameras), len(points)
    weights = jnp.where(((weights > 0).sum(axis=1) >= 2)[:, None], weights, 0.0)
    numbers = jnp.concatenate([cameras.reshape(count, 12), lenses[:, None]], axis=1)
    seen = (weights > 0).any(axis=0)
    problem = Problem(
        _to_blocks(points),
        _to_blocks(weights),
        (half_diagonals, object_space),
        _free(seen, object_space > 0),
        numbers,
        jnp.zeros_like(numbers).at[:, 12].set(jnp.where(object_space > 0, 0.0, 1.0 / LENS_SIGMA**2)),
        loss,
        jnp.asarray(STEPS),
    )
    end, cost = _optimum(problem, Unknowns(numbers, _to_blocks(places)))
    found = jnp.moveaxis(end.points, -1, 1).reshape(-1, 3)[:frames]
    return Factors(end.cameras[:, :12].reshape(count, 3, 4), found, end.cameras[:, 12], cost)


def _free(seen: Bool[Array, " C"], object_space: Bool[Array, " C"]) -> Bool[Array, "C 13"]:
    """Cameras that see nothing stay; lenses stay in the factorisation."""
    return jnp.concatenate([jnp.repeat(seen[:, None], 12, axis=1), (seen & ~object_space)[:, None]], axis=1)


@eqx.filter_custom_jvp
def _optimum(problem: Problem, start: Unknowns) -> tuple[Unknowns, Float[Array, ""]]:
    end = run_solver(SOLVER, start, problem)
    return Unknowns(end.cameras, end.points), end.cost


@_optimum.def_jvp
def _optimum_jvp(primals, tangents):
    problem, start = primals

    def ended(problem: Problem) -> tuple[Unknowns, Float[Array, ""]]:
        end = optimum(_TO_THE_END, start, problem)
        return end, 2.0 * half_cost(SOLVER.model, end, problem)

    return eqx.filter_jvp(ended, (problem,), (tangents[0],))


def _to_blocks(values: Float[Array, "N *rest"]) -> Float[Array, "NB *rest B"]:
    """Frames in blocks, the block last, with zeros at the end of the last one."""
    missing = -len(values) % BLOCK
    padded = jnp.pad(values, [(0, missing), *[(0, 0)] * (values.ndim - 1)])
    return jnp.moveaxis(padded.reshape(-1, BLOCK, *values.shape[1:]), 1, -1)
