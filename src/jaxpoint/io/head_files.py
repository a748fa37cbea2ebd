"""Head tracks in files: `heads.csv`, one line for each person in each frame.

Columns `frame,time_s,person,x_m,y_m,z_m,sigma_m,views,status`: `sigma_m` is the standard deviation in the worst
direction, `views` the names of the cameras that measured the head, joined by `|`, `status` in words (`REASONS`). Where
a person is not in the room there is no line; frames with nobody have none at all.
"""

from __future__ import annotations

import csv
import io

import numpy as np

from jaxpoint.body.tracking.head_tracks import REASONS, HeadTracks, Status
from jaxpoint.io.files import StrPath, natural_key, read_table, read_text, replacing

HEAD_COLUMNS = ("frame", "time_s", "person", "x_m", "y_m", "z_m", "sigma_m", "views", "status")
_DIGITS = 5  # of a metre: a hundredth of a millimetre


def save_heads(path: StrPath, heads: HeadTracks) -> None:
    """Write `heads.csv`, at once or not at all.

    Raises:
        ValueError: a camera's name contains `|`.
    """
    wrong = [name for name in heads.cameras if "|" in name]
    if wrong:
        raise ValueError(f"The camera '{wrong[0]}' cannot be written to heads.csv: '|' separates names; rename it.")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEAD_COLUMNS)
    for frame, person in np.argwhere(heads.present):
        views = "|".join(name for name, used in zip(heads.cameras, heads.used[frame, person]) if used)
        numbers = (*heads.positions[frame, person], heads.sigma[frame, person])
        writer.writerow(
            [
                heads.frame_ids[frame],
                f"{heads.times[frame]:.6f}".rstrip("0").rstrip("."),
                heads.people[person],
                *(f"{number:.{_DIGITS}f}" for number in numbers),
                views,
                REASONS[Status(heads.status[frame, person])],
            ]
        )
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def read_heads(path: StrPath, cameras: tuple[str, ...] = ()) -> HeadTracks:
    """The head tracks in a file written by `save_heads`, of the frames that have somebody.

    Args:
        path: the file.
        cameras: their names in the order wanted; those in the file, cam_2 before cam_10, if left out.

    Raises:
        FileFormatError: a missing column or value, an unknown camera or status, or a person twice in one frame.
    """
    nobody = read_text(path).strip() == ",".join(HEAD_COLUMNS)
    rows = [] if nobody else read_table(path, HEAD_COLUMNS)
    seen = {name for row in rows for name in row.values["views"].split("|") if name}
    names = cameras or tuple(sorted(seen, key=natural_key))
    frames = np.array(sorted({row.integer("frame") for row in rows}), int)
    people = np.array(sorted({row.integer("person") for row in rows}), int)
    statuses = {text: status for status, text in REASONS.items() if status != Status.ABSENT}
    shape = len(frames), len(people)
    heads = HeadTracks(
        frames,
        np.zeros(len(frames)),
        people,
        np.zeros((*shape, 3)),
        np.zeros(shape),
        np.zeros((*shape, len(names)), bool),
        np.full(shape, int(Status.ABSENT)),
        names,
    )
    for row in rows:
        frame = int(np.searchsorted(frames, row.integer("frame")))
        place = frame, int(np.searchsorted(people, row.integer("person")))
        if heads.present[place]:
            raise row.error(f"person {row.integer('person')} is a second time in frame {row.integer('frame')}.")
        if row.text("status") not in statuses:
            raise row.error(f"the status '{row.text('status')}' is none of {', '.join(statuses)}.")
        unknown = [name for name in row.values["views"].split("|") if name and name not in names]
        if unknown:
            raise row.error(f"the camera '{unknown[0]}' is none of {', '.join(names)}.")
        heads.times[frame] = row.number("time_s")
        heads.positions[place] = [row.number(column) for column in ("x_m", "y_m", "z_m")]
        heads.sigma[place] = row.number("sigma_m")
        heads.used[place] = [name in row.values["views"].split("|") for name in names]
        heads.status[place] = statuses[row.text("status")]
    return heads
