"""Answers as pictures and sentences for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from jaxpoint.body.arm import ArmReason, PointingArm
from jaxpoint.body.following import Following
from jaxpoint.camera.rig import CameraRig
from jaxpoint.detection.colour import Image
from jaxpoint.extras import extra
from jaxpoint.io.session import Session
from jaxpoint.pointing.answers import Answer
from jaxpoint.pointing.objects import NOTHING
from jaxpoint.pointing.pipeline import SessionAnswers
from jaxpoint.report.answer_text import sentence
from jaxpoint.report.figures_pointing import PointingScene, RoomScene
from jaxpoint.report.pointing_page import GestureEntry
from jaxpoint.report.pointing_sheet import Outline, PointingView, pointing_sheet

HEADER = ("gesture", "time", "person", "answer", "probability", "distance", "line", "views")
NEAREST_M = 0.15  # what is nearer to a camera's plane is not drawn
_STEPS = 24  # of a drawn edge: lenses bend it
_FOLDED_PX = 2.0


def room_scene(pointed: SessionAnswers, rig: CameraRig) -> RoomScene:
    """The room, its objects and cameras, for the figures in 3-D."""
    room = pointed.scene.room
    low, high = np.asarray(room.low), np.asarray(room.high)
    return RoomScene(low, high, pointed.scene.objects.outlines, np.asarray(rig.positions), rig.names)


def images_of(session: Session, frames: Sequence[int]) -> list[list[Image | None]]:
    """The image of every camera (outer) in some frames (inner); None where it has none."""
    found = [dict(session.images(camera, frames)) for camera in range(len(session.names))]
    return [[own.get(frame) for frame in frames] for own in found]


def gesture_entries(
    session: Session,
    following: Following,
    pointed: SessionAnswers,
    images: Sequence[Sequence[Image | None]],
    truth: Mapping[int, str] | None = None,
    missing: list[str] | None = None,
) -> list[GestureEntry]:
    """Every gesture as the page shows it.

    Args:
        session: with its calibration.
        following: the arms.
        pointed: the answers.
        images: of every camera (outer) in the frame of each gesture, as `images_of` gives them.
        truth: what is meant, by the gesture's number, where it is known.
        missing: takes a sentence for each picture that could not be made.
    """
    assert session.rig is not None
    faces = pointed.scene.objects.outlines
    shown = []
    for i, answer in enumerate(pointed.answers):
        sheet = None
        with extra(f"the picture of gesture {answer.number}", [] if missing is None else missing):
            arm = following.arms.get((pointed.frames[i], pointed.people[i]))
            sheet = _sheet(session.rig, answer, arm, [own[i] for own in images], faces)
        shown.append(_entry(answer, sheet, None if truth is None else truth.get(answer.number, "")))
    return shown


def _sheet(
    rig: CameraRig, answer: Answer, arm: PointingArm | None, images: Sequence[Image | None], faces: Mapping[str, list]
) -> np.ndarray | None:
    """All views, red, green, blue; None where no camera has an image: landmarks may be given of such frames too."""
    views = [_view(rig, camera, image, answer, arm, faces) for camera, image in enumerate(images) if image is not None]
    return pointing_sheet(views)[..., ::-1] if views else None


def _entry(answer: Answer, sheet: np.ndarray | None, meant: str | None) -> GestureEntry:
    text = sentence(answer)
    truth = ""
    if meant:
        right = meant == answer.name
        truth = f"In truth: {_the(meant)}. " + ("The answer is right." if right else "The answer is wrong.")
    row = [
        f"{answer.number}", f"{answer.time_s:.1f} s", f"{answer.person}", answer.name,
        f"{100 * answer.probability:.0f} %", f"{answer.distance_m:.1f} m", answer.line, f"{answer.views}",
    ]  # fmt: skip
    if meant is not None:
        row += [meant or "no gesture", "yes" if meant == answer.name else "no"]
    return GestureEntry(
        number=answer.number,
        title=answer.name,
        sentence=text[0].upper() + text[1:] + ".",
        row=row,
        sheet=sheet,
        caption=f"Every camera at {answer.time_s:.2f} s (frame {answer.frame}).",
        scene=_scene(answer),
        chances=answer.probabilities[:6],
        line=_line(answer),
        reasons=answer.reasons,
        truth=truth,
        right=meant == answer.name,
    )


def _line(answer: Answer) -> list[tuple[str, str]]:
    met = ", ".join(f"{place.name} ({place.distance_m:.1f} m)" for place in answer.hits) or "no object"
    near = ", ".join(f"{name} ({angle:.0f}°)" for name, angle in answer.nearest)
    rows = [
        ("held", f"{answer.start_s:.1f} to {answer.end_s:.1f} s"),
        ("line", f"{answer.line}, ± {answer.sigma_deg:.1f}°"),
        ("meets", met),
        ("nearest", near),
    ]
    if answer.calibration_sigma_deg is not None:
        rows.insert(2, ("of the calibration", f"± {answer.calibration_sigma_deg:.2f}°"))
    if answer.surface is not None:
        rows.append(("ends on", f"{answer.surface.name} ({answer.surface.distance_m:.1f} m)"))
    if answer.words:
        rows.append(("words", " ".join(answer.words)))
    return rows


def _the(name: str) -> str:
    return "nothing that is known" if name == NOTHING else f"the {name}"


def _likely(answer: Answer) -> list[str]:
    """Other objects that are nearly as probable."""
    return [name for name, chance in answer.probabilities[1:3] if name != NOTHING and 3 * chance > answer.probability]


def _scene(answer: Answer) -> PointingScene:
    meant = None if answer.name == NOTHING else answer.name
    length = answer.distance_m if answer.distance_m > 0 else 3.0
    return PointingScene(
        {**answer.joints, "tip": answer.origin},
        answer.origin,
        answer.direction,
        length,
        float(np.deg2rad(answer.sigma_deg)),
        meant,
        _likely(answer),
    )


def _view(
    rig: CameraRig, camera: int, image: Image, answer: Answer, arm: PointingArm | None, faces: Mapping[str, list]
) -> PointingView:
    def seen(points: Float[np.ndarray, "N 3"]) -> list[Float[np.ndarray, "M 2"]]:
        return _project(rig, camera, points)

    outlines = []
    for name in [answer.name, *_likely(answer)]:
        edges: list[np.ndarray] = []
        for face in faces.get(name, []):
            edges += seen(_close_outline(face))
        if edges:
            outlines.append(Outline(name, edges, name == answer.name))
    reach = np.linspace(0.03, max(answer.distance_m, 0.5), _STEPS)
    line = max(seen(answer.origin + reach[:, None] * answer.direction), key=len, default=None)
    own = None if arm is None else arm.views[camera]
    title = rig.names[camera]
    if own is None or own.reason != ArmReason.FOUND:
        why = "no arm" if own is None else own.reason.name.lower().replace("_", " ")
        return PointingView(image, title, outlines, line, reason=f"not used: {why}")
    return PointingView(image, title, outlines, line, _pair(own.tip), _pair(own.base))


def _pair(pixel: Float[np.ndarray, "2"]) -> tuple[float, float]:
    return float(pixel[0]), float(pixel[1])


def _close_outline(corners: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "M 3"]:
    """The outline once around, with places along each edge."""
    share = np.linspace(0.0, 1.0, _STEPS)[:, None]
    ends = np.roll(corners, -1, axis=0)
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, ends)])


def _project(rig: CameraRig, camera: int, points: np.ndarray) -> list[Float[np.ndarray, "M 2"]]:
    """Runs of points in front of a camera, as pixels.

    Far outside of the image a lens model folds back and means nothing: what does not undistort to where it came from
    is left out.
    """
    pixels, depth = np.asarray(rig.project(points))[:, camera], np.asarray(rig.depth(points))[:, camera]
    size = np.asarray(rig.image_sizes)[camera]
    straight = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ np.asarray(rig.matrices)[camera].T
    straight = straight[:, :2] / np.where(np.abs(straight[:, 2:]) > 1e-9, straight[:, 2:], 1.0)
    back, valid = rig.undistort(np.repeat(pixels[:, None], len(rig), axis=1))
    same = np.linalg.norm(np.asarray(back)[:, camera] - straight, axis=1) < _FOLDED_PX
    near = (np.abs(pixels - size / 2) < size).all(axis=1)
    good = (depth > NEAREST_M) & near & same & np.asarray(valid)[:, camera] & np.isfinite(pixels).all(axis=1)
    runs = np.split(np.arange(len(points)), np.flatnonzero(np.diff(good.astype(int))) + 1)
    return [pixels[run] for run in runs if good[run[0]] and len(run) > 1]
