"""How does each stage of the self-calibration compare with the original toolbox's?

The recording strawlab2010 of the multi-camera self-calibration toolbox (Svoboda, Martinec, Pajdla 2005) comes with the
figures that the toolbox printed on every second frame. This calibrates the same frames three times: by `factorisation`
and by `thesis` at the default settings, and by `thesis` at the toolbox's own (RANSAC at 10 px, no lens distortion in
front of the adjustment), and sets the stages side by side, as Markdown. The toolbox's two projective errors are those
before and after its factorisation, ours those of the factorisation and of the projective adjustment that follows it.

    python experiments/self_calibration_stages.py DATA/svoboda_strawlab2010 --out stages.md
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, EpipolarSettings
from jaxpoint.errors import JaxpointError
from jaxpoint.io.svoboda import read_svoboda
from jaxpoint.tracks import Tracks

TOOLBOX_TOLERANCE_PX = 10.0
TOOLBOX_INLIERS = (("523/523", 1, 2), ("432/434", 0, 2), ("362/362", 2, 3))
"""Of the toolbox's four pairs two are this first one, seen from either camera. It names none of them; these are the
ones that share about as many frames (it counted after it had left a few frames out)."""
TOOLBOX_PROJECTIVE_PX = (0.709, 0.688)
TOOLBOX_FINAL_PX = 0.62


@dataclass(frozen=True)
class Stages:
    """Set the stages of the self-calibration beside the original toolbox's."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Folder of strawlab2010: points.dat, IdMat.dat, Res.dat."""
    out: Path = Path("self_calibration_stages.md")
    """The table, as Markdown."""
    every: int = 2
    """Use every n-th frame; the toolbox used every second."""


def main(options: Stages) -> None:
    """Calibrate, and write and print the table.

    Raises:
        JaxpointError: the recording cannot be read or solved.
    """
    recording = read_svoboda(options.recording)
    tracks = recording.select_frames(np.arange(0, recording.frames, options.every))
    solved = {name: calibrate(tracks, settings) for name, settings in cases(tracks).items()}
    text = markdown(solved)
    options.out.write_text(text)
    sys.stdout.write(text)


def cases(tracks: Tracks) -> dict[str, CalibrateSettings]:
    """The settings compared, by name. Thresholds are given at a width of 1280 px, the toolbox's at the image's own."""
    tolerance = TOOLBOX_TOLERANCE_PX * 1280.0 / float(tracks.image_sizes[:, 0].mean())
    as_toolbox = EpipolarSettings(method="ransac", threshold_px=tolerance, division_model=False)
    return {
        "factorisation": CalibrateSettings(init="factorisation"),
        "thesis": CalibrateSettings(init="thesis"),
        "thesis, RANSAC 10 px": CalibrateSettings(init="thesis", epipolar=as_toolbox),
    }


def markdown(solved: dict[str, Calibration]) -> str:
    """Inliers of every pair, then the errors of every stage, a column for each calibration."""
    first = next(iter(solved.values()))
    toolbox = {(i, j): text for text, i, j in TOOLBOX_INLIERS}
    pairs = [(i, j) for i in range(first.tracks.cameras) for j in range(i + 1, first.tracks.cameras)]
    rows = [
        [f"inliers, cameras {i} and {j}", toolbox.get((i, j), ""), *(_inliers(each, i, j) for each in solved.values())]
        for i, j in pairs
    ]
    figures = [stage_figures(each) for each in solved.values()]
    published = {
        "projective error, first, px": TOOLBOX_PROJECTIVE_PX[0],
        "projective error, refined, px": TOOLBOX_PROJECTIVE_PX[1],
        "final mean, px": TOOLBOX_FINAL_PX,
    }
    rows += [[what, _number(published.get(what)), *(_number(each[what]) for each in figures)] for what in figures[0]]
    header = ["", "toolbox", *solved]
    return "".join(f"| {' | '.join(row)} |\n" for row in [header, ["---"] * len(header), *rows])


def _inliers(solved: Calibration, i: int, j: int) -> str:
    table = solved.pairs
    return "" if table.inliers is None else f"{table.inliers[i, j]}/{table.shared[i, j]}"


def stage_figures(solved: Calibration) -> dict[str, Any]:
    """What the stages of one calibration left as errors, and what they are the mean of."""
    projective = next(s.figures for s in solved.stages if "projective_mean_px_before" in s.figures)
    compared = solved.tracks.visible & (solved.errors > 0)
    return {
        "projective error, first, px": projective["projective_mean_px_before"],
        "projective error, refined, px": projective["projective_mean_px_after"],
        "final mean, px": float(solved.errors[solved.kept].mean()),
        "observations in it": int(solved.kept.sum()),
        "mean over all observations, px": float(solved.errors[compared].mean()),
        "observations given": int(solved.tracks.visible.sum()),
        "settled": "yes" if solved.converged else "no",
    }


def _number(value: float | int | str | None) -> str:
    return "" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    try:
        main(tyro.cli(Stages, description=__doc__))
    except JaxpointError as error:
        sys.stderr.write(f"self_calibration_stages: {error}\n")
        sys.exit(error.exit_code)
