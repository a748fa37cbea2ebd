"""Answers as a table: `gestures.csv`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jaxpoint.pointing.answers import Answer
from jaxpoint.report.answer_text import as_json

COLUMNS = (
    "gesture", "person", "start_s", "end_s", "time_s", "frame", "words", "line", "views", "tip_x_m", "tip_y_m",
    "tip_z_m", "direction_x", "direction_y", "direction_z", "azimuth_deg", "elevation_deg", "sigma_deg", "answer",
    "distance_m", "point_x_m", "point_y_m", "point_z_m", "probability", "ambiguous", "second", "second_probability",
    "nothing_probability", "hits", "hit_distances_m",
    "nearest_1", "nearest_1_deg", "nearest_2", "nearest_2_deg", "nearest_3", "nearest_3_deg", "surface",
    "surface_distance_m", "sentence", "reasons",
)  # fmt: skip


def gestures_table(answers: Sequence[Answer]) -> dict[str, list]:
    """One line a gesture; several hits of a line stand between semicolons."""
    lines = [_line(answer) for answer in answers]
    return {name: [line.get(name) for line in lines] for name in COLUMNS}


def _line(answer: Answer) -> dict[str, Any]:
    chances = dict(answer.probabilities)
    values = as_json(answer)
    line: dict[str, Any] = {
        **{name: values[name] for name in COLUMNS if name in values},
        "words": " ".join(answer.words),
        "ambiguous": int(answer.ambiguous),
        "nothing_probability": chances.get("nothing", 0.0),
        "hits": "; ".join(place.name for place in answer.hits),
        "hit_distances_m": "; ".join(f"{place.distance_m:.3f}" for place in answer.hits),
        "surface": None,
        "reasons": " ".join(answer.reasons),
    }
    line.update({f"tip_{axis}_m": float(answer.origin[i]) for i, axis in enumerate("xyz")})
    line.update({f"direction_{axis}": float(answer.direction[i]) for i, axis in enumerate("xyz")})
    if answer.point is not None:
        line.update({f"point_{axis}_m": float(answer.point[i]) for i, axis in enumerate("xyz")})
    if len(answer.probabilities) > 1:
        line["second"], line["second_probability"] = answer.probabilities[1]
    for i, (name, angle) in enumerate(answer.nearest, start=1):
        line[f"nearest_{i}"], line[f"nearest_{i}_deg"] = name, angle
    if answer.surface is not None:
        line["surface"], line["surface_distance_m"] = answer.surface.name, answer.surface.distance_m
    return line
