"""Simulated sessions with every score of their pixels, rendered once: one file a session, in a folder of the caller.

Used by `person_evaluation.py` and `pointing_evaluation.py`: what one of them has rendered the other only reads.
"""

from __future__ import annotations

import json
import multiprocessing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from jaxpoint.config.people import SleeveShares
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import replacing

LAYOUT = 2  # of the files; higher whenever they hold something else
PEOPLE_A_SESSION = 8  # as many as the masks of a session can tell apart
SHOWING = SleeveShares(none=0.1, short=0.45, elbow=0.2, rolled=0.25, long=0.0)


@dataclass(frozen=True)
class Asked:
    """What a session is made with."""

    gestures: int
    each: int  # of one person
    every: int  # frames of a hold

    def __str__(self) -> str:
        return f"--gestures {self.gestures} --each {self.each} --every {self.every}"


def scored_sessions(seeds: range, gestures: int, every: int, workers: int, folder: Path, each: int = 1) -> list[dict]:
    """All sessions, those that the folder does not hold yet rendered and scored.

    Args:
        seeds: one session each.
        gestures: of one session.
        every: which frames of a hold are looked at: every so many.
        workers: processes, one core each.
        folder: of the files `seed_N.json`.
        each: gestures of one person.

    Raises:
        FileFormatError: a file there is of another layout.
        UsageError: more people than labels, or a file there was made with other gestures or frames.
    """
    if each < 1 or gestures < 1 or gestures % each or gestures // each > PEOPLE_A_SESSION:
        raise UsageError(
            f"{gestures} gestures, {each} of each person, are asked for; --gestures must be a multiple of --each, and "
            f"masks tell 1 to {PEOPLE_A_SESSION} people apart."
        )
    asked = Asked(gestures, each, every)
    folder.mkdir(parents=True, exist_ok=True)
    paths = {seed: folder / f"seed_{seed}.json" for seed in seeds}
    kept = {seed: read_session(path, asked) for seed, path in paths.items() if path.exists()}
    left = [(seed, asked, path) for seed, path in paths.items() if seed not in kept]
    if left:
        with multiprocessing.get_context("spawn").Pool(workers) as pool:
            for done, seed in enumerate(pool.imap_unordered(_keep, left), start=1):
                kept[seed] = read_session(paths[seed], asked)
                print(f"session {seed} scored, {done} of {len(left)}", flush=True)
    return [kept[seed] for seed in seeds]


def read_session(path: Path, asked: Asked) -> dict:
    """A kept session.

    Raises:
        FileFormatError: it is of another layout.
        UsageError: it was made with other gestures or frames.
    """
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        layout = kept.get("layout", 1)
    except (ValueError, AttributeError):
        raise FileFormatError(f"'{path}' is no kept session; delete it, or name another folder with --out.") from None
    if layout != LAYOUT:
        raise FileFormatError(
            f"'{path}' has layout {layout}, and layout {LAYOUT} is read; delete it, or name another folder with --out."
        )
    made = Asked(kept["asked"], kept.get("each", 1), kept["every"])
    if made != asked:
        raise UsageError(
            f"'{path}' holds {made}, and {asked} are asked for; ask for the same, or name another folder with --out."
        )
    return kept


def settings_of(gestures: int, each: int = 1) -> SimulationSettings:
    """Gestures, `each` of one person, one person after the other; sleeves show the forearm."""
    settings = SimulationSettings()
    looks = replace(settings.people.looks, sleeves=SHOWING)
    people = replace(settings.people, play="gestures", gestures=gestures, people=gestures // each, looks=looks)
    return replace(settings, people=people)


def score_session(settings: SimulationSettings, seed: int, every: int) -> dict:
    """All scores of one session, for JSON: of views, of gestures, and what pointing needs to answer them."""
    import person_scores
    from jaxpoint.config.person import PersonSettings
    from jaxpoint.simulate.simulated_session import simulate_session
    from pointing_scores import kept_gesture
    from session_pixels import gestures_of

    session = simulate_session(settings, seed)
    views, gestures, pointing = [], [], []
    for pixels in gestures_of(session, PersonSettings(), every):
        own, gesture = person_scores.score(pixels)
        views += [asdict(view) for view in own]
        gestures.append(asdict(gesture))
        pointing.append(asdict(kept_gesture(pixels)))
    things = [{"name": t.name, "kind": t.kind, "corners": t.corners.tolist()} for t in session.objects]
    room = {"objects": things, "room": session.scene.size.tolist()}
    people = settings.people
    made = {"layout": LAYOUT, "seed": seed, "asked": people.gestures, "each": people.gestures // people.people}
    return made | {"every": every} | {"views": views, "gestures": gestures, "pointing": pointing} | room


def _keep(job: tuple[int, Asked, Path]) -> int:
    import cv2

    seed, asked, path = job
    cv2.setNumThreads(1)
    scores = score_session(settings_of(asked.gestures, asked.each), seed, asked.every)
    with replacing(path) as file:
        file.write(json.dumps(scores).encode())
    return seed
