"""Do two people keep their ids when they meet, and how well are their heads known?

Point-level simulation (`jaxpoint.simulate.heads`): six cameras on the walls, heads found with 4 px of noise, 20 %
missed, 0.3 false ones a view and frame; two people whose silhouettes overlap in a view are one, with one head, which is
now and then between the two. They come within 0.3 to 0.6 m of one another: pass, cross, overtake, or meet and go back.
An id is swapped where it belongs to one person before and to the other after.

    python experiments/head_crossings.py --seeds 1000 1080 --out crossings.md
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import jax
import numpy as np
import tyro
from rich.progress import track

from jaxpoint.body.tracking.tracker import track_heads
from jaxpoint.simulate.heads import Meeting, random_meeting

APART_M = 0.8  # farther from one another it is plain who is who
NEAR_M = 0.3  # a track is a person's within this distance


@dataclass(frozen=True)
class HeadCrossings:
    """Track simulated meetings."""

    seeds: tuple[int, int] = (1000, 1080)
    """First seed of a meeting, and one past the last."""
    out: Path = Path("crossings.md")
    """The table, as Markdown."""


def main(settings: HeadCrossings) -> None:
    """Track all meetings of every kind and write one row each."""
    rows = {kind: [] for kind in get_args(Meeting)}
    for seed in track(range(*settings.seeds)):
        kind = get_args(Meeting)[seed % len(rows)]
        rows[kind].append(one(seed, kind))
    lines = [
        "| meeting | number | swapped ids | not two ids | head, median | 95 % | beside one another, median | 95 % |",
        "|---|---|---|---|---|---|---|---|",
        *(line(kind, found) for kind, found in rows.items() if found),
    ]
    settings.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(settings.out.read_text(encoding="utf-8"))


def one(seed: int, kind: Meeting) -> tuple[bool, bool, np.ndarray, np.ndarray]:
    """Whether ids were swapped, whether there were others than two, and errors (m) apart and beside one another."""
    meeting = random_meeting(seed, kind=kind)
    with jax.enable_x64(True):
        heads = track_heads(meeting.room.rig, meeting.pixels, meeting.valid, meeting.times).heads
    gaps = np.linalg.norm(heads.positions[:, :, None] - meeting.places[:, None], axis=-1)
    apart = np.linalg.norm(meeting.places[:, 0] - meeting.places[:, 1], axis=1) > APART_M
    whose, error = gaps.argmin(axis=2), gaps.min(axis=2)
    plain = heads.present & apart[:, None] & (error < NEAR_M)
    swapped = any(len(set(whose[plain[:, n], n].tolist())) > 1 for n in range(len(heads.people)))
    sides = (error[heads.present & where[:, None]] for where in (apart, ~apart))
    return swapped, len(heads.people) != 2, *sides


def line(kind: Meeting, found: list) -> str:
    """One row of the table."""
    swapped, others, apart, beside = zip(*found)
    errors = [np.concatenate(part) for part in (apart, beside)]
    shown = " | ".join(f"{100 * np.quantile(part, share):.1f} cm" for part in errors for share in (0.5, 0.95))
    return f"| {kind} | {len(found)} | {sum(swapped)} | {sum(others)} | {shown} |"


if __name__ == "__main__":
    main(tyro.cli(HeadCrossings))
