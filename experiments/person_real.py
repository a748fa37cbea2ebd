"""What do the detectors of a person reach on real video, and where do they fail?

pose2sim_single: a bare-torso man who hardly leaves the spot, seen by four cameras, with joints labelled by eye. Is it
noticed that the median image holds him? How often do the median, MOG2 and a background that is given (the
calibration's stills, from which he is cut out) find him and his head, how far is the head from the labelled cap, in
the images and in 3-D, and the thesis's and our forearm from the labelled elbow and wrist? opencv_vtest and
bodypose3d_cam0 have no truth: they are counted, and looked at. hand_keypoints: skin and tip against the labels. Writes
one table, a sheet of pictures of each recording to look at, and `report.html` with all of it.

    python experiments/person_real.py DATA --out person_real
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import cv2
import jax
import numpy as np
import tyro
from jaxtyping import Float
from markupsafe import Markup
from scipy.interpolate import CubicSpline

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.person import HeadSettings, PersonSettings, SilhouetteSettings
from jaxpoint.detect.arm import Crop
from jaxpoint.detect.colour import Image, scaled
from jaxpoint.detect.endpoints import axis_line
from jaxpoint.detect.head import Head, find_head
from jaxpoint.detect.person import cut_crop
from jaxpoint.detect.region import label_regions
from jaxpoint.detect.silhouette import (
    AdaptiveBackground,
    Silhouette,
    foreground,
    learn_background,
    never_clears,
    silhouettes,
)
from jaxpoint.detect.skin import SkinModel, skin_mask, skin_model
from jaxpoint.detect.thesis import thesis_forearm
from jaxpoint.errors import FileFormatError
from jaxpoint.io.video import open_frames
from jaxpoint.person.arms import find_arm
from jaxpoint.report.html import render, write_page
from jaxpoint.report.person import titled
from jaxpoint.report.style import to_data_uri
from jaxpoint.report.tables import Table, origin_table
from jaxpoint.runs import provenance
from pose2sim import BAR, BARRED, BARRED_SIZE, Labels, located, missed, read_labels, video_rig

Row = tuple[str, str, str]
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
SETTINGS = PersonSettings()
DRAWN = "Green: the silhouette's outline; yellow: its head, red where it was rejected"
SHEETS = {
    "pose2sim.png": f"pose2sim_single, given background. {DRAWN}; cross: the labelled cap.",
    "vtest.png": f"opencv_vtest, the median as background. {DRAWN}.",
    "bodypose3d_static.png": f"bodypose3d_cam0, the median as background: it holds him in the chair. {DRAWN}.",
    "bodypose3d_mog2.png": f"bodypose3d_cam0, MOG2. {DRAWN}.",
    "hands.png": "hand_keypoints. Green: the region of skin that holds most keypoints; yellow: its axis; cross: the "
    "labelled tip of the index finger.",
}


@dataclass(frozen=True)
class PersonReal:
    """The detectors of a person on real video."""

    data: Annotated[Path, tyro.conf.Positional]
    """Folder that holds pose2sim_single, opencv_vtest, bodypose3d_cam0 and hand_keypoints."""
    out: Path = Path("person_real")
    """Folder for the table and the sheets."""


def main() -> int:
    """All recordings, each row printed as it comes."""
    options = tyro.cli(PersonReal)
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    lines = ["| recording | figure | reached |", "|---|---|---|"]
    sys.stdout.write("\n".join(lines) + "\n")
    rows: list[Row] = []
    for part in (balancing, passing, sitting, hands):
        for row in part(options.data, options.out):
            rows.append(row)
            lines.append(f"| {' | '.join(row)} |")
            sys.stdout.write(lines[-1] + "\n")
            sys.stdout.flush()
    (options.out / "person_real.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_page(options.out / "report.html", page(rows, options.out))
    return 0


def page(rows: list[Row], folder: Path) -> str:
    """The table and the sheets of a folder on one page."""
    pictures = []
    for name, caption in SHEETS.items():
        uri = to_data_uri(read_image(folder / name)[..., ::-1])
        pictures.append((Markup('<img src="{}" alt="{}" style="width: 100%">').format(uri, caption), caption))
    return render(
        "study.html.j2",
        kind="experiment",
        title="The detectors of a person on real video",
        subtitle="Silhouettes and heads to look at, beside what was counted",
        sections=[("found", "What was found"), ("pictures", "In pictures"), ("figures", "All figures"),
                  ("provenance", "Provenance")],
        found="The man of pose2sim_single is compared with joints labelled by eye. opencv_vtest and bodypose3d_cam0 "
        "have no truth: their silhouettes and heads are counted, and here to be judged by eye.",
        figures=pictures,
        rows=Table(["recording", "figure", "reached"], [[cell.replace("`", "") for cell in row] for row in rows]),
        provenance=origin_table(provenance("python experiments/person_real.py", [], 0), {}, None),
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------- pose2sim_single


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
    image = scaled(image, np.median((median + 1) / (image[::4, ::4] + 1.0), axis=(0, 1)))
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
            region = thesis_forearm(images[k], one[0], SETTINGS.thesis).region
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
        arm = find_arm(rig, crops, *head_of(rig, ones))
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


# ------------------------------------------------------------------------------- recordings without any truth


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


# ---------------------------------------------------------------------------------------------- hand_keypoints


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


# --------------------------------------------------------------------------------------------------- pictures


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


def sheet(path: Path, pictures: list[tuple[str, Image]], columns: int, width: int = 300) -> None:
    """Pictures under their titles in rows, all of one width; each row is as high as its highest."""
    small = []
    for title, picture in pictures:
        size = width, round(width * picture.shape[0] / picture.shape[1])
        small.append(titled(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA)), title, "", lines=1))
    small += [np.zeros((1, width, 3), np.uint8)] * (-len(small) % columns)
    rows = []
    for first in range(0, len(small), columns):
        row = small[first : first + columns]
        height = max(one.shape[0] for one in row)
        rows.append(np.hstack([cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, 0, cv2.BORDER_CONSTANT) for p in row]))
    cv2.imwrite(str(path), np.vstack(rows))


if __name__ == "__main__":
    raise SystemExit(main())
