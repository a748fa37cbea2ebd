"""Kept joints to answers: the default with and without a bias fitted on other people, and the thesis's ray; used by
`pointing_evaluation.py`."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxpoint.answer.answers import NOTHING, SHARPER, Scene, answers
from jaxpoint.answer.holds import Hold
from jaxpoint.answer.hypotheses import correction_of, hypotheses
from jaxpoint.answer.lines import HeldJoints
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import fit
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.joints import Joints, is_left
from jaxpoint.pointing.line import KINDS, directions
from jaxpoint.pointing.objects import Objects, Rectangle, Thing
from jaxpoint.pointing.room import Room

LINES = KINDS[:2]  # forearm and finger
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
    return fit("blend", given, source="simulated people who point approximately, from pixels")


def answers_of(session: dict, model: Bias, sharper: float = SHARPER) -> list[dict]:
    """One row a gesture."""
    things = [Thing(t["name"], Rectangle(np.array(t["corners"])), t["kind"]) for t in session["objects"]]
    centres = np.array([np.mean(t["corners"], axis=0) for t in session["objects"]])
    scene = Scene(Objects.of(things), centres, Room(np.zeros(3), np.array(session["room"])), True)
    rows = []
    for gesture in session["gestures"]:
        row = {key: gesture[key] for key in ("seed", "gesture", "person", "law", "target", "found", "views")}
        for mode, correction in (("raw", None), ("with the model", correction_of(model))):
            row[mode] = _answered(gesture, scene, correction, sharper)
        row["thesis"] = _thesis(gesture, scene)
        rows.append(row)
    return rows


def _answered(gesture: dict, scene: Scene, correction, sharper: float) -> dict:
    if not gesture["found"]:
        return {"name": None, "probability": 0.0, "error_deg": None, "line": None, "second": None}
    covariance = jnp.asarray(gesture["covariance"])[None]
    joints = Joints.of_flat(np.array(gesture["joints"])[None])
    held = HeldJoints(joints, covariance, jnp.zeros_like(covariance), np.zeros(1, int))
    times = np.array([gesture["start_s"], gesture["end_s"]])
    hold = Hold(0, np.arange(2), times, gesture["views"])
    ways = hypotheses(held, "auto", None, correction)
    (answer,) = answers([hold], held, ways, scene, [1], [0], sharper=sharper)
    error = _off_deg(answer.origin, answer.direction, gesture)
    second = answer.probabilities[1][0] if len(answer.probabilities) > 1 else None
    return {
        "name": answer.name,
        "probability": answer.probability,
        "error_deg": error,
        "line": answer.line,
        "second": second,
    }


def _thesis(gesture: dict, scene: Scene) -> dict:
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
