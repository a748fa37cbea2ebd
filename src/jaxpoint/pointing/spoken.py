"""What was said, and with which gesture: deictic words pair with gestures, names are evidence (thesis 6.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from jaxpoint.pointing.objects import Objects
from jaxpoint.pointing.word_evidence import words_evidence

DEICTIC = frozenset({"this", "that", "these", "those", "here", "there"})
WINDOW_S = 1.0  # between onsets of gesture and word
SIGMA_S = 0.35  # thesis 6.1: most lie within -0.52 and +0.45 s
AROUND_S = 1.5  # a name so near to the deictic word, or to the gesture, speaks of the same thing
_NOT_POINTING = (("think", "that"), ("say", "that"), ("know", "that"), ("there", "is"), ("there", "are"), ("there's",))


@dataclass(frozen=True)
class Interval:
    """When a gesture is, s."""

    start_s: float
    end_s: float


@dataclass(frozen=True)
class Word:
    """A word, and when it was said, s."""

    text: str
    start_s: float
    end_s: float


def pair_words(words: Sequence[Word], holds: Sequence[tuple[float, float]]) -> list[list[Word]]:
    """The words that belong to each gesture: its deictic word, and what was said around it.

    Deictic words and gestures pair one to one, so that the whole is likeliest: onsets within `WINDOW_S`, a Gaussian
    of `SIGMA_S` about simultaneous ones.

    Args:
        words: in order of time.
        holds: start and end of each gesture's hold, s. The onset of a gesture is taken to be its hold's.
    """
    pointing = [i for i, word in enumerate(words) if _text(word) in DEICTIC and not _trap(words, i)]
    said: list[list[Word]] = [[] for _ in holds]
    if pointing and holds:
        apart = np.array([[start - words[i].start_s for i in pointing] for start, _ in holds])
        cost = np.where(np.abs(apart) <= WINDOW_S, (apart / SIGMA_S) ** 2, 1e6)
        for gesture, place in zip(*linear_sum_assignment(cost)):
            if cost[gesture, place] < 1e6:
                said[gesture].append(words[pointing[place]])
    for gesture, (start, end) in enumerate(holds):
        onset = said[gesture][0].start_s if said[gesture] else None
        low, high = (start, end) if onset is None else (min(start, onset), max(end, onset))
        near = [w for w in words if low - AROUND_S <= w.start_s <= high + AROUND_S and _text(w) not in DEICTIC]
        said[gesture] += [word for word in near if _nearest(word, holds) == gesture]
    return said


def evidence_of(said: Sequence[Sequence[Word]], objects: Objects) -> Float[np.ndarray, "G K"]:
    """How much likelier each object is by what was said with each gesture: its name, its kind, or a tag."""
    return np.stack([words_evidence(objects, [word.text for word in own]) for own in said])


def _nearest(word: Word, holds: Sequence[tuple[float, float]]) -> int:
    return int(np.argmin([max(start - word.start_s, word.start_s - end, 0.0) for start, end in holds]))


def _text(word: Word) -> str:
    return word.text.lower().strip(".,;:!?\"'")


def _trap(words: Sequence[Word], place: int) -> bool:
    """Whether it is part of a phrase that does not point, such as "I think that" or "there is"."""
    texts = [_text(word) for word in words]
    for phrase in _NOT_POINTING:
        for start in range(place - len(phrase) + 1, place + 1):
            if start >= 0 and tuple(texts[start : start + len(phrase)]) == phrase:
                return True
    return False
