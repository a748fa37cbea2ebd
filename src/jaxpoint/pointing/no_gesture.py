"""Why no gesture was found in a session, and what helps: each cause has another remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from jaxpoint.body.following import Following
from jaxpoint.config.pointing import GestureSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.pointing.holds import ArmTrack, find_holds

SELDOM = 0.2  # of the frames of followed people with a measured arm; below, arms are missed rather than at rest
AT_REST = 0.17  # of the stature, the stretch that hanging arms reach: less must not be asked for


def no_gesture(
    frames: int, following: Following, tracks: Sequence[ArmTrack], settings: GestureSettings
) -> InsufficientDataError:
    """The cause: nobody followed, hardly an arm measured, none stretched far enough, or none held long enough."""
    found = f"No gesture was found in {frames} frames"
    present = int(following.tracking.heads.present.sum())
    shown = sum(len(track.frames) for track in tracks)
    if not present:
        return InsufficientDataError(
            f"{found}: nobody was followed in the room, as no head was seen by two cameras for long enough; `jaxpoint "
            "detect person` with the same session and options says why, camera by camera."
        )
    if shown < max(settings.min_frames, SELDOM * present):
        return InsufficientDataError(
            f"{found}: somebody was followed in {present} of them, but a whole forearm was measured in {shown} only, "
            "which takes two views; `jaxpoint detect person` with the same options says for every view what was in the "
            "way, and --landmarks of a pose estimator may see more."
        )
    return InsufficientDataError(
        f"{found}, though an arm was measured in {shown} of them: {_stiller(tracks, settings)}"
    )


def _stiller(tracks: Sequence[ArmTrack], settings: GestureSettings) -> str:
    """Which of the two conditions of a gesture was missed, and by how much."""
    farthest = max((float(track.stretch.max()) for track in tracks if len(track.stretch)), default=0.0)
    asked = f"{settings.min_stretch:.2f} of the stature, which --gesture.min-stretch asks for"
    held = _farthest_held(tracks, settings)
    if held is not None:
        return (
            f"the farthest that one was held out was {held:.2f}, not {asked}; point with a straight arm, or lower that "
            f"to {held:.2f}."
        )
    if farthest >= settings.min_stretch:
        return (
            f"it reached {asked}, but was not held still for {settings.min_hold_s:.1f} s there; point for longer, "
            "lower --gesture.min-hold-s, or say when by --times."
        )
    return (
        f"none was held out farther than {AT_REST:.2f} of the stature, as arms hang, and {settings.min_stretch:.2f} is "
        "asked for; point with a straight arm, or say when by --times."
    )


def _farthest_held(tracks: Sequence[ArmTrack], settings: GestureSettings) -> float | None:
    """The largest stretch, in hundredths, that would find a gesture if it were asked for; None at that of rest."""
    low, high = round(100 * AT_REST) + 1, int(100 * settings.min_stretch)
    best = None
    while low <= high:
        middle = (low + high) // 2
        if find_holds(tracks, replace(settings, min_stretch=middle / 100)):
            best, low = middle / 100, middle + 1
        else:
            high = middle - 1
    return best
