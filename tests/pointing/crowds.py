"""People drawn at random who point at known targets, each with a bias that is known."""

import numpy as np

from jaxpoint.geometry.angles import turn_directions
from jaxpoint.pointing.bias.pointings import Pointings

NAMES = ("anna", "ben", "cleo", "dan", "eve", "fay", "gus")
LINES = ("head", "hand", "shoulder")


def crowd(
    seed=0, people=6, gestures=30, *, bias_deg=(4.0, 9.0), between_deg=1.0, within_deg=1.0, slips=0.1
) -> Pointings:
    """Every line is off by the bias, the person's own offset (alike in all), and the gesture's; some are slips.

    The hand's line is off by its own 5 and -3 degrees; the shoulder's as often as not by 10 degrees to either side.
    """
    draw = np.random.default_rng(seed)
    count = people * gestures
    who = np.repeat(np.arange(people), gestures)
    targets = np.array([3.0, 0.0, 1.5]) + draw.uniform(-1, 1, (count, 3))
    tips = np.array([0.5, 0.1, 1.4]) + 0.2 * draw.normal(size=(count, 3))
    to = targets - tips
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    personal = between_deg * draw.normal(size=(people, 2))
    own = personal[who] + within_deg * draw.normal(size=(count, 2))
    own[draw.random(count) < slips] += 40.0
    head = np.array(bias_deg) + own
    hand = np.array([5.0, -3.0]) + own + 0.2 * draw.normal(size=(count, 2))
    shoulder = own + 10 * draw.choice([-1, 1], size=(count, 1))
    directions = np.stack([turn_directions(to, np.deg2rad(off)) for off in (head, hand, shoulder)], axis=1)
    names = tuple(f"{NAMES[person % 7]}{person // 7 or ''}" for person in who)
    gestures_named = tuple(map(str, range(count)))
    return Pointings(gestures_named, names, LINES, np.repeat(tips[:, None], 3, axis=1), directions, targets)
