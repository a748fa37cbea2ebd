"""A whole `Calibration` in the files of a run: `calibration.json`, `tracks.npz`, and the rest in `result.npz`."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.calibration.alignment import Alignment
from jaxpoint.calibration.recording import Freedom
from jaxpoint.calibration.result import Calibration, Finding, FrameHold, PairTable, Stage
from jaxpoint.errors import FileFormatError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.io.calibration import read_calibration_json, write_calibration_json
from jaxpoint.io.files import replacing
from jaxpoint.io.track_files import load_tracks, save_tracks

VERSION = 1
ARRAYS = ("points", "point_valid", "residuals", "verdicts")
FREEDOM = ("free", "prior_mean", "prior_weight")  # fields of `Freedom`
OWNER = "lens_owner"  # where cameras have a lens in common


def save_result(folder: Path, calibration: Calibration, provenance: dict[str, Any]) -> None:
    """Write `calibration.json`, `tracks.npz` and `result.npz` into a folder."""
    write_calibration_json(
        folder / "calibration.json",
        calibration.rig,
        unit=calibration.unit,
        covariance=calibration.camera_covariance,
        gauge=calibration.gauge,
        provenance=provenance,
        time_offsets=calibration.time_offsets,
        readout_times=calibration.readout_times,
        in_room=calibration.in_room,
    )
    save_tracks(folder / "tracks.npz", calibration.tracks)
    about = {
        "version": VERSION,
        "sigma_px": calibration.sigma_px,
        "converged": bool(calibration.converged),
        "message": calibration.message,
        "seconds": calibration.seconds,
        "seed": calibration.seed,
        "loss_scale": calibration.loss_scale,
        "hold": None if calibration.hold is None else asdict(calibration.hold),
        "undetermined": calibration.undetermined,
        "pairs": asdict(calibration.pairs),
        "stages": [asdict(stage) for stage in calibration.stages],
        "findings": [asdict(finding) for finding in calibration.findings],
        "alignment": None if calibration.alignment is None else _alignment_fields(calibration.alignment),
    }
    with replacing(folder / "result.npz") as file:
        arrays = {name: np.asarray(getattr(calibration, name)) for name in ARRAYS}
        if calibration.freedom is not None:
            arrays |= {name: getattr(calibration.freedom, name) for name in FREEDOM}
            owner = calibration.freedom.owner
            arrays |= {} if owner is None else {OWNER: owner}
        np.savez_compressed(file, about=np.array(json.dumps(about, default=_plain)), **arrays)  # pyright: ignore[reportArgumentType]


def load_result(folder: Path) -> Calibration:
    """The calibration that `save_result` wrote into a folder.

    Raises:
        FileFormatError: a file is missing, damaged, or of a later version.
    """
    saved = read_calibration_json(folder / "calibration.json")
    tracks = load_tracks(folder / "tracks.npz")
    path = folder / "result.npz"
    try:
        with path.open("rb") as file:  # np.load itself would leave a damaged file open
            stored = np.load(file, allow_pickle=False)
            arrays = {name: stored[name] for name in ARRAYS}
            # Runs of earlier days do not have it; `uncertainty_of` says so where it is needed.
            freedom = Freedom(*(stored[name] for name in FREEDOM)) if set(FREEDOM) <= set(stored.files) else None
            if freedom is not None and OWNER in stored.files:
                freedom = replace(freedom, owner=stored[OWNER])
            about = json.loads(str(stored["about"]))
    except FileNotFoundError:
        raise FileFormatError(f"There is no file {path}; give the folder of a run of `calibrate`.") from None
    except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path} is damaged ({error}); calibrate again.") from None
    if about["version"] != VERSION:
        raise FileFormatError(f"{path} has version {about['version']}, this jaxpoint reads {VERSION}; update jaxpoint.")
    return Calibration(
        rig=saved.rig,
        tracks=tracks,
        **arrays,
        sigma_px=about["sigma_px"],
        converged=about["converged"],
        message=about["message"],
        pairs=_pairs(about["pairs"]),
        stages=tuple(Stage(**stage) for stage in about["stages"]),
        seconds=about["seconds"],
        unit=saved.unit,
        alignment=None if about["alignment"] is None else _alignment(about["alignment"]),
        camera_covariance=saved.covariance,
        gauge=saved.gauge,
        undetermined=about.get("undetermined", ""),
        time_offsets=saved.time_offsets,
        readout_times=saved.readout_times,
        seed=about["seed"],
        freedom=freedom,
        loss_scale=about.get("loss_scale"),
        hold=None if about.get("hold") is None else FrameHold(**about["hold"]),
        findings=tuple(Finding(**(f | {"cameras": tuple(f["cameras"])})) for f in about.get("findings", [])),
    )


def _pairs(fields: dict[str, Any]) -> PairTable:
    inliers = fields["inliers"]
    return PairTable(
        tuple(fields["names"]),
        np.array(fields["seen"]),
        np.array(fields["shared"]),
        np.array(fields["coverage"]),
        None if inliers is None else np.array(inliers),
    )


def _alignment_fields(alignment: Alignment) -> dict[str, Any]:
    similarity = alignment.similarity
    fields = vars(alignment) | {
        "similarity": {name: getattr(similarity, name) for name in ("scale", "rotation", "translation")}
    }
    return fields


def _alignment(fields: dict[str, Any]) -> Alignment:
    similarity = {name: np.array(value) for name, value in fields["similarity"].items()}
    return Alignment(
        **fields
        | {
            "similarity": Similarity(**similarity),
            "names": tuple(fields["names"]),
            "residual_mm": np.array(fields["residual_mm"]),
            "leave_one_out_mm": tuple(fields["leave_one_out_mm"]),
            "warnings": tuple(fields["warnings"]),
        }
    )


def _plain(value: Any) -> Any:
    """What JSON does not know: arrays and scalars of numpy and JAX."""
    return np.asarray(value).tolist()
