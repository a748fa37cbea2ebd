"""The thesis's own factorisation: projective depths by epipolar geometry, missing entries filled, rank 4.

Depths: Sturm & Triggs 1996 (thesis eq. 5.6). Fill: Martinec & Pajdla 2002 (after Jacobs 1997). Kept as the baseline
and as one more hypothesis; with much missing data the default of `factorization` does better.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.calibration.factorization import Projective, normalise_projective
from jaxpoint.calibration.twoview import NormalisedTracks, TwoViewGeometry, fundamental
from jaxpoint.epipolar import lift
from jaxpoint.geometry.arrays import AnyArray
from jaxpoint.geometry.linalg import smallest_vectors, span_projector

TUPLES = 1024  # quadruples of frames whose common subspace is sought


def depth_ratios(
    matrix: Float[AnyArray, "3 3"], rays_i: Float[AnyArray, "N 3"], rays_j: Float[AnyArray, "N 3"]
) -> Float[Array, " N"]:
    """lambda_i / lambda_j of every match (thesis eq. 5.6), up to one factor for the pair.

    Args:
        matrix: F with ray_i^T F ray_j = 0; its left null vector is the epipole in view i.
    """
    epipole = jnp.linalg.svd(matrix)[0][:, 2]
    across = jnp.cross(epipole[None], rays_i)
    line = (matrix[None] * rays_j[:, None, :]).sum(axis=2)
    length = (across**2).sum(axis=1)
    return (across * line).sum(axis=1) / jnp.where(length > 1e-12, length, 1.0)


def depths(data: NormalisedTracks, geometry: TwoViewGeometry, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Projective depths (N, C), and where they are known.

    Every pair leaves one factor free. The factors are chosen pair by pair, those with most inliers first, so that
    they agree with the depths already chained (the median over frames: one bad frame must not decide).
    """
    rays = np.asarray(lift(jnp.asarray(data.points), jnp.asarray(geometry.lenses)))
    cameras = rays.shape[1]
    known = np.zeros(kept.shape, bool)
    result = np.ones(kept.shape)
    order = sorted(geometry.fundamentals, key=lambda pair: -geometry.inliers[pair])
    root = order[0][0]
    known[:, root] = kept[:, root]
    reached = {root}
    while len(reached) < cameras:
        edges = [(i, j) for i, j in order if (i in reached) != (j in reached)]
        if not edges:
            break
        first, second = edges[0]
        new = second if first in reached else first
        _attach(new, reached, rays, geometry, kept, known, result)
        reached.add(new)
    return result, known


def _attach(new, reached, rays, geometry, kept, known, result) -> None:
    """Depths of one more camera from all cameras that it shares frames with, and of frames that only it brings in."""
    partners = [old for old in reached if geometry.inliers[new, old] > 0]
    partners.sort(key=lambda old: -geometry.inliers[new, old])
    for old in partners:
        both = kept[:, new] & kept[:, old]
        ratio = np.asarray(depth_ratios(fundamental(geometry, old, new), rays[:, new], rays[:, old]))
        usable = both & known[:, old] & np.isfinite(ratio) & (np.abs(ratio) > 1e-9)
        agree = usable & known[:, new]
        if known[:, new].any():
            if agree.sum() < 5:
                continue
            ratio = ratio * np.median(result[agree, new] / (ratio[agree] * result[agree, old]))
        elif usable.any():
            ratio = ratio / np.median(ratio[usable])
        fresh = usable & ~known[:, new]
        result[fresh, new] = ratio[fresh] * result[fresh, old]
        known[fresh, new] = True
        # A frame that no camera before it saw starts with this pair; its column may have any scale.
        opened = both & ~known[:, old] & ~known[:, new] & (np.abs(ratio) > 1e-9)
        result[opened, old], result[opened, new] = 1.0, ratio[opened]
        known[opened, old] = known[opened, new] = True


@eqx.filter_jit
def fill_rank_four(
    measurements: Float[Array, "N C 3"], known: Bool[Array, "N C"], tuples: Int[Array, "T 4"]
) -> tuple[Float[Array, "C 3 4"], Float[Array, "N 4"]]:
    """Cameras and points of a scaled measurement matrix with holes (Martinec & Pajdla 2002).

    Four frames span the column space where all four are known; what is orthogonal to that span there is orthogonal
    to the cameras. The cameras are the four directions least covered by all those complements together, the points
    a least-squares fit to the known entries. Pure: for jit, vmap and grad; hidden entries have the derivative 0.
    """
    cameras = measurements.shape[1]
    scaled = jnp.where(known[..., None], measurements, 0.0)
    square = (scaled**2).sum(axis=(1, 2))
    scaled = scaled / jnp.sqrt(jnp.where(square > 0, square, 1.0))[:, None, None]

    def complement(total, index):
        common = jnp.repeat(known[index].all(axis=0), 3)
        span = jnp.where(common[:, None], scaled[index].reshape(4, -1).T, 0.0)
        values = jnp.linalg.svd(jax.lax.stop_gradient(span), compute_uv=False)
        usable = (common.sum() >= 6) & (values[3] > 1e-4 * values[0])
        safe = jnp.where(usable, span, jnp.eye(*span.shape, dtype=span.dtype))
        part = jnp.diag(common.astype(span.dtype)) - span_projector(safe)
        return total + jnp.where(usable, part, 0.0), None

    total, _ = jax.lax.scan(complement, jnp.zeros((3 * cameras, 3 * cameras), scaled.dtype), tuples)
    motion = smallest_vectors(total, 4).reshape(cameras, 3, 4)

    def place(row, seen):
        weight = jnp.repeat(seen, 3)[:, None]
        design = jnp.where(weight, motion.reshape(-1, 4), 0.0)
        normal = design.T @ design + 1e-12 * jnp.eye(4, dtype=row.dtype)
        return jnp.linalg.solve(normal, design.T @ row.reshape(-1))

    return motion, jax.vmap(place)(scaled, known)


def thesis_factorisation(
    data: NormalisedTracks, geometry: TwoViewGeometry, kept: np.ndarray, rng: np.random.Generator
) -> Projective:
    """Depths, fill and rank-4 factorisation as the thesis describes them (5.3.2, 5.3.3)."""
    scale, known = depths(data, geometry, kept)
    known = known & (known.sum(axis=1) >= 2)[:, None]
    rays = np.asarray(lift(jnp.asarray(data.points), jnp.asarray(geometry.lenses)))
    tuples = _quadruples(known, rng)
    motion, points = fill_rank_four(jnp.asarray(scale[..., None] * rays), jnp.asarray(known), jnp.asarray(tuples))
    return normalise_projective(data, np.asarray(motion), np.asarray(points), geometry.lenses, kept, 0.0)


def _quadruples(known: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Frames drawn together that share cameras: the first at random, the others among its kin."""
    usable = np.flatnonzero(known.sum(axis=1) >= 2)
    shared = known[usable].astype(int) @ known[usable].T.astype(int)
    chosen = np.zeros((TUPLES, 4), int)
    for row in range(TUPLES):
        first = rng.integers(len(usable))
        kin = shared[first] >= min(known[usable[first]].sum(), 3)
        others = rng.choice(len(usable), 3, p=kin / kin.sum())
        chosen[row] = usable[[first, *others]]
    return chosen
