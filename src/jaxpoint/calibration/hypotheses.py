"""Starts for the Euclidean adjustment, from a projective reconstruction or from a chain of essential matrices."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxpoint.calibration.essential import chain, voted_focals
from jaxpoint.calibration.factorization import Projective
from jaxpoint.calibration.recording import Recording, RigState, padded_cameras
from jaxpoint.calibration.stratification import Views, candidates, upgrade
from jaxpoint.calibration.twoview import NormalisedTracks, TwoViewGeometry
from jaxpoint.camera.conversion import fit_coefficients
from jaxpoint.camera.lenses import LensChoice
from jaxpoint.camera.parameters import ASPECT, CENTER, COEFFICIENTS, FOCAL, adjusted_lenses, size_of
from jaxpoint.camera.rig import CameraRig

REFERENCE_PAIRS = 4  # pairs of cameras whose focal lengths are searched
HYPOTHESES = 3  # upgrades that are tried in full, at most
TYPICAL_FOCAL, SIGMA_LOG_FOCAL = 1.2, 0.7  # half diagonals: what is believed of an unknown lens
SIGMA_KNOWN_FOCAL = 0.02


@dataclass(frozen=True)
class Lenses:
    """What is known of the lenses before the rig is solved."""

    focals: np.ndarray | None  # (C,) half diagonals, where intrinsics are known
    division: np.ndarray  # (C,) division-model parameters
    known: CameraRig | None
    choice: LensChoice  # its free coefficients are what the division model is turned into

    @staticmethod
    def of(
        data: NormalisedTracks,
        geometry: TwoViewGeometry,
        known: CameraRig | None,
        choice: LensChoice,
    ) -> Lenses:
        """From known intrinsics, or from the pairs' division-model parameters."""
        focals = None if known is None else np.asarray(known.cameras.focal)[:, 0] / data.half_diagonals
        return Lenses(focals, geometry.lenses, known, choice)


def euclidean_upgrades(
    recording: Recording, data: NormalisedTracks, projective: Projective, kept: np.ndarray, lenses: Lenses
) -> list[RigState]:
    """Distinct Euclidean rigs of a projective reconstruction, the most plausible lenses first."""
    count = len(projective.cameras)
    views = _views(projective.cameras, lenses.focals)
    visible = jnp.asarray(np.pad(kept, ((0, 0), (0, len(views.exists) - count))))
    roots, costs = candidates(views, jnp.asarray(_reference_pairs(kept)))
    costs = np.asarray(costs)
    states: list[RigState] = []
    signatures: list[np.ndarray] = []
    for root, cost in zip(roots, costs):
        if states and cost > max(100.0 * costs[0], 25.0 * count):
            break
        rig = upgrade(root, views, jnp.asarray(projective.points), visible)
        focal = np.asarray(rig.focal)[:count]
        signature = np.append(np.log(focal), float(rig.in_front))
        if not np.isfinite(signature).all() or any(np.abs(signature - old).max() < 0.05 for old in signatures):
            continue
        signatures.append(signature)
        rotation, translation = np.asarray(rig.rotation)[:count], np.asarray(rig.translation)[:count]
        states.append(
            rig_state(recording, data, rotation, translation, focal, np.asarray(rig.points), lenses, projective.lenses)
        )
        if len(states) == HYPOTHESES:
            break
    return states


def _views(cameras: np.ndarray, focals: np.ndarray | None) -> Views:
    count = len(cameras)
    pad = padded_cameras(count) - count
    sigma = SIGMA_LOG_FOCAL if focals is None else SIGMA_KNOWN_FOCAL
    focals = np.full(count, TYPICAL_FOCAL) if focals is None else focals
    return Views(
        jnp.asarray(np.concatenate([cameras, np.tile(np.eye(3, 4), (pad, 1, 1))])),
        jnp.asarray(np.arange(count + pad) < count),
        jnp.asarray(np.log(np.append(focals, np.ones(pad)))),
        jnp.asarray(sigma),
    )


def compile_upgrade(recording: Recording, data: NormalisedTracks) -> None:
    """Run the upgrade once on nothing, for its compilation."""
    views = _views(np.tile(np.eye(3, 4), (recording.cameras, 1, 1)), None)
    roots, _ = candidates(views, jnp.zeros((REFERENCE_PAIRS, 2), int))
    frames, cameras = len(data.points), len(views.exists)
    upgrade(roots[0], views, jnp.zeros((frames, 4)), jnp.zeros((frames, cameras), bool))


