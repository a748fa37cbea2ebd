"""The eye with which a person aims (thesis 7.1), learnt from what the lines of both eyes meet.

Over one fingertip they are some 6 degrees apart. The eye is the person's own, so all gestures of a person show it: one
eye's lines meet things that can be meant, the other's pass them by. One gesture shows little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxpoint.pointing.line_hypotheses import LineHypothesis

MOST_SURE = 0.99  # of an eye, however many gestures speak for it


def learnt_eyes(
    hypotheses: Sequence[LineHypothesis], marginal: Float[np.ndarray, "W G"], people: Sequence[int]
) -> Float[np.ndarray, "W G"]:
    """Weights of the hypotheses once the aiming eye has been learnt from all gestures of each person; bounded.

    Prior odds of the eyes times, over the person's gestures, the ratio of the densities that both give to the gesture.
    Each is that of the eye's line or of the other hypotheses' by how probable aiming is, so that a gesture that is
    hardly aimed teaches nothing. How probable aiming is stays as it was.

    Args:
        hypotheses: how each gesture may be pointing; weights stay as they are without two that aim, one an eye.
        marginal: density of each hypothesis's lines whatever is meant, see `Posterior`.
        people: who makes each gesture.
    """
    weight = np.stack([hypothesis.weight for hypothesis in hypotheses])
    aimed = [i for i, hypothesis in enumerate(hypotheses) if hypothesis.aims]
    if len(aimed) != 2:
        return weight
    rest = [i for i, hypothesis in enumerate(hypotheses) if not hypothesis.aims]
    aims = weight[aimed].sum(axis=0)
    density = aims * marginal[aimed] + (weight[rest] * marginal[rest]).sum(axis=0)
    known = (density > 0).all(axis=0)
    ratio = np.diff(np.log(np.where(known, density, 1.0)), axis=0)[0]
    _, who = np.unique(people, return_inverse=True)
    prior = np.diff(np.log(weight[aimed]), axis=0)[0]
    most = np.log(MOST_SURE / (1 - MOST_SURE))
    odds = np.clip(prior + np.bincount(who, ratio)[who], -most, most)
    second = 1 / (1 + np.exp(-odds))
    weight[aimed] = aims * np.stack([1 - second, second])
    return weight
