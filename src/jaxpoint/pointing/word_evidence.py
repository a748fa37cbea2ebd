"""What spoken words reveal about the object that is meant: factors of likelihood for `posterior`."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxpoint.pointing.objects import Objects

MISNAMED = 0.1  # how likely a word that fits other objects is said of one that it does not fit, beside one that it does


def words_evidence(objects: Objects, words: Sequence[str], misnamed: float = MISNAMED) -> Float[np.ndarray, " K"]:
    """One factor an object: 1 where all words fit its name, kind or tags, `misnamed` times less for each that does not.

    Words that fit no object ("that", "over", "there") change nothing.
    """
    known = [
        _stems(" ".join((name, kind, *tags))) for name, kind, tags in zip(objects.names, objects.kinds, objects.tags)
    ]
    factors = np.ones(len(objects))
    for word in _stems(" ".join(words)):
        fits = np.array([word in own for own in known])
        if fits.any():
            factors *= np.where(fits, 1.0, misnamed)
    return factors


def _stems(text: str) -> set[str]:
    """Words in small letters, their plural's s taken off."""
    return {word[:-1] if len(word) > 3 and word.endswith("s") else word for word in re.findall(r"\w+", text.lower())}
