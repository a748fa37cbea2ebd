"""Kept joints to answers: the default with and without a bias fitted on other people, and the thesis's ray; used by
`pointing_evaluation.py`."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxpoint.body.joints import Joints, is_left
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.answers import CALIBRATION_EXPONENT, Answer, ObjectScene, answers
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import fit_bias
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.held_joints import HeldJoints
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.holds import Hold
from jaxpoint.pointing.line_hypotheses import Correction, correction_of, line_hypotheses
from jaxpoint.pointing.objects import NOTHING, Objects, Thing
from jaxpoint.pointing.pointing_line import KINDS, directions
from jaxpoint.pointing.room_box import Room
from jaxpoint.pointing.shapes import Rectangle

LINES = KINDS[:2]  # forearm and finger
NOT_FOUND = {"name": None, "probability": 0.0, "error_deg": None, "line": None, "second": None}
MIRROR = np.array([1.0, -1.0, 1.0])


def fitted(sessions: list[dict]) -> Bias:
    """The bias of the forearm's line, with the finger's beside it, of people who point approximately.

    Left arms are mirrored. A finger that shares a part of the forearm's error tells of it.
    """
    people, origins, lines, targets = [], [], [], []
    for session in sessions:
        for gesture in session["gestures"]:
            if gesture["found"] and gesture["law"] == "approximate" and gesture["views"] > 2:
                joints = Joints.of_flat(np.array(gesture["joints"]))
                sign = MIRROR if bool(is_left(joints)) else np.ones(3)
                people.append(gesture["person"])
                origins.append(sign * np.asarray(joints.tip))
                lines.append(sign * np.asarray(directions(joints)[: len(LINES)]))
                targets.append(sign * np.array(gesture["target_m"]))
    names = tuple(str(i) for i in range(len(people)))
    origins, lines, targets = np.repeat(np.array(origins)[:, None], len(LINES), 1), np.array(lines), np.array(targets)
    given = Pointings(names, tuple(people), LINES, origins, lines, targets)
    return fit_bias("blend", given, source="simulated people who point approximately, from pixels")


def answers_of(session: dict, model: Bias, exponent: float = CALIBRATION_EXPONENT) -> list[dict]:
    """One row a gesture."""
    things = [Thing(t["name"], Rectangle(np.array(t["corners"])), t["kind"]) for t in session["objects"]]
    centres = np.array([np.mean(t["corners"], axis=0) for t in session["objects"]])
    scene = ObjectScene(Objects.of(things), centres, Room(np.zeros(3), np.array(session["room"])), True)
    keys = ("seed", "gesture", "person", "law", "target", "found", "views")
    rows = [
        {key: gesture[key] for key in keys} | {"thesis": _thesis(gesture, scene)} for gesture in session["gestures"]
    ]
    for mode, correction in (("raw", None), ("with the model", correction_of(model))):
        for row, answer in zip(rows, _answered(session["gestures"], scene, correction, exponent), strict=True):
            row[mode] = answer
    return rows


def _answered(gestures: list[dict], scene: ObjectScene, correction: Correction | None, exponent: float) -> list[dict]:
    """Of each gesture the answer; those that were found are answered together, as `jaxpoint point` does."""
    given = [gesture for gesture in gestures if gesture["found"]]
    told = []
    if given:
        covariance = jnp.asarray([gesture["covariance"] for gesture in given])
        joints = Joints.of_flat(np.array([gesture["joints"] for gesture in given]))
        held = HeldJoints(joints, covariance, jnp.zeros_like(covariance), np.zeros(len(given), int))
        people = sorted({gesture["person"] for gesture in given})
        holds = [
            Hold(people.index(g["person"]), np.arange(2), np.array([g["start_s"], g["end_s"]]), g["views"])
            for g in given
        ]
        ways = line_hypotheses(held, "auto", None, correction)
        told = answers(holds, held, ways, scene, range(len(people)), [0] * len(given), exponent=exponent)
    found = iter(told)
    return [_shown(gesture, next(found)) if gesture["found"] else NOT_FOUND for gesture in gestures]


def _shown(gesture: dict, answer: Answer) -> dict:
    return {
        "name": answer.name,
        "probability": answer.probability,
        "error_deg": _off_deg(answer.origin, answer.direction, gesture),
        "line": answer.line,
        "second": answer.probabilities[1][0] if len(answer.probabilities) > 1 else None,
    }


def _thesis(gesture: dict, scene: ObjectScene) -> dict:
    """The first object on the thesis's ray; nothing where it meets none."""
    if gesture["thesis_tip_m"] is None:
        return {"name": None, "error_deg": None}
    tip, direction = np.array(gesture["thesis_tip_m"]), np.array(gesture["thesis_direction"])
    hit = intersect(Ray(tip[None], direction[None]), scene.objects)
    name = scene.objects.names[int(hit.object[0, 0])] if bool(hit.valid[0, 0]) else NOTHING
    return {"name": name, "error_deg": _off_deg(tip, direction, gesture)}


def _off_deg(origin: np.ndarray, direction: np.ndarray, gesture: dict) -> float:
    """Great-circle angle between a line and the direction from its tip to the target."""
    true = np.array(gesture["target_m"]) - origin
    cosine = direction @ true / np.linalg.norm(true)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
