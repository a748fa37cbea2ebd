"""Landmarks of a pose estimator: `frame,camera,name,x,y,confidence`, and `person` where there are several.

Any estimator will do: names are taken as COCO, MediaPipe (`LEFT_WRIST`, `left_index`) and OpenPose (`LWrist`) write
them. `frame` is the number of the frame in the session, x and y are px, (0, 0) the centre of the top-left pixel.
`person` tells people of one image apart and need not be the same person from image to image.
"""

from __future__ import annotations

import re

from jaxpoint.errors import FileFormatError
from jaxpoint.evidence.body_landmarks import BodyLandmarks
from jaxpoint.evidence.person_evidence import JOINTS
from jaxpoint.io.files import Row, StrPath, read_table
from jaxpoint.io.session import Session

BEYOND = 1.0  # image sizes by which a landmark may lie outside: estimators guess at limbs that the border cuts off
_ENDINGS = ("_finger_tip", "_finger", "_tip")  # of an index finger


def read_poses(path: StrPath, session: Session, min_confidence: float) -> BodyLandmarks:
    """The landmarks of a file.

    Args:
        path: the file.
        session: whose frames they were found in.
        min_confidence: landmarks below are as if not given.

    Raises:
        FileFormatError: a missing column or value, an unknown camera, a frame that the session has not, a confidence
            outside of 0..1, a place far outside of the image or in fractions of it, the same landmark twice, or no name
            that is known.
    """
    rows = read_table(path, ("frame", "camera", "name", "x", "y", "confidence"))
    places = {int(frame): place for place, frame in enumerate(session.frame_ids)}
    found: dict[tuple[int, int, str], dict[str, tuple[float, float, float]]] = {}
    known = False
    for row in rows:
        joint = joint_of(row.text("name"))
        confidence = row.number("confidence")
        if not 0 <= confidence <= 1:
            raise row.error(f"column 'confidence' is {confidence:g}; give it as 0 to 1.")
        key = (_frame(row, places, session), row.camera(session.names), row.values.get("person", ""))
        known = known or joint in JOINTS
        if joint not in JOINTS or confidence < min_confidence:
            continue
        if joint in found.setdefault(key, {}):
            raise row.error(
                f"camera '{session.names[key[1]]}' has '{joint}' twice in frame {row.integer('frame')}; tell people "
                "apart in a column 'person'."
            )
        found[key][joint] = *_pixel(row, session, key[1]), confidence
    if not known:
        raise rows[0].error(
            f"no landmark has a known name, the first is '{rows[0].text('name')}'; use {', '.join(JOINTS)}."
        )
    landmarks = BodyLandmarks.of((frame, camera, found[frame, camera, who]) for frame, camera, who in sorted(found))
    _check_pixels(path, landmarks)
    return landmarks


def joint_of(name: str) -> str:
    """The name in `JOINTS` of an estimator's landmark, or what it is called there where there is none."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", re.sub(r"^([LR])(?=[A-Z][a-z])", r"\1_", name.strip()))
    plain = re.sub(r"[\s\-.]+", "_", spaced).lower()
    plain = re.sub(r"^l_", "left_", re.sub(r"^r_", "right_", plain))
    for ending in _ENDINGS:
        if plain.endswith(f"index{ending}"):
            return plain.removesuffix(ending)
    return plain


def _frame(row: Row, places: dict[int, int], session: Session) -> int:
    frame = row.integer("frame")
    if frame not in places:
        raise row.error(
            f"the session has no frame {frame}; its frames go from {session.frame_ids.min()} to "
            f"{session.frame_ids.max()}."
        )
    return places[frame]


def _pixel(row: Row, session: Session, camera: int) -> tuple[float, float]:
    x, y = row.number("x"), row.number("y")
    width, height = session.sizes[camera].tolist()
    if not (-BEYOND <= x / width <= 1 + BEYOND and -BEYOND <= y / height <= 1 + BEYOND):
        raise row.error(
            f"({x:g}, {y:g}) lies far outside the image of camera '{session.names[camera]}', which has {width} x "
            f"{height} px; give pixels of that image, and no line where a landmark was not found."
        )
    return x, y


def _check_pixels(path: StrPath, landmarks: BodyLandmarks) -> None:
    """Fractions of the image, as some estimators give them, are no pixels: all would lie in the first corner."""
    given = landmarks.pixels[landmarks.seen]
    if given.size and given.min() >= -BEYOND and given.max() <= 1 + BEYOND:
        raise FileFormatError(
            f"{path}: all {given.size} coordinates lie between {given.min():.3g} and {given.max():.3g}, as fractions "
            "of the image do; give pixels: multiply x by the image's width and y by its height."
        )
