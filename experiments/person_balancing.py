"""pose2sim_single: silhouettes, heads and forearms of a man who hardly leaves the spot, against labels by eye."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from jaxpoint.body.limb_arms import find_arm
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.person import ThesisSettings
from jaxpoint.detection.colour import Image, scale_channels
from jaxpoint.detection.person.crop import Crop
from jaxpoint.detection.person.head_template import Head, find_head
from jaxpoint.detection.person.silhouette import (
    AdaptiveBackground,
    Silhouette,
    foreground,
    learn_background,
    never_clears,
    silhouettes,
)
from jaxpoint.detection.person.silhouette_evidence import SilhouetteEvidence
from jaxpoint.detection.person.skin import SkinModel, skin_model
from jaxpoint.detection.person.thesis_regions import thesis_forearm
from jaxpoint.detection.person.watcher import cut_crop
from person_pictures import SETTINGS, Row, drawn, read_image, read_video, sheet
from pose2sim import BAR, BARRED, BARRED_SIZE, Labels, located, missed, read_labels, video_rig

Found = list[list[tuple[Silhouette, Head] | None]]  # C cameras, F images
FRAMES = 100  # of every camera of pose2sim_single
HEAD_RIGHT_M = 0.15  # farther from the labelled cap it is another part of the body
FOREARM_RIGHT = (20.0, 40.0)  # degrees and px: largest difference from the labelled forearm, in angle and place
ARM_RIGHT_DEG = 15.0  # from the labelled forearm; farther it is another limb
DROPPED_PX = 20.0  # a view that misses the head found by the others by more is left out of it
# Where the stills show somebody: the video there, over frames in which nobody is there. x0, y0, x1, y1; first, end.
STILL_PEOPLE = {
    "cam01": [((0, 240, 400, 1000), (85, 100))],
    "cam02": [((600, 440, 880, 560), (78, 84)), ((600, 560, 880, 1060), (93, 100))],
    "cam03": [((900, 760, 1088, 1920), (0, 100))],
    "cam04": [((0, 960, 500, 1920), (80, 100))],
}


def balancing(data: Path, out: Path) -> Iterator[Row]:
    """The man on the beam, who is in every image."""
    folder, name = data / "pose2sim_single", "pose2sim_single"
    rig, labels = video_rig(folder), read_labels()
    cap = joint_track(rig, labels, "cap")
    caps, depths = np.asarray(rig.project(cap)), np.asarray(rig.depth(cap))
    focal = np.asarray(rig.cameras.focal)[:, 0]
    videos = {camera: read_video(folder / "videos" / f"{camera}.mp4") for camera in rig.names}
    shares = [never_clears(images, SETTINGS.background) for images in videos.values()]
    yield name, "`never_clears`, four cameras (more than 0.1: it holds somebody)", ", ".join(f"{x:.2f}" for x in shares)
    kept: dict[str, Found] = {}
    for background in ("median", "mog2", "given"):
        kept[background] = [
            looked_at(images, background, still(folder, camera, images), focal[i], caps[:, i])
            for i, (camera, images) in enumerate(videos.items())
        ]
        yield (
            name,
            f"background {background}: silhouette; head, within 15 cm of the cap",
            counted(kept[background], caps, depths / focal),
        )
    found = kept["given"]
    arms = {
        side: np.stack([joint_track(rig, labels, f"{side}_{end}") for end in ("elbow", "wrist")], axis=1)
        for side in ("left", "right")
    }
    for figure, reached in (
        *heads_in_space(rig, found, cap),
        *thesis_regions(rig, videos, found, arms),
        *arms_in_space(rig, videos, found, arms),
    ):
        yield name, figure, reached
    shown = [(i, camera, k) for i, camera in enumerate(rig.names) for k in (5, 35, 65, 95)]
    pictures = [(f"{camera}, frame {k}", drawn(videos[camera][k], found[i][k], caps[k, i])) for i, camera, k in shown]
    sheet(out / "pose2sim.png", pictures, 4)


def joint_track(rig: CameraRig, labels: dict[tuple[int, str], Labels], joint: str) -> Float[np.ndarray, "F 3"]:
    """A labelled joint in all frames, m: a spline through the labelled ones."""
    frames = sorted(frame for frame, name in labels if name == joint and labels[frame, name].seen.sum() >= 2)
    chosen = [labels[frame, joint] for frame in frames]
    stacked = Labels(
        (joint,) * len(chosen),
        np.concatenate([one.pixels for one in chosen]),
        np.concatenate([one.seen for one in chosen]),
    )
    return CubicSpline(frames, np.asarray(located(rig, stacked).points))(np.arange(FRAMES))


def still(folder: Path, camera: str, images: list[Image]) -> Image:
    """The room without the man, as the video would show it."""
    image = read_image(folder / "calibration" / "extrinsics" / f"{camera}_ext.png")
    if camera in BARRED:
        image = cv2.resize(image, BARRED_SIZE, interpolation=cv2.INTER_AREA)
        image = cv2.copyMakeBorder(image, BAR, BAR, 0, 0, cv2.BORDER_CONSTANT)
    median = np.median(np.stack(images[::10])[:, ::4, ::4], axis=0)
    image = scale_channels(image, np.median((median + 1) / (image[::4, ::4] + 1.0), axis=(0, 1)))
    for (x0, y0, x1, y1), (first, end) in STILL_PEOPLE[camera]:
        image[y0:y1, x0:x1] = np.median(np.stack([one[y0:y1, x0:x1] for one in images[first:end]]), axis=0)
    return image


def shaken(room: Image) -> list[Image]:
    """One image moved by a pixel each way: a still lies on a video no more exactly, and has no noise of its own."""
    shifts = [np.array([[1.0, 0.0, x], [0.0, 1.0, y]]) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    size = (room.shape[1], room.shape[0])
    moved = [cv2.warpAffine(room, shift, size, borderMode=cv2.BORDER_REPLICATE) for shift in shifts]
    return 3 * [np.asarray(image, dtype=np.uint8) for image in moved]


def looked_at(
    images: list[Image], background: str, room: Image, focal: float, caps: Float[np.ndarray, "F 2"]
) -> list[tuple[Silhouette, Head] | None]:
    """The silhouette that holds the labelled cap in each image, and its head."""
    settings = SETTINGS.background
    if background == "mog2":
        foreground_of = AdaptiveBackground(replace(settings, method="mog2")).foreground
    else:
        learnt = learn_background(shaken(room) if background == "given" else images, settings)
        foreground_of = partial(foreground, background=learnt, settings=settings)
    found = []
    for image, (x, y) in zip(images, caps.astype(int)):
        mask = foreground_of(image)
        holding = [one for one in silhouettes(mask, SETTINGS.silhouette) if one.full()[y, x]]
        found.append((holding[0], find_head(holding[0], focal, SETTINGS.head)) if holding else None)
    return found


def counted(
    found: Found,
    caps: Float[np.ndarray, "F C 2"],
    metres: Float[np.ndarray, "F C"],
) -> str:
    """Images with silhouette, with head, with the right head, and how far from the cap these are."""
    sight = [(i, k, one) for i, camera in enumerate(found) for k, one in enumerate(camera) if one is not None]
    heads = [(i, k, one[1]) for i, k, one in sight if one[1].found]
    off = np.array([np.hypot(h.x - caps[k, i, 0], h.y - caps[k, i, 1]) * metres[k, i] for i, k, h in heads])
    total, right = sum(map(len, found)), off[off < HEAD_RIGHT_M]
    middle = (
        f"; median {100 * np.median(right):.1f} cm, 95 % {100 * np.quantile(right, 0.95):.1f} cm" if len(right) else ""
    )
    return f"{len(sight)}; {len(heads)}, {len(right)} of {total} images{middle}"


def heads_in_space(rig: CameraRig, found: Found, cap: Float[np.ndarray, "F 3"]) -> Iterator[tuple[str, str]]:
    """The heads of all views triangulated, beside the caps of the labelled frames."""
    pixels, seen = np.zeros((FRAMES, len(rig), 2)), np.zeros((FRAMES, len(rig)), bool)
    for i, camera in enumerate(found):
        for k, one in enumerate(camera):
            if one is not None and one[1].found:
                pixels[k, i], seen[k, i] = (one[1].x, one[1].y), True
    heads = Labels(("head",) * FRAMES, pixels, seen)
    worst = np.linalg.norm(missed(rig, heads), axis=2)
    outlying = (worst == worst.max(axis=1, keepdims=True)) & (worst > DROPPED_PX) & (seen.sum(axis=1) > 2)[:, None]
    heads = replace(heads, seen=seen & ~outlying)
    off = (np.asarray(located(rig, heads).points) - cap)[::5]
    size = 100 * np.linalg.norm(off, axis=1)
    yield (
        "head in 3-D beside the labelled cap, 20 frames: median, 95 %, largest",
        (
            f"{np.median(size):.1f}, {np.quantile(size, 0.95):.1f}, {size.max():.1f} cm "
            f"(mean offset in z {100 * off[:, 2].mean():+.1f} cm; {outlying.sum()} of {seen.sum()} views left out)"
        ),
    )


def thesis_regions(
    rig: CameraRig,
    videos: dict[str, list[Image]],
    found: Found,
    arms: dict[str, Float[np.ndarray, "F 2 3"]],
) -> Iterator[tuple[str, str]]:
    """The thesis's region in each view beside the labelled forearms."""
    held = right = total = 0
    for i, images in enumerate(videos.values()):
        ends = [np.asarray(rig.project(arm))[:, :, i] for arm in arms.values()]
        for k in range(0, FRAMES, 5):
            one = found[i][k]
            if one is None:
                continue
            total += 1
            region = thesis_forearm(images[k], one[0], ThesisSettings()).region
            held += region is not None
            right += region is not None and any(
                is_forearm(region.centroid, region.orientation, *end[k].astype(float)) for end in ends
            )
    yield "thesis's forearm region: found; of these along a labelled forearm", f"{held} of {total} views; {right}"


