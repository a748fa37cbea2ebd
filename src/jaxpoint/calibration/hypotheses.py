"""From a projective reconstruction to starts for the Euclidean adjustment."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxpoint.calibration.bundle import CENTER, FOCAL, RADIAL, SIZE
from jaxpoint.calibration.factorization import Projective
from jaxpoint.calibration.recording import Recording, RigState, padded_cameras
from jaxpoint.calibration.stratification import Upgraded, candidates, upgrade
from jaxpoint.calibration.twoview import NormalisedTracks

REFERENCE_PAIRS = 4  # pairs of cameras whose focal lengths are searched
HYPOTHESES = 3  # upgrades that are tried in full, at most


def upgraded_states(
    recording: Recording, data: NormalisedTracks, projective: Projective, kept: np.ndarray
) -> list[RigState]:
    """Distinct Euclidean rigs, the most plausible lenses first."""
    count = len(projective.cameras)
    pad = padded_cameras(count) - count
    cameras = jnp.asarray(np.concatenate([projective.cameras, np.tile(np.eye(3, 4), (pad, 1, 1))]))
    seen = jnp.asarray(np.arange(count + pad) < count)
    roots, costs = candidates(cameras, seen, jnp.asarray(_reference_pairs(kept)))
    costs = np.asarray(costs)
    states, focals = [], []
    for root, cost in zip(roots, costs):
        if cost > max(100.0 * costs[0], 25.0 * count) and states:
            break
        visible = jnp.asarray(np.pad(kept, ((0, 0), (0, pad))))
        rig = upgrade(root, cameras, jnp.asarray(projective.points), visible, seen)
        focal = np.log(np.asarray(rig.focal)[:count])
        if not np.isfinite(focal).all() or any(np.abs(focal - other).max() < 0.05 for other in focals):
            continue
        focals.append(focal)
        states.append(rig_state(recording, data, rig, projective.lenses))
        if len(states) == HYPOTHESES:
            break
    return states


def _reference_pairs(kept: np.ndarray) -> np.ndarray:
    """The pairs of cameras that share most frames, REFERENCE_PAIRS of them."""
    visible = kept.astype(int)
    shared = np.triu(visible.T @ visible, 1)
    order = np.argsort(-shared, axis=None)[:REFERENCE_PAIRS]
    pairs = np.stack(np.unravel_index(order, shared.shape), axis=1)
    pairs = pairs[shared[pairs[:, 0], pairs[:, 1]] > 0]
    return np.resize(pairs, (REFERENCE_PAIRS, 2))


def rig_state(recording: Recording, data: NormalisedTracks, rig: Upgraded, lenses: np.ndarray) -> RigState:
    """The 15 numbers of every camera, in pixels, at a scale where the cameras are about 1 apart."""
    count = recording.cameras
    size = len(recording.image_sizes)
    numbers, base = np.zeros((size, SIZE)), np.tile(np.eye(3), (size, 1, 1))
    base[:count] = np.asarray(rig.rotation)[:count]
    translation, points = np.asarray(rig.translation)[:count], np.nan_to_num(np.asarray(rig.points))
    positions = -np.einsum("cji,cj->ci", base[:count], translation)
    middle = positions.mean(axis=0)
    length = np.sqrt(((positions - middle) ** 2).sum(axis=1).mean())
    length = length if length > 0 else 1.0
    numbers[:count, 3:6] = (translation + np.einsum("cij,j->ci", base[:count], middle)) / length
    points = np.clip((points - middle) / length, -1e3, 1e3)
    focal = np.asarray(rig.focal)[:count]
    numbers[:, FOCAL] = np.log(1000.0)
    numbers[:count, FOCAL] = np.log(focal * data.half_diagonals)
    numbers[:, CENTER] = (recording.image_sizes - 1) / 2.0
    for camera in range(count):
        reach = np.linalg.norm(data.points[data.visible[:, camera], camera], axis=1).max()
        numbers[camera, RADIAL] = brown_of_division(lenses[camera], focal[camera], reach)
    return RigState(numbers, base, points)


def brown_of_division(lens: float, focal: float, reach: float) -> np.ndarray:
    """k1 and k2 that bend like a division-model lens up to the distorted radius `reach` (half diagonals)."""
    bent = np.linspace(0.05, 1.0, 40) * reach
    third = 1.0 + lens * bent**2
    bent, third = bent[third > 0.2], third[third > 0.2]
    straight = bent / third / focal
    design = np.stack([straight**3, straight**5], axis=1)
    k1, k2 = np.linalg.lstsq(design, bent / focal - straight, rcond=None)[0]
    return np.array([k1, k2])
