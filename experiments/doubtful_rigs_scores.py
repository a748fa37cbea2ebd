"""What became of the rigs of `doubtful_rigs.py`: right, wrong, refused with the true cause or with another.

Wrong is a delivered camera of which a focal length, the centre or the rotation is beyond 4 predicted standard
deviations and beyond twice the control's error (rms over its cameras). A refusal names the true cause where its
sentence or its causes match what `CAUSES` lists for one of the faults, together with the camera's name where a single
one is at fault; where nothing determines the rig, words for that count too. The table was written before any answer was
seen.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import chi2

from doubtful_rigs_determined import Determined
from doubtful_rigs_errors import CameraError
from doubtful_rigs_faults import KINDS, Fault
from doubtful_rigs_layouts import CRITICAL, LAYOUTS

SIGMAS, TIMES = 4.0, 2.0
LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
QUANTITIES = {"focal": 1, "centre": 3, "rotation": 3}  # and their degrees of freedom
SHOWN = 3  # excesses of one rig that are listed
OUTCOMES = ("good and right", "good and wrong", "refused, true cause", "refused, other cause")
REST = "rest good and right, camera named"  # refused for a camera that was left out, by its true cause
CAUSES = {
    "aspect": r"aspect|pixels (that )?are not square|not square",
    "crop": r"crop|principal point",
    "lens": r"\blens|\bwide",
    "rate": r"\brates?\b|\bdrift",
    "late": r"\blate\b|\bearly\b|\boffset|out of step",
    "frozen": r"hardly moves|frozen|one pixel|same pixel|stands still",
    "mirrored": r"mirror",
    "other room": r"fits no other|contradict|another (room|recording|light)",
}
PARALLEL = r"parallel"
UNDETERMINED = r"not determined?\b|undetermined|too little|parallel|\bline\b|\bplane\b"
NOT_PROSE = r"`[^`]*`|--[\w.-]+"  # commands and options are no causes
LIGHT_BLAMED = r"\blight\b[^.]*\b(plane|line)\b"  # the light fills a volume in every rig: never true


@dataclass(frozen=True)
class Result:
    """What was delivered, or why nothing was."""

    passed: bool
    message: str = ""  # of the failure
    causes: tuple[str, ...] = ()
    error: str = ""  # its class
    crashed: bool = False  # it is none of jaxpoint's own
    seconds: float = 0.0
    cameras: tuple[CameraError, ...] = ()
    holds: bool = False  # it passes but for cameras that were left out and named


@dataclass(frozen=True)
class Record:
    """One rig, as kept on disk."""

    seed: int
    kind: str
    turn_deg: float | None
    faults: tuple[Fault, ...]
    cameras: int
    frames: int
    noise_px: float
    extent_m: float
    determined: Determined
    result: Result
    control: Result
    control_held: bool  # the control knows its lenses


@dataclass(frozen=True)
class Excess:
    """An error beyond what is allowed."""

    camera: str
    quantity: str
    error: float
    sigma: float
    control: float | None

    def __str__(self) -> str:
        control = "no control" if self.control is None else f"control {_figure(self.quantity, self.control)}"
        said = f"{_figure(self.quantity, self.error)} (sigma {_figure(self.quantity, self.sigma)}, {control})"
        return f"{self.camera} {self.quantity} {said}"


def _figure(quantity: str, value: float) -> str:
    return f"{value:.2g} deg" if quantity == "rotation" else f"{value:.2%}"


def excesses(record: Record) -> list[Excess]:
    """What is wrong with the delivered cameras, the worst first in units of what is allowed."""
    control = {name: _control(record.control, name) for name in QUANTITIES}
    found = [
        Excess(camera.name, name, error, sigma, control[name])
        for camera in record.result.cameras
        for name in QUANTITIES
        for error, sigma in _each(camera, name)
        if error > max(SIGMAS * sigma, TIMES * (control[name] or 0.0))
    ]
    return sorted(found, key=lambda one: -one.error / max(SIGMAS * one.sigma, TIMES * (one.control or 0.0), 1e-12))


def _each(camera: CameraError, quantity: str) -> list[tuple[float, float]]:
    """Errors, not negative, with their standard deviations."""
    if quantity == "focal":
        both = {(abs(error), sigma) for error, sigma in zip(camera.focal, camera.focal_sigma)}
        return sorted(both)  # one where pixels are square
    if quantity == "centre":
        return [(camera.centre, camera.centre_sigma)]
    return [(camera.rotation_deg, camera.rotation_sigma_deg)]


def _control(control: Result, quantity: str) -> float | None:
    errors = [error for camera in control.cameras for error, _ in _each(camera, quantity)]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else None


def names_true_cause(record: Record) -> bool:
    """Whether a refusal says what is wrong with this rig."""
    said = " ".join([record.result.message, *record.result.causes])
    text = re.sub(NOT_PROSE, " ", said)
    if record.kind in CRITICAL and re.search(PARALLEL, text, re.IGNORECASE):
        return True
    if not record.determined.enough and re.search(UNDETERMINED, re.sub(LIGHT_BLAMED, " ", text), re.IGNORECASE):
        return True
    return any(_names(text, fault) for fault in record.faults)


def _names(text: str, fault: Fault) -> bool:
    named = not fault.one or re.search(rf"\bcam_{fault.cameras[0]}\b", text) is not None
    return named and re.search(CAUSES[fault.kind], text, re.IGNORECASE) is not None


def outcome(record: Record) -> str:
    """One of `OUTCOMES`, or `REST`."""
    if (record.result.passed or record.result.holds) and excesses(record):
        return OUTCOMES[1]
    if record.result.passed:
        return OUTCOMES[0]
    if record.result.holds and names_true_cause(record):
        return REST
    return OUTCOMES[2] if names_true_cause(record) else OUTCOMES[3]


def kinds_of(record: Record) -> list[str]:
    """Layout and faults of a rig, as the table lists them."""
    return [record.kind, *({fault.kind for fault in record.faults} or {"no fault"})]


@dataclass
class Tally:
    """Counts of one kind of rig."""

    rigs: int = 0
    outcomes: dict[str, int] = field(default_factory=lambda: dict.fromkeys((*OUTCOMES, REST), 0))
    crashed: int = 0
    determined: int = 0
    determined_right: int = 0  # delivered and right: called good, or without the camera that is named
    determined_refused: int = 0
    undetermined_good: int = 0  # called good all the same: so wide a prediction is hardly ever wrong

    def add(self, record: Record) -> None:
        """Count one rig."""
        what = outcome(record)
        self.rigs += 1
        self.outcomes[what] += 1
        self.crashed += record.result.crashed
        if record.determined.enough:
            self.determined += 1
            self.determined_right += what in (OUTCOMES[0], REST)
            self.determined_refused += what in OUTCOMES[2:]
        else:
            self.undetermined_good += record.result.passed

    @property
    def refused(self) -> int:
        """Rigs that were not called good."""
        return self.outcomes[OUTCOMES[2]] + self.outcomes[OUTCOMES[3]] + self.outcomes[REST]


def tallies(records: list[Record]) -> dict[str, Tally]:
    """Counts over all rigs, by layout and by fault."""
    found = {name: Tally() for name in ("all", *LAYOUTS, "no fault", *KINDS)}
    for record in records:
        for name in ("all", *kinds_of(record)):
            found[name].add(record)
    return found


def squares(results: Sequence[Result], quantity: str) -> np.ndarray:
    """Squared errors of the results called good, in units of the predicted covariance, of every camera."""
    cameras = [camera for result in results if result.passed or result.holds for camera in result.cameras]
    if quantity == "focal":
        pairs = [(camera.focal[1], camera.focal_sigma[1]) for camera in cameras]
        return np.array([(error / sigma) ** 2 for error, sigma in pairs if sigma > 0])
    values = [getattr(camera, f"{quantity}_square") for camera in cameras]
    return np.array([value for value in values if value is not None])


def inside(results: Sequence[Result], quantity: str, levels: tuple[float, ...] = LEVELS) -> list[float]:
    """The share of cameras whose region of each predicted probability holds the truth; NaN without any."""
    found = squares(results, quantity)
    bounds = chi2.ppf(levels, QUANTITIES[quantity])
    return [float((found <= bound).mean()) if len(found) else float("nan") for bound in bounds]


def summary(records: list[Record]) -> dict[str, Any]:
    """All figures, as JSON takes them."""
    found = tallies(records)
    total = found["all"]
    wrong = [record for record in records if outcome(record) == OUTCOMES[1]]
    results = [record.result for record in records]
    plain = [record.control for record in records if not record.control_held]
    curves = {name: inside(results, name) for name in QUANTITIES}
    return {
        "rigs": total.rigs,
        "wrong_called_good": len(wrong),
        "determined_right": share(total.determined_right, total.determined),
        "refusals_with_the_true_cause": share(total.outcomes[OUTCOMES[2]] + total.outcomes[REST], total.refused),
        "inside_95": {name: _finite(curve[LEVELS.index(0.95)]) for name, curve in curves.items()},
        "inside_95_of_controls": {name: _finite(inside(plain, name, (0.95,))[0]) for name in QUANTITIES},
        "by_kind": {name: {**vars(tally)} for name, tally in found.items() if tally.rigs},
        "levels": list(LEVELS),
        "inside": {name: [_finite(value) for value in curve] for name, curve in curves.items()},
        "regions": {name: len(squares(results, name)) for name in QUANTITIES},
        "wrong": [{"seed": record.seed, "what": [str(one) for one in excesses(record)[:SHOWN]]} for record in wrong],
        "median_seconds": float(np.median([record.result.seconds for record in records])) if records else None,
    }


def share(part: int, whole: int) -> float | None:
    """None of nothing."""
    return part / whole if whole else None


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
