"""`jaxpoint diff`: two calibrations of one room against each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from jaxpoint.io.calibration import SavedCalibration
    from jaxpoint.report.difference import Compared


@dataclass(frozen=True, kw_only=True)
class Diff(Options):
    """Say how two calibrations of one room differ, and whether their uncertainties allow that.

    jaxpoint diff runs/monday runs/friday

    The second is brought onto the first before, so that frame and unit do not count. Cameras are matched by name.
    `--out` also writes the findings as a page.
    """

    first: Annotated[Path, tyro.conf.Positional]
    """A run, or a calibration.json."""
    second: Annotated[Path, tyro.conf.Positional]
    """Another of the same room."""
    no_align: bool = field(default=False)
    """Compare in metres as they stand: both were aligned to the same landmarks, and the frame counts too."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> Diff:
        """The command's defaults under a configuration file."""
        return Diff(first=tyro.MISSING, second=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """The difference; being inconsistent is an answer, no failure."""
        from jaxpoint.report.difference import difference_table, figures_of, sentences

        if self.out is not None:
            self.needed_folder("")
        compared = compare(self.first, self.second, align=not self.no_align)
        shown = difference_table(compared)
        lines = (*table(shown.header, shown.rows), *sentences(compared))
        if self.out is not None:
            lines = (*lines, f"Report: {self._keep(self.out, compared)}")
        return Outcome(figures_of(compared), lines)

    def _keep(self, out: Path, compared: Compared) -> Path:
        from jaxpoint.report.difference import figures_of, write_difference_report
        from jaxpoint.runs import MARK, new_run, provenance, write_json

        files = [path / "calibration.json" if path.is_dir() else path for path in (self.first, self.second)]
        made = provenance("jaxpoint diff", files, 0)
        with new_run(out, self.force) as folder:
            write_json(folder / MARK, made)
            write_json(folder / "diff.json", figures_of(compared))
            titles = str(self.first), str(self.second)
            write_difference_report(folder / "report.html", compared, titles=titles, provenance=made)
        return out / "report.html"


def compare(first: Path, second: Path, align: bool = True) -> Compared:
    """The difference between two calibrations, over the places where the first one's light was.

    Raises:
        FileFormatError: a file is not what it should be.
        UsageError: no camera is in both, image sizes differ, or without alignment one has no metres.
        InsufficientDataError: they hardly see the same places.
    """
    from jaxpoint.calibration.difference import difference, sampled_places
    from jaxpoint.io.calibration import read_calibration
    from jaxpoint.report.difference import Compared

    one, other = read_calibration(first), read_calibration(second)
    names = [name for name in one.rig.names if name in other.rig.names]
    if not names:
        raise UsageError(
            f"'{first}' and '{second}' have no camera in common: {', '.join(one.rig.names)}; "
            f"{', '.join(other.rig.names)}. Cameras are matched by name."
        )
    for path, saved in ((first, one), (second, other)):
        if not align and saved.unit != "m":
            raise UsageError(f"'{path}' is not in metres; align it first, or leave out --no-align.")
    notes = [
        f"Not compared, because only '{path}' has them: {', '.join(alone)}."
        for path, saved in ((first, one), (second, other))
        if (alone := [name for name in saved.rig.names if name not in names])
    ]
    here, there = (saved.rig.select([saved.rig.names.index(name) for name in names]) for saved in (one, other))
    for name, size, again in zip(names, here.image_sizes.tolist(), there.image_sizes.tolist()):
        if size != again:
            raise UsageError(f"Camera '{name}' has images of {size} px in '{first}', of {again} px in '{second}'.")
    missing = _uncompared(first, one, second, other, align)
    covariances = None if missing else (_of(one, names), _of(other, names))
    light = _light(first)
    found = difference(here, there, sampled_places(here) if light is None else light, covariances, align)
    if light is None:
        notes.append(
            f"'{first}' is no run: the places compared lie along its cameras' lines of sight, not where a light was."
        )
    if missing:
        notes.append(f"No comparison with the uncertainties is possible: {missing}")
    if set(one.provenance.get("inputs", {}).values()) & set(other.provenance.get("inputs", {}).values()):
        notes.append("Both come from the same input, so their errors are alike: expect less than is allowed.")
    notes += [f"'{path}' was marked when it was made: {why}" for path in (first, second) if (why := _marked(path))]
    if one.unit != "m":
        notes.append(f"Lengths are in thousandths of the unit of '{first}'; align it to have mm.")
    return Compared(found, "mm" if one.unit == "m" else "thousandths", tuple(notes))


def _uncompared(first: Path, one: SavedCalibration, second: Path, other: SavedCalibration, align: bool) -> str:
    """Why differences cannot be held against uncertainties, or nothing."""
    for path, saved in ((first, one), (second, other)):
        if saved.covariance is None:
            return f"'{path}' holds no covariance; give a run of `calibrate` or `align`."
        if not align and saved.gauge != "landmarks":
            return f"'{path}' does not say how well its frame is known; align it by landmarks, or leave out --no-align."
    return ""


def _marked(path: Path) -> str | None:
    """Why a run did not pass, if it is one and did not."""
    from jaxpoint.runs import read_json

    metrics = path / "metrics.json"
    return read_json(metrics).get("failure") if metrics.is_file() else None


def _of(saved: SavedCalibration, names: list[str]) -> np.ndarray:
    """The covariance of some cameras."""
    import numpy as np

    assert saved.covariance is not None
    count = len(saved.rig)
    chosen = [saved.rig.names.index(name) for name in names]
    blocks = saved.covariance.reshape(count, -1, count, saved.covariance.shape[0] // count)
    size = blocks.shape[1] * len(names)
    return blocks[np.ix_(chosen, range(blocks.shape[1]), chosen, range(blocks.shape[1]))].reshape(size, size)


def _light(path: Path) -> np.ndarray | None:
    """Places of the light of a run, evenly few; None of a file."""
    import numpy as np

    from jaxpoint.calibration.difference import PLACES
    from jaxpoint.io.result import load_result

    if not (path / "result.npz").is_file():
        return None
    calibration = load_result(path)
    points = calibration.points[calibration.point_valid]
    return points[np.linspace(0, len(points) - 1, min(PLACES, len(points))).astype(int)] if len(points) else None
