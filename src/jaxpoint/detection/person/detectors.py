"""Detectors of people by name: whatever turns a session into what each camera shows of people."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import cast

from jaxpoint.config.person import PersonSettings
from jaxpoint.detection.person.session_watch import Progress, watch_session
from jaxpoint.errors import UsageError
from jaxpoint.evidence.body_landmarks import landmark_views
from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence
from jaxpoint.io.landmark_files import read_poses
from jaxpoint.io.session import Session

SILHOUETTES, LANDMARKS, AUTO = "silhouettes", "landmarks", "auto"


@dataclass(frozen=True)
class PeopleRequest:
    """What a detector of people is asked for; each reads what it needs."""

    session: Session
    settings: PersonSettings = field(default_factory=PersonSettings)
    landmarks: Path | None = None  # file of a pose estimator
    min_confidence: float = 0.3  # of landmarks that count
    cache: Path | None = None  # folder of what earlier calls found; None keeps nothing
    anew: bool = False  # look again where something was kept
    workers: int = 0  # processes at most; 0 for one a core
    progress: Progress | None = None


PeopleDetector = Callable[[PeopleRequest], Sequence[AbstractCameraEvidence]]
"""What each of the session's cameras shows of people, in the order of its cameras."""


def _silhouettes(request: PeopleRequest) -> Sequence[AbstractCameraEvidence]:
    return watch_session(
        request.session,
        request.settings,
        cache=request.cache,
        anew=request.anew,
        workers=request.workers,
        progress=request.progress,
    )


def _landmarks(request: PeopleRequest) -> Sequence[AbstractCameraEvidence]:
    session = request.session
    if request.landmarks is None:
        raise UsageError("The detector 'landmarks' reads a file; give it by --landmarks.")
    found = read_poses(request.landmarks, session, request.min_confidence)
    return landmark_views(found, session.sizes, session.frame_index >= 0)


_DETECTORS: dict[str, PeopleDetector] = {SILHOUETTES: _silhouettes, LANDMARKS: _landmarks}


def register_detector(name: str, detector: PeopleDetector) -> None:
    """Make a detector known to the commands, by its name.

    Raises:
        ValueError: another detector has the name.
    """
    if name == AUTO or _DETECTORS.get(name, detector) is not detector:
        raise ValueError(f"There is a detector '{name}' already; give the new one another name.")
    _DETECTORS[name] = detector


def unregister_detector(name: str) -> None:
    """Forget a detector; for tests.

    Raises:
        KeyError: there is none of this name.
    """
    del _DETECTORS[name]


def detector_of(name: str, landmarks: Path | None = None) -> PeopleDetector:
    """A detector by its registered name, or as `module:function`.

    Args:
        name: `auto` stands for landmarks where a file of them is given, and else for silhouettes.
        landmarks: that file.

    Raises:
        UsageError: there is none of this name, or landmarks are given to a detector that is not theirs.
    """
    if name == AUTO:
        name = SILHOUETTES if landmarks is None else LANDMARKS
    if name == SILHOUETTES and landmarks is not None:
        raise UsageError("The detector 'silhouettes' reads no landmarks; give --landmarks or that detector, not both.")
    if name in _DETECTORS:
        return _DETECTORS[name]
    module, separator, function = name.partition(":")
    if not separator:
        known = ", ".join((AUTO, *sorted(_DETECTORS)))
        raise UsageError(f"There is no detector '{name}'; choose among {known}, or name yours as module:function.")
    return _import_detector(module, function)


def _import_detector(module: str, function: str) -> PeopleDetector:
    if "" not in sys.path:  # the folder in which the command runs, as `python -m` has it
        sys.path.insert(0, "")
    try:
        found = getattr(import_module(module), function, None) if module and function else None
    except ImportError as error:
        needed = error.name or module
        raise UsageError(
            f"The detector '{module}:{function}' needs the module '{needed}', which cannot be imported; run it in the "
            "module's folder, or set PYTHONPATH."
        ) from None
    if not callable(found):
        raise UsageError(f"'{module}:{function}' is no function; name a detector as module:function.")
    return cast("PeopleDetector", found)


def detect_people(request: PeopleRequest, detector: str = AUTO) -> tuple[AbstractCameraEvidence, ...]:
    """What every camera of a session shows of people.

    Args:
        request: the session, and what detectors read.
        detector: its registered name, or `module:function`; `auto` chooses by what is given.

    Raises:
        UsageError: there is no such detector, or it gives views of other cameras or frames than the session has.
        FileFormatError, InsufficientDataError: as the detector.
    """
    found = tuple(detector_of(detector, request.landmarks)(request))
    cameras, frames = len(request.session.names), len(request.session.frame_ids)
    if len(found) != cameras or any(len(view.reasons) != frames for view in found):
        lengths = ", ".join(str(len(view.reasons)) for view in found) or "none"
        raise UsageError(
            f"The detector '{detector}' gave {len(found)} views with {lengths} frames, and the session has {cameras} "
            f"cameras with {frames}; return one view a camera, with all frames."
        )
    return found