def arms_in_space(
    rig: CameraRig,
    videos: dict[str, list[Image]],
    found: Found,
    arms: dict[str, Float[np.ndarray, "F 2 3"]],
) -> Iterator[tuple[str, str]]:
    """Our arm beside the labelled forearm whose wrist is nearer to its tip."""
    angles, offs = [], []
    model = skin_model(SETTINGS.skin)
    for k in range(0, FRAMES, 5):
        ones = [camera[k] for camera in found]
        crops = [one and crop_of(images[k], one[0], model) for images, one in zip(videos.values(), ones)]
        people = [None if crop is None else SilhouetteEvidence(crop) for crop in crops]
        arm = find_arm(rig, people, *head_of(rig, ones))
        if arm is None:
            continue
        to_wrist = [np.linalg.norm(own[k, 1] - arm.tip) for own in arms.values()]
        ends = list(arms.values())[int(np.argmin(to_wrist))][k]
        angles.append(between(arm.direction, ends[1] - ends[0]))
        # The tip is no point of the axis: a hand may be bent.
        beside = np.linalg.norm(np.cross(ends - np.asarray(arm.axis.near), arm.direction), axis=1)
        offs.append((*beside, min(to_wrist)))
    right = np.array(angles) < ARM_RIGHT_DEG
    elbow, wrist, tip = 100 * np.median(np.array(offs)[right], axis=0)
    yield (
        f"our arm in 3-D: answers; within {ARM_RIGHT_DEG:.0f} degrees of a labelled forearm; of these direction, "
        "median, mean; its axis from the labelled elbow and wrist, median; its tip from the wrist, median",
        f"{len(angles)} of {FRAMES // 5} frames; {right.sum()}; {np.median(np.array(angles)[right]):.1f}, "
        f"{np.mean(np.array(angles)[right]):.1f} degrees; {elbow:.1f}, {wrist:.1f} cm; {tip:.1f} cm",
    )


