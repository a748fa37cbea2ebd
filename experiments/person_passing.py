"""opencv_vtest and bodypose3d_cam0, which have no truth: silhouettes and heads to count and to look at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from jaxpoint.config.person import HeadSettings, SilhouetteSettings
from jaxpoint.detection.colour import Image
from jaxpoint.detection.person.head_template import find_head
from jaxpoint.detection.person.silhouette import (
    AdaptiveBackground,
    foreground,
    learn_background,
    never_clears,
    silhouettes,
)
from person_pictures import SETTINGS, Row, drawn, read_video, sheet


@dataclass(frozen=True)
class Scene:
    """How a recording without truth is looked at. Focal lengths are guesses: no head is compared with a place."""

    method: Literal["static", "mog2"]
    focal_px: float
    head: HeadSettings = SETTINGS.head
    people: SilhouetteSettings = SETTINGS.silhouette


def passing(data: Path, out: Path) -> Iterator[Row]:
    """Many who cross a street, far away: the median is the street."""
    images = read_video(data / "opencv_vtest" / "vtest.avi")
    far = replace(SETTINGS.head, nearest_m=5.0, farthest_m=20.0)
    many = replace(SETTINGS.silhouette, people=10, min_fraction=0.0007)
    yield from without_truth("opencv_vtest", images, Scene("static", 900.0, far, many), out / "vtest.png")


def sitting(data: Path, out: Path) -> Iterator[Row]:
    """One who passes, sits down, rises and comes near: the median holds him in the chair."""
    images = read_video(data / "bodypose3d_cam0" / "cam0_test.mp4")
    for method in ("static", "mog2"):
        yield from without_truth("bodypose3d_cam0", images, Scene(method, 550.0), out / f"bodypose3d_{method}.png")


def without_truth(name: str, images: list[Image], scene: Scene, path: Path) -> Iterator[Row]:
    """How many images have silhouettes, and a head in the largest; twelve of them drawn."""
    settings = replace(SETTINGS.background, method=scene.method)
    share = never_clears(images, settings)
    adaptive, learnt = AdaptiveBackground(settings), learn_background(images, settings)
    seen = heads = 0
    pictures = []
    shown = set(np.linspace(0.05 * len(images), len(images) - 1, 12).astype(int).tolist())
    for k, image in enumerate(images):
        mask = foreground(image, learnt, settings) if scene.method == "static" else adaptive.foreground(image)
        found = [(one, find_head(one, scene.focal_px, scene.head)) for one in silhouettes(mask, scene.people)]
        seen += bool(found)
        heads += bool(found) and found[0][1].found
        if k in shown:
            picture = image
            for one in found:
                picture = drawn(picture, one, None)
            pictures.append((f"frame {k}", picture))
    sheet(path, pictures, 3, 480)
    figure = f"background {scene.method}: `never_clears`; images with a silhouette, with a head in the largest"
    yield name, figure, f"{share:.3f}; {seen}, {heads} of {len(images)}"
