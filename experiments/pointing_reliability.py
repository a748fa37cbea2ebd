"""Do probabilities of pointing say how often they are right? Many simulated people, their joints measured with noise.

No image is drawn: joints are the simulator's, with the errors that pixels leave (head 8 mm, wrist 3, elbow and tip 4
per axis). So no arm is missed and none is another limb's, which `pointing_evaluation.py` counts. Powers to which the
probabilities are raised are compared; `jaxpoint.pointing.answers.CALIBRATION_EXPONENT` was chosen on these seeds.
People who point several times (--each) show by that with which eye they aim, and by how much their forearm misses.

    python experiments/pointing_reliability.py --powers 1 1.3
    python experiments/pointing_reliability.py --powers 1 1.3 --each 4 --seeds 500 520
"""

from __future__ import annotations

import argparse
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxpoint.body.joints import joints_with_covariance
from jaxpoint.config.people import PeopleSettings, PointingSettings
from jaxpoint.simulate.people.play import make_play
from jaxpoint.simulate.simulated_session import floor_of
from pointing_evaluation import answered, summary
from pointing_people import Setting

OBJECTS, PEOPLE = 30, 16
NOISE_M = np.repeat([0.008, 0.004, 0.003, 0.004], 3)  # of head, elbow, wrist and tip, per axis
SAID_M = np.repeat([0.010, 0.005, 0.004, 0.0065], 3)  # what the measurement says of itself
SEEN_M = 0.012, 0.22  # the forearm's axis is seen from before the wrist to so far behind it


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(500, 540), metavar=("FIRST", "END"))
    parser.add_argument("--powers", nargs="+", type=float, default=(1.0, 1.2, 1.4, 1.6))
    parser.add_argument("--each", type=int, default=1, help="gestures of one person")
    args = parser.parse_args()
    with jax.enable_x64(True):
        sessions = [drawn(seed, args.each) for seed in range(*args.seeds)]
        for power in args.powers:
            print(f"## Power {power:g}\n\n{summary(answered(sessions, exponent=power))}", flush=True)


def drawn(seed: int, each: int = 1) -> dict:
    """A room and its people as `scored_sessions.py` keeps them from pixels."""
    setting, rng = Setting.drawn(seed, OBJECTS), np.random.default_rng([seed, 4])
    people = PeopleSettings(play="gestures", people=PEOPLE, gestures=PEOPLE * each, pointing=PointingSettings())
    floor = floor_of(setting.scene, setting.viewpoints)
    play = make_play(np.random.default_rng([seed, 3]), people, cast(Any, setting.things), floor)
    gestures = [_measured(actor, gesture, seed, rng) for actor in play.actors for gesture in actor.gestures]
    things = [{"name": t.name, "kind": t.kind, "corners": t.corners.tolist()} for t in setting.things]
    return {"seed": seed, "gestures": gestures, "objects": things, "room": setting.scene.size.tolist()}


def _measured(actor, gesture, seed: int, rng: np.random.Generator) -> dict:
    """A gesture whose arm was found, with noise."""
    joints = actor.skeleton((gesture.hold_first_s + gesture.hold_last_s) / 2).joints
    head, elbow, wrist, tip = (joints[n] for n in ("head", *(f"{gesture.hand}_{p}" for p in ("elbow", "wrist", "tip"))))
    ahead = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    wrist = wrist - SEEN_M[0] * ahead
    places = np.concatenate([head, wrist - SEEN_M[1] * ahead, wrist, tip]) + rng.normal(0.0, NOISE_M)
    found, covariance = joints_with_covariance(jnp.asarray(places), jnp.diag(jnp.asarray(SAID_M) ** 2))
    return {
        "seed": seed,
        "gesture": gesture.number,
        "person": f"{seed}-{gesture.person}",
        "law": gesture.law,
        "target": gesture.target,
        "target_m": gesture.target_m.tolist(),
        "found": True,
        "views": 5,
        "start_s": gesture.hold_first_s,
        "end_s": gesture.hold_last_s,
        "joints": np.asarray(found.flat).tolist(),
        "covariance": np.asarray(covariance).tolist(),
        "thesis_tip_m": None,
        "thesis_direction": None,
    }


if __name__ == "__main__":
    main()
