"""Can this calibration be trusted? Every threshold stated, and one sentence that a newcomer understands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxpoint.calibration.pairs import MIN_FRAMES
from jaxpoint.calibration.quality import GateCheck, Quality
from jaxpoint.calibration.result import Finding, Level, PairTable
from jaxpoint.config import CalibrateSettings
from jaxpoint.report.advice import ENOUGH_COVERAGE, ENOUGH_SHARED, Advice
from jaxpoint.report.summary import Summary, image_coverage, mean, px
from jaxpoint.tracks import Tracks


@dataclass(frozen=True)
class Judgement:
    """The verdict: `bad` when a gate failed, `care` when something else deserves a look."""

    level: Level
    title: str
    sentence: str
    checks: list[GateCheck]


def judge_summary(summary: Summary, quality: Quality, advice: list[Advice], settings: CalibrateSettings) -> Judgement:
    """The quality gate's decision in words, with what else makes a calibration doubtful."""
    checks = [*quality.checks, *_warnings(summary, settings)]
    if quality.failure is not None:
        title = "Holds, but without cameras that were left out" if quality.holds else "Not to be trusted"
        advice_first = "" if quality.holds else "Do not use this calibration yet. "
        return Judgement("bad", title, f"{advice_first}{quality.failure}", checks)
    facts = (
        f"on average the cameras agree to {px(summary.mean_px, 2)} on where the light was "
        f"(limit {settings.max_mean_px:g} px), and {summary.kept_fraction:.1%} of {summary.comparable.sum():,} "
        f"observations fit (at least {settings.min_kept:.0%})"
    )
    notable = [item.finding for item in quality.findings if item.level == "care"]
    urgent = [item.finding for item in advice if item.urgent]
    doubtful = [f"{check.what}: {check.found}." for check in checks if check.level == "care"]
    if first := [*notable, *urgent, *doubtful]:
        sentence = f"It passes its thresholds: {facts}. But look at this first: {first[0]}"
        return Judgement("care", "Usable, with care", sentence, checks)
    return Judgement("good", "This calibration can be trusted", f"{facts[0].upper()}{facts[1:]}.", checks)


def advice_of(findings: Sequence[Finding]) -> list[Advice]:
    """What the gate found, as advice: what fails first."""
    return [Advice(item.finding, f"{item.remedy.rstrip('.')}.", urgent=item.level == "bad") for item in findings]


def _warnings(summary: Summary, settings: CalibrateSettings) -> list[GateCheck]:
    """What does not fail a calibration but makes it doubtful."""
    names, seen = summary.names, np.maximum(summary.comparable.sum(axis=0), 1)
    kept = summary.kept.sum(axis=0) / seen
    means = np.array([mean(summary.errors[summary.kept[:, c], c]) for c in range(len(names))])
    worst, fewest = int(np.argmax(np.nan_to_num(means, nan=np.inf))), int(kept.argmin())
    limit = settings.max_mean_px
    return [
        GateCheck("Worst camera", f"{names[worst]}, {px(means[worst])}", f"at most {limit:g} px",
              "good" if means[worst] <= limit else "care"),
        GateCheck("Fewest kept in a camera", f"{names[fewest]}, {kept[fewest]:.1%}",
              f"at least {settings.min_kept:.0%}", "good" if kept[fewest] >= settings.min_kept else "care"),
        *_connections(names, summary.shared),
        *_coverage(names, summary.pixels, summary.visible, summary.sizes),
    ]  # fmt: skip


def _connections(names: Sequence[str], shared: np.ndarray) -> list[GateCheck]:
    """The camera that shares fewest frames with its second best partner (with its only one in a rig of two)."""
    partners = shared.copy()
    np.fill_diagonal(partners, 0)
    second = np.sort(partners, axis=1)[:, -min(2, max(len(names) - 1, 1))]
    alone = int(second.argmin())
    others = "two others" if len(names) > 2 else "the other"
    return [
        GateCheck(
            f"Least connected camera, frames shared with {others}",
            f"{names[alone]}, {second[alone]:,}",
            f"at least {ENOUGH_SHARED}",
            "good" if second[alone] >= ENOUGH_SHARED else "care",
        )
    ]


def _coverage(names: Sequence[str], pixels: np.ndarray, visible: np.ndarray, sizes: np.ndarray) -> list[GateCheck]:
    """The camera whose light visited the fewest cells of its image."""
    covered = (image_coverage(pixels, visible, sizes) > 0).mean(axis=(1, 2))
    narrow = int(covered.argmin())
    return [
        GateCheck(
            "Least covered image",
            f"{names[narrow]}, {covered[narrow]:.0%}",
            f"at least {ENOUGH_COVERAGE:.0%}",
            "good" if covered[narrow] >= ENOUGH_COVERAGE else "care",
        )
    ]


def judge_tracks(tracks: Tracks, pairs: PairTable, advice: list[Advice], problem: str | None) -> Judgement:
    """Whether tracks are worth calibrating, before anything is solved.

    Args:
        problem: why they cannot be calibrated, where that is already known.
    """
    names = tracks.names
    usable = int((tracks.visible.sum(axis=1) >= 2).sum())
    checks = [
        GateCheck("Frames seen by two or more cameras", f"{usable:,}", f"at least {MIN_FRAMES}",
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
