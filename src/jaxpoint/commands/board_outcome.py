"""What `intrinsics` and `stereo` share: the run of a calibration from boards, and what is said of it in a few lines."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.calibration.board_figures import ViewFit, lens_sigma_map, view_fits, where_next
from jaxpoint.calibration.board_quality import assess_boards
from jaxpoint.calibration.pair_poses import pair_scatter
from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.camera import POSE_NAMES
from jaxpoint.camera.lens import COMMON
from jaxpoint.camera.mixed import own_coefficients
from jaxpoint.commands.console import table
from jaxpoint.commands.options import Outcome, at
from jaxpoint.config import RoomConfig, to_toml
from jaxpoint.detection.board.board_search import BoardDetection, notes_of
from jaxpoint.extras import extra
from jaxpoint.metrics import metrics
from jaxpoint.report.board_page import write_board_report
from jaxpoint.runs import new_run, provenance, save_files

More = Callable[[Path, dict[str, Any]], tuple[tuple[str, ...], dict[str, Any]]]
"""Writes further results into a run's folder, adds their figures, and returns lines and what its page shows."""


def write_board_outcome(
    calibration: Calibration,
    detection: BoardDetection | None,
    out: Path,
    room: RoomConfig,
    *,
    title: str,
    sources: Sequence[Path],
    force: bool,
    more: More | None = None,
) -> Outcome:
    """The run directory, whole or not at all, its report, and the outcome with the failure of the gate, if any."""
    quality = assess_boards(calibration, room.calibrate)
    seconds = None if detection is None else detection.seconds
    figures = {**metrics(calibration, seconds, quality), **board_metrics(calibration, detection)}
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), sources, calibration.seed)
    missing: list[str] = []
    shown: dict[str, Any] = {}

    def report(folder: Path) -> None:
        with extra("report.html", missing):
            write_board_report(
                folder / "report.html", calibration, detection, quality, figures,
                title=title, provenance=made, config_text=to_toml(room), extra_context=shown,
            )  # fmt: skip

    lines: tuple[str, ...] = ()
    with new_run(out, force, report) as folder:
        if more is not None:
            with extra("the rectification and depth", missing):
                lines, context = more(folder, figures)
                shown.update(context)
        save_files(folder, calibration, room, figures, made)
    page = out / "report.html"
    told = {**figures, "run": str(out), "report": str(page) if page.exists() else None}
    notes = () if detection is None else notes_of(detection)
    care = [f"{item.finding} {item.remedy}." for item in quality.findings if item.level == "care"]
    text = (*_table(figures), *_summary(figures), *lines, *notes, *care, *at("Report", page))
    return Outcome(told, text, quality.failure, tuple(missing))


def board_metrics(calibration: Calibration, detection: BoardDetection | None) -> dict[str, Any]:
    """What `metrics.json` has of a calibration from boards beside the usual: views, lenses with sigmas, coverage."""
    views, names = view_fits(calibration), calibration.rig.names
    return {
        **({} if detection is None else {"board": detection.board.spec}),
        "views": len(views),
        "poor_views": [_view(view, names) for view in views if view.poor],
        "every_view": [_view(view, names) for view in views],
        "lenses": [_lens(calibration, camera) for camera in range(len(names))],
        "pair_scatter": [
            {
                "cameras": [names[scatter.first], names[scatter.second]],
                "views": len(scatter.views),
                "shift_mm": 1e3 * scatter.shift_m,
                "turn_deg": scatter.turn_deg,
                "over_noise": scatter.ratio,
            }
            for scatter in pair_scatter(calibration)
        ],
    }


def _view(view: ViewFit, names: Sequence[str]) -> dict[str, Any]:
    return {**asdict(view), "camera": names[view.camera]}


def _lens(calibration: Calibration, camera: int) -> dict[str, Any]:
    """Parameters with standard deviations, coverage, and where to hold the board next."""
    rig, size = calibration.rig, calibration.rig.camera_size
    values, model = np.asarray(rig.cameras.lens.parameters)[camera], rig.lens_models[camera]
    own = np.concatenate([np.ones(COMMON, bool), own_coefficients(type(rig.cameras.lens), model)])
    covariance, sigmas = calibration.camera_covariance, [None] * len(values)
    if covariance is not None:
        every = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(len(rig), size)
        sigmas = every[camera, len(POSE_NAMES) :][own].tolist()
    place, worst = where_next(calibration, camera), lens_sigma_map(calibration, camera)
    names = model.parameter_names()
    return {
        "name": rig.names[camera],
        "lens": model.name,
        "parameters": dict(zip(names, values[own].tolist())),
        "sigmas": dict(zip(names, sigmas)),
        "coverage": float(calibration.pairs.coverage[camera]),
        "lens_sigma_px": None if worst is None or not np.isfinite(worst).any() else float(np.nanmedian(worst)),
        "hold_board_next": None if place is None else {"at_px": list(place[0]), "in_words": place[1]},
    }


def _table(figures: dict[str, Any]) -> tuple[str, ...]:
    rows = []
    for lens, camera, mean in zip(figures["lenses"], figures["cameras"], figures["reprojection"]["per_camera_mean_px"]):
        values, sigmas = lens["parameters"], lens["sigmas"]
        focal, center = ("fx", "fy"), ("cx", "cy")
        rows.append(
            (
                lens["name"],
                lens["lens"],
                " ".join(_with_sigma(values[key], sigmas[key]) for key in focal),
                " ".join(_with_sigma(values[key], sigmas[key]) for key in center),
                f"{camera['used']}/{camera['total']}",
                "-" if mean is None else f"{mean:.3f}",
                f"{lens['coverage']:.0%}",
            )
        )
    return table(("camera", "lens", "focal px", "centre px", "kept", "mean px", "coverage"), rows)


def _with_sigma(value: float, sigma: float | None) -> str:
    return f"{value:.1f}" if sigma is None else f"{value:.1f}±{sigma:.1f}"


def _summary(figures: dict[str, Any]) -> tuple[str, ...]:
    errors, used = figures["reprojection"], figures["observations"]
    if errors["rms_px"] is None:
        return ("no corner was kept",)
    return (
        f"rms {errors['rms_px']:.3f} px, mean {errors['mean_px']:.3f} px over {used['used']} of {used['total']} "
        f"corners in {figures['views']} views, {figures['seconds']['total']:.1f} s",
    )
