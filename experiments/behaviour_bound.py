"""How exactly can approximate pointing be corrected at best, where the person is not known?

The simulated law of behaviour (`config.people.ApproximateSettings`) gives each person an error of the forearm of their
own, of which the finger shares an unknown part. Whoever knows that law, but not the person, and sees the forearm
without error and the finger with some, can do no better than the middle of all pointings that look alike. Angles are
small, so azimuth and elevation are taken as plane. What is measured is no finger but the line from wrist to fingertip:
the index finger stands beside the hand's axis, to a side that the unknown turn of the palm decides. No estimator of
jaxpoint is used.

    python experiments/behaviour_bound.py
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.spatial import KDTree

from jaxpoint.config.people import ApproximateSettings, Normal, PointingSettings

KNOWN, ASKED, ALIKE = 300_000, 10_000, 400
FINGER_NOISE_DEG = (0.1, 1.0, 2.0, 4.0)
PALM_DEG = 9.6  # by which the index fingertip stands beside the hand's axis as seen from the wrist: 2.9 of 17 cm
WRIST_NOISE_DEG = 1.5  # of the direction from wrist to fingertip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    rng, law = np.random.default_rng(parser.parse_args().seed), ApproximateSettings()
    print("| error of the finger's direction, degrees per axis | median error at best, degrees |\n|---|---|")
    forearm, _ = drawn(rng, law, ASKED, 0.0)
    print(f"| the finger is not seen | {np.median(np.hypot(*(forearm - np.median(forearm, axis=0)).T)):.2f} |")
    for noise in FINGER_NOISE_DEG:
        print(f"| {noise} | {at_best(drawn(rng, law, KNOWN, noise), drawn(rng, law, ASKED, noise)):.2f} |")
    known, asked = (drawn(rng, law, count, WRIST_NOISE_DEG, PALM_DEG) for count in (KNOWN, ASKED))
    print(f"| {WRIST_NOISE_DEG}, from the wrist, the palm's turn not known | {at_best(known, asked):.2f} |")


def at_best(known: tuple[np.ndarray, np.ndarray], asked: tuple[np.ndarray, np.ndarray]) -> float:
    """Median distance of errors from the middle of those of pointings that look alike."""
    _, alike = KDTree(known[1]).query(asked[1], ALIKE)
    return float(np.median(np.hypot(*(asked[0] - np.median(known[0][alike], axis=1)).T)))


def drawn(
    rng: np.random.Generator, law: ApproximateSettings, count: int, noise: float, palm: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Error of the forearm, and by how much finger and forearm are seen apart: azimuth and elevation, degrees."""
    own = np.stack([_normal(rng, law.azimuth_bias_deg, count), _normal(rng, law.elevation_bias_deg, count)], axis=1)
    scatter = np.array([law.azimuth_scatter_deg, law.elevation_scatter_deg])
    error = own + rng.normal(0.0, scatter, (count, 2))
    follows = rng.uniform(law.finger_follows.low, law.finger_follows.high, (count, 1))
    turn = PointingSettings().palm_turn_deg
    palm_turn = np.deg2rad(rng.uniform(turn.low, turn.high, count))
    beside = palm * np.stack([np.sin(palm_turn), np.cos(palm_turn)], axis=1)  # inwards and up
    return error, (1 - follows) * error - beside + rng.normal(0.0, noise, (count, 2))


def _normal(rng: np.random.Generator, spread: Normal, count: int) -> np.ndarray:
    return np.clip(rng.normal(spread.mean, spread.sd, count), spread.low, spread.high)


if __name__ == "__main__":
    main()
