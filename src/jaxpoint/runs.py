"""A run directory: all that a calibration was made from and gave, written whole or not at all.

`config.toml` the resolved settings, `provenance.json` versions, seed and hashes of the input, `metrics.json`,
`calibration.json` and `calibration.toml`, `tracks.npz`, `result.npz` (with the two before, all that `read_run` needs).
`report.html` comes after, when all this is in place, so that nothing in it can cost a result.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from itertools import chain, count
from pathlib import Path
from typing import Any

from jaxpoint.calibration.quality import Quality, assess
from jaxpoint.calibration.result import Calibration
from jaxpoint.config import RoomConfig, load_config, to_toml
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.extras import extra
from jaxpoint.io.formats.anipose_toml import write_calibration_toml
from jaxpoint.io.result_files import load_result, save_result
from jaxpoint.metrics import metrics
from jaxpoint.report.html import write_report

MARK = "provenance.json"  # the file by which a folder is known as a run
_LOG = logging.getLogger(__name__)
PACKAGES = ("jaxpoint", "jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "opencv-python-headless")


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after something was finished; the message says where it lies."""


@contextmanager
def new_run(out: Path, force: bool = False, extras: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its name when the block ends well.

    When the block fails the folder vanishes and `out` stays as it was. When it is interrupted what was written stays
    in `<out>.unfinished`. An earlier run in `out` is replaced with `force`, and only at the very end.

    Args:
        extras: called with `out` once the results are in place, for pages and pictures; each of them inside
            `jaxpoint.extras.extra`. Interrupted there, the run is unfinished too.

    Raises:
        UsageError: `out` is a file, cannot be written, or is a folder that is not empty (with `force`: and is not an
            earlier run).
        Interrupted: Ctrl-C, where something had been written.
    """
    out = Path(out).absolute()
    check_out(out, force)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise UsageError(f"Nothing can be written at '{out}' ({error.strerror}); choose another --out.") from None
    try:
        beside.chmod(0o777 & ~_umask())
        yield beside
        with _in_place(beside, out):
            if extras is not None:
                extras(out)
    except KeyboardInterrupt:
        if beside.exists() and any(beside.iterdir()):
            unfinished = _unused_path(out.with_name(f"{out.name}.unfinished"))
            beside.rename(unfinished)
            raise Interrupted(f"what was finished lies in {unfinished}") from None
        raise
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def check_out(out: Path, force: bool = False) -> None:
    """Refuse an output folder before any work is done.

    Raises:
        UsageError: as in `new_run`.
    """
    if out.is_file():
        raise UsageError(f"'{out}' is a file; --out must name a folder.")
    _check_writable(out)
    if not out.is_dir() or not any(out.iterdir()):
        return
    if not force:
        raise UsageError(f"The folder '{out}' is not empty; choose another --out, or replace the run in it by --force.")
    if not (out / MARK).is_file():
        raise UsageError(
            f"The folder '{out}' is not empty and holds no run of jaxpoint, so --force does not touch it; "
            "choose another --out."
        )


def _check_writable(out: Path) -> None:
    """Try it in the nearest folder that exists: better now than after a minute of work."""
    near = next(folder for folder in out.absolute().parents if folder.exists())
    try:
        Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=near)).rmdir()
    except OSError as error:
        raise UsageError(f"Nothing can be written at '{out}' ({error.strerror}); choose another --out.") from None


@contextmanager
def _in_place(beside: Path, out: Path) -> Iterator[None]:
    """`beside` takes the name `out`; an earlier run there is deleted only when the block has ended.

    Interrupted, both are as they were before.
    """
    old = None
    if out.exists():
        old = Path(tempfile.mkdtemp(prefix=f".{out.name}.old.", dir=out.parent)) / "run"
        out.rename(old)
    try:
        beside.rename(out)
        yield
    except KeyboardInterrupt:
        if not beside.exists():
            out.rename(beside)
        raise
    finally:
        if old is not None:
            if not out.exists():
                old.rename(out)
            shutil.rmtree(old.parent, ignore_errors=True)


def _unused_path(path: Path) -> Path:
    """The path, or the first of path-2, path-3, ... that does not exist."""
    names = (path.with_name(f"{path.name}-{i}") for i in count(2))
    return next(name for name in chain([path], names) if not name.exists())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@dataclass(frozen=True)
class Run:
    """A run directory that was read."""

    folder: Path
    calibration: Calibration
    config: RoomConfig
    metrics: dict[str, Any]


def write_run(
    out: Path,
    calibration: Calibration,
    config: RoomConfig,
    *,
    command: str,
    inputs: Sequence[Path] = (),
    detect_seconds: float | None = None,
    quality: Quality | None = None,
    force: bool = False,
    missing: list[str] | None = None,
) -> dict[str, Any]:
    """Write a run directory, whole or not at all, then its report, and return what its `metrics.json` holds.

    Args:
        command: the command line, for the record.
        inputs: files and folders whose hashes are recorded.
        quality: what `assess` decided of the calibration under this configuration, where that is known already.
        missing: takes a sentence where the report could not be made.

    Raises:
        UsageError: `out` cannot be used, see `new_run`.
    """
    quality = quality or assess(calibration, config.calibrate, config.align)
    figures, made = metrics(calibration, detect_seconds, quality), provenance(command, inputs, calibration.seed)
    notes = [] if missing is None else missing

    def report(folder: Path) -> None:
        write_run_report(folder, calibration, config, quality, figures, made, notes)

    with new_run(out, force, report) as folder:
        save_files(folder, calibration, config, figures, made)
    return figures


def save_run(
    folder: Path, calibration: Calibration, config: RoomConfig, *, command: str
) -> Callable[[Path, list[str]], None]:
    """The results of a run in a new folder inside of another run, and what writes its report later.

    Returns:
        Called with the folder's final place and with the list that takes a sentence where the report is missing.
    """
    quality = assess(calibration, config.calibrate, config.align)
    figures, made = metrics(calibration, quality=quality), provenance(command, (), calibration.seed)
    folder.mkdir()
    save_files(folder, calibration, config, figures, made)
    return lambda place, missing: write_run_report(place, calibration, config, quality, figures, made, missing)


def save_files(
    folder: Path, calibration: Calibration, config: RoomConfig, figures: dict[str, Any], made: dict[str, Any]
) -> None:
    """All results of a run; nothing that only shows them."""
    write_json(folder / MARK, made)
    (folder / "config.toml").write_text(to_toml(config), encoding="utf-8")
    write_json(folder / "metrics.json", figures)
    save_result(folder, calibration, made)
    write_calibration_toml(
        folder / "calibration.toml",
        calibration.rig,
        unit=calibration.unit,
        metadata={
            "error": figures["reprojection"]["mean_px"] or 0.0,
            **({} if calibration.in_room or calibration.unit != "m" else {"in_room": False}),
        },
    )


def write_run_report(
    folder: Path,
    calibration: Calibration,
    config: RoomConfig,
    quality: Quality,
    figures: dict[str, Any],
    made: dict[str, Any],
    missing: list[str],
) -> None:
    """The page of a run whose results are in place."""
    with extra("report.html", missing):
        write_report(
            folder / "report.html",
            calibration,
            settings=config.calibrate,
            align_settings=config.align,
            quality=quality,
            metrics=figures,
            config_text=to_toml(config),
            provenance=made,
        )


def read_run(folder: Path | str) -> Run:
    """A run directory written by `calibrate`, `align` or `demo`.

    Raises:
        FileFormatError: a file is missing or damaged.
        UsageError: its `config.toml` holds an unknown key.
    """
    folder = Path(folder)
    figures = read_json(folder / "metrics.json")
    return Run(folder, load_result(folder), load_config(folder / "config.toml"), figures)


def write_json(path: Path, value: Any) -> None:
    """Strict JSON (no NaN), indented.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    path.write_text(json.dumps(value, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """The content of a JSON file of a run.

    Raises:
        FileFormatError: it is missing or is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileFormatError(f"'{path.parent}' has no {path.name}; give the folder of a run of `calibrate`.") from None
    except ValueError as error:
        line = f" (line {error.lineno})" if isinstance(error, json.JSONDecodeError) else ""
        raise FileFormatError(f"'{path}' is damaged: it is not JSON{line}; make the run anew.") from None


def provenance(command: str, inputs: Sequence[Path], seed: int) -> dict[str, Any]:
    """What the run was made with: versions, seed, time, and the SHA-256 of every input file."""
    return {
        "command": command,
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": seed,
        "versions": versions(),
        "platform": platform.platform(),
        "inputs": {str(file): digest for path in inputs for file in _files(path) if (digest := _sha256(file))},
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _files(path: Path) -> list[Path]:
    """The file itself, or the data files directly in a folder; its pictures are left out, which are thousands."""
    if path.is_file():
        return [path]
    if not path.is_dir():  # gone since it was read
        return []
    wanted = {".dat", ".rad", ".txt", ".csv", ".toml", ".json", ".npz"}
    return sorted(file for file in path.iterdir() if file.suffix in wanted and file.is_file())


def _sha256(path: Path) -> str | None:
    """None of a file that is gone or closed to us by now: it was read before, and its hash is worth no result."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        _LOG.warning("'%s' cannot be hashed for the record (%s).", path, error.strerror)
        return None
