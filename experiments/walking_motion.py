"""Is every second in which somebody walks found by the motion detector?

Simulated people walk about a furnished room with flickering lights and six cameras. A second counts where the body
moves by more than 0.3 m in it, so that seconds in which somebody starts or stops are among them, and at least 2,000
pixels of the person are visible in a camera in the middle of it. It is found where that camera's intervals of motion
hold all frames of it that show so much of the person walking, faster than 0.3 m/s: who has not started yet stands
still. The threshold is learnt from the same camera's recording of the
empty room. Target: every second.

    python experiments/walking_motion.py --seeds 200 203
"""

from __future__ import annotations

import argparse
import multiprocessing
from dataclasses import replace
from itertools import pairwise

import numpy as np

from jaxpoint.config.person import MotionSettings
from jaxpoint.config.simulation import SimulationSettings

WALKED_M = 0.3  # in a second
SHOWN_PX = 2000
SECONDS = 12.0  # of a session that are drawn
CAMERAS = 2  # of each session, which see the most


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(200, 203), metavar=("FIRST", "END"))
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    counted = np.zeros(2, int)
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        for seed, found, walked in pool.imap(walking_seconds, range(*args.seeds)):
            print(f"session {seed}: {found} of {walked} walking seconds found", flush=True)
            counted += found, walked
    print(f"| walking seconds | found | target |\n|---|---|---|\n| {counted[1]} | {counted[0]} | all |")


def walking_seconds(seed: int) -> tuple[int, int, int]:
    """The seed, and how many seconds of walking before a camera were found, of how many."""
    from jaxpoint.detection.person.frame_motion import intervals, learn_threshold, motion_between
    from jaxpoint.simulate.simulated_session import simulate_session

    settings, motion = SimulationSettings(), MotionSettings()
    people = replace(settings.people, play="session")
    session = simulate_session(replace(settings, people=people), seed)
    rate = 1.0 / (session.time_of(1) - session.time_of(0))
    frames = range(min(round(SECONDS * rate), session.frame_at(session.play.duration_s)))
    found = walked = 0
    for camera in _most_seeing(session, frames):
        empty = [session.empty(k, camera) for k in range(motion.min_pairs + 1)]
        threshold = learn_threshold(np.array([motion_between(a, b, motion).edges for a, b in pairwise(empty)]), motion)
        shown = [session.frame(frame, camera) for frame in frames]
        edges = [motion_between(a.image, b.image, motion).edges for a, b in pairwise(shown)]
        active = np.zeros(len(shown), bool)
        for first, last in intervals(np.array([0, *edges]) > threshold, motion):
            active[first : last + 1] = True
        for start in range(0, len(shown) - round(rate), round(rate)):
            stop = start + round(rate)
            for person in _walkers(session, shown, start, stop):
                walked += 1
                steps = [f for f in range(start + 1, stop) if person in _visible(shown[f])]
                found += all(active[f] for f in steps if _moved(session, person, f - 1, f) * rate > WALKED_M)
    return seed, found, walked


def _most_seeing(session, frames) -> list[int]:
    """The cameras that see most heads."""
    import jax

    heads = np.array([actor.joints(session.time_of(f))["head"] for f in frames[::5] for actor in session.play.actors])
    with jax.enable_x64(True):
        pixels, depth = np.asarray(session.rig.project(heads)), np.asarray(session.rig.depth(heads))
    inside = (pixels > 0).all(axis=-1) & (pixels < np.asarray(session.rig.image_sizes)).all(axis=-1) & (depth > 0)
    return np.argsort(-inside.sum(axis=0))[:CAMERAS].tolist()


def _walkers(session, shown, start: int, stop: int) -> list[int]:
    """Who walks through these frames, visible in the middle of them."""
    seen = _visible(shown[(start + stop) // 2])
    return [person for person in sorted(seen) if _moved(session, person, start, stop) > WALKED_M]


def _moved(session, person: int, first: int, last: int) -> float:
    """How far a head moves over the floor from one frame to another, m."""
    actor = next(actor for actor in session.play.actors if actor.person.number == person)
    start, end = (actor.joints(session.time_of(frame))["head"][:2] for frame in (first, last))
    return float(np.linalg.norm(end - start))


def _visible(frame) -> set[int]:
    return {view.person for view in frame.views if view.silhouette_px >= SHOWN_PX}


if __name__ == "__main__":
    main()
