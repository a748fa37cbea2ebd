"""Is a wrong calibration ever called good? Difficult rigs, each with its truth and with the same rig without its fault.

Eight layouts (parallel, nearly parallel by 0.2 to 10 degrees, tilted alike, converging, in a line, ring, ceiling,
corridor) of 3 to 12 cameras, of each a fault at most two: pixels that are not square, cropped images, wide equidistant
lenses, one camera at another rate, late, frozen, mirrored, or of another room. `calibrate` sees the tracks alone, with
default settings, and its quality gate calls the result good or not. The control is the same recording without the
fault; where the layout itself is critical, nothing is at fault, or the control's own data do not determine it, with the
true lenses held. `doubtful_rigs_determined.py` says before anything is run which rigs could come out right, and
`doubtful_rigs_scores.py` what counts as wrong and as the true cause. One file a rig (rigs/SEED.json), kept with
`--resume`; summary.json and report.html over all of them.

    python experiments/doubtful_rigs.py --seeds 0 40 --out runs/doubtful
    python experiments/doubtful_rigs.py --seeds 1000 1400 --out runs/doubtful_final --resume --jobs 2
    python experiments/doubtful_rigs.py --show 4

Development looks at seeds 0 to 99; the figures that count are those of 1000 to 1399, which nobody looks at one by one.
"""

from __future__ import annotations

import json
import multiprocessing
import shlex
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import msgspec
import numpy as np
import tyro

from doubtful_rigs_determined import determined
from doubtful_rigs_errors import best_fit, errors_of
from doubtful_rigs_faults import KINDS
from doubtful_rigs_generator import FIRST, Rig, draw
from doubtful_rigs_layouts import CRITICAL, LAYOUTS
from doubtful_rigs_page import write_study
from doubtful_rigs_scores import Record, Result, excesses, outcome, summary
from elevation_bias import commit
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import padded_cameras
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.errors import JaxpointError, UsageError
from jaxpoint.runs import provenance

ANY = ("none", *LAYOUTS, *KINDS)


@dataclass(frozen=True)
class DoubtfulRigs:
    """Calibrate difficult rigs, and see whether a wrong one is called good."""

    seeds: tuple[int, int] = (0, 40)
    """First seed, and one past the last."""
    out: Path = Path("doubtful_rigs")
    """Folder of rigs/SEED.json, summary.json and report.html."""
    resume: bool = False
    """Keep the rigs that the folder holds, and run the others."""
    jobs: int = 1
    """Processes; each compiles its own programs, so rigs of as many cameras go to the same one."""
    only: str | None = None
    """One layout or one kind of fault ("none": no fault)."""
    show: int | None = None
    """Run this seed alone, and print the truth beside the estimate."""


def main(options: DoubtfulRigs) -> None:
    """Run the rigs that are missing, then write and print the summary of all in the folder.

    Raises:
        UsageError: an unknown kind, or a folder with rigs without `--resume`.
    """
    folder = options.out / "rigs"
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.glob("*.json")) and not options.resume:
        raise UsageError(f"'{folder}' holds rigs already; add --resume to keep them, or give another --out.")
    missing = [seed for seed in chosen_seeds(options) if not (folder / f"{seed}.json").exists()]
    records: list[Record] = []
    try:
        for record in run_all(missing, options.jobs):
            (folder / f"{record.seed}.json").write_bytes(msgspec.json.format(msgspec.json.encode(record)) + b"\n")
            records.append(record)
            sys.stdout.write(f"[{len(records)}/{len(missing)}] {line(record)}\n")
            sys.stdout.flush()
    finally:
        figures = write_summary(options.out)
    shown = {name: value for name, value in figures.items() if name not in ("by_kind", "levels", "inside")}
    sys.stdout.write(json.dumps(shown, indent=2) + "\n")


