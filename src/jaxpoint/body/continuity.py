"""Arms over time: a frame that its neighbours contradict is looked at again where they predict the arm.

Single frames fail where views merge an arm with what is behind it; a frame later they do not. Nothing is smoothed:
an answer always comes from the images of its own frame, or is withdrawn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from jaxpoint.body.arm import PointingArm

WINDOW_S = 0.35  # neighbours are no farther away
TURN = np.deg2rad(15.0)  # by which arms of neighbouring frames may differ,
TURN_A_SECOND = np.deg2rad(120.0)  # and more with the time between: an arm that is raised
JUMP_M = 0.10  # the same for the tip
JUMP_M_A_SECOND = 2.0
SUPPORT = 2  # neighbours that agree, before a frame is looked at again
OUTVOTED = 3  # before an answer that stands alone is withdrawn
ROUNDS = 3  # what was found again supports the frames beside it

Arms = dict[int, PointingArm | None]
Again = Callable[[int, int], PointingArm | None]


def with_neighbours(
    arms: Mapping[int, PointingArm | None],
    times: Float[np.ndarray, " F"],
    again: Again,
) -> Arms:
    """The arms of one person by frame, those that neighbours contradict found anew or withdrawn.

    Args:
        arms: by frame, None where none was found.
        times: of all frames, s.
        again: looks for the arm of the first frame where that of the second predicts it.
    """
    arms = dict(arms)
    for _ in range(ROUNDS):
        changed = {frame: new for frame in arms if (new := _reconsider(arms, times, frame, again)) is not arms[frame]}
        if not changed:
            break
        arms.update(changed)
    return arms


def _reconsider(arms: Arms, times: np.ndarray, frame: int, again: Again) -> PointingArm | None:
    own = arms[frame]
    others = {
        m: arm for m, arm in arms.items() if m != frame and arm is not None and abs(times[m] - times[frame]) <= WINDOW_S
    }
    group = _majority(others, times)
    if len(group) < SUPPORT:
        return own
    if own is not None and _alike(own, others[group[0]], times[frame] - times[group[0]]):
        return own
    nearest = min(group, key=lambda other: abs(times[other] - times[frame]))
    found = again(frame, nearest)
    if found is not None and _alike(found, others[nearest], times[frame] - times[nearest]):
        return found
    return None if own is not None and len(group) >= OUTVOTED else own


def _majority(arms: Mapping[int, PointingArm], times: np.ndarray) -> list[int]:
    """The frames that most of them agree with, the one with the most agreement first; none without a majority."""
    groups = [[m, *(o for o in arms if o != m and _alike(arms[m], arms[o], times[m] - times[o]))] for m in arms]
    best = max(groups, key=len, default=[])
    return best if 2 * len(best) > len(arms) else []


def _alike(a: PointingArm, b: PointingArm, seconds: float) -> bool:
    apart = np.arccos(np.clip(a.direction @ b.direction, -1.0, 1.0))
    jump = np.linalg.norm(a.tip - b.tip)
    seconds = abs(seconds)
    return bool(apart <= TURN + TURN_A_SECOND * seconds and jump <= JUMP_M + JUMP_M_A_SECOND * seconds)
