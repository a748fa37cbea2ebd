"""Is the pointing arm found, and how exactly? The default beside the thesis's method, on simulated sessions.

People of all statures, skin tones and sleeves that show the forearm stand in a furnished room and point, accurately
or approximately; six cameras look on. Both methods see the same images. A region is right where most of it is the
pointing arm and it holds at least 30 % of the visible forearm and hand. Views count where at least 60 % of the forearm
is visible and it is seen at more than 45 degrees to its axis. A gesture has an answer where at least half of the frames
of its hold have an arm; its direction is their median. The thesis's finger is looked for in the views of people with a
coloured cap, whose colour two clicks into three images taught. Sessions of seeds from 10,000 on are for the final run
alone; nothing was tuned on them.

    python experiments/person_evaluation.py --seeds 0 4 --gestures 8 --out evaluation

Each session's scores are kept in the folder of --out, so that a run that was cut short goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxpoint.config.people import SleeveShares
from jaxpoint.config.simulation import SimulationSettings

PEOPLE_A_SESSION = 8  # as many as the masks of a session can tell apart
SHOWING = SleeveShares(none=0.1, short=0.45, elbow=0.2, rolled=0.25, long=0.0)
USABLE = 0.6, 45.0  # share of the forearm seen, angle to the line of sight in degrees
RESAMPLES = 2000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 2), metavar=("FIRST", "END"))
    parser.add_argument("--gestures", type=int, default=PEOPLE_A_SESSION, help="of one session, each by another person")
    parser.add_argument("--every", type=int, default=2, help="which frames of a hold are scored: every so many")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("evaluation"))
    args = parser.parse_args()
    if not 1 <= args.gestures <= PEOPLE_A_SESSION:
        parser.error(f"--gestures is 1 to {PEOPLE_A_SESSION}: masks tell no more people apart.")
    args.out.mkdir(parents=True, exist_ok=True)
    jobs = [(seed, args.gestures, args.every, args.out / f"seed_{seed}.json") for seed in range(*args.seeds)]
    left = [job for job in jobs if not job[-1].exists()]
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        for done, seed in enumerate(pool.imap_unordered(_score, left), start=1):
            print(f"session {seed} scored, {done} of {len(left)}", flush=True)
    views, gestures = [], []
    for *_, path in jobs:
        kept = json.loads(path.read_text())
        views += kept["views"]
        gestures += kept["gestures"]
    table = summary(views, gestures)
    (args.out / "evaluation.md").write_text(table)
    print(table)


def settings_of(gestures: int) -> SimulationSettings:
    """Single gestures, each by another person, whose sleeves show the forearm."""
    settings = SimulationSettings()
    looks = replace(settings.people.looks, sleeves=SHOWING)
    people = replace(settings.people, play="gestures", gestures=gestures, people=gestures, looks=looks)
    return replace(settings, people=people)


def _score(job: tuple[int, int, int, Path]) -> int:
    import cv2
    import jax

    from person_scores import as_rows, score_session

    seed, gestures, every, path = job
    cv2.setNumThreads(1)
    with jax.enable_x64(True):
        views, scores = score_session(settings_of(gestures), seed, every=every)
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps({"views": as_rows(views), "gestures": as_rows(scores)}))
    beside.rename(path)
    return seed


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
    main()
