"""Is the thing pointed at named right? Simulated sessions from pixels to answers, beside the thesis's method.

People of all statures, skin tones and sleeves that show the forearm stand in a furnished room and point, accurately
or approximately, at one of its objects or at nothing; six cameras look on, whose calibration is the true one. A
gesture that is not found, and one without an arm, counts as wrong. The model of bias is fitted on other people: those
of other sessions. Sessions of seeds from 10,000 on are for the final run alone; nothing was tuned on them.

    python experiments/pointing_evaluation.py --seeds 40 52 --gestures 4 --out pointing

What pixels gave is kept in the folder of --out, so that a run that was cut short goes on where it stopped, answers can
be drawn anew without pixels, and `person_evaluation.py` with the same folder renders nothing anew. `reliability.png`
shows how often answers are right beside how often they say so; the expected calibration error is told beside the one
that true probabilities have by chance. --bias FILE also writes the model that is fitted on all these people.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import pairwise
from pathlib import Path

import jax
import numpy as np

from jaxpoint.errors import JaxpointError
from reliability_picture import reliability_picture
from scored_sessions import scored_sessions

FOLDS = 5  # of sessions: the people of one are answered with the bias of the others
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)  # of probability
RESAMPLES = 2000
MODES = ("raw", "with the model", "thesis")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(40, 42), metavar=("FIRST", "END"))
    parser.add_argument("--gestures", type=int, default=4, help="of one session")
    parser.add_argument("--each", type=int, default=1, help="gestures of one person")
    parser.add_argument("--every", type=int, default=2, help="which frames of a hold are looked at: every so many")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("pointing"))
    parser.add_argument("--bias", type=Path, default=None, help="where to write the bias of all these people")
    args = parser.parse_args()
    kept = scored_sessions(range(*args.seeds), args.gestures, args.every, args.workers, args.out, args.each)
    sessions = [session | {"gestures": session["pointing"]} for session in kept]
    with jax.enable_x64(True):
        rows = answered(sessions)
        if args.bias is not None:
            from jaxpoint.io.bias_files import write_bias
            from pointing_answers import fitted

            write_bias(args.bias, fitted(sessions))
    (args.out / "answers.json").write_text(json.dumps(rows))
    table = summary(rows)
    (args.out / "pointing.md").write_text(table)
    reliability_picture(*_given_and_right(rows), BINS, args.out / "reliability.png")
    print(table)


def answered(sessions: list[dict], **how: float) -> list[dict]:
    """Every gesture answered in every mode; the model's people are those of other sessions. `how`: see `answers_of`."""
    from pointing_answers import answers_of, fitted

    rows = []
    for fold in range(min(FOLDS, len(sessions))):
        own = [session for i, session in enumerate(sessions) if i % FOLDS == fold]
        others = [session for i, session in enumerate(sessions) if i % FOLDS != fold]
        model = fitted(others)
        for session in own:
            rows += answers_of(session, model, **how)
    return rows


def summary(rows: list[dict]) -> str:
    """All figures as Markdown."""
    lines = [f"{len(rows)} gestures, {sum(row['found'] for row in rows)} of them found.", ""]
    lines += ["| named right, % | raw | with the model | thesis |", "|---|---|---|---|"]
    groups = {law: [row for row in rows if row["law"] == law] for law in ("accurate", "approximate")}
    groups["all"] = rows
    groups["at nothing"] = [row for row in rows if row["target"] == "nothing"]
    groups["two views only"] = [row for row in rows if row["found"] and row["views"] <= 2]
    for name, own in groups.items():
        cells = [_share(np.array([row[mode]["name"] == row["target"] for row in own])) for mode in MODES]
        lines.append(f"| {name} (n = {len(own)}) | {' | '.join(cells)} |")
    lines += ["", "| great-circle error, degrees: median | raw | with the model | thesis |", "|---|---|---|---|"]
    for name, own in groups.items():
        aimed = [row for row in own if row["target"] != "nothing"]
        cells = [
            _median([row[mode]["error_deg"] for row in aimed if row[mode]["error_deg"] is not None]) for mode in MODES
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", *_reliability(rows), ""])


def _reliability(rows: list[dict]) -> list[str]:
    """Of answers given with a probability, how many are right; and the expected calibration error."""
    lines = ["| probability, with the model | answers | mean probability | right |", "|---|---|---|---|"]
    given, right = _given_and_right(rows)
    error = 0.0
    for low, high in pairwise(BINS):
        own = (given > low) & (given <= high)
        if own.any():
            error += own.mean() * abs(given[own].mean() - right[own].mean())
            lines.append(
                f"| {low:.2f} to {high:.2f} | {own.sum()} | {given[own].mean():.2f} | {right[own].mean():.2f} |"
            )
    by_chance = f"{_error_by_chance(given):.3f}" if len(given) else "–"
    return [*lines, "", f"Expected calibration error: {error:.3f}; of true probabilities, by chance: {by_chance}"]


def _given_and_right(rows: list[dict]) -> tuple[np.ndarray, np.ndarray]:
    """Of gestures that were found, the answer's probability and whether it is right."""
    found = [(row["with the model"], row["target"]) for row in rows if row["found"]]
    given = np.array([answer["probability"] for answer, _ in found], float)
    return given, np.array([answer["name"] == target for answer, target in found], bool)


def _error_by_chance(given: np.ndarray) -> float:
    """The mean of the expected calibration error if answers were right exactly as often as their probabilities say."""
    right = np.random.default_rng(0).random((RESAMPLES, len(given))) < given
    off, place = np.where(right, 1.0, 0.0) - given, np.searchsorted(BINS, given) - 1
    missed = [np.mean(np.abs(np.sum(off[:, place == i], axis=1))) for i in range(len(BINS) - 1)]
    return float(np.sum(missed) / len(given))


def _share(right: np.ndarray) -> str:
    """Per cent with its Wilson interval of 95 %."""
    if not len(right):
        return "–"
    n, p, z = len(right), right.mean(), 1.96
    middle, half = p + z**2 / (2 * n), z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    low, high = (middle - half) / (1 + z**2 / n), (middle + half) / (1 + z**2 / n)
    return f"{100 * p:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def _median(values: list[float]) -> str:
    if not values:
        return "–"
    rng = np.random.default_rng(0)
    low, high = np.percentile([np.median(rng.choice(values, len(values))) for _ in range(RESAMPLES)], [2.5, 97.5])
    return f"{np.median(values):.1f} ({low:.1f} to {high:.1f})"


if __name__ == "__main__":
    try:
        main()
    except JaxpointError as error:
        sys.stderr.write(f"pointing_evaluation: {error}\n")
        sys.exit(error.exit_code)
