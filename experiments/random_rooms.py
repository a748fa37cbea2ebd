"""Does self-calibration survive random rooms?

Each seed draws a room: 300 frames, 3 to 12 cameras of unlike lenses around it or along one wall, distortion down to
k1 = -0.35, 0.3 to 1 px of noise, 40 to 100 % visibility, 0 to 10 % gross outliers of which a third hide along epipolar
lines. `calibrate` sees the tracks alone. The reference is its own last stage, started from the truth: nothing that has
to be found first can do better, so a higher cost means another, worse minimum. One row a room (rows.csv), and a table
of the targets (summary.md, summary.json). Rows that exist are not run again: stop it and start it at any time.

    python experiments/random_rooms.py --seeds 0 200 --out rooms
    python experiments/random_rooms.py --seeds 0 60 --out rooms_factorisation --init factorisation
    python experiments/random_rooms.py --seeds 0 200 --rooms wide --out wide_rooms

`--rooms wide` draws lenses of 100 to 190 degrees, alone or among ordinary ones (`wide_rooms.py`); the reference sees
through fisheye lenses then.
"""

from __future__ import annotations

import csv
import json
import multiprocessing
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import jax
import msgspec
import numpy as np
import tyro
from rich.progress import track

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.assembly import centre_rig
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.outliers import Settled, refine_coarse_to_fine, refine_to_convergence
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import Freedom, Recording, RigState
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import CENTER, FOCAL, size_of
from jaxpoint.config import CalibrateSettings, to_toml
from jaxpoint.errors import JaxpointError, UsageError
from jaxpoint.simulate.rooms import RandomRoom, random_room
from wide_rooms import WideRoom, true_fisheye_state, wide_room

Room: TypeAlias = RandomRoom | WideRoom
COST_MARGIN = 1.01  # of the reference's cost
CENTRE_MARGIN = 3.0  # of the reference's error


@dataclass(frozen=True)
class RandomRooms:
    """Calibrate random rooms, and compare each with what can be reached from its truth."""

    seeds: tuple[int, int] = (0, 200)
    """First seed, and one past the last."""
    out: Path = Path("random_rooms")
    """Folder of rows.csv, summary.md and summary.json; the rows in it are kept."""
    workers: int = 2
    """Processes; each compiles its own programs, so rooms of as many cameras go to the same one."""
    frames: int = 300
    """Positions of the light in every room."""
    cameras: int | None = None
    """Cameras of every room; drawn if not given."""
    rooms: Literal["ordinary", "wide"] = "ordinary"
    """Ordinary lenses, or some of 100 to 190 degrees."""
    settings: Annotated[CalibrateSettings, tyro.conf.arg(name="")] = field(default_factory=CalibrateSettings)
    """Settings of the calibration, as under [calibrate] in a configuration file."""


@dataclass(frozen=True)
class Row:
    """One room. What a room that ends in an error does not have is None."""

    seed: int
    cameras: int
    layout: str  # where ordinary cameras stand; of wide ones law and angle (degrees) of each lens
    visibility: float
    noise_px: float
    outlier_share: float
    verdict: str  # "ok", "gate" (a result, marked as not to be trusted) or "error"
    seconds: float
    ratio: float | None = None  # robust cost over all observations to the reference's
    centres_mm: float | None = None  # rms after similarity
    reference_mm: float | None = None
    mirrored: bool | None = None
    outliers: int | None = None  # with two good views of the frame besides
    found: int | None = None  # of those
    good: int | None = None  # with two more good views of the frame
    lost: int | None = None  # of those
    sigma_px: float | None = None
    lens: str | None = None
    start: str | None = None  # the method of the first solution
    start_ratio: float | None = None  # its cost to the reference's final one
    rounds: int | None = None
    remark: str | None = None  # the sentence of the error or gate

    @property
    def right(self) -> bool:
        """As good as from the truth, in cost, in place and in hand."""
        if self.ratio is None or self.centres_mm is None or self.reference_mm is None:
            return False
        near = self.centres_mm <= CENTRE_MARGIN * self.reference_mm
        return self.ratio <= COST_MARGIN and near and not self.mirrored


