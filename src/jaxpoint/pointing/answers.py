"""What each gesture points at: hits in order, what is nearest, probabilities, and reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxpoint.body.joints import Joints, is_left
from jaxpoint.compilation import jit
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.aiming_eye import learnt_eyes
from jaxpoint.pointing.batching import over_lines
from jaxpoint.pointing.held_joints import HeldJoints
from jaxpoint.pointing.hits import Hits, intersect
from jaxpoint.pointing.holds import Hold
from jaxpoint.pointing.line_hypotheses import LineHypothesis
from jaxpoint.pointing.nearest import Nearest, nearest
from jaxpoint.pointing.objects import NOTHING, Objects, Shapes
from jaxpoint.pointing.personal_offsets import Ask, learnt_offsets, turned_lines
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import AMBIGUOUS, Behaviour, posterior
from jaxpoint.pointing.room_box import SURFACES, Room, RoomPoint, end_in_room
from jaxpoint.pointing.word_evidence import words_evidence

WRONG_OF_TWO_VIEWS = 0.15  # share of arms of two views that are another limb, or none
WRONG_OF_MORE = 0.02
# Calibration exponent of the probabilities. By the lines' distributions alone answers are right more often than their
# probabilities; this power makes both agree and changes no order. Chosen on `experiments/pointing_reliability.py`.
CALIBRATION_EXPONENT = 1.3
JOINTS = ("head", "eye", "shoulder", "elbow", "wrist", "tip")
SHOWN = 0.005  # smallest probability that is listed


@dataclass(frozen=True)
class Place:
    """An object, or a surface of the room, that the line meets."""

    name: str
    distance_m: float  # from the fingertip, along the line
    point: Float[np.ndarray, "3"]  # m


@dataclass(frozen=True)
class Answer:
    """One gesture, its line, and what it points at."""

    number: int
    person: int
    start_s: float
    end_s: float
    time_s: float
    frame: int  # number of the frame that is shown
    views: int
    line: str  # the way of pointing that explains the answer best
    joints: dict[str, Float[np.ndarray, "3"]]  # m
    origin: Float[np.ndarray, "3"]  # m, the fingertip
    direction: Float[np.ndarray, "3"]  # unit
    sigma_deg: float  # of the measured direction, per axis
    calibration_sigma_deg: float | None  # the calibration's part; None where it has no covariance
    hits: tuple[Place, ...]  # nearest first
    surface: Place | None  # where the line leaves the room; None from outside of it
    nearest: tuple[tuple[str, float], ...]  # the three nearest objects, degrees off the line
    probabilities: tuple[tuple[str, float], ...]  # likeliest first, nothing among them
    ambiguous: bool
    name: str  # the answer: an object, or "nothing"
    distance_m: float  # from the fingertip to `point`; 0 without one
    # m: where the line meets the answer; the object's middle where it passes it by; the place on the room's surface
    # where nothing is meant, None from outside of the room.
    point: Float[np.ndarray, "3"] | None
    reasons: tuple[str, ...]  # a sentence each: what to know of this answer
    words: tuple[str, ...] = ()

    @property
    def probability(self) -> float:
        """Of the answer."""
        return self.probabilities[0][1]

    @property
    def azimuth_deg(self) -> float:
        """Of the line, from the x axis to the left."""
        return float(np.degrees(np.arctan2(self.direction[1], self.direction[0])))

    @property
    def elevation_deg(self) -> float:
        """Of the line, above the horizontal."""
        return float(np.degrees(np.arcsin(np.clip(self.direction[2], -1, 1))))


@dataclass(frozen=True)
class ObjectScene:
    """What can be pointed at, and where."""

    objects: Objects
    centres: Float[np.ndarray, "K 3"]  # m
    room: Room
    room_known: bool  # given, not guessed from the objects


def answers(
    holds: Sequence[Hold],
    held: HeldJoints,
    hypotheses: Sequence[LineHypothesis],
    scene: ObjectScene,
    people: Sequence[int],
    frames: Sequence[int],
    *,
    evidence: Float[np.ndarray, "G K"] | None = None,
    words: Sequence[Sequence[str]] = (),
    known_errors: bool = False,
    exponent: float = CALIBRATION_EXPONENT,
) -> list[Answer]:
    """The answer to every gesture.

    Args:
        holds: G gestures.
        held: their joints.
        hypotheses: how each may be pointing.
        scene: objects and room.
        people: the id of each person of the tracks.
        frames: the number of the frame shown of each gesture.
        evidence: likelihood factors of what was said.
        words: what was said with each gesture.
        known_errors: the calibration has a covariance.
        exponent: the power to which probabilities are raised; 1 leaves them as the lines' distributions have them.
    """
    persons = [hold.person for hold in holds]
    wrong = np.array([WRONG_OF_TWO_VIEWS if hold.views <= 2 else WRONG_OF_MORE for hold in holds])
    each, marginal = _ask_by_hypothesis(hypotheses, scene.objects, evidence)
    ask = partial(_ask_posterior, scene.objects, evidence)
    hypotheses = _own_offsets(hypotheses, each, marginal, persons, wrong, held, ask)
    weight = learnt_eyes(hypotheses, marginal, persons)[..., None]
    right = (weight * each).sum(axis=0) ** exponent
    right /= right.sum(axis=1, keepdims=True)
    chance = (1 - wrong[:, None]) * right + wrong[:, None] / right.shape[1]
    best = chance.argmax(axis=1)
    # The hypothesis whose share in the winning answer is largest is the one that is shown.
    likeliest = [hypotheses[k] for k in (weight * each)[:, np.arange(len(holds)), best].argmax(axis=0)]
    shown = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], own.lines.ray) for i, own in enumerate(likeliest)]
    measured = _meet_objects(shown, scene)
    said = list(words) or [()] * len(holds)
    given = _Given(held, scene, people, frames, known_errors)
    found = [
        _answer(i, hold, given, likeliest[i], jax.tree.map(itemgetter(i), measured), chance[i], said[i])
        for i, hold in enumerate(holds)
    ]
    if evidence is None:
        return found
    unsaid = _without_words(each, evidence, weight).argmax(axis=1)
    names = (*scene.objects.names, NOTHING)
    return [_by_words(answer, names[k], scene.objects) for answer, k in zip(found, unsaid)]


def _ask_by_hypothesis(
    hypotheses: Sequence[LineHypothesis], objects: Objects, evidence: Float[np.ndarray, "G K"] | None
) -> tuple[Float[np.ndarray, "W G answers"], Float[np.ndarray, "W G"]]:
    """Probabilities of all objects and of nothing by each hypothesis, and the density of each hypothesis's lines.

    Ways whose behaviours are of one structure are asked in one call, which costs more than a few lines do.
    """
    count = len(hypotheses[0].weight)
    each, marginal = np.zeros((len(hypotheses), count, len(objects) + 1)), np.zeros((len(hypotheses), count))
    alike: dict[Any, list[int]] = {}
    for i, hypothesis in enumerate(hypotheses):
        alike.setdefault(jax.tree.structure(hypothesis.behaviour), []).append(i)
    for places in alike.values():
        lines, behaviour = hypotheses[places[0]].lines, hypotheses[places[0]].behaviour
        if len(places) > 1:
            spread = partial(np.broadcast_to, shape=count)
            asked = [(one.lines, jax.tree.map(spread, one.behaviour)) for one in (hypotheses[i] for i in places)]
            lines, behaviour = jax.tree.map(lambda *leaves: np.concatenate(leaves), *asked)
        found, density = _ask_posterior(objects, evidence, lines, behaviour, np.tile(np.arange(count), len(places)))
        each[places], marginal[places] = found.reshape(len(places), count, -1), density.reshape(-1, count)
    return each, marginal


def _ask_posterior(
    objects: Objects,
    evidence: Float[np.ndarray, "G K"] | None,
    lines: PointingLine,
    behaviour: Behaviour,
    gestures: Int[np.ndarray, " g"],
) -> tuple[Float[np.ndarray, "*batch answers"], Float[np.ndarray, "*batch"]]:
    """Probabilities of all objects and of nothing, and densities, of lines whose last axis is of these gestures."""
    found = posterior(lines, objects, behaviour, evidence=None if evidence is None else evidence[gestures])
    return np.concatenate([found.probability, np.asarray(found.nothing)[..., None]], axis=-1), np.asarray(
        found.marginal
    )


def _without_words(
    each: Float[np.ndarray, "W G answers"], evidence: Float[np.ndarray, "G K"], weight: Float[np.ndarray, "W G 1"]
) -> Float[np.ndarray, "G answers"]:
    """Probabilities as they were without what was said: the factor of each object taken off."""
    plain = each / np.append(evidence, np.ones((len(evidence), 1)), axis=1)
    return (weight * plain / plain.sum(axis=2, keepdims=True)).sum(axis=0)


def _own_offsets(
    hypotheses: Sequence[LineHypothesis],
    each: Float[np.ndarray, "W G answers"],
    marginal: Float[np.ndarray, "W G"],
    persons: Sequence[int],
    wrong: Float[np.ndarray, " G"],
    held: HeldJoints,
    ask: Ask,
) -> list[LineHypothesis]:
    """The hypotheses with people's own offsets learnt and taken off; `each` and `marginal` are brought up to date."""
    corrected = list(hypotheses)
    if len(set(persons)) == len(persons):  # as one gesture alone, which must be answered at once
        return corrected
    left = np.asarray(_left_arms(held.joints))
    weighed = np.stack([hypothesis.weight for hypothesis in hypotheses]) * marginal
    for i, hypothesis in enumerate(hypotheses):
        learnt = learnt_offsets(hypothesis, weighed.sum(axis=0) - weighed[i], wrong, persons, left, ask)
        if learnt is None:
            continue
        own = learnt.gestures
        each[i, own], marginal[i, own] = learnt.probability, learnt.marginal
        offset = np.zeros((len(left), 2))
        offset[own] = learnt.offset
        corrected[i] = replace(hypothesis, lines=turned_lines(hypothesis.lines, offset, left), offset=offset)
    return corrected


