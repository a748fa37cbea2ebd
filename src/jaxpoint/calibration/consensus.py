"""Where the light was, whatever some of the cameras say: the point on which most views agree, for every frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np

from jaxpoint.calibration.recording import Recording, RigState
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.parameters import FOCAL, lens_parameters
from jaxpoint.compilation import jit

MAX_PAIRS = 128  # of a large rig, this many pairs are tried
FIRM = 0.5  # of the threshold: two views that agree to this are no chance
FAR = 20.0  # thresholds, beyond which an error counts no more


@dataclass(frozen=True)
class Consensus:
    """The best point of every frame and who supports it."""

    points: np.ndarray  # (N, 3)
    agree: np.ndarray  # (N, D) views within the threshold of the point and in front
    placed: np.ndarray  # (N,) there is a point, even if nobody agrees with it
    ambiguous: np.ndarray  # (N,) two views agree, but so do two others: nobody can say who is wrong


def consensus(recording: Recording, state: RigState, threshold: float) -> Consensus:
    """Triangulate every frame from every pair of views and keep the point with which most views agree (px)."""
    pairs = _pairs(recording)
    points, agree, placed, ambiguous = _search(
        state.lens, recording.pixels, recording.visible, state.rotation, state.cameras, pairs, np.float64(threshold)
    )
    return Consensus(np.asarray(points), np.asarray(agree), np.asarray(placed), np.asarray(ambiguous))


def no_consensus(recording: Recording) -> Consensus:
    """No point at all, where nothing but poses and known points places rows."""
    rows = len(recording.pixels)
    nothing = np.zeros(rows, bool)
    return Consensus(np.zeros((rows, 3)), np.zeros(recording.visible.shape, bool), nothing, nothing)


def _pairs(recording: Recording) -> np.ndarray:
    """Pairs of cameras that share frames, the most first; padded by repetition to a multiple of 16."""
    visible = recording.visible[:, : recording.cameras].astype(int)
    shared = visible.T @ visible
    pairs = sorted(combinations(range(recording.cameras), 2), key=lambda pair: -shared[pair])
    pairs = [pair for pair in pairs if shared[pair] > 0][:MAX_PAIRS] or [(0, 1)]
    missing = -len(pairs) % 16
    return np.array(pairs + [pairs[0]] * missing)


@partial(jit, static_argnums=0)
def _search(lens: type[AbstractLens], pixels, visible, rotation, cameras, pairs, threshold):
    parameters = jnp.stack(lens_parameters(list(cameras[:, FOCAL:].T)))  # (q, D)
    rays, valid = _rays(lens, parameters, pixels)
    rays = (rays[:, :, :, None] * rotation[None]).sum(axis=2)
    centers = -(rotation * cameras[:, 3:6, None]).sum(axis=1)

    def attempt(best, pair):
        first, second = pair[0], pair[1]
        point, good = _midpoint(centers[first], rays[:, first], centers[second], rays[:, second])
        good = good & visible[:, first] & visible[:, second] & valid[:, first] & valid[:, second]
        error, seen = _errors(lens, parameters, rotation, cameras, point, pixels)
        agree = visible & (error < threshold) & seen & good[:, None]
        count = agree.sum(axis=1)
        cost = jnp.where(visible, jnp.minimum(error, FAR * threshold), 0.0).sum(axis=1)
        cost = jnp.where(good, cost, jnp.inf)
        old_point, old_agree, old_count, old_cost, old_firm, ambiguous = best
        firm = (agree & (error < FIRM * threshold)).sum(axis=1) >= 2
        more, equal = count > old_count, count == old_count
        other = equal & firm & old_firm & (agree != old_agree).any(axis=1)
        take = more | (equal & (cost < old_cost))
        ambiguous = jnp.where(more, False, ambiguous | other)
        return (
            jnp.where(take[:, None], point, old_point),
            jnp.where(take[:, None], agree, old_agree),
            jnp.where(take, count, old_count),
            jnp.where(take, cost, old_cost),
            jnp.where(more, firm, old_firm | (equal & firm)),
            ambiguous,
        ), None

    frames, dtype = pixels.shape[0], pixels.dtype
    start = (
        jnp.zeros((frames, 3), dtype),
        jnp.zeros_like(visible),
        jnp.zeros(frames, jnp.int64 if dtype == jnp.float64 else jnp.int32),
        jnp.full(frames, jnp.inf, dtype),
        jnp.zeros(frames, bool),
        jnp.zeros(frames, bool),
    )
    (points, agree, count, cost, _, ambiguous), _ = jax.lax.scan(attempt, start, pairs)
    return points, agree, jnp.isfinite(cost), ambiguous & (count == 2) & (visible.sum(axis=1) > 2)


def _midpoint(origin_a, rays_a, origin_b, rays_b):
    """Middle of the shortest segment between two rays, for all frames; False where they are nearly parallel."""
    apart = (origin_b - origin_a)[None]
    cosine = (rays_a * rays_b).sum(axis=1)
    along_a, along_b = (apart * rays_a).sum(axis=1), (apart * rays_b).sum(axis=1)
    sine2 = 1.0 - cosine**2
    good = sine2 > 1e-6
    sine2 = jnp.where(good, sine2, 1.0)
    reach_a = (along_a - cosine * along_b) / sine2
    reach_b = (cosine * along_a - along_b) / sine2
    point = 0.5 * (origin_a[None] + reach_a[:, None] * rays_a + origin_b[None] + reach_b[:, None] * rays_b)
    return point, good & (reach_a > 0) & (reach_b > 0)


def _rays(lens: type[AbstractLens], parameters, pixels):
    """Unit directions (N, D, 3) in the cameras, and whether the lenses have them (N, D)."""

    def one(own, seen):
        return lens(own).unproject(seen)  # pyright: ignore[reportCallIssue]

    return jax.vmap(one, in_axes=(1, 1), out_axes=1)(parameters, pixels)


def _errors(lens: type[AbstractLens], parameters, rotation, cameras, points, pixels):
    """Reprojection errors (N, D) px, and whether the points lie where the cameras may see them (N, D)."""
    local = (rotation[None] * points[:, None, None, :]).sum(axis=3) + cameras[None, :, 3:6]
    direction = tuple(local[..., i] for i in range(3))
    x, y = lens.slopes_of([own[None] for own in parameters], direction, wild=True).pixel
    error = jnp.sqrt((x - pixels[..., 0]) ** 2 + (y - pixels[..., 1]) ** 2)
    return error, jnp.ones_like(x, bool) if lens.sees_sideways else local[..., 2] > 0