def main(options: RandomRooms) -> None:
    """Run the rooms that have no row yet, then write and print the summary.

    Raises:
        UsageError: the folder holds rows made otherwise.
    """
    options.out.mkdir(parents=True, exist_ok=True)
    check_same(options)
    path = options.out / "rows.csv"
    rows = read_rows(path)
    done = {row.seed for row in rows}
    missing = [seed for seed in range(*options.seeds) if seed not in done]
    try:
        for row in track(solved_rooms(options, missing), "rooms", total=len(missing)):
            append(path, row)
            rows.append(row)
    finally:
        write_summary(options.out, rows)
    sys.stdout.write((options.out / "summary.md").read_text())


def check_same(options: RandomRooms) -> None:
    """Leave word of how the rows are made, or refuse to mix them with others."""
    path = options.out / "config.toml"
    kind = "" if options.rooms == "ordinary" else f'rooms = "{options.rooms}"\n'
    text = f"frames = {options.frames}\ncameras = {options.cameras or 0}\n{kind}\n"
    text += f"[settings]\n{to_toml(options.settings)}"
    if path.exists() and path.read_text() != text:
        raise UsageError(f"'{path}' shows that the rows there were made with other settings; give another --out.")
    path.write_text(text)


def solved_rooms(options: RandomRooms, seeds: list[int]) -> Iterator[Row]:
    """Rows as they are finished, small rooms first."""
    context = multiprocessing.get_context("spawn")
    pools = [ProcessPoolExecutor(1, context, _leave_interrupts_to_the_parent) for _ in range(options.workers)]
    try:
        futures = [
            pool.submit(solved_room, seed, options)
            for pool, share in zip(pools, shared_out(options, seeds))
            for seed in share
        ]
        for future in as_completed(futures):
            yield future.result()
    finally:
        for pool in pools:
            pool.shutdown(cancel_futures=True)


def shared_out(options: RandomRooms, seeds: list[int]) -> list[list[int]]:
    """The seeds of every worker: rooms of as many cameras go to the same one, the largest to the least busy."""
    drawn = [(drawn_room(seed, options).tracks.cameras, seed) for seed in seeds]
    shares: list[list[int]] = [[] for _ in range(options.workers)]
    load = [0] * options.workers
    for cameras in sorted({count for count, _ in drawn}, reverse=True):
        group = [seed for count, seed in drawn if count == cameras]
        worker = int(np.argmin(load))
        load[worker] += len(group) * cameras
        shares[worker] = group + shares[worker]
    return shares


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def drawn_room(seed: int, options: RandomRooms) -> Room:
    """The room of a seed."""
    if options.rooms == "wide":
        return wide_room(seed, cameras=options.cameras, frames=options.frames)
    return random_room(seed, cameras=options.cameras, frames=options.frames)


def solved_room(seed: int, options: RandomRooms) -> Row:
    """Calibrate one room and hold it against the reference."""
    room = drawn_room(seed, options)
    started = time.perf_counter()
    try:
        solved = calibrate(room.tracks, options.settings)
    except JaxpointError as error:
        return Row(**drawn_figures(room, seed), verdict="error", seconds=elapsed(started), remark=str(error))
    seconds = elapsed(started)
    with jax.enable_x64(True):
        best = reference(room, options.settings)
        centres_mm, mirrored = centre_error(room, np.asarray(solved.rig.positions), solved.points, solved.point_valid)
        count = room.tracks.cameras
        state = best.judged.state
        placed = (best.judged.kept.sum(axis=1) >= 2)[: room.tracks.frames]
        reference_mm, _ = centre_error(room, state.positions[:count], state.points[: room.tracks.frames], placed)
    with jax.enable_x64(True):
        doubt = assess(with_covariance(solved), options.settings).failure
    return Row(
        **drawn_figures(room, seed),
        verdict="ok" if doubt is None else "gate",
        seconds=seconds,
        centres_mm=centres_mm,
        reference_mm=reference_mm,
        mirrored=mirrored,
        **outlier_figures(room, solved),
        **stage_figures(solved, best.cost),
        sigma_px=solved.sigma_px,
        remark=None if doubt is None else str(doubt),
    )


