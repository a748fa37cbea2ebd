"""Images of real recordings: read, drawn upon, and put on a sheet to look at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from jaxpoint.config.person import PersonSettings
from jaxpoint.detection.colour import Image
from jaxpoint.detection.person.head_template import Head
from jaxpoint.detection.person.silhouette import (
    Silhouette,
)
from jaxpoint.errors import FileFormatError
from jaxpoint.io.video import open_frames
from jaxpoint.report.contact_sheet import add_title

Row = tuple[str, str, str]
SETTINGS = PersonSettings()


def read_video(path: Path) -> list[Image]:
    """All frames."""
    return [image for _, image in open_frames(path).stream()]


def read_image(path: Path) -> Image:
    """One image."""
    image = cv2.imread(str(path))
    if image is None:
        raise FileFormatError(f"There is no image '{path}'; check the folder of recordings.")
    return np.asarray(image, dtype=np.uint8)


def drawn(image: Image, one: tuple[Silhouette, Head] | None, cap: Float[np.ndarray, "2"] | None) -> Image:
    """The image with the silhouette's outline, the head (red where rejected), and a cross at the labelled cap."""
    picture = image.copy()
    width = max(2, image.shape[1] // 250)
    if one is not None:
        silhouette, head = one
        outlines, _ = cv2.findContours(silhouette.full().view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(picture, outlines, -1, (80, 255, 80), width)
        axes = (int(0.39 * head.height_px), int(head.height_px / 2))
        colour = (0, 230, 255) if head.found else (0, 0, 255)
        cv2.ellipse(picture, (int(head.x), int(head.y)), axes, 0, 0, 360, colour, width)
    if cap is not None:
        cv2.drawMarker(picture, (int(cap[0]), int(cap[1])), (255, 0, 255), cv2.MARKER_CROSS, 12 * width, width)
    return picture


def sheet(path: Path, pictures: list[tuple[str, Image]], columns: int, width: int = 300) -> None:
    """Pictures under their titles in rows, all of one width; each row is as high as its highest."""
    small = []
    for title, picture in pictures:
        size = width, round(width * picture.shape[0] / picture.shape[1])
        small.append(add_title(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA)), title, "", lines=1))
    small += [np.zeros((1, width, 3), np.uint8)] * (-len(small) % columns)
    rows = []
    for first in range(0, len(small), columns):
        row = small[first : first + columns]
        height = max(one.shape[0] for one in row)
        rows.append(np.hstack([cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, 0, cv2.BORDER_CONSTANT) for p in row]))
    cv2.imwrite(str(path), np.vstack(rows))