def crop_of(image: Image, silhouette: Silhouette, model: SkinModel) -> Crop:
    """The man's pixels, skin or not."""
    return cut_crop(image, silhouette.full().astype(np.uint8) * np.uint8(255), silhouette, model)


def head_of(
    rig: CameraRig, ones: list[tuple[Silhouette, Head] | None]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "C 2"]]:
    """The head in the room and in each image."""
    pixels, seen = np.zeros((1, len(rig), 2)), np.zeros((1, len(rig)), bool)
    for camera, one in enumerate(ones):
        if one is not None:
            pixels[0, camera], seen[0, camera] = (one[1].x, one[1].y), one[1].found
    point = np.asarray(located(rig, Labels(("head",), pixels, seen)).points[0])
    return point, np.asarray(rig.project(point))


def is_forearm(
    centroid: Float[np.ndarray, "2"],
    orientation: float,
    elbow: Float[np.ndarray, "2"],
    wrist: Float[np.ndarray, "2"],
) -> bool:
    """Whether a region lies along a labelled forearm."""
    across = between(np.array([np.cos(orientation), -np.sin(orientation)]), wrist - elbow)
    middle = float(np.hypot(*(centroid - (elbow + wrist) / 2)))
    return min(across, 180 - across) < FOREARM_RIGHT[0] and middle < FOREARM_RIGHT[1]


def between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two vectors, degrees."""
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))