def elapsed(started: float) -> float:
    """Seconds since then."""
    return time.perf_counter() - started


def drawn_figures(room: Room, seed: int) -> dict:
    """What the room is like."""
    visible = room.tracks.visible
    if isinstance(room, WideRoom):
        layout = room.lens_angles
    else:
        layout = "wall" if np.ptp(room.positions[:, 1]) < 1e-6 else "around"
    return {
        "seed": seed,
        "cameras": room.tracks.cameras,
        "layout": layout,
        "visibility": float(visible.mean()),
        "noise_px": room.noise_px,
        "outlier_share": float(room.is_outlier.sum() / visible.sum()),
    }


def stage_figures(solved: Calibration, reference_cost: float) -> dict:
    """Costs and choices on the way, from the calibration's own stages."""
    stages = {stage.name: stage.figures for stage in solved.stages}
    first, last = stages["First solution"], stages["Adjustment"]
    return {
        "ratio": last["robust_cost_px2"] / reference_cost,
        "rounds": last["rounds"],
        "start": first["chosen"],
        "start_ratio": first["candidates"][0]["robust_cost_px2"] / reference_cost,
        "lens": stages["Lens model"]["chosen"] if "Lens model" in stages else None,
    }


def outlier_figures(room: Room, solved: Calibration) -> dict[str, int]:
    """Gross outliers found and good observations lost, of those that two other good views of the frame can test."""
    good = room.tracks.visible & ~room.is_outlier
    views = good.sum(axis=1, keepdims=True)
    outliers, testable = room.is_outlier & (views >= 2), good & (views >= 3)
    return {
        "outliers": int(outliers.sum()),
        "found": int((outliers & ~solved.kept).sum()),
        "good": int(testable.sum()),
        "lost": int((testable & ~solved.kept).sum()),
    }


def reference(room: Room, settings: CalibrateSettings) -> Settled:
    """The last stage of the calibration, started from the truth."""
    recording = Recording.of(room.tracks)
    first = "radial2" if isinstance(room, RandomRoom) else "fisheye"
    distortion = first if settings.lens.distortion == "auto" else settings.lens.distortion
    start = true_state(room, recording) if isinstance(room, RandomRoom) else true_fisheye_state(room, recording)
    freedom = Freedom.of(recording, settings.lens, distortion)
    return refine_to_convergence(
        recording, refine_coarse_to_fine(recording, start, freedom), freedom, settings.outliers
    )


def true_state(room: RandomRoom, recording: Recording) -> RigState:
    """The truth as the adjustment sees it."""
    count, size = recording.cameras, len(recording.image_sizes)
    base, numbers = np.tile(np.eye(3), (size, 1, 1)), np.zeros((size, size_of(Brown)))
    points = np.zeros((len(recording.pixels), 3))
    base[:count], points[: recording.frames] = room.rotation, room.points
    numbers[:, FOCAL] = np.log(1000.0)  # of the cameras that only fill up the arrays
    numbers[:count, 3:6] = room.translation
    numbers[:count, FOCAL] = np.log(room.focal)
    numbers[:count, CENTER] = room.center
    numbers[:count, CENTER.stop :] = room.distortion
    return centre_rig(RigState(numbers, base, points), recording.visible, count)


def centre_error(room: Room, centres: np.ndarray, points: np.ndarray, placed: np.ndarray) -> tuple[float, bool]:
    """Rms of the camera centres (mm) after similarity, and whether cameras and light fit better as a mirror image."""
    source = np.concatenate([centres, np.where(placed[:, None], points, 0.0)])
    target = np.concatenate([room.positions, room.points])
    is_camera = np.arange(len(source)) < len(centres)

    def misfit(weights: np.ndarray, allow_mirror: bool) -> float:
        fit = umeyama(source, target, weights.astype(float), allow_mirror)
        square = ((np.asarray(fit @ source) - target) ** 2).sum(axis=1)
        # One wild point of the light must not decide on the hand.
        return float(np.sqrt(square[weights].mean() if weights is is_camera else np.median(square[weights])))

    believed = np.concatenate([np.ones(len(centres), bool), placed])
    return 1e3 * misfit(is_camera, False), misfit(believed, True) < 0.9 * misfit(believed, False)


