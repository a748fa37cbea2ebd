"""`jaxpoint diff`: two calibrations of one room against each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.options import Options, Outcome, at
from jaxpoint.config import RoomConfig
from jaxpoint.errors import QualityError, UsageError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    import numpy as np

    from jaxpoint.io.rig_entries import SavedCalibration
    from jaxpoint.report.difference_page import Compared


@dataclass(frozen=True, kw_only=True)
class Diff(Options):
    """Say how two calibrations of one room differ, and whether their uncertainties allow that.

    jaxpoint diff runs/monday runs/friday

    The second is brought onto the first before, so that frame and unit do not count. Cameras are matched by name.
    `--out` also writes the findings as a page. Ends in exit code 5 where they differ by more than their uncertainties
    allow, in 0 where they agree and where one holds no covariance, so that nobody can tell.
    """

    first: Annotated[Path, tyro.conf.Positional]
    """A run, or a calibration of any format (`jaxpoint convert --list`)."""
    second: Annotated[Path, tyro.conf.Positional]
    """Another of the same room."""
    no_align: bool = field(default=False)
    """Compare in metres as they stand: both were aligned to the same landmarks, and the frame counts too."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> Diff:
        """The command's defaults under a configuration file."""
        return Diff(first=tyro.MISSING, second=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """The difference; more than the uncertainties allow is a failure of the outcome."""
        from jaxpoint.report.difference_page import difference_table, figures_of, sentences

        if self.out is not None:
            self.needed_folder("")
        compared = compare(self.first, self.second, align=not self.no_align)
        shown = difference_table(compared)
        lines = (*table(shown.header, shown.rows), *sentences(compared))
        missing: list[str] = []
        if self.out is not None:
            self._keep(self.out, compared, missing)
            lines = (*lines, *at("Report", self.out / "report.html"))
        return Outcome(figures_of(compared), lines, _failure(compared, self.first, self.second), tuple(missing))

    def _keep(self, out: Path, compared: Compared, missing: list[str]) -> None:
        from jaxpoint.report.difference_page import figures_of, write_difference_report
        from jaxpoint.runs import MARK, new_run, provenance, write_json

        runs = [(path, path / "calibration.json") for path in (self.first, self.second)]
        files = [inside if inside.is_file() else path for path, inside in runs]
        made = provenance("jaxpoint diff", files, 0)
        titles = str(self.first), str(self.second)

        def page(folder: Path) -> None:
            with extra("report.html", missing):
                write_difference_report(folder / "report.html", compared, titles=titles, provenance=made)

        with new_run(out, self.force, page) as folder:
            write_json(folder / MARK, made)
            write_json(folder / "diff.json", figures_of(compared))


def compare(first: Path, second: Path, align: bool = True) -> Compared:
    """The difference between two calibrations, over the places where the first one's light was.

    Raises:
        FileFormatError: a file is not what it should be.
        UsageError: no camera is in both, image sizes differ, or without alignment one has no metres.
        InsufficientDataError: they hardly see the same places.
    """
    from jaxpoint.calibration.difference import difference, sampled_places
    from jaxpoint.io.exchange import read_cameras
    from jaxpoint.report.difference_page import Compared

    one, other = read_cameras(first), read_cameras(second)
    names = [name for name in one.rig.names if name in other.rig.names]
    if not names:
        raise UsageError(
            f"'{first}' and '{second}' have no camera in common: {', '.join(one.rig.names)}; "
            f"{', '.join(other.rig.names)}. Cameras are matched by name."
        )
    for path, saved in ((first, one), (second, other)):
        if not align and (saved.unit != "m" or not saved.in_room):
            lacking = "metres" if saved.unit != "m" else "the frame of the room"
            raise UsageError(f"'{path}' is not in {lacking}; align it first, or leave out --no-align.")
    notes = [
        f"Not compared, because only '{path}' has them: {', '.join(alone)}."
        for path, saved in ((first, one), (second, other))
        if (alone := [name for name in saved.rig.names if name not in names])
    ]
    here, there = (saved.rig.select([saved.rig.names.index(name) for name in names]) for saved in (one, other))
    for name, size, again in zip(names, here.image_sizes.tolist(), there.image_sizes.tolist()):
        if size != again:
            raise UsageError(
                f"Camera '{name}' has images of {size[0]} x {size[1]} px in '{first}', of {again[0]} x {again[1]} px "
                f"in '{second}'; only calibrations of one mode of a camera can be compared."
            )
    missing = _why_not_compared(first, one, second, other, align)
    covariances = None if missing else (_of(one, names), _of(other, names))
    light = _points_of_light(first)
    found = difference(here, there, sampled_places(here) if light is None else light, covariances, align)
    if light is None:
        notes.append(
            f"'{first}' is no run: the places compared lie along its cameras' lines of sight, not where a light was."
        )
    if missing:
        notes.append(f"No comparison with the uncertainties is possible: {missing}")
    if set(one.provenance.get("inputs", {}).values()) & set(other.provenance.get("inputs", {}).values()):
        notes.append("Both come from the same input, so their errors are alike: expect less than is allowed.")
    notes += [*one.notes, *other.notes]
    if one.unit != "m":
        notes.append(f"Lengths are in thousandths of the unit of '{first}'; align it to have mm.")
    return Compared(found, "mm" if one.unit == "m" else "thousandths", tuple(notes))


def _failure(compared: Compared, first: Path, second: Path) -> QualityError | None:
    """That they disagree; None where they agree, or where nothing says how uncertain they are."""
    allowed = compared.found.allowed
    if allowed is None or allowed.consistent:
        return None
    names = " and ".join(compared.found.first.names[c] for c in allowed.culprits)
    return QualityError(
        f"'{second}' differs from '{first}' by {allowed.ratio_all:.1f} times what their uncertainties allow"
        f"{f', most of all in {names}' if names else ''}: a camera or lens was touched between the recordings, or one "
        "calibration is wrong; record the light again and see which of them the new calibration agrees with."
    )


def _why_not_compared(first: Path, one: SavedCalibration, second: Path, other: SavedCalibration, align: bool) -> str:
    """Why differences cannot be held against uncertainties, or nothing."""
    for path, saved in ((first, one), (second, other)):
        if saved.covariance is None:
            return _without_covariance(path)
        if not align and saved.gauge != "landmarks":
            return f"'{path}' does not say how well its frame is known; align it by landmarks, or leave out --no-align."
    return ""


def _without_covariance(path: Path) -> str:
    """Why a calibration says nothing of its uncertainty: of a run, what stood in the way when it was made."""
    from jaxpoint.io.result_files import load_result

    why = load_result(path).undetermined if (path / "result.npz").is_file() else ""
    if why:
        return f"'{path}' holds no covariance, because of this: {why}"
    return f"'{path}' holds no covariance; give the folder of a run of `calibrate` or `align`."


def _of(saved: SavedCalibration, names: list[str]) -> np.ndarray:
    """The covariance of some cameras."""
    import numpy as np

    assert saved.covariance is not None
    count = len(saved.rig)
    chosen = [saved.rig.names.index(name) for name in names]
    blocks = saved.covariance.reshape(count, -1, count, saved.covariance.shape[0] // count)
    size = blocks.shape[1] * len(names)
    return blocks[np.ix_(chosen, range(blocks.shape[1]), chosen, range(blocks.shape[1]))].reshape(size, size)


def _points_of_light(path: Path) -> np.ndarray | None:
    """Places of the light of a run, evenly few; None of a file."""
    import numpy as np

    from jaxpoint.calibration.difference import PLACES
    from jaxpoint.io.result_files import load_result

    if not (path / "result.npz").is_file():
        return None
    calibration = load_result(path)
    points = calibration.points[calibration.point_valid]
    return points[np.linspace(0, len(points) - 1, min(PLACES, len(points))).astype(int)] if len(points) else None
