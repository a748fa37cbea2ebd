"""Which cameras stand where an older survey has them, and which were moved since."""

from __future__ import annotations

from itertools import combinations

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.alignment import umeyama

TRIPLES = 5000  # all of 32 cameras; of more so many are drawn
CLEARLY = 3.0  # times as far as errors explain: cameras nearer than that belong to a poor survey, and stay


def still_cameras(
    centres: Float[np.ndarray, "N 3"], known: Float[np.ndarray, "N 3"], moved_m: float
) -> Bool[np.ndarray, " N"]:
    """The cameras that one similarity brings to where they are known to be; all, where that is not to be told.

    Every three cameras propose a similarity. Some are left out where most of all cameras agree on one, no other set as
    large does, and those that are left out are clearly elsewhere.

    Args:
        centres: solver's unit.
        known: m.
        moved_m: how far errors alone bring a camera from its known place.
    """
    count = len(centres)
    everyone = np.ones(count, bool)
    with jax.enable_x64(True):
        if count < 4 or _distances(centres, known, everyone[None])[0].max() <= moved_m:
            return everyone
        triples = np.array(list(combinations(range(count), 3)))
        if len(triples) > TRIPLES:
            triples = triples[np.random.default_rng(0).choice(len(triples), TRIPLES, replace=False)]
        chosen = np.zeros((len(triples), count), bool)
        chosen[np.arange(len(triples))[:, None], triples] = True
        distances = _distances(centres, known, chosen)
        fits = np.all((distances <= moved_m) | ~chosen, axis=1)
        near = (distances <= moved_m) & fits[:, None]
        sets, sizes = np.unique(near, axis=0), np.unique(near, axis=0).sum(axis=1)
        best = sets[int(sizes.argmax())]
        alone = (sizes == sizes.max()).sum() == 1 and 2 * sizes.max() > count and sizes.max() >= 3
        if not alone:
            return everyone
        away = _distances(centres, known, best[None])[0][~best]
    return best if (away > CLEARLY * moved_m).all() else everyone


def _distances(
    centres: Float[np.ndarray, "N 3"], known: Float[np.ndarray, "N 3"], chosen: Bool[np.ndarray, "T N"]
) -> Float[np.ndarray, "T N"]:
    """From every camera to its known place (m), under the similarities that fit the chosen ones."""
    fits = jax.vmap(umeyama, in_axes=(None, None, 0))(centres, known, chosen.astype(float))
    scale, rotation, translation = (np.asarray(part) for part in (fits.scale, fits.rotation, fits.translation))
    placed = scale[:, None, None] * np.einsum("tij,nj->tni", rotation, centres) + translation[:, None]
    return np.linalg.norm(placed - known, axis=-1)