def read_rows(path: Path) -> list[Row]:
    """The rows written so far."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        lines = [{name: text for name, text in line.items() if text != ""} for line in csv.DictReader(file)]
    return msgspec.convert(lines, list[Row], strict=False)


def append(path: Path, row: Row) -> None:
    """One more row, under a header if it is the first."""
    fresh = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, [column.name for column in fields(Row)])
        if fresh:
            writer.writeheader()
        writer.writerow(asdict(row))


def summary(rows: list[Row]) -> dict:
    """The figures that the targets are about."""
    solved = [row for row in rows if row.ratio is not None]
    trusted = [row for row in rows if row.verdict == "ok"]

    def total(name: str) -> int:
        return sum(getattr(row, name) for row in solved)

    return {
        "rooms": len(rows),
        "cost_within_1_percent": sum(row.ratio <= COST_MARGIN for row in solved if row.ratio is not None),
        "centres_within_3_times": sum(
            (row.centres_mm or 0) <= CENTRE_MARGIN * (row.reference_mm or 0) for row in solved
        ),
        "mirrored": sum(bool(row.mirrored) for row in solved),
        "outliers_found": total("found") / max(total("outliers"), 1),
        "good_lost": total("lost") / max(total("good"), 1),
        "errors": sum(row.verdict == "error" for row in rows),
        "marked_by_a_gate": sum(row.verdict == "gate" for row in rows),
        "right_but_marked": sum(row.verdict == "gate" and row.right for row in rows),
        "wrong_called_good": sum(not row.right for row in trusted),
        "median_seconds": float(np.median([row.seconds for row in rows])) if rows else None,
        "not_right": [asdict(row) for row in sorted(rows, key=lambda row: row.seed) if not row.right],
    }


def write_summary(out: Path, rows: list[Row]) -> None:
    """summary.json and summary.md."""
    figures = summary(rows)
    (out / "summary.json").write_text(json.dumps(figures, indent=2) + "\n")
    (out / "summary.md").write_text(markdown(figures))


def markdown(figures: dict) -> str:
    """The table of the targets, and one line for every room that missed them."""
    rooms = figures["rooms"]
    targets = [
        ("cost within 1 % of the one from the truth", f"{figures['cost_within_1_percent']} of {rooms}", ">= 99 %"),
        (
            "centres within 3 times the error from the truth",
            f"{figures['centres_within_3_times']} of {rooms}",
            ">= 99 %",
        ),
        ("mirrored", str(figures["mirrored"]), "0"),
        ("testable gross outliers found", f"{figures['outliers_found']:.2%}", ">= 95 %"),
        ("testable good observations lost", f"{figures['good_lost']:.2%}", "< 1 %"),
        ("ended in an error, or marked by a gate", f"{figures['errors']}, {figures['marked_by_a_gate']}", "the rest"),
        ("right, but marked by a gate", str(figures["right_but_marked"]), ""),
        ("wrong rigs called good", str(figures["wrong_called_good"]), "0"),
    ]
    lines = ["| what | found | wanted |", "|---|---|---|", *(f"| {' | '.join(line)} |" for line in targets)]
    if figures["not_right"]:
        shown = ("seed", "cameras", "layout", "verdict", "ratio", "centres_mm", "reference_mm", "start_ratio", "remark")
        lines += ["", f"| {' | '.join(shown)} |", "|---" * len(shown) + "|"]
        lines += [f"| {' | '.join(_cell(row[name]) for name in shown)} |" for row in figures["not_right"]]
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    try:
        main(tyro.cli(RandomRooms, description=__doc__))
    except JaxpointError as error:
        sys.stderr.write(f"random_rooms: {error}\n")
        sys.exit(error.exit_code)
