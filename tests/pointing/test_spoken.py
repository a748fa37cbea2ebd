"""Words and gestures: pairs against all possible ones, phrases that do not point, and names as evidence."""

from itertools import permutations

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.speech import read_words
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.shapes import Rectangle
from jaxpoint.pointing.spoken import SIGMA_S, WINDOW_S, Word, evidence_of, pair_words


def said(*words):
    return [Word(text, start, start + 0.3) for text, start in words]


def texts(pairs):
    return [[word.text for word in own] for own in pairs]


def test_a_deictic_word_pairs_with_its_gesture():
    words = said(("bring", 1.0), ("this", 1.4), ("and", 3.0), ("that", 4.9))
    pairs = pair_words(words, [(1.5, 2.3), (5.0, 6.0)])
    assert [own[0].text for own in pairs] == ["this", "that"]


def test_words_and_gestures_pair_one_to_one_as_is_likeliest():
    rng = np.random.default_rng(0)
    for _ in range(20):
        starts, words = np.sort(rng.uniform(0, 3, 4)), np.sort(rng.uniform(0, 3, 4))
        pairs = pair_words(said(*(("this", float(t)) for t in words)), [(float(t), float(t) + 0.5) for t in starts])

        def cost(order, starts=starts, words=words):
            apart = starts - words[list(order)]
            return sum((a / SIGMA_S) ** 2 if abs(a) <= WINDOW_S else 1e6 for a in apart)

        best = min(cost(order) for order in permutations(range(4)))
        got = [own[0].start_s if own else None for own in pairs]
        used = [t for t in got if t is not None]
        assert len(used) == len(set(used))
        total = sum(1e6 if t is None else ((s - t) / SIGMA_S) ** 2 for s, t in zip(starts, got))
        assert total == pytest.approx(best)


@pytest.mark.parametrize("phrase", [("think", "that"), ("there", "is"), ("know", "that")])
def test_phrases_that_do_not_point_pair_with_nothing(phrase):
    words = said((phrase[0], 1.2), (phrase[1], 1.5))
    (own,) = pair_words(words, [(1.4, 2.0)])
    assert not {word.text for word in own} & {"this", "that", "there"} or own[0].text not in ("that", "there")


def test_names_and_tags_are_evidence_for_their_gesture_alone():
    square = np.array([[0, 0, 1.0], [1, 0, 1], [0, 0, 0], [1, 0, 0]])
    things = [Thing(name, Rectangle(square + i), kind, tags) for i, (name, kind, tags) in enumerate(
        [("red book", "book", ("reading",)), ("lamp", "light", ()), ("door", "door", ())]
    )]  # fmt: skip
    objects = Objects.of(things)
    words = said(("that", 1.0), ("book", 1.3), ("this", 8.0), ("light", 8.4))
    evidence = evidence_of(pair_words(words, [(1.1, 2.0), (8.1, 9.0)]), objects)
    assert evidence[0].argmax() == 0
    assert evidence[1].argmax() == 1
    assert (evidence[:, 2] < evidence.max(axis=1)).all()
    assert (evidence_of([[]], objects) == 1).all()


def test_a_bad_table_is_refused_by_its_line(tmp_path):
    (tmp_path / "words.csv").write_text("word,start_s,end_s\nthis,2.0,1.0\n")
    with pytest.raises(FileFormatError, match="line 2: it ends at 1 s, before its start at 2 s"):
        read_words(tmp_path / "words.csv")
    (tmp_path / "empty.csv").write_text("word,start_s,end_s\n")
    with pytest.raises(FileFormatError, match="header but no rows"):
        read_words(tmp_path / "empty.csv")
