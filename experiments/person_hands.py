"""hand_keypoints: regions of skin and their tips against labelled hands."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from jaxpoint.detection.colour import Image
from jaxpoint.detection.person.endpoints import axis_line
from jaxpoint.detection.person.skin import SkinModel, skin_mask, skin_model
from jaxpoint.detection.region import label_regions
from person_pictures import SETTINGS, Row, read_image, sheet


def hands(data: Path, out: Path) -> Iterator[Row]:
    """Skin and fingertip of 16 labelled hands."""
    labelled = list(read_hands(data / "hand_keypoints"))
    for kind in ("fitted", "box", "thesis"):
        model = skin_model(replace(SETTINGS.skin, model=kind))
        rows = [hand_found(image, points, model) for image, points in labelled]
        recall, tip = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
        yield (
            "hand_keypoints",
            f"skin {kind}, 16 hands: keypoints in the hand's region, mean, least; hands with 80 % of them",
            f"{recall.mean():.2f}, {recall.min():.2f}; {(recall >= 0.8).sum()}",
        )
        yield (
            "hand_keypoints",
            f"skin {kind}: nearer end of the region's axis to the index fingertip, in hand sizes; within a quarter",
            f"median {np.median(tip):.2f}; {(tip < 0.25).sum()}",
        )
    by_shape = sorted(labelled, key=lambda one: one[0].shape[0] / one[0].shape[1])
    sheet(out / "hands.png", [("", hand_drawn(image, points)) for image, points in by_shape], 4)


def read_hands(folder: Path) -> Iterator[tuple[Image, Float[np.ndarray, "K 2"]]]:
    """Every image with its labelled keypoints, px; the index fingertip is number 8, NaN where it is not labelled."""
    for path in sorted(folder.glob("*/test_*.json")):
        content = json.loads(path.read_text())
        files = {image["id"]: image["file_name"] for image in content["images"]}
        for one in content["annotations"]:
            image = read_image(path.parent / files[one["image_id"]])
            points = np.array(one["keypoints"], float).reshape(21, 3)
            yield image, np.where(points[:, 2:] > 0, points[:, :2], np.nan)


def hand_region(image: Image, points: Float[np.ndarray, "K 2"], model: SkinModel) -> np.ndarray | None:
    """The region of skin that holds most keypoints."""
    labels, regions = label_regions(skin_mask(image, model))
    if not regions:
        return None
    held = held_labels(labels, points)
    return labels == np.bincount(held[held > 0]).argmax() if (held > 0).any() else None


def held_labels(labels: np.ndarray, points: Float[np.ndarray, "K 2"]) -> np.ndarray:
    """What the image has at each keypoint."""
    x, y = np.round(points[np.isfinite(points).all(axis=1)]).astype(int).T
    return labels[np.clip(y, 0, labels.shape[0] - 1), np.clip(x, 0, labels.shape[1] - 1)]


def hand_found(image: Image, points: Float[np.ndarray, "K 2"], model: SkinModel) -> tuple[float, float]:
    """Part of the keypoints in the region, and the tip's distance over the hand's size (diagonal of its keypoints)."""
    region = hand_region(image, points, model)
    if region is None:
        return 0.0, np.inf
    recall = float(held_labels(region, points).mean())
    line = axis_line(region)
    if line is None or not np.isfinite(points[8]).all():
        return recall, np.inf
    size = float(np.hypot(*np.ptp(points[np.isfinite(points).all(axis=1)], axis=0)))
    return recall, float(np.linalg.norm(line.ends - points[8], axis=1).min() / size)


def hand_drawn(image: Image, points: Float[np.ndarray, "K 2"]) -> Image:
    """The region of the fitted model, its axis, and the labelled fingertip."""
    picture = image.copy()
    width = max(1, image.shape[1] // 150)
    region = hand_region(image, points, skin_model(SETTINGS.skin))
    if region is not None:
        outlines, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(picture, outlines, -1, (80, 255, 80), width)
        line = axis_line(region)
        if line is not None:
            start, end = (tuple(int(v) for v in point) for point in line.ends)
            cv2.line(picture, start, end, (0, 230, 255), width)
    if np.isfinite(points[8]).all():
        cv2.drawMarker(picture, tuple(int(v) for v in points[8]), (255, 0, 255), cv2.MARKER_CROSS, 10 * width, width)
    return picture