@jit
def _left_arms(joints: Joints) -> Bool[Array, " G"]:
    return jax.vmap(is_left)(joints)


@dataclass(frozen=True)
class _Given:
    """What all answers share."""

    held: HeldJoints
    scene: ObjectScene
    people: Sequence[int]
    frames: Sequence[int]
    known_errors: bool


def _meet_objects(shown: Sequence[Ray], scene: ObjectScene) -> tuple[Hits, Nearest, RoomPoint]:
    """Hits, the three nearest, and the end in the room, of the line of each gesture: in numpy, to be read singly."""
    rays = jax.tree.map(lambda *leaves: np.stack(leaves), *shown)
    found = over_lines(partial(_meet_room, scene.objects.shapes, len(scene.objects), scene.room), rays)
    return jax.tree.map(np.asarray, found)


@partial(jit, static_argnames="count")
def _meet_room(shapes: Shapes, count: int, room: Room, rays: Ray) -> tuple[Hits, Nearest, RoomPoint]:
    objects = Objects(shapes, ("",) * count, ("",) * count, ((),) * count)  # names would be another program
    return intersect(rays, objects), nearest(rays, objects), end_in_room(rays, room)


def _answer(
    i: int,
    hold: Hold,
    given: _Given,
    hypothesis: LineHypothesis,
    measured: tuple[Hits, Nearest, RoomPoint],
    chance: Float[np.ndarray, " answers"],
    words: Sequence[str],
) -> Answer:
    scene = given.scene
    hit, close, end = measured
    names = (*scene.objects.names, NOTHING)
    order = np.argsort(-chance, kind="stable")
    hits = tuple(
        Place(names[int(hit.object[j])], float(hit.distance[j]), np.asarray(hit.point[j]))
        for j in np.flatnonzero(hit.valid)
    )
    surface = Place(SURFACES[int(end.surface)], float(end.distance), np.asarray(end.point)) if end.inside else None
    origin, name = np.asarray(hypothesis.lines.ray.origin)[i], names[order[0]]
    chances = tuple((names[k], float(chance[k])) for k in order if chance[k] >= SHOWN or k == order[0])
    meant = _meant(name, hits, surface, origin, scene)
    return Answer(
        number=i + 1,
        person=int(given.people[hold.person]),
        start_s=hold.start_s,
        end_s=hold.end_s,
        time_s=hold.time_s,
        frame=int(given.frames[i]),
        views=hold.views,
        line=hypothesis.kind,
        joints={name: np.asarray(getattr(given.held.joints, name))[i] for name in JOINTS},
        origin=origin,
        direction=np.asarray(hypothesis.lines.ray.direction)[i],
        sigma_deg=_sigma_deg(np.asarray(hypothesis.lines.covariance)[i, 3:, 3:]),
        calibration_sigma_deg=_sigma_deg(hypothesis.by_calibration[i]) if given.known_errors else None,
        hits=hits,
        surface=surface,
        nearest=tuple(
            (names[int(close.object[j])], float(np.degrees(close.measure[j]))) for j in np.flatnonzero(close.valid)
        ),
        probabilities=chances,
        ambiguous=bool(len(order) > 1 and chance[order[0]] < AMBIGUOUS * chance[order[1]]),
        name=name,
        distance_m=0.0 if meant is None else meant.distance_m,
        point=None if meant is None else meant.point,
        reasons=(*_reasons(hold, hypothesis, name, hits, surface), *_offset_reasons(hypothesis, i)),
        words=tuple(words),
    )


