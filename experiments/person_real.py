"""What do the detectors of a person reach on real video, and where do they fail?

pose2sim_single: a bare-torso man who hardly leaves the spot, seen by four cameras, with joints labelled by eye. Is it
noticed that the median image holds him? How often do the median, MOG2 and a background that is given (the
calibration's stills, from which he is cut out) find him and his head, how far is the head from the labelled cap, in
the images and in 3-D, and the thesis's and our forearm from the labelled elbow and wrist? opencv_vtest and
bodypose3d_cam0 have no truth: they are counted, and looked at. hand_keypoints: skin and tip against the labels. Writes
one table, a sheet of pictures of each recording to look at, and `report.html` with all of it.

    python experiments/person_real.py DATA --out person_real
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import jax
import tyro
from markupsafe import Markup

from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import to_data_uri
from jaxpoint.report.tables import Table, origin_table
from jaxpoint.runs import provenance
from person_balancing import balancing
from person_hands import hands
from person_passing import passing, sitting
from person_pictures import Row, read_image

DRAWN = "Green: the silhouette's outline; yellow: its head, red where it was rejected"
SHEETS = {
    "pose2sim.png": f"pose2sim_single, given background. {DRAWN}; cross: the labelled cap.",
    "vtest.png": f"opencv_vtest, the median as background. {DRAWN}.",
    "bodypose3d_static.png": f"bodypose3d_cam0, the median as background: it holds him in the chair. {DRAWN}.",
    "bodypose3d_mog2.png": f"bodypose3d_cam0, MOG2. {DRAWN}.",
    "hands.png": "hand_keypoints. Green: the region of skin that holds most keypoints; yellow: its axis; cross: the "
    "labelled tip of the index finger.",
}


@dataclass(frozen=True)
class PersonReal:
    """The detectors of a person on real video."""

    data: Annotated[Path, tyro.conf.Positional]
    """Folder that holds pose2sim_single, opencv_vtest, bodypose3d_cam0 and hand_keypoints."""
    out: Path = Path("person_real")
    """Folder for the table and the sheets."""


def main() -> int:
    """All recordings, each row printed as it comes."""
    options = tyro.cli(PersonReal)
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    lines = ["| recording | figure | reached |", "|---|---|---|"]
    sys.stdout.write("\n".join(lines) + "\n")
    rows: list[Row] = []
    for part in (balancing, passing, sitting, hands):
        for row in part(options.data, options.out):
            rows.append(row)
            lines.append(f"| {' | '.join(row)} |")
            sys.stdout.write(lines[-1] + "\n")
            sys.stdout.flush()
    (options.out / "person_real.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_page(options.out / "report.html", page(rows, options.out))
    return 0


def page(rows: list[Row], folder: Path) -> str:
    """The table and the sheets of a folder on one page."""
    pictures = []
    for name, caption in SHEETS.items():
        uri = to_data_uri(read_image(folder / name)[..., ::-1])
        pictures.append((Markup('<img src="{}" alt="{}" style="width: 100%">').format(uri, caption), caption))
    return render(
        "study.html.j2",
        kind="experiment",
        title="The detectors of a person on real video",
        subtitle="Silhouettes and heads to look at, beside what was counted",
        sections=[("found", "What was found"), ("pictures", "In pictures"), ("figures", "All figures"),
                  ("provenance", "Provenance")],
        found="The man of pose2sim_single is compared with joints labelled by eye. opencv_vtest and bodypose3d_cam0 "
        "have no truth: their silhouettes and heads are counted, and here to be judged by eye.",
        figures=pictures,
        rows=Table(["recording", "figure", "reached"], [[cell.replace("`", "") for cell in row] for row in rows]),
        provenance=origin_table(provenance("python experiments/person_real.py", [], 0), {}, None),
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