def _reference_pairs(kept: np.ndarray) -> np.ndarray:
    """The pairs of cameras that share most frames, REFERENCE_PAIRS of them."""
    visible = kept.astype(int)
    shared = np.triu(visible.T @ visible, 1)
    order = np.argsort(-shared, axis=None)[:REFERENCE_PAIRS]
    pairs = np.stack(np.unravel_index(order, shared.shape), axis=1)
    pairs = pairs[shared[pairs[:, 0], pairs[:, 1]] > 0]
    return np.resize(pairs, (REFERENCE_PAIRS, 2))


def essential_chains(
    recording: Recording, data: NormalisedTracks, geometry: TwoViewGeometry, kept: np.ndarray, lenses: Lenses
) -> list[RigState]:
    """The rig of a chain of essential matrices, or nothing where a camera is not reached."""
    focals = voted_focals(geometry) if lenses.focals is None else lenses.focals
    poses = chain(geometry, data.points, kept, focals)
    if poses is None:
        return []
    return [rig_state(recording, data, *poses, focals, None, lenses, geometry.lenses)]


def rig_state(
    recording: Recording,
    data: NormalisedTracks,
    rotation: np.ndarray,
    translation: np.ndarray,
    focal: np.ndarray,
    points: np.ndarray | None,
    lenses: Lenses,
    division: np.ndarray,
) -> RigState:
    """The parameters of every camera, in pixels, at a scale where the cameras are about 1 apart.

    Args:
        rotation, translation: cam_from_world (C, 3, 3), (C, 3).
        focal: (C,) half diagonals.
        points: (N, 3), or None where there are none yet (they come out as zeros).
        lenses: known intrinsics, where there are any, replace the focal lengths.
        division: (C,) division-model parameters.
    """
    count, size = recording.cameras, len(recording.image_sizes)
    numbers, base = np.zeros((size, size_of(lenses.choice.model))), np.tile(np.eye(3), (size, 1, 1))
    base[:count] = rotation
    positions = -np.einsum("cji,cj->ci", rotation, translation)
    middle = positions.mean(axis=0)
    length = np.sqrt(((positions - middle) ** 2).sum(axis=1).mean()) or 1.0
    numbers[:count, 3:6] = (translation + np.einsum("cij,j->ci", rotation, middle)) / length
    placed = np.zeros((len(data.points), 3))
    if points is not None:
        placed = np.clip((np.nan_to_num(points) - middle) / length, -1e3, 1e3)
    numbers[:, FOCAL] = np.log(1000.0)
    numbers[:, CENTER] = (recording.image_sizes - 1) / 2.0
    if lenses.known is not None:
        numbers[:count, FOCAL:] = adjusted_lenses(lenses.known)
        return RigState(numbers, base, placed, lenses.choice.model)
    numbers[:count, FOCAL] = np.log(focal * data.half_diagonals)
    numbers[:count, ASPECT] = -np.log(data.pixel_aspects)
    for camera in range(count):
        choice = lenses.choice.select([camera])
        reach = np.linalg.norm(data.points[data.visible[:, camera], camera], axis=1).max()
        numbers[camera, COEFFICIENTS] = coefficients_of_division(division[camera], focal[camera], reach, choice)
    return RigState(numbers, base, placed, lenses.choice.model)


_FOUR_WAYS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


def coefficients_of_division(lens: float, focal: float, reach: float, choice: LensChoice) -> np.ndarray:
    """Coefficients (k,) of one camera that bend like a division-model lens up to the distorted radius `reach`.

    In half diagonals.
    """
    bent = np.linspace(0.05, 1.0, 40) * reach
    third = 1.0 + lens * bent**2
    bent, third = bent[third > 0.2], third[third > 0.2]
    straight, seen = ((values[:, None, None] * _FOUR_WAYS).reshape(-1, 2) for values in (bent / third / focal, bent))
    directions = np.concatenate([straight, np.ones((len(straight), 1))], axis=1)
    common = np.array([focal, focal, 0.0, 0.0])
    return fit_coefficients(choice.model, common, directions, seen, choice.free[0], choice.mean[0])
