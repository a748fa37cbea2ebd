"""Is the pointing arm found, and how exactly? The default beside the thesis's method, on simulated sessions.

People of all statures, skin tones and sleeves that show the forearm stand in a furnished room and point, accurately
or approximately; six cameras look on. Both methods see the same images. A region is right where most of it is the
pointing arm and it holds at least 30 % of the visible forearm and hand. Views count where at least 60 % of the forearm
is visible and it is seen at more than 45 degrees to its axis. A gesture has an answer where at least half of the frames
of its hold have an arm; its direction is their median. The thesis's finger is looked for in the views of people with a
coloured cap, whose colour two clicks into three images taught. Sessions of seeds from 10,000 on are for the final run
alone; nothing was tuned on them.

    python experiments/person_evaluation.py --seeds 0 4 --gestures 8 --out evaluation

Each session's scores are kept in the folder of --out, so that a run that was cut short goes on where it stopped, and
`pointing_evaluation.py` with the same folder renders nothing anew.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from jaxpoint.errors import JaxpointError
from scored_sessions import PEOPLE_A_SESSION, scored_sessions

USABLE = 0.6, 45.0  # share of the forearm seen, angle to the line of sight in degrees
RESAMPLES = 2000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 2), metavar=("FIRST", "END"))
    parser.add_argument("--gestures", type=int, default=PEOPLE_A_SESSION, help="of one session")
    parser.add_argument("--each", type=int, default=1, help="gestures of one person")
    parser.add_argument("--every", type=int, default=2, help="which frames of a hold are scored: every so many")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("evaluation"))
    args = parser.parse_args()
    sessions = scored_sessions(range(*args.seeds), args.gestures, args.every, args.workers, args.out, args.each)
    views = [view for session in sessions for view in session["views"]]
    gestures = [gesture for session in sessions for gesture in session["gestures"]]
    table = summary(views, gestures)
    (args.out / "person.md").write_text(table)
    print(table)


def summary(views: list[dict], gestures: list[dict]) -> str:
    """All figures as a Markdown table."""
    usable = [view for view in views if view["visible"] >= USABLE[0] and view["angle_deg"] > USABLE[1]]
    enough = [one for one in gestures if one["usable_views"] >= 2]
    answered = [one for one in enough if 2 * one["answered"] >= one["frames"]]
    capped = [view for view in usable if view["thesis_finger"] != "no_cap"]
    direction = np.array([one["direction_deg"] for one in answered])
    tips = np.array([one["tip_m"] for one in gestures if one["answered"]])
    heads = np.array([head for one in gestures for head in one["head_m"]])
    milliseconds = np.array([view["detect_ms"] for view in views])
    rows = [
        ("views looked at, usable", f"{len(views)}, {len(usable)}", "", ""),
        ("gestures, with two or more usable views", f"{len(gestures)}, {len(enough)}", "", ""),
        ("right region of usable views, %", *_shares(usable, "right"), ">= 95"),
        ("wrong region, %", *_shares(usable, "wrong"), "<= 1 (thesis >= 15)"),
        (f"finger right in {len(capped)} views, %", "", _share(capped, "thesis_finger", "right"), "thesis < 60"),
        ("gestures with an answer, %", f"{100 * len(answered) / max(1, len(enough)):.1f}", "", ">= 97"),
        ("direction, degrees: median", _interval(direction, np.median), "", "<= 1.0"),
        ("direction, degrees: mean", _interval(direction, np.mean), "", "<= 2.0"),
        ("three views less two, degrees: median of pairs", _interval(_pairs(gestures), np.median), "", "not above 0"),
        ("tip, cm: median", _interval(100 * tips, np.median), "", "<= 1.5"),
        ("head, cm: median", _interval(100 * heads, np.median), "", "<= 2"),
        ("head, cm: 95th percentile", _interval(100 * heads, lambda x: np.percentile(x, 95)), "", "<= 5"),
        ("image stages, ms a frame: median", f"{np.median(milliseconds):.1f}", "", "<= 15"),
    ]
    lines = ["| figure | default | thesis | target |", "|---|---|---|---|"]
    return "\n".join(
        [*lines, *(f"| {' | '.join(row)} |" for row in rows), "", _by(answered, "law"), _by(answered, "sleeve")]
    )


def _shares(views: list[dict], verdict: str) -> tuple[str, ...]:
    """Per cent of the views, of the default and of the thesis's method."""
    return tuple(_share(views, method, verdict) for method in ("default", "thesis"))


def _share(views: list[dict], method: str, verdict: str) -> str:
    return f"{100 * np.mean([view[method] == verdict for view in views]):.1f}" if views else "–"


def _pairs(gestures: list[dict]) -> np.ndarray:
    return np.array([one["three_views_deg"] - one["two_views_deg"] for one in gestures])


def _interval(values: np.ndarray, statistic) -> str:
    """The statistic with its bootstrap interval of 95 %."""
    values = values[np.isfinite(values)]
    if not len(values):
        return "–"
    rng = np.random.default_rng(0)
    drawn = [statistic(rng.choice(values, len(values))) for _ in range(RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{statistic(values):.2f} ({low:.2f} to {high:.2f})"


def _by(gestures: list[dict], key: str) -> str:
    """Direction by a property of the people."""
    lines = [f"| {key} | gestures | direction, degrees: median | mean |", "|---|---|---|---|"]
    for value in sorted({one[key] for one in gestures}):
        own = np.array([one["direction_deg"] for one in gestures if one[key] == value])
        lines.append(f"| {value} | {len(own)} | {np.median(own):.2f} | {own.mean():.2f} |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    try:
        main()
    except JaxpointError as error:
        sys.stderr.write(f"person_evaluation: {error}\n")
        sys.exit(error.exit_code)
