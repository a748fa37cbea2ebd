"""The report: one HTML file that opens anywhere, without a network."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from typing import Any

import jinja2
import numpy as np
from jaxtyping import UInt8
from markupsafe import Markup, escape

from jaxpoint.calibration.alignment import Alignment
from jaxpoint.calibration.camera_clock import ClockSurvey
from jaxpoint.calibration.quality import Quality, assess
from jaxpoint.calibration.result import Calibration, PairTable
from jaxpoint.config import AlignSettings, CalibrateSettings
from jaxpoint.io.files import StrPath, replacing
from jaxpoint.report import figures_lens, figures_residuals, figures_scene, figures_tracks, figures_uncertainty, tables
from jaxpoint.report.accuracy import accuracy_of, on_accuracy
from jaxpoint.report.advice import ENOUGH_SHARED, Advice, advise, advise_on_tracks
from jaxpoint.report.reading import before_alignment, summarise
from jaxpoint.report.style import camera_colors, round_number, short_names, style, to_data_uri, to_svg
from jaxpoint.report.summary import RigScene, Summary, px
from jaxpoint.report.verdict import advice_of, judge_summary, judge_tracks
from jaxpoint.tracks import Tracks

Sheets = Sequence[tuple[str, UInt8[np.ndarray, "_ _ 3"]]]

_NO_ADVICE = Advice(
    "Nothing in the data asks for action.", "Calibrate again whenever a camera, its lens or its focus is touched."
)
_MAX_POINTS = 2500  # dots of the interactive view


def write_report(
    path: StrPath,
    calibration: Calibration,
    *,
    settings: CalibrateSettings | None = None,
    align_settings: AlignSettings | None = None,
    quality: Quality | None = None,
    provenance: Mapping[str, Any] | None = None,
    metrics: Mapping[str, Any] | None = None,
    config_text: str | None = None,
    sheets: Sheets = (),
    title: str = "Camera calibration",
) -> None:
    """Write the report of a calibration; nothing is solved.

    Args:
        path: the HTML file; it is replaced whole or not at all.
        settings: thresholds of the verdict; the defaults if not given.
        align_settings: threshold of the alignment; the default if not given.
        quality: what `assess` decided under these settings, where it was asked already.
        provenance: what the run was made with (versions, inputs, time), shown as it is.
        metrics: as `jaxpoint.metrics.metrics` gives; its `seconds` include the detection.
        config_text: the resolved settings, shown folded up.
        sheets: contact sheets of the detections, (caption, RGB image (H, W, 3) of 0..255).
        title: heading of the page.

    Raises:
        OSError: the folder is missing or not writable.
    """
    settings = settings or CalibrateSettings()
    quality = quality or assess(calibration, settings, align_settings)
    summary = summarise(calibration)
    accuracy = accuracy_of(calibration, summary)
    advice = [*_advice(summary, calibration), *on_accuracy(accuracy, summary.names)]
    scenes = _scenes(summary, calibration.alignment)
    with style():
        figures = _figures(summary, scenes)
        shown = figures_uncertainty.accuracy_section(calibration, summary, accuracy)
    seconds = (metrics or {}).get("seconds", calibration.seconds)
    page = render(
        "calibration.html.j2",
        kind="jaxpoint calibration report",
        title=title,
        subtitle=f"{len(summary.names)} cameras, {calibration.tracks.extent}",
        sections=_sections(calibration, sheets),
        judgement=judge_summary(summary, quality, advice, settings),
        tiles=_tiles(summary, calibration, seconds),
        advice=[*advice_of(quality.findings), *advice] or [_NO_ADVICE],
        fits=tables.fit_table(summary),
        lenses=tables.lens_table(summary, calibration.time_offsets, calibration.readout_times),
        accuracy=shown,
        figures=figures,
        rig_caption=_rig_caption(calibration.alignment),
        space_caption=_space_caption(summary.scene),
        pairs=tables.pair_matrix(calibration.pairs),
        enough_shared=ENOUGH_SHARED,
        kept=tables.kept_table(summary),
        outliers=tables.outlier_table(summary),
        alignment=_alignment(calibration.alignment),
        stages=tables.stage_list(calibration.stages),
        sheets=encoded(sheets),
        provenance=tables.origin_table(provenance, seconds, calibration.seed),
        config_text=config_text,
        rig_data=_rig_data(scenes, summary),
    )
    write_page(path, page)


def write_tracks_report(
    path: StrPath,
    tracks: Tracks,
    pairs: PairTable,
    *,
    clocks: ClockSurvey | None = None,
    problem: str | None = None,
    provenance: Mapping[str, Any] | None = None,
    config_text: str | None = None,
    sheets: Sheets = (),
    title: str = "Check of the tracks",
) -> None:
    """Write what can be said about tracks before anything is solved: pairs, coverage, synchrony.

    Args:
        path: the HTML file; it is replaced whole or not at all.
        pairs: as `calibration.pairs.pair_table` gives.
        clocks: as `calibration.clocks.survey_clocks` gives.
        problem: why these tracks cannot be calibrated, where that is already known.
        provenance: as in `write_report`.
        config_text: as in `write_report`.
        sheets: as in `write_report`.
        title: as in `write_report`.

    Raises:
        OSError: the folder is missing or not writable.
    """
    clocks = ClockSurvey((), ()) if clocks is None else clocks
    advice = advise_on_tracks(tracks, clocks.clocks)
    with style():
        names = short_names(tracks.names)
        coverage = figures_lens.coverage_maps(names, tracks.pixels, tracks.visible, tracks.image_sizes)
        timeline = figures_tracks.timeline(names, tracks.visible, tracks.frame_ids)
        figures = {"coverage": Markup(to_svg(coverage)), "timeline": Markup(to_svg(timeline))}
    views = tracks.visible.sum(axis=1)
    page = render(
        "tracks.html.j2",
        kind="jaxpoint check",
        title=title,
        subtitle=f"{tracks.cameras} cameras, {tracks.extent}",
        sections=[
            ("verdict", "Verdict"), ("next", "What to do"), ("pairs", "Pairs"), ("coverage", "Coverage"),
            ("sync", "In step?"), *([("detections", "Detections")] if sheets else []), ("provenance", "Provenance"),
        ],
        judgement=judge_tracks(tracks, pairs, advice, problem),
        tiles=[
            (str(tracks.cameras), "cameras"),
            (f"{tracks.frames:,}", "frames"),
            (f"{int((views >= 2).sum()):,}", "frames seen by two or more"),
            (f"{int((views >= 3).sum()):,}", "frames seen by three or more"),
            (f"{int(tracks.visible.sum()):,}", "observations"),
        ],
        advice=advice or [Advice("The recording looks fine.", "Go on with `jaxpoint calibrate`.")],
        pairs=tables.pair_matrix(pairs),
        moments=tables.moment_table(names, clocks.pairs),
        clocks=tables.clock_table(names, clocks.clocks),
        enough_shared=ENOUGH_SHARED,
        figures=figures,
        sheets=encoded(sheets),
        provenance=tables.origin_table(provenance, {}, None),
        config_text=config_text,
    )  # fmt: skip
    write_page(path, page)


def write_detection_section(path: StrPath, sheets: Sheets, *, title: str = "Detections") -> None:
    """Write a page of contact sheets alone: (caption, RGB image (H, W, 3) of 0..255) each.

    Raises:
        OSError: the folder is missing or not writable.
    """
    page = render(
        "detection.html.j2", kind="jaxpoint detect", title=title, subtitle="", sections=[], sheets=encoded(sheets)
    )
    write_page(path, page)


def _figures(summary: Summary, scenes: list[tuple[str, RigScene]]) -> dict[str, Markup]:
    """Every figure of the calibration report, by name."""
    names = short_names(summary.names)
    summary = replace(summary, names=names)
    cones = [figures_scene.frusta(scene, summary.sizes, summary.focal, summary.center) for _, scene in scenes]
    agreeing = summary.kept.sum(axis=1)[summary.point_valid]
    drawn = {
        "rig": figures_scene.rig_views(scenes, names, cones),
        "coverage": figures_lens.coverage_maps(names, summary.pixels, summary.visible, summary.sizes),
        "space": figures_scene.coverage_in_space(scenes[-1][1], agreeing, names, cones[-1]),
        "reprojections": figures_residuals.reprojections(summary),
        "kept": figures_residuals.kept_against_mean(summary),
        "distribution": figures_residuals.error_distribution(summary),
        "field": figures_residuals.vector_field(summary),
        "time": figures_residuals.over_time(summary),
        "lens": figures_lens.distortion_curves(names, summary.lens),
    }
    return {name: Markup(to_svg(figure)) for name, figure in drawn.items()}


def _scenes(summary: Summary, alignment: Alignment | None) -> list[tuple[str, RigScene]]:
    """The rig as solved and, once aligned, in the room; alone, the solved one is turned upright to be readable."""
    if alignment is None:
        room = summary.scene if summary.scene.in_room else summary.scene.upright()
        return [("As solved, turned upright", room)]
    return [("As solved", before_alignment(summary.scene, alignment.similarity)), ("In the room", summary.scene)]


def _sections(calibration: Calibration, sheets: Sheets) -> list[tuple[str, str]]:
    optional = {"alignment": calibration.alignment is not None, "stages": bool(calibration.stages)}
    optional["detections"] = len(sheets) > 0
    optional["accuracy"] = calibration.camera_covariance is not None or bool(calibration.undetermined)
    everything = {
        "verdict": "Verdict", "next": "What to do", "cameras": "Cameras", "rig": "Rig", "coverage": "Coverage",
        "residuals": "Fit", "accuracy": "Accuracy", "lenses": "Lenses", "alignment": "Alignment",
        "outliers": "Outliers", "stages": "Stages", "detections": "Detections", "provenance": "Provenance",
    }  # fmt: skip
    return [(name, text) for name, text in everything.items() if optional.get(name, True)]


def _tiles(summary: Summary, calibration: Calibration, seconds: Mapping[str, Any]) -> list[tuple[str, str]]:
    tiles = [
        (px(summary.mean_px), "mean error, kept"),
        (px(summary.mean_all_px), "mean error, all"),
        (f"{summary.kept_fraction:.1%}", f"of {int(summary.comparable.sum()):,} kept (frames of two views)"),
        (f"{int(summary.point_valid.sum()):,}", f"of {calibration.tracks.extent} used"),
        (px(summary.sigma_px, 2), "noise of a coordinate"),
        ("metres" if calibration.unit == "m" else "no unit", "aligned" if calibration.in_room else "not aligned"),
    ]
    total = seconds.get("total")
    return tiles if total is None else [*tiles, (f"{total:.1f} s", "to compute")]


def _advice(summary: Summary, calibration: Calibration) -> list[Advice]:
    """What the data, the solver and the alignment advise."""
    advice = advise(summary)
    if not calibration.converged:
        others = any(item.urgent for item in advice)
        stuck = Advice(
            f"The solver did not converge: {calibration.message}.",
            "What stands next below is the likely cause: mend that, then calibrate again."
            if others
            else 'Nothing below says why: calibrate again with fewer distortion terms (lens.distortion = "radial1") or '
            "with another `--seed`, and report it where that does not help either.",
            urgent=True,
        )
        advice = [stuck, *advice]
    if calibration.alignment is not None:
        return [*advice, *_on_alignment(calibration.alignment)]
    if not calibration.in_room:
        step = "Measure a few points of the room and run `jaxpoint align RUN --landmarks landmarks.csv --out RUN2`."
        lacking = "no floor" if calibration.unit == "m" else "no unit and no floor"
        advice = [*advice, Advice(f"The result has {lacking} yet.", step)]
    return advice


def _on_alignment(alignment: Alignment) -> Iterator[Advice]:
    """A known point that stands out, and a mirror image that was not ruled out."""
    errors = [e if e is not None else r for e, r in zip(alignment.leave_one_out_mm, alignment.residual_mm)]
    worst, middle = int(np.argmax(errors)), float(np.median(errors))
    if len(errors) >= 4 and errors[worst] > 3 * middle:
        yield Advice(
            f"The known point {alignment.names[worst]} is off by {errors[worst]:.0f} mm when it is left out of the "
            f"fit; the median is {middle:.0f} mm.",
            "Measure and click it again, or leave it out.",
        )
    if not alignment.handedness_verified:
        yield Advice("A mirrored room would fit as well.", "Add one known point off the plane of the others.")


def _alignment(alignment: Alignment | None) -> dict[str, Any] | None:
    if alignment is None:
        return None
    top = max(alignment.max_mm, 1e-9)
    return {
        "method": alignment.method,
        "rms_mm": alignment.rms_mm,
        "max_mm": alignment.max_mm,
        "scale": float(alignment.similarity.scale),
        "verified": alignment.handedness_verified,
        "warnings": alignment.warnings,
        "rows": [
            {
                "name": name,
                "residual": f"{residual:.1f}",
                "bar": 100 * residual / top,
                "left_out": "too few points" if left_out is None else f"{left_out:.1f}",
            }
            for name, residual, left_out in zip(alignment.names, alignment.residual_mm, alignment.leave_one_out_mm)
        ],
    }


def _rig_caption(alignment: Alignment | None) -> str:
    if alignment is None:
        return (
            "The solver's frame has no unit and no up; for reading it is turned so that the cameras stand upright. "
            "Aligning it to known points gives metres and the axes of the room."
        )
    return "Left: as solved, where axes and unit mean nothing yet. Right: after alignment, in metres, z up."


def _space_caption(scene: RigScene) -> str:
    text = (
        "Places of the light, darker where more cameras agree on them. The calibration is sure where dots are dense "
        "and dark; where there are none it extrapolates."
    )
    return text if scene.unit == "m" else text + " Upright is guessed from the cameras."


def _rig_data(scenes: list[tuple[str, RigScene]], summary: Summary) -> Markup:
    """The scenes as JSON for the interactive view, safe inside a script element."""
    data = []
    for title, scene in scenes:
        cones = figures_scene.frusta(scene, summary.sizes, summary.focal, summary.center)
        low, high = figures_scene.bounds(scene, cones)
        chosen = np.linspace(0, len(scene.points) - 1, min(_MAX_POINTS, len(scene.points))).astype(int)
        points = scene.points[chosen]
        points = points[((points >= low) & (points <= high)).all(axis=1)]
        digits = max(0, 4 - int(np.floor(np.log10((high - low).max()))))
        data.append(
            {
                "title": title,
                "unit": scene.unit,
                "low": low.round(digits).tolist(),
                "high": high.round(digits).tolist(),
                "step": round_number((high - low)[:2].max() / 4),
                "points": points.round(digits).tolist(),
                "cameras": [
                    {"name": name, "color": color, "cone": cone.round(digits).tolist()}
                    for name, color, cone in zip(short_names(summary.names), camera_colors(len(cones)), cones)
                ],
            }
        )
    return Markup(json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def encoded(sheets: Sheets) -> list[tuple[str, str]]:
    """Captions and images as a page holds them."""
    return [(caption, to_data_uri(image)) for caption, image in sheets]


def render(template: str, **context: Any) -> str:
    """A page from its template."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jaxpoint.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = _code
    return environment.get_template(template).render(version=metadata.version("jaxpoint"), **context)


def _code(text: str) -> Markup:
    """The text with what stands between backticks set as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def write_page(path: StrPath, page: str) -> None:
    """Write a page, whole or not at all."""
    with replacing(path) as file:
        file.write(page.encode("utf-8"))
