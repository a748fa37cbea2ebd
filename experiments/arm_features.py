"""How much does each feature show of an arm that points? Fits the weights of `jaxpoint.body.arm_features`.

People of simulated sessions point; every limb that the views agree on is measured, and one that is off the true
forearm by less than 12 degrees, with its tip nearer than 15 cm, is the arm. A logistic regression weighs the features.
It is scored on people who were not fitted: in each frame the likeliest limb is the answer, where its log odds are
enough.

    python experiments/arm_features.py --seeds 200 212 --every 4 --out arm_features.md

The measured limbs are kept beside the table, in `arm_features.json`: a second run only fits. Seeds from 10,000 on are
for final runs alone.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from dataclasses import asdict, fields
from itertools import groupby
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.body.arm_features import CONSTANT, WEIGHTS, ArmFeatures
from jaxpoint.body.limb_arms import LEAST

NAMES = [field.name for field in fields(ArmFeatures)]
RIGHT_DEG, RIGHT_M = 12.0, 0.15
FOLDS = 5
SHRINKAGE = 0.3  # of a weight, per standard deviation of its feature: a ridge


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(200, 202), metavar=("FIRST", "END"))
    parser.add_argument("--gestures", type=int, default=8, help="of one session, each by another person")
    parser.add_argument("--every", type=int, default=4, help="which frames of a hold are looked at: every so many")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("arm_features.md"))
    args = parser.parse_args()
    kept = args.out.with_suffix(".json")
    if not kept.exists():
        jobs = [(seed, args.gestures, args.every) for seed in range(*args.seeds)]
        with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
            found = [limb for own in pool.imap(_limbs_of_session, jobs) for limb in own]
        kept.write_text(json.dumps(found))
    table = summary(json.loads(kept.read_text()))
    args.out.write_text(table)
    print(table)


def _limbs_of_session(job: tuple[int, int, int]) -> list[dict]:
    """Every measured limb of the people who point, with its features and whether it is the arm."""
    import cv2
    import jax

    from jaxpoint.config.person import PersonSettings
    from jaxpoint.simulate.simulated_session import simulate_session
    from scored_sessions import settings_of
    from session_pixels import gestures_of

    cv2.setNumThreads(1)
    seed, gestures, every = job
    session = simulate_session(settings_of(gestures), seed)
    found = []
    with jax.enable_x64(True):
        for pixels in gestures_of(session, PersonSettings(), every):
            for moment in pixels.held:
                found += _limbs_of_moment(pixels, moment)
    print(f"session {seed}: {len(found)} limbs", flush=True)
    return found


def _limbs_of_moment(pixels, moment: int) -> list[dict]:
    from jaxpoint.body.limb_arms import measure_limbs

    session, gesture, following = pixels.session, pixels.gesture, pixels.following
    heads, row, truth = following.tracking.heads, pixels.moments.index(moment), pixels.joints(moment)
    true_axis = truth[f"{gesture.hand}_wrist"] - truth[f"{gesture.hand}_elbow"]
    true_axis /= np.linalg.norm(true_axis)
    found = []
    for person in np.flatnonzero(heads.present[row]).tolist():
        head = heads.positions[row, person]
        if np.linalg.norm(head - truth["head"]) > 0.3:
            continue
        own = following.sightings[row, person].tolist()
        crops = [None if s < 0 else pixels.seen[c].person(s) for c, s in enumerate(own)]
        for limb in measure_limbs(session.rig, crops, head, np.asarray(session.rig.project(head))):
            off = np.degrees(np.arccos(np.clip(limb.direction @ true_axis, -1, 1)))
            tip = float(np.linalg.norm(limb.tip - truth[f"{gesture.hand}_tip"]))
            right = bool(off < RIGHT_DEG and tip < RIGHT_M)
            features = {} if limb.features is None else asdict(limb.features)
            found.append({"moment": [session.seed, gesture.number, moment], "right": right} | features)
    return found


def summary(limbs: list[dict]) -> str:
    """The weights, and how often they choose the arm of people who were not fitted, as Markdown."""
    features = np.array([[limb[name] for name in NAMES] for limb in limbs], float)
    right = np.array([limb["right"] for limb in limbs], bool)
    person = np.array([limb["moment"][0] + limb["moment"][1] for limb in limbs])
    weights, constant = fitted(features, right)
    held_out = np.zeros(len(limbs))
    for fold in range(FOLDS):
        own = person % FOLDS == fold
        others = fitted(features[~own], right[~own])
        held_out[own] = features[own] @ others[0] + others[1]
    lines = [f"{len(limbs)} measured limbs, {right.sum()} of them the arm that points.", ""]
    lines += ["| feature | weight fitted | a standard deviation | weight used |", "|---|---|---|---|"]
    for name, weight, spread, used in zip(NAMES, weights, features.std(axis=0), WEIGHTS, strict=True):
        lines.append(f"| {name} | {weight:.3g} | {weight * spread:.2f} | {used:.3g} |")
    lines += [f"| constant | {constant:.3g} | | {CONSTANT:.3g} |", ""]
    lines += ["| moments with a limb | answered, % | right of these, % |", "|---|---|---|"]
    moments = [limb["moment"] for limb in limbs]
    for name, odds in (("fitted on others", held_out), ("weights used", features @ WEIGHTS + CONSTANT)):
        lines.append(f"| {name} | {_chosen(moments, right, odds)} |")
    return "\n".join([*lines, ""])


def _chosen(moments: list[list[int]], right: Bool[np.ndarray, " L"], odds: Float[np.ndarray, " L"]) -> str:
    best = [
        max(own, key=lambda i: odds[i])
        for _, group in groupby(range(len(odds)), moments.__getitem__)
        for own in [list(group)]
    ]
    answered = [i for i in best if odds[i] > LEAST]
    return f"{100 * len(answered) / len(best):.1f} | {100 * right[answered].mean():.1f}"


def fitted(features: Float[np.ndarray, "L S"], right: Bool[np.ndarray, " L"]) -> tuple[Float[np.ndarray, " S"], float]:
    """Weights and constant of a logistic regression with a ridge on standardised features."""
    from scipy.optimize import minimize

    middle, spread = features.mean(axis=0), features.std(axis=0) + 1e-9
    rows = np.column_stack([(features - middle) / spread, np.ones(len(features))])

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        odds = rows @ weights
        ridge = SHRINKAGE * np.append(weights[:-1], 0.0)
        value = np.sum(np.logaddexp(0, odds) - right * odds) + ridge @ weights
        return float(value), rows.T @ (1 / (1 + np.exp(-odds)) - right) + 2 * ridge

    found = minimize(loss, np.zeros(rows.shape[1]), jac=True).x
    weights = found[:-1] / spread
    return weights, float(found[-1] - weights @ middle)


if __name__ == "__main__":
    main()
