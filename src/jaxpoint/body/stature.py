"""How long the parts of a person are, by the height of the head (Drillis & Contini 1966)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

HEAD_M = 0.24  # height of a head
SMALLEST_M, TALLEST_M = 1.45, 2.0  # of standing people
SEATED_M = 1.65  # stature of a person whose head is lower than that
HAND_OF_STATURE = 0.108  # from the wrist to the fingertip
ELBOW_OF_STATURE = 0.254  # from the fingertip to the elbow
SPAN_OF_STATURE = (HAND_OF_STATURE, 0.240)  # behind the tip: the forearm without its ends


def stature(head: Float[np.ndarray, "3"]) -> float:
    """By the centre of the head (m) where a person stands, else that of a small adult."""
    top = float(head[2]) + HEAD_M / 2
    return min(top, TALLEST_M) if top > SMALLEST_M else SEATED_M


def limb_span(head: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """Between wrist and elbow, behind the tip, m."""
    return np.array(SPAN_OF_STATURE) * stature(head)
