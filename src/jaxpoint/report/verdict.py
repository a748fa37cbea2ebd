"""Can this calibration be trusted? Every threshold stated, and one sentence that a newcomer understands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from jaxpoint.calibration.alignment import Alignment
from jaxpoint.calibration.pairs import MIN_FRAMES
from jaxpoint.calibration.result import Calibration, PairTable
from jaxpoint.config import AlignSettings, CalibrateSettings
from jaxpoint.report.advice import ENOUGH_COVERAGE, ENOUGH_SHARED, Advice
from jaxpoint.report.summary import Summary, image_coverage, mean, px
from jaxpoint.tracks import Tracks

Level = Literal["good", "care", "bad"]


@dataclass(frozen=True)
class Check:
    """One thing that was held against a threshold."""

    what: str
    found: str
    wanted: str
    level: Level
    reason: str = ""  # in a sentence, where it is a gate


@dataclass(frozen=True)
class Judgement:
    """The verdict: `bad` when a gate failed, `care` when something else deserves a look."""

    level: Level
    title: str
    sentence: str
    checks: list[Check]


def judge_summary(
    summary: Summary,
    calibration: Calibration,
    advice: list[Advice],
    settings: CalibrateSettings,
    align: AlignSettings,
) -> Judgement:
    """Hold a calibration against the quality gates of its settings, and against what makes one doubtful."""
    checks = [*_gates(summary, calibration, settings), *_warnings(summary, settings)]
    if calibration.alignment is not None:
        checks += _alignment(calibration.alignment, align)
    urgent = [item for item in advice if item.urgent]
    failed = [check for check in checks if check.level == "bad"]
    doubtful = [check for check in checks if check.level == "care"]
    facts = (
        f"on average the cameras agree to {px(summary.mean_px, 2)} on where the light was "
        f"(limit {settings.max_mean_px:g} px), and {summary.kept_fraction:.1%} of {summary.comparable.sum():,} "
        f"observations fit (at least {settings.min_kept:.0%})"
    )
    if failed:
        reasons = " and ".join(check.reason for check in failed)
        return Judgement("bad", "Not to be trusted", f"Do not use this calibration yet: {reasons}.", checks)
    if urgent or doubtful:
        first = urgent[0].finding if urgent else f"{doubtful[0].what}: {doubtful[0].found}."
        sentence = f"It passes its thresholds: {facts}. But look at this first: {first}"
        return Judgement("care", "Usable, with care", sentence, checks)
    return Judgement("good", "This calibration can be trusted", f"{facts[0].upper()}{facts[1:]}.", checks)


def _gates(summary: Summary, calibration: Calibration, settings: CalibrateSettings) -> list[Check]:
    """The thresholds at which `jaxpoint calibrate` itself fails."""
    return [
        Check(
            "Solver",
            calibration.message if calibration.converged else f"not converged: {calibration.message}",
            "converged",
            "good" if calibration.converged else "bad",
            f"the solver did not converge ({calibration.message})",
        ),
        Check(
            "Mean error of the observations kept",
            px(summary.mean_px),
            f"at most {settings.max_mean_px:g} px",
            "good" if summary.mean_px <= settings.max_mean_px else "bad",
            f"the mean error is {px(summary.mean_px, 2)} (limit {settings.max_mean_px:g} px)",
        ),
        Check(
            "Observations kept",
            f"{summary.kept_fraction:.1%}",
            f"at least {settings.min_kept:.0%}",
            "good" if summary.kept_fraction >= settings.min_kept else "bad",
            f"only {summary.kept_fraction:.0%} of the observations fit (at least {settings.min_kept:.0%} are needed)",
        ),
    ]


def _warnings(summary: Summary, settings: CalibrateSettings) -> list[Check]:
    """What does not fail a calibration but makes it doubtful."""
    names, seen = summary.names, np.maximum(summary.comparable.sum(axis=0), 1)
    kept = summary.kept.sum(axis=0) / seen
    means = np.array([mean(summary.errors[summary.kept[:, c], c]) for c in range(len(names))])
    worst, fewest = int(np.argmax(np.nan_to_num(means, nan=np.inf))), int(kept.argmin())
    limit = settings.max_mean_px
    return [
        Check("Worst camera", f"{names[worst]}, {px(means[worst])}", f"at most {limit:g} px",
              "good" if means[worst] <= limit else "care"),
        Check("Fewest kept in a camera", f"{names[fewest]}, {kept[fewest]:.1%}", f"at least {settings.min_kept:.0%}",
              "good" if kept[fewest] >= settings.min_kept else "care"),
        *_connections(names, summary.shared),
        *_coverage(names, summary.pixels, summary.visible, summary.sizes),
    ]  # fmt: skip


def _connections(names: Sequence[str], shared: np.ndarray) -> list[Check]:
    """The camera that shares fewest frames with its second best partner (with its only one in a rig of two)."""
    partners = shared.copy()
    np.fill_diagonal(partners, 0)
    second = np.sort(partners, axis=1)[:, -min(2, max(len(names) - 1, 1))]
    alone = int(second.argmin())
    others = "two others" if len(names) > 2 else "the other"
    return [
        Check(
            f"Least connected camera, frames shared with {others}",
            f"{names[alone]}, {second[alone]:,}",
            f"at least {ENOUGH_SHARED}",
            "good" if second[alone] >= ENOUGH_SHARED else "care",
        )
    ]


def _coverage(names: Sequence[str], pixels: np.ndarray, visible: np.ndarray, sizes: np.ndarray) -> list[Check]:
    """The camera whose light visited the fewest cells of its image."""
    covered = (image_coverage(pixels, visible, sizes) > 0).mean(axis=(1, 2))
    narrow = int(covered.argmin())
    return [
        Check(
            "Least covered image",
            f"{names[narrow]}, {covered[narrow]:.0%}",
            f"at least {ENOUGH_COVERAGE:.0%}",
            "good" if covered[narrow] >= ENOUGH_COVERAGE else "care",
        )
    ]


def _alignment(alignment: Alignment, settings: AlignSettings) -> list[Check]:
    verified = alignment.handedness_verified
    return [
        Check(
            "Alignment to the room, rms",
            f"{alignment.rms_mm:.1f} mm",
            f"at most {settings.max_rms_mm:g} mm",
            "good" if alignment.rms_mm <= settings.max_rms_mm else "bad",
            f"the known points are missed by {alignment.rms_mm:.0f} mm rms (limit {settings.max_rms_mm:g} mm)",
        ),
        Check(
            "Handedness (mirror image ruled out)",
            "verified" if verified else "not verified: the known points lie on a plane",
            "verified",
            "good" if verified else "care",
        ),
    ]


def judge_tracks(tracks: Tracks, pairs: PairTable, advice: list[Advice], problem: str | None) -> Judgement:
    """Whether tracks are worth calibrating, before anything is solved.

    Args:
        problem: why they cannot be calibrated, where that is already known.
    """
    names = tracks.names
    usable = int((tracks.visible.sum(axis=1) >= 2).sum())
    checks = [
        Check("Frames seen by two or more cameras", f"{usable:,}", f"at least {MIN_FRAMES}",
              "good" if usable >= MIN_FRAMES else "bad"),
        *_connections(names, pairs.shared),
        *_coverage(names, tracks.pixels, tracks.visible, tracks.image_sizes),
    ]  # fmt: skip
    if problem or checks[0].level == "bad":
        sentence = problem or f"Only {usable} frames are seen by two or more cameras; {MIN_FRAMES} are needed."
        return Judgement("bad", "Not enough to calibrate", sentence, checks)
    urgent = [item.finding for item in advice if item.urgent]
    doubtful = [f"{check.what}: {check.found}." for check in checks if check.level != "good"]
    if urgent or doubtful:
        sentence = f"It can be tried, but look at this first: {(urgent + doubtful)[0]}"
        return Judgement("care", "Enough to try, with care", sentence, checks)
    sentence = f"{usable:,} frames are seen by two or more cameras, and every camera is connected to the others."
    return Judgement("good", "Ready to calibrate", sentence, checks)
