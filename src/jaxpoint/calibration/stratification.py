"""From projective to Euclidean: the plane at infinity and the focal lengths (Hartley and Zisserman 2004, chapter 19).

The dual absolute quadric Q = G G^T is kept positive semi-definite of rank 3 by construction: G (4 x 3) is what is
solved for. Its images P Q P^T = K K^T say how far each camera is from zero skew, unit aspect and a principal point at
the image centre. Coordinates: pixels from the image centre over half the image diagonal, undistorted.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.compilation import jit_once
from jaxpoint.geometry.linalg import null_vector
from jaxpoint.geometry.rotation import nearest_rotation

FOCALS = (0.2, 4.0)  # in half diagonals: 160 to 20 degrees of view along the diagonal
GRID = 30
SIGMA_CENTER, SIGMA_ASPECT, SIGMA_SKEW = 0.05, 0.02, 0.02
HUGE = 1e6


class Views(eqx.Module):
    """Projective cameras, and what is believed of their focal lengths."""

    projections: Float[Array, "C 3 4"]  # scaled so that depths are positive
    exists: Bool[Array, " C"]  # False for padding
    log_focal: Float[Array, " C"]  # expected, of half diagonals
    log_focal_sigma: Float[Array, ""]


def image_of_quadric(projections: Float[Array, "C 3 4"], root: Float[Array, "4 3"]) -> Float[Array, "C 3 3"]:
    """K K^T of every camera, scaled so that its last entry is 1."""
    seen = jnp.einsum("cij,jk->cik", projections, root)
    omega = jnp.einsum("cik,cjk->cij", seen, seen)
    return omega / jnp.maximum(omega[:, 2:, 2:], 1e-12)


def _lens_residuals(root, views: Views) -> Float[Array, "C 5"]:
    """How implausible the cameras are under a quadric, in standard deviations."""
    omega = image_of_quadric(views.projections, root)
    x, y = omega[:, 0, 2], omega[:, 1, 2]
    square_x = jnp.maximum(omega[:, 0, 0] - x**2, 1e-6)
    square_y = jnp.maximum(omega[:, 1, 1] - y**2, 1e-6)
    skew = (omega[:, 0, 1] - x * y) / jnp.sqrt(square_x * square_y)
    log_x, log_y = 0.5 * jnp.log(square_x), 0.5 * jnp.log(square_y)
    rows = [
        x / SIGMA_CENTER,
        y / SIGMA_CENTER,
        (log_x - log_y) / SIGMA_ASPECT,
        skew / SIGMA_SKEW,
        (0.5 * (log_x + log_y) - views.log_focal) / views.log_focal_sigma,
    ]
    residual = jnp.stack(rows, axis=1)
    # A single wild camera must not decide: large residuals grow with their square root.
    size = jnp.sqrt(1.0 + (residual / 10.0) ** 2)
    return jnp.where(views.exists[:, None], residual / jnp.sqrt(size), 0.0)


def linear_quadric(views: Views) -> Float[Array, "4 3"]:
    """Root of the dual absolute quadric from weighted linear equations (Pollefeys et al. 2002), made semi-definite."""
    seen = views.exists
    scale = jnp.linalg.norm(views.projections[:, 2], axis=1)
    unit = views.projections / jnp.where(seen, scale, 1.0)[:, None, None]
    upper = jnp.triu_indices(4)

    def row(camera, i, j):
        outer = camera[i][:, None] * camera[j][None, :]
        both = outer + outer.T
        return both[upper] - jnp.where(upper[0] == upper[1], outer[upper], 0.0)

    def rows(camera, log_focal):
        square = jnp.exp(2.0 * log_focal)
        return jnp.stack(
            [
                (row(camera, 0, 0) - row(camera, 1, 1)) / 0.2,
                row(camera, 0, 1) / 0.01,
                row(camera, 0, 2) / 0.1,
                row(camera, 1, 2) / 0.1,
                (row(camera, 0, 0) - square * row(camera, 2, 2)) / 5.0,
                (row(camera, 1, 1) - square * row(camera, 2, 2)) / 5.0,
            ]
        )

    equations = jnp.where(seen[:, None, None], jax.vmap(rows)(unit, views.log_focal), 0.0).reshape(-1, 10)

    def solved(weights):
        values = jnp.linalg.eigh((equations * weights[:, None]).T @ (equations * weights[:, None]))[1][:, 0]
        quadric = jnp.zeros((4, 4), values.dtype).at[upper].set(values)
        quadric = quadric + quadric.T - jnp.diag(jnp.diagonal(quadric))
        depth = jnp.einsum("ci,ij,cj->c", unit[:, 2], quadric, unit[:, 2])
        return quadric * jnp.sign(jnp.where(seen, depth, 0.0).sum()), jnp.abs(depth)

    quadric, depth = solved(jnp.ones(equations.shape[0]))
    for _ in range(2):
        quadric, depth = solved(jnp.repeat(1.0 / jnp.maximum(depth, 1e-3 * jnp.max(depth)), 6))
    values, vectors = jnp.linalg.eigh(quadric)
    return vectors[:, 1:] * jnp.sqrt(jnp.maximum(values[None, 1:], 1e-6 * values[3]))


def focal_grid(views: Views, first, second) -> Float[Array, "K 4 3"]:
    """Best roots over a grid of two cameras' focal lengths, which fix the plane at infinity (Gherardi & Fusiello 2010).

    Depths must be positive beforehand: the sign of P matters. Returns the K = 3 best of GRID^2, unlike each other.
    """
    back = _complete(views.projections[first])
    relative = views.projections[second] @ back
    grid = jnp.geomspace(*FOCALS, GRID)
    focals = jnp.stack(jnp.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    roots = jax.vmap(lambda pair: back @ _root_of_focals(relative, pair[0], pair[1]))(focals)
    costs = jax.vmap(lambda root: (_lens_residuals(root, views) ** 2).sum())(roots)
    costs = jnp.where(jnp.isfinite(costs), costs, HUGE**2)
    chosen = []
    for _ in range(3):
        best = jnp.argmin(costs)
        chosen.append(roots[best])
        far = jnp.abs(jnp.log(focals / focals[best][None])).max(axis=1) > 0.3
        costs = jnp.where(far, costs, HUGE**2)
    return jnp.stack(chosen)


def _complete(projection: Float[Array, "3 4"]) -> Float[Array, "4 4"]:
    """H with P H = [I | 0]."""
    inverse = projection.T @ jnp.linalg.inv(projection @ projection.T)
    return jnp.concatenate([inverse, null_vector(projection)[:, None]], axis=1)


def _root_of_focals(relative: Float[Array, "3 4"], focal_a, focal_b) -> Float[Array, "4 3"]:
    """Root of the quadric in the frame where the first camera is [I | 0], given two focal lengths."""
    first = jnp.stack([focal_a, focal_a, jnp.ones_like(focal_a)])
    second = jnp.stack([focal_b, focal_b, jnp.ones_like(focal_b)])
    middle = relative[:, :3] * first[None] / second[:, None]
    shift = relative[:, 3] / second
    length = jnp.maximum(jnp.linalg.norm(shift), 1e-12)
    axis = shift / length
    side = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    side = side - axis * (side @ axis)
    side = side / jnp.linalg.norm(side)
    turn = jnp.stack([axis, side, jnp.cross(axis, side)])
    w1, w2, w3 = turn @ middle
    plane = (jnp.cross(w2, w3) / jnp.maximum(jnp.linalg.norm(w3), 1e-12) - w1) / length
    return jnp.concatenate([jnp.diag(first), plane[None]], axis=0)


def refine(root: Float[Array, "4 3"], views: Views) -> tuple[Float[Array, "4 3"], Float[Array, ""]]:
    """Levenberg-Marquardt on the root; returns it with its cost (sum of squared standard deviations).

    A root may turn and scale without a change of the residuals; its derivative has no part of that.
    """
    root = root / jnp.maximum(jnp.linalg.norm(root), 1e-12)
    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-9)
    adjoint = optx.ImplicitAdjoint(lx.SVD(rcond=1e-9))
    solution = optx.least_squares(_lens_residuals, solver, root, args=views, max_steps=64, throw=False, adjoint=adjoint)
    cost = (_lens_residuals(solution.value, views) ** 2).sum()
    return solution.value, jnp.where(jnp.isfinite(cost), cost, HUGE**2)


@jit_once
def candidates(views: Views, pairs: Int[Array, "R 2"]) -> tuple[Float[Array, "K 4 3"], Float[Array, " K"]]:
    """Refined upgrade hypotheses, best first: the linear quadric and the focal grids of some reference pairs.

    Args:
        views: the cameras.
        pairs: indices of reference cameras.
    """
    starts = jax.lax.map(lambda pair: focal_grid(views, pair[0], pair[1]), pairs).reshape(-1, 4, 3)
    starts = jnp.concatenate([starts, linear_quadric(views)[None]])
    roots, costs = jax.lax.map(lambda root: refine(root, views), starts)
    order = jnp.argsort(costs)
    return roots[order], costs[order]


class Upgraded(eqx.Module):
    """A Euclidean rig in normalised image coordinates."""

    rotation: Float[Array, "C 3 3"]  # cam_from_world
    translation: Float[Array, "C 3"]
    focal: Float[Array, " C"]  # half diagonals
    center: Float[Array, "C 2"]  # half diagonals from the image centre
    points: Float[Array, "F 3"]
    in_front: Float[Array, ""]  # fraction of the observations in front of their camera


@jit_once
def upgrade(
    root: Float[Array, "4 3"], views: Views, points: Float[Array, "F 4"], visible: Bool[Array, "F C"]
) -> Upgraded:
    """Apply a root: cameras K [R | t] with det R = +1, and the points in front of them (no mirror).

    Scaling each P so that det R = +1 leaves one sign, that of all depths together; it is chosen so that most points
    lie in front. A mirrored rig would need det R = -1, so it cannot come out.
    """
    infinite = null_vector(root.T)
    frame = jnp.concatenate([root, infinite[:, None] * jnp.linalg.norm(root)], axis=1)
    cameras = jnp.einsum("cij,jk->cik", views.projections, frame)
    cameras = cameras * jnp.sign(jnp.linalg.det(cameras[:, :, :3]))[:, None, None]
    omega = image_of_quadric(views.projections, root)
    x, y = omega[:, 0, 2], omega[:, 1, 2]
    focal = jnp.sqrt(jnp.sqrt(jnp.maximum(omega[:, 0, 0] - x**2, 1e-4) * jnp.maximum(omega[:, 1, 1] - y**2, 1e-4)))
    focal = jnp.clip(focal, *FOCALS)
    center = jnp.clip(jnp.stack([x, y], axis=1), -0.2, 0.2)
    scale = jnp.cbrt(jnp.maximum(jnp.abs(jnp.linalg.det(cameras[:, :, :3])), 1e-30) / focal**2)
    unit = cameras / scale[:, None, None]
    upper = jnp.concatenate(
        [unit[:, :2] - center[:, :, None] * unit[:, 2:], focal[:, None, None] * unit[:, 2:]], axis=1
    )
    local = upper / focal[:, None, None]
    rotation = jax.vmap(nearest_rotation)(jnp.where(views.exists[:, None, None], local[:, :, :3], jnp.eye(3)[None]))
    world = points @ jnp.linalg.inv(frame).T
    weight = jnp.where(jnp.abs(world[:, 3]) < 1e-12, 1e-12, world[:, 3])
    world = world[:, :3] / weight[:, None]
    depth = jnp.einsum("cj,fj->fc", local[:, 2, :3], world) + local[None, :, 2, 3]
    ahead = jnp.where(visible, jnp.sign(depth), 0.0).sum()
    sign = jnp.where(ahead < 0, -1.0, 1.0)
    in_front = (visible & (sign * depth > 0)).sum() / jnp.maximum(visible.sum(), 1)
    return Upgraded(rotation, sign * local[:, :, 3], focal, center, sign * world, in_front)
