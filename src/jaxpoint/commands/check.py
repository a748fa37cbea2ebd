"""`jaxpoint check`: is the recording good enough, without solving anything?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import intrinsics_from, tracks_from
from jaxpoint.commands.options import Inline, Outcome, SeededOptions, at
from jaxpoint.config import EpipolarSettings, InputSettings, RoomConfig
from jaxpoint.errors import InsufficientDataError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.calibration.camera_clock import ClockSurvey
    from jaxpoint.calibration.result import PairTable
    from jaxpoint.report.advice import Advice
    from jaxpoint.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Check(SeededOptions):
    """Say whether tracks suffice for a calibration: what the cameras share, cover, and whether they run in step.

    jaxpoint check tracks.npz

    Takes seconds and solves nothing. `--out` also writes the findings as a page.
    """

    tracks: Annotated[Path, tyro.conf.Positional]
    """Tracks (.npz, .csv), or a folder with points.dat."""
    input: Annotated[InputSettings, Inline] = field(default_factory=InputSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Check:
        """The command's defaults under a configuration file."""
        return Check(tracks=tyro.MISSING, input=room.input, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """The pair table and what it means; data that does not suffice is a failure of the outcome."""
        from jaxpoint.calibration.clocks import survey_clocks
        from jaxpoint.calibration.pairs import pair_table
        from jaxpoint.calibration.readout_search import survey_readouts
        from jaxpoint.report.advice import advise_on_tracks

        if self.out is not None:
            self.needed_folder("")
        tracks = tracks_from(self.tracks, self.input)
        intrinsics, pairs = intrinsics_from(self.input, tracks), pair_table(tracks)
        with console.progress() as progress:
            clocks = survey_clocks(
                tracks,
                EpipolarSettings(),
                self.seed,
                intrinsics,
                progress=lambda done, total: progress("cameras in step?", done, total),
            )
            clocks = survey_readouts(clocks, tracks, EpipolarSettings(), self.seed, intrinsics)
        advice: list[Advice] = []
        missing: list[str] = []
        with extra("the advice", missing):
            advice = advise_on_tracks(tracks, clocks.clocks)
        failure = _failure(tracks, pairs, clocks, intrinsics is not None)
        figures = {
            "cameras": [
                {"name": name, "frames": int(seen), "coverage": float(covered)}
                for name, seen, covered in zip(pairs.names, pairs.seen, pairs.coverage)
            ],
            "frames": tracks.frames,
            "shared": pairs.shared.tolist(),
            "time_offsets": [clock.offset_frames for clock in clocks.clocks],
            "clocks": [asdict(clock) for clock in clocks.clocks],
            "advice": [asdict(item) for item in advice],
            "sufficient": failure is None,
            "problem": None if failure is None else str(failure),
        }
        lines = _lines(pairs, tracks.frames, advice, failure is None and not missing)
        if self.out is not None:
            self._keep(self.out, tracks, pairs, clocks, figures, missing)
            lines = (*lines, *at("Report", self.out / "report.html"))
        return Outcome(figures, lines, failure, tuple(missing))

    def _keep(
        self,
        out: Path,
        tracks: Tracks,
        pairs: PairTable,
        clocks: ClockSurvey,
        figures: dict[str, Any],
        missing: list[str],
    ) -> None:
        from jaxpoint.report.html import write_tracks_report
        from jaxpoint.runs import MARK, new_run, provenance, write_json

        made = provenance("jaxpoint check", [self.tracks], self.seed)

        def page(folder: Path) -> None:
            with extra("report.html", missing):
                write_tracks_report(
                    folder / "report.html", tracks, pairs, clocks=clocks, problem=figures["problem"], provenance=made
                )

        with new_run(out, self.force, page) as folder:
            write_json(folder / MARK, made)
            write_json(folder / "check.json", figures)


def _failure(
    tracks: Tracks, pairs: PairTable, clocks: ClockSurvey, known_intrinsics: bool
) -> InsufficientDataError | None:
    """Why the tracks do not suffice as they are: too little of them, or a camera that contradicts the others."""
    from jaxpoint.calibration.clock_findings import Timing, held_share, problems
    from jaxpoint.calibration.pairs import check_pairs

    try:
        check_pairs(tracks, pairs, known_intrinsics=known_intrinsics)
    except InsufficientDataError as error:
        return error
    for problem in problems(clocks.clocks, Timing.of(tracks), held_share(tracks)):
        return InsufficientDataError(problem)
    return None


def _lines(pairs: PairTable, frames: int, advice: Sequence[Advice], sufficient: bool) -> tuple[str, ...]:
    rows = [
        (name, int(pairs.seen[i]), f"{pairs.coverage[i]:.0%}", *(int(n) if i != j else "" for j, n in enumerate(row)))
        for i, (name, row) in enumerate(zip(pairs.names, pairs.shared))
    ]
    return (
        f"{frames} frames; image covered, and frames shared by each two cameras:",
        *table(("camera", "seen", "covered", *pairs.names), rows),
        *(f"- {item.finding} {item.remedy}" for item in advice),
        *(("Enough for a calibration.",) if sufficient else ()),
    )
