"""The page of a calibration from boards: of one lens, of a pair, or of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from markupsafe import Markup

from jaxpoint.calibration.board_figures import ViewFit, view_fits
from jaxpoint.calibration.pair_poses import pair_scatter
from jaxpoint.calibration.quality import Quality
from jaxpoint.calibration.result import Calibration
from jaxpoint.detection.board.board_search import BoardDetection
from jaxpoint.io.files import StrPath
from jaxpoint.report import figures_boards, figures_lens, figures_residuals, tables
from jaxpoint.report.advice import Advice
from jaxpoint.report.html import encoded, render, write_page
from jaxpoint.report.reading import summarise
from jaxpoint.report.style import short_names, style, to_svg
from jaxpoint.report.verdict import Judgement, advice_of

WORST, WIDTH = 4, 640  # views that are shown, and how wide
FOUND, REJECTED = (60, 200, 90), (230, 60, 80)  # RGB
ARROW = 20.0  # px of a picture that the rms error of a view takes


def write_board_report(
    path: StrPath,
    calibration: Calibration,
    detection: BoardDetection | None,
    quality: Quality,
    figures: Mapping[str, Any],
    *,
    title: str,
    provenance: Mapping[str, Any],
    config_text: str,
    extra_context: Mapping[str, Any],
) -> None:
    """Write the page, whole or not at all.

    Args:
        path: of the page.
        calibration: of `calibrate_boards`, with its covariance.
        detection: where the corners come from; without it no images are shown.
        quality: what `assess_boards` decided.
        figures: what `metrics.json` holds.
        title: heading of the page.
        provenance: versions, command, inputs.
        config_text: the settings as TOML.
        extra_context: of a stereo pair, `rectified`: its figures and pictures.

    Raises:
        OSError: the folder is missing or not writable.
    """
    views, names = view_fits(calibration), short_names(calibration.rig.names)
    page = render(
        "board.html.j2",
        kind="jaxpoint calibration from boards",
        title=title,
        subtitle=_subtitle(calibration, figures),
        sections=_sections(detection, extra_context, len(names)),
        judgement=_judge(quality, figures),
        tiles=_tiles(figures),
        advice=advice_of(quality.findings)
        or [Advice("Nothing in the data asks for action.", "Calibrate again whenever lens or focus are touched.")],
        lenses=_lens_table(figures),
        figures=_drawn(calibration, views, names),
        views=_view_table(views, names),
        worst=encoded(worst_views(calibration, detection, views)) if detection is not None else [],
        rectified=extra_context.get("rectified"),
        provenance=tables.origin_table(provenance, figures["seconds"], calibration.seed),
        config_text=config_text,
    )
    write_page(path, page)


def _subtitle(calibration: Calibration, figures: Mapping[str, Any]) -> str:
    board = f"{figures['board']}, " if "board" in figures else ""
    cameras = len(calibration.rig)
    return f"{board}{figures['views']} views of {cameras} camera{'s' if cameras > 1 else ''}"


def _sections(detection: BoardDetection | None, more: Mapping[str, Any], cameras: int) -> list[tuple[str, str]]:
    return [
        ("verdict", "Verdict"), ("next", "What to do"), ("lenses", "Lenses"), ("coverage", "Coverage"),
        ("views", "Views"), ("residuals", "Fit"), *([("pairs", "Cameras")] if cameras > 1 else []),
        *([("rectified", "Rectified")] if more.get("rectified") else []),
        *([("worst", "Worst views")] if detection is not None else []), ("provenance", "Provenance"),
    ]  # fmt: skip


def _judge(quality: Quality, figures: Mapping[str, Any]) -> Judgement:
    if quality.failure is not None:
        return Judgement("bad", "Not to be trusted", f"Do not use it yet. {quality.failure}", list(quality.checks))
    errors, used = figures["reprojection"], figures["observations"]
    facts = (
        f"{used['used']:,} of {used['total']:,} corners fit, with {errors['rms_px']:.3f} px (rms) between where they "
        "were found and where the calibration says they are"
    )
    care = [item.finding for item in quality.findings if item.level == "care"]
    if care:
        return Judgement(
            "care", "Usable, with care", f"{facts}. But look at this first: {care[0]}", list(quality.checks)
        )
    return Judgement("good", "This calibration can be trusted", f"{facts}.", list(quality.checks))


def _tiles(figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    errors, used = figures["reprojection"], figures["observations"]
    return [
        ("unknown" if errors["rms_px"] is None else f"{errors['rms_px']:.3f} px", "rms of the corners kept"),
        (f"{used['used'] / max(used['total'], 1):.1%}", f"of {used['total']:,} corners kept"),
        (str(figures["views"]), "views"),
        (str(len(figures["poor_views"])), "of them poor"),
        (f"{min(lens['coverage'] for lens in figures['lenses']):.0%}", "of the image with corners"),
        (f"{figures['seconds']['total']:.1f} s", "to compute"),
    ]


def _lens_table(figures: Mapping[str, Any]) -> tables.Table:
    """One row a parameter, one column a camera."""
    lenses = figures["lenses"]
    rows = [
        [key, *(_value(lens["parameters"][key], lens["sigmas"][key]) for lens in lenses)]
        for key in lenses[0]["parameters"]
    ]
    return tables.Table([lenses[0]["lens"], *(lens["name"] for lens in lenses)], rows)


def _value(value: float, sigma: float | None) -> str:
    """With as many digits as the standard deviation allows."""
    if sigma is None:
        return f"{value:.5g}"
    if sigma == 0:
        return f"{value:.5g} (held)"
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 7))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def _drawn(calibration: Calibration, views: list[ViewFit], names: tuple[str, ...]) -> dict[str, Markup | None]:
    summary = summarise(calibration)
    with style():
        drawn = {
            "coverage": figures_lens.coverage_maps(
                names, calibration.tracks.pixels, calibration.kept, calibration.tracks.image_sizes
            ),
            "held": figures_boards.ways_held(views, names),
            "errors": figures_boards.view_errors(views, names),
            "distribution": figures_residuals.error_distribution(summary),
            "field": figures_residuals.vector_field(summary),
            "lens": figures_lens.distortion_curves(names, summary.lens),
        }
        if calibration.camera_covariance is not None:
            drawn["certainty"] = figures_boards.lens_certainty(calibration, names)
        scatters = pair_scatter(calibration)
        if scatters:
            drawn["pairs"] = figures_boards.pair_shifts(scatters, names)
        made = {name: Markup(to_svg(figure)) for name, figure in drawn.items()}
    return {"certainty": None, "pairs": None, **made}


def _view_table(views: list[ViewFit], names: tuple[str, ...]) -> tables.Table:
    """The poorest views first."""
    rows = [
        [
            f"{names[view.camera]} {view.frame_id}",
            f"{view.rms_px:.3f}",
            f"{view.kept} of {view.corners}",
            f"{view.tilt_deg:.0f}°",
            f"{view.distance_m:.2f} m",
            "poor" if view.poor else "",
        ]
        for view in sorted(views, key=lambda view: (not view.poor, -view.rms_px))[:12]
    ]
    return tables.Table(["View", "Rms, px", "Corners kept", "Tilt", "Distance", ""], rows)


def worst_views(
    calibration: Calibration, detection: BoardDetection, views: list[ViewFit]
) -> list[tuple[str, UInt8[np.ndarray, "_ _ 3"]]]:
    """The views that fit worst, with their residuals as arrows."""
    shown = []
    for view in sorted(views, key=lambda view: -view.rms_px)[:WORST]:
        picture = _residual_picture(calibration, detection, view)
        name = calibration.rig.names[view.camera]
        zoom = ARROW / max(view.rms_px, 1e-9)
        caption = f"{name}, frame {view.frame_id}: {view.rms_px:.2f} px; arrows from found to calibrated, × {zoom:.0f}"
        shown.append((caption, picture))
    return shown


def _residual_picture(calibration: Calibration, detection: BoardDetection, view: ViewFit) -> UInt8[np.ndarray, "_ _ 3"]:
    image = detection.image(view.frame_id, view.camera)
    scale = WIDTH / image.shape[1]
    picture = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)
    tracks = calibration.tracks
    rows = np.flatnonzero((tracks.frame_ids == view.frame_id) & tracks.visible[:, view.camera])
    start = (tracks.pixels[rows, view.camera] + 0.5) * scale - 0.5
    end = start + ARROW / max(view.rms_px, 1e-9) * calibration.residuals[rows, view.camera]
    kept = calibration.kept[rows, view.camera]
    for a, b, good in zip(np.rint(start).astype(int), np.rint(end).astype(int), kept):
        cv2.arrowedLine(picture, a.tolist(), b.tolist(), FOUND if good else REJECTED, 1, cv2.LINE_AA, tipLength=0.25)
    return np.asarray(picture)
