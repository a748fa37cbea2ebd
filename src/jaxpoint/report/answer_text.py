"""An answer as a sentence for a person, and aloud."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping, Sequence

from jaxpoint.errors import MissingDependencyError
from jaxpoint.pointing.answers import Answer
from jaxpoint.pointing.objects import NOTHING

SPEAKER = "espeak-ng"
SURE = 0.8


def sentence(answer: Answer) -> str:
    """What is pointed at, how far away, and what else it may be, such as "the book, 2.3 m away; or the newspaper"."""
    others = [name for name, chance in answer.probabilities[1:] if 3 * chance > answer.probability]
    if answer.name == NOTHING:
        text = "nothing that is known"
        if answer.surface is not None:
            text = f"a place on {answer.surface.name}, {answer.distance_m:.1f} m away, where nothing is known"
        return "; or ".join([text, *(_the(name) for name in others[:2])])
    sure = "" if answer.probability >= SURE else ", probably" if answer.probability >= 0.5 else ", perhaps"
    text = f"{_the(answer.name)}, {answer.distance_m:.1f} m away{sure}"
    return "; or ".join([text, *(_the(name) for name in others[:2])])


def _the(name: str) -> str:
    return "nothing" if name == NOTHING else f"the {name}"


def check_speaker() -> None:
    """Whether this machine can speak.

    Raises:
        MissingDependencyError: the program is not installed.
    """
    if shutil.which(SPEAKER) is None:
        raise MissingDependencyError(
            f"--speak needs the program {SPEAKER}, which is not there; install it, or go without."
        )


def speak(text: str) -> None:
    """Say it.

    Raises:
        MissingDependencyError: the program is not installed, or fails.
    """
    check_speaker()
    try:
        done = subprocess.run([SPEAKER, text], capture_output=True, text=True)
    except OSError as error:
        raise MissingDependencyError(f"{SPEAKER} failed ({error.strerror}); go without --speak.") from None
    if done.returncode:
        why = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
        raise MissingDependencyError(f"{SPEAKER} failed ({why}); go without --speak.")


def as_json(answer: Answer) -> Mapping[str, object]:
    """All of an answer, for a program or a robot.

    `point_m` is where to go: the place where the line meets the answer, the object's middle where it passes it by, the
    place on the room's surface where nothing is meant; None only where a person outside the room points at nothing.
    """
    return {
        "gesture": answer.number,
        "person": answer.person,
        "start_s": answer.start_s,
        "end_s": answer.end_s,
        "time_s": answer.time_s,
        "frame": answer.frame,
        "words": list(answer.words),
        "line": answer.line,
        "views": answer.views,
        "origin_m": _floats(answer.origin),
        "direction": _floats(answer.direction),
        "azimuth_deg": answer.azimuth_deg,
        "elevation_deg": answer.elevation_deg,
        "sigma_deg": answer.sigma_deg,
        "calibration_sigma_deg": answer.calibration_sigma_deg,
        "answer": answer.name,
        "distance_m": answer.distance_m,
        "point_m": None if answer.point is None else _floats(answer.point),
        "probability": answer.probability,
        "probabilities": dict(answer.probabilities),
        "ambiguous": answer.ambiguous,
        "hits": [{"name": p.name, "distance_m": p.distance_m, "point_m": _floats(p.point)} for p in answer.hits],
        "nearest": [{"name": name, "angle_deg": angle} for name, angle in answer.nearest],
        "surface": None
        if answer.surface is None
        else {
            "name": answer.surface.name,
            "distance_m": answer.surface.distance_m,
            "point_m": _floats(answer.surface.point),
        },
        "reasons": list(answer.reasons),
        "sentence": sentence(answer),
    }


def _floats(values) -> Sequence[float]:
    return [float(value) for value in values]