def chosen_seeds(options: DoubtfulRigs) -> list[int]:
    """Those asked for.

    Raises:
        UsageError: there is no such kind.
    """
    seeds = list(range(*options.seeds))
    if options.only is None:
        return seeds
    if options.only not in ANY:
        raise UsageError(f"There is no kind '{options.only}'; --only takes one of {', '.join(ANY)}.")
    return [seed for seed in seeds if is_of(seed, options.only)]


def is_of(seed: int, kind: str) -> bool:
    """Whether the rig of a seed has this layout or this fault; solves nothing."""
    if kind in LAYOUTS or kind == "none":
        return kind in (tuple(LAYOUTS)[seed % len(LAYOUTS)], FIRST[seed % len(FIRST)])
    return any(fault.kind == kind for fault in draw(seed)[0].faults)


def run_all(seeds: list[int], jobs: int) -> Iterator[Record]:
    """Records as they are finished, in this process or in several."""
    size = {seed: padded_cameras(len(draw(seed)[0].cameras)) for seed in seeds}
    ordered = sorted(seeds, key=lambda seed: (size[seed], seed))
    if jobs <= 1:
        yield from map(run_seed, ordered)
        return
    context = multiprocessing.get_context("spawn")
    pools = [ProcessPoolExecutor(1, context, _leave_interrupts_to_the_parent) for _ in range(jobs)]
    load = np.cumsum([size[seed] for seed in ordered])
    whose = np.minimum(load * jobs // max(load[-1] + 1, 1), jobs - 1) if ordered else load
    try:
        futures = [pools[job].submit(run_seed, seed) for job, seed in zip(whose, ordered)]
        for future in as_completed(futures):
            yield future.result()
    finally:
        for pool in pools:
            pool.shutdown(cancel_futures=True)


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_seed(seed: int) -> Record:
    """A rig and its control, calibrated and held against the truth."""
    rig, control = draw(seed)
    own = determined(rig)
    held = rig.kind in CRITICAL or not rig.faults or not determined(control).enough
    return Record(
        seed=seed,
        kind=rig.kind,
        turn_deg=rig.layout.turn_deg,
        faults=rig.faults,
        cameras=len(rig.cameras),
        frames=rig.tracks.frames,
        noise_px=rig.noise_px,
        extent_m=rig.cameras.extent_m,
        determined=own,
        result=run_one(rig)[0],
        control=run_one(control, held)[0],
        control_held=held,
    )


def run_one(rig: Rig, held: bool = False) -> tuple[Result, Calibration | None]:
    """What the command line would deliver for these tracks: calibration, covariance, gate.

    Args:
        held: give the true lenses, and hold them.
    """
    lens = LensSettings(known="hold" if held else "none")
    settings, began = CalibrateSettings(lens=lens), time.perf_counter()
    with jax.enable_x64(True):
        intrinsics = true_lenses(rig) if held else None
        try:
            solved = with_covariance(calibrate(rig.tracks, settings, intrinsics=intrinsics))
            judged = assessed(solved, settings)
        except JaxpointError as error:
            return Result(False, str(error), _causes(error), type(error).__name__, False, elapsed(began)), None
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            told = f"{error} ({Path(where.filename).name}:{where.lineno})"
            return Result(False, told, (), type(error).__name__, True, elapsed(began)), None
        judged = replace(judged, seconds=elapsed(began), cameras=errors_of(solved, rig))
    return judged, solved


def assessed(solved: Calibration, settings: CalibrateSettings) -> Result:
    """The verdict of the quality gate."""
    found = assess(solved, settings)
    said, kind = ("", "") if found.failure is None else (str(found.failure), type(found.failure).__name__)
    return Result(found.passed, said, found.causes, kind, holds=found.holds)


def _causes(error: JaxpointError) -> tuple[str, ...]:
    """The causes that an error carries, where it does."""
    return tuple(str(cause) for cause in getattr(error, "causes", ()))


def elapsed(began: float) -> float:
    """Seconds since then."""
    return time.perf_counter() - began


def true_lenses(rig: Rig) -> CameraRig:
    """The true cameras of a control, which are perspective ones."""
    cameras = rig.cameras
    distortion = np.zeros((len(cameras), 5))
    distortion[:, :2] = cameras.radial
    translation = -np.einsum("cij,cj->ci", cameras.rotation, cameras.position)
    numbers = (cameras.focals, cameras.center, distortion, cameras.rotation, translation)
    return CameraRig.from_parameters(*numbers, cameras.size, rig.tracks.names)


def line(record: Record) -> str:
    """What became of a rig, in one line."""
    faults = "; ".join(map(str, record.faults)) or "no fault"
    turn = "" if record.turn_deg is None else f" {record.turn_deg:.2g} deg"
    worst = [f"WORST {one}" for one in excesses(record)[:1] if record.result.passed]
    told = worst or ([f"{record.result.error}: {record.result.message[:110]}"] if not record.result.passed else [])
    could = "determined" if record.determined.enough else "undetermined"
    head = f"{record.seed} {record.kind}{turn}, {record.cameras} cameras, {faults} ({could}): {outcome(record)}"
    spent = f"{record.result.seconds:.1f} + {record.control.seconds:.1f} s"
    return " | ".join([head, *told, spent])


def write_summary(out: Path) -> dict:
    """summary.json and report.html of every rig in the folder."""
    files = sorted((out / "rigs").glob("*.json"), key=lambda path: int(path.stem))
    records = [msgspec.json.decode(path.read_bytes(), type=Record) for path in files]
    figures = summary(records)
    (out / "summary.json").write_text(json.dumps(figures, indent=2) + "\n")
    command = shlex.join(["python", "experiments/doubtful_rigs.py", *sys.argv[1:]])
    write_study(out / "report.html", records, figures, provenance(command, [], 0) | {"commit": commit()})
    return figures


def show(seed: int) -> None:
    """Print the truth of a rig beside its estimate."""
    rig, _ = draw(seed)
    result, solved = run_one(rig)
    said = [
        f"{rig.kind}, {len(rig.cameras)} cameras, {'; '.join(map(str, rig.faults)) or 'no fault'}",
        str(determined(rig)),
    ]
    said.append(f"passed: {result.passed} {result.error} {result.message} {result.causes}")
    if solved is not None:
        said += ["camera: fx fy cx cy, estimated / true [sigma of f]; centre of the extent [sigma], rotation [sigma]"]
        said += _beside(rig, result, solved)
        true = rig.cameras.select(np.array([rig.tracks.names.index(name) for name in solved.rig.names]))
        said.append(f"light: median distance {1e3 * best_fit(solved, rig, true.position).misfit:.1f} mm")
    sys.stdout.write("\n".join(said) + "\n")


def _beside(rig: Rig, result: Result, solved: Calibration) -> Iterator[str]:
    for c, error in enumerate(result.cameras):
        own, lens = rig.tracks.names.index(error.name), solved.rig.cameras
        found = [*np.asarray(lens.focal)[c], *np.asarray(lens.center)[c]]
        true = [*rig.cameras.focals[own], *rig.cameras.center[own]]
        pairs = " ".join(f"{a:.0f}/{b:.0f}" for a, b in zip(found, true))
        yield (
            f"{error.name}: {pairs} [{error.focal_sigma[1]:.2%}] {error.centre:.2%} [{error.centre_sigma:.2%}] "
            f"{error.rotation_deg:.2f} [{error.rotation_sigma_deg:.2f}] deg"
        )


if __name__ == "__main__":
    try:
        asked = tyro.cli(DoubtfulRigs, description=__doc__)
        main(asked) if asked.show is None else show(asked.show)
    except JaxpointError as error:
        sys.stderr.write(f"doubtful_rigs: {error}\n")
        sys.exit(error.exit_code)