def _meant(
    name: str, hits: Sequence[Place], surface: Place | None, origin: Float[np.ndarray, "3"], scene: ObjectScene
) -> Place | None:
    """Where the line meets the answer; the object's middle where it passes it by."""
    if name == NOTHING:
        return surface
    for place in hits:
        if place.name == name:
            return place
    middle = scene.centres[scene.objects.names.index(name)]
    return Place(name, float(np.linalg.norm(middle - origin)), middle)


def _sigma_deg(covariance: np.ndarray) -> float:
    """Of a unit direction, per axis across it."""
    return float(np.degrees(np.sqrt(np.trace(covariance) / 2)))


def _reasons(
    hold: Hold, hypothesis: LineHypothesis, name: str, hits: Sequence[Place], surface: Place | None
) -> tuple[str, ...]:
    reasons = []
    if hold.views <= 2:
        reasons.append(f"The arm was measured in {hold.views} views only; one more would check it.")
    if surface is None:
        reasons.append("The fingertip lies outside of the room; check the calibration, or the room's size.")
    met = [place.name for place in hits]
    if name != NOTHING and name not in met:
        passed = f", which meets the {met[0]}" if met else ", which meets no object"
        reasons.append(f"The {name} lies beside the line{passed}; it is still the likeliest.")
    elif name != NOTHING and met[0] != name:
        reasons.append(f"The {name} lies behind the {met[0]}.")
    if hypothesis.kind == "eye-fingertip":
        reasons.append("The finger lies on the line of sight: the line goes from the eye over the fingertip.")
    return tuple(reasons)


def _by_words(answer: Answer, unsaid: str, objects: Objects) -> Answer:
    """The answer with a reason where words make it likeliest, and another would be without them."""
    if answer.name == unsaid:
        return answer
    against = answer.name == NOTHING
    place = objects.names.index(unsaid if against else answer.name)
    factors = [(word, words_evidence(objects, [word])) for word in answer.words]
    own = [word for word, factor in factors if factor.min() < 1 and (factor[place] < 1) == against]
    if not own:  # moved by what was said with other gestures of the person
        return answer
    said = f"The word{'s' if own[1:] else ''} '{' '.join(own)}' speak{'' if own[1:] else 's'}"
    reason = f"{said} against the {unsaid}." if against else f"{said} for the {answer.name}."
    return replace(answer, reasons=(*answer.reasons, reason))


def _offset_reasons(hypothesis: LineHypothesis, i: int) -> tuple[str, ...]:
    """That the line was turned by the offset learnt from the person's gestures."""
    if hypothesis.offset is None or not hypothesis.offset[i].any():
        return ()
    off = np.degrees(np.hypot(*hypothesis.offset[i]))
    return (f"The line is turned by {off:.1f} degrees, by which this person's gestures miss what is meant.",)
