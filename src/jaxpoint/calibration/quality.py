"""The quality gate: whether a calibration passes, decided once from everything known of it.

The exit code, the console, `metrics.json` and the report show what is decided here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from jaxpoint.calibration.camera_checks import camera_findings
from jaxpoint.calibration.determinacy import determinacy_findings
from jaxpoint.calibration.held_terms import held_term_findings
from jaxpoint.calibration.known_lenses import known_lens_findings
from jaxpoint.calibration.known_points import known_point_findings
from jaxpoint.calibration.lens_checks import lens_findings
from jaxpoint.calibration.normal import NormalEquations, normal_equations
from jaxpoint.calibration.prior_checks import prior_findings
from jaxpoint.calibration.result import Calibration, Finding, Level
from jaxpoint.calibration.shared_checks import shared_lens_findings
from jaxpoint.config import AlignSettings, CalibrateSettings
from jaxpoint.errors import JaxpointError, NotConvergedError, QualityError


@dataclass(frozen=True)
class GateCheck:
    """One figure held against its threshold."""

    what: str
    found: str
    wanted: str
    level: Level
    reason: str = ""  # a clause, where it fails


@dataclass(frozen=True)
class Quality:
    """What is decided of a calibration."""

    checks: tuple[GateCheck, ...]  # the plain thresholds
    findings: tuple[Finding, ...]  # causes, the failing ones first

    @property
    def level(self) -> Level:
        """`bad` where anything fails, `care` where anything deserves a look."""
        levels = {item.level for item in (*self.checks, *self.findings)}
        return "bad" if "bad" in levels else "care" if "care" in levels else "good"

    @property
    def passed(self) -> bool:
        """Whether the calibration may be trusted."""
        return self.level != "bad"

    @property
    def holds(self) -> bool:
        """Whether it passes but for cameras that were left out: what is delivered may be trusted."""
        kept = [item for item in self.findings if item.level == "bad" and not item.left_out]
        return not kept and all(check.level != "bad" for check in self.checks)

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes of failure, in words that stay the same."""
        return tuple(dict.fromkeys(item.cause for item in self.findings if item.level == "bad"))

    @property
    def failure(self) -> JaxpointError | None:
        """Why it does not pass, and what helps; None where it passes."""
        if self.passed:
            return None
        causes = [item for item in self.findings if item.level == "bad"]
        failed = [check for check in self.checks if check.level == "bad"]
        kind = NotConvergedError if not causes and failed[0].what == SOLVER else QualityError
        if not causes:
            reasons = " and ".join(check.reason for check in failed)
            return kind(f"{reasons[0].upper()}{reasons[1:]}; the results are kept and marked. {_LOOK}")
        text = " Also: ".join(f"{item.finding} {item.remedy.rstrip('.')}." for item in causes)
        kept = "passes every other check and is kept" if self.holds else "is kept and marked"
        return kind(f"{text} The calibration {kept}.")


SOLVER = "Solver"
COMPARABLE = "observations in frames of two or more views"
_LOOK = "The report shows which camera, place or time disagrees."


def assess(
    calibration: Calibration, settings: CalibrateSettings | None = None, align: AlignSettings | None = None
) -> Quality:
    """Hold a calibration, aligned or not, against everything known of it. Needs its covariance (`with_covariance`).

    Args:
        settings: thresholds; the defaults if not given.
        align: threshold of the alignment; it counts for aligned calibrations only.
    """
    settings, align = settings or CalibrateSettings(), align or AlignSettings()
    checks = tuple(_checks(calibration, settings, align))
    normal, geometry = _normal(calibration), list(determinacy_findings(calibration, settings))
    found = [
        *shared_lens_findings(calibration, normal),
        *_without_corollary(calibration.findings, geometry),
        *geometry,
        *prior_findings(calibration, normal),
        *known_lens_findings(calibration, normal),
        *known_point_findings(calibration),
        *lens_findings(calibration),
        *(() if normal is None else held_term_findings(calibration)),
        *camera_findings(calibration, settings, normal),
    ]
    order = {"bad": 0, "care": 1, "good": 2}
    return Quality(checks, tuple(sorted(found, key=lambda item: order[item.level])))


def _without_corollary(findings: Iterable[Finding], geometry: Iterable[Finding]) -> Iterator[Finding]:
    """The findings but for open pixel aspects where the geometry leaves focal lengths open too: one cause is enough."""
    critical = any(item.level == "bad" for item in geometry)
    return (item for item in findings if not (critical and item.level == "bad" and item.cause == "pixel aspect"))


def _normal(calibration: Calibration) -> NormalEquations | None:
    """The normal equations, where the calibration says what was free and has inliers."""
    possible = calibration.freedom is not None and calibration.sigma_px > 0 and calibration.kept.any()
    return normal_equations(calibration) if possible else None


def plain_checks(calibration: Calibration, settings: CalibrateSettings, seen: int, what: str) -> Iterator[GateCheck]:
    """Solver, mean error, and share of inliers.

    Args:
        seen: observations that could have been inliers.
        what: which these are, in words.
    """
    yield GateCheck(
        SOLVER,
        calibration.message if calibration.converged else f"not converged: {calibration.message}",
        "converged",
        "good" if calibration.converged else "bad",
        f"the adjustment did not converge ({calibration.message})",
    )
    errors = calibration.errors[calibration.kept]
    mean = float(errors.mean()) if errors.size else float("nan")
    yield GateCheck(
        "Mean error of the inliers",
        f"{mean:.3f} px" if errors.size else "no inlier",
        f"at most {settings.max_mean_px:g} px",
        "good" if mean <= settings.max_mean_px else "bad",
        f"the mean reprojection error is {mean:.2f} px, above the {settings.max_mean_px:g} px allowed"
        if errors.size
        else "no observation was kept",
    )
    share = calibration.kept.sum() / max(seen, 1)
    yield GateCheck(
        "Inliers",
        f"{share:.1%}",
        f"at least {settings.min_kept:.0%}",
        "good" if share >= settings.min_kept else "bad",
        f"only {share:.0%} of the {what} fit, below the {settings.min_kept:.0%} asked for",
    )


def _checks(calibration: Calibration, settings: CalibrateSettings, align: AlignSettings) -> Iterator[GateCheck]:
    """The plain thresholds of the settings."""
    yield from plain_checks(calibration, settings, int(calibration.comparable.sum()), COMPARABLE)
    aligned = calibration.alignment
    if aligned is not None:
        yield GateCheck(
            "Alignment to the room, rms",
            f"{aligned.rms_mm:.1f} mm",
            f"at most {align.max_rms_mm:g} mm",
            "good" if aligned.rms_mm <= align.max_rms_mm else "bad",
            f"the alignment leaves {aligned.rms_mm:.0f} mm (rms), above the {align.max_rms_mm:g} mm allowed",
        )
        verified = aligned.handedness_verified
        yield GateCheck(
            "Handedness (mirror image ruled out)",
            "verified" if verified else "not verified: the known points lie on a plane",
            "verified",
            "good" if verified else "care",
        )
