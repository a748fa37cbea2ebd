"""Sessions as they go wrong in life, each made from a good one: a copy in which one camera is spoilt.

`good_session` writes one from images; every function below it takes a good session, the folder of the bad one and the
camera to spoil, and gives back that folder. Videos are Motion JPEG, in which every frame stands for itself.
"""

import csv
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from jaxpoint.io.session import recordings
from jaxpoint.io.video import open_frames

RATE = 12.5  # frames a second, of `good_session`
Images = Sequence[np.ndarray]


def good_session(folder: Path, images: dict[str, Images], calibration: Path | None = None) -> Path:
    """A session of synchronised cameras, each with its images, and with timestamps."""
    for camera, frames in images.items():
        write_video(folder / "videos" / f"{camera}.avi", frames)
    count = len(next(iter(images.values())))
    write_timestamps(folder, {camera: [(k, k, k / RATE) for k in range(count)] for camera in images})
    if calibration is not None:
        shutil.copyfile(calibration, folder / "calibration.json")
    return folder


def stops(good: Path, bad: Path, camera: str) -> Path:
    """The camera stops in the middle; the timestamps promise frames that its file no longer has."""
    return _respoilt(good, bad, camera, lambda images: images[: len(images) // 2])


def cut_off(good: Path, bad: Path, camera: str) -> Path:
    """The file of the camera is cut off in the middle, as by a full disk: its header promises all frames."""
    shutil.copytree(good, bad)
    path = recordings(bad / "videos")[camera]
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    return bad


def empty_file(good: Path, bad: Path, camera: str) -> Path:
    """The file of the camera holds nothing."""
    shutil.copytree(good, bad)
    recordings(bad / "videos")[camera].write_bytes(b"")
    return bad


def dropped(good: Path, bad: Path, camera: str, lost: Sequence[int] = (3, 4, 9)) -> Path:
    """Frames of the camera are lost, and the timestamps know it."""
    _respoilt(good, bad, camera, lambda images: [image for k, image in enumerate(images) if k not in lost])
    rows = read_timestamps(bad)
    left = [(frame, time) for frame, _, time in rows[camera] if frame not in lost]
    rows[camera] = [(frame, k, time) for k, (frame, time) in enumerate(left)]
    write_timestamps(bad, rows)
    return bad


def doubled(good: Path, bad: Path, camera: str, repeated: Sequence[int] = (3, 9)) -> Path:
    """The camera hands out these frames once more in place of the next ones."""

    def again(images: list[np.ndarray]) -> list[np.ndarray]:
        return [images[k - 1] if k - 1 in repeated else image for k, image in enumerate(images)]

    return _respoilt(good, bad, camera, again)


def drifting(good: Path, bad: Path, camera: str, rate: float = 1.01) -> Path:
    """The clock of the camera runs faster than the others'."""
    shutil.copytree(good, bad)
    rows = read_timestamps(bad)
    rows[camera] = [(frame, k, rate * time) for frame, k, time in rows[camera]]
    write_timestamps(bad, rows)
    return bad


def shorter(good: Path, bad: Path, camera: str) -> Path:
    """No timestamps, and the camera has fewer frames than the others."""
    stops(good, bad, camera)
    (bad / "timestamps.csv").unlink()
    return bad


def other_rate(good: Path, bad: Path, camera: str) -> Path:
    """No timestamps, and the camera took every second frame at half the rate."""
    _respoilt(good, bad, camera, lambda images: images[::2], rate=RATE / 2)
    (bad / "timestamps.csv").unlink()
    return bad


def other_size(good: Path, bad: Path, camera: str) -> Path:
    """The video of the camera has half the size that its calibration knows."""
    return _respoilt(good, bad, camera, lambda images: [image[::2, ::2] for image in images])


def dark(good: Path, bad: Path, camera: str) -> Path:
    """The lens cap is on: noise and nothing else."""
    rng = np.random.default_rng(0)

    def noise(images: list[np.ndarray]) -> list[np.ndarray]:
        return [rng.integers(0, 6, image.shape, dtype=np.uint8) for image in images]

    return _respoilt(good, bad, camera, noise)


def blown_out(good: Path, bad: Path, camera: str) -> Path:
    """Exposed far too long."""
    return _changed(good, bad, camera, lambda image: cv2.convertScaleAbs(image, alpha=6.0, beta=120))


def grey(good: Path, bad: Path, camera: str) -> Path:
    """A monochrome camera: three equal channels."""
    return _changed(good, bad, camera, lambda image: cv2.merge([cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)] * 3))


def half_out_of_view(good: Path, bad: Path, camera: str) -> Path:
    """The camera was turned: the left half of its view is now the right one, beside a blank wall."""

    def turned(image: np.ndarray) -> np.ndarray:
        moved = np.full_like(image, np.median(image, axis=(0, 1)))
        half = image.shape[1] // 2
        moved[:, half : 2 * half] = image[:, :half]
        return moved

    return _changed(good, bad, camera, turned)


def nobody(good: Path, bad: Path, camera: str) -> Path:
    """The camera shows the room alone, with other noise each time."""
    rng = np.random.default_rng(1)

    def still(images: list[np.ndarray]) -> list[np.ndarray]:
        alone = np.median(np.stack(images), axis=0)
        return [np.clip(alone + rng.normal(0, 2, alone.shape), 0, 255).astype(np.uint8) for _ in images]

    return _respoilt(good, bad, camera, still)


def write_video(path: Path, images: Images, rate: float = RATE) -> None:
    """A Motion JPEG video."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, (width, height))
    for image in images:
        writer.write(image)
    writer.release()


def write_timestamps(folder: Path, rows: dict[str, list[tuple[int, int, float]]]) -> None:
    """By camera: frame, position in the file, time in s."""
    with (folder / "timestamps.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("sync_index", "cam_id", "frame_index", "frame_time"))
        table.writerows((frame, camera, k, time) for camera, own in rows.items() for frame, k, time in own)


def read_timestamps(folder: Path) -> dict[str, list[tuple[int, int, float]]]:
    """The other way round."""
    rows: dict[str, list[tuple[int, int, float]]] = {}
    with (folder / "timestamps.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            one = int(row["sync_index"]), int(row["frame_index"]), float(row["frame_time"])
            rows.setdefault(row["cam_id"], []).append(one)
    return rows


def _changed(good: Path, bad: Path, camera: str, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    return _respoilt(good, bad, camera, lambda images: [change(image) for image in images])


def _respoilt(
    good: Path, bad: Path, camera: str, change: Callable[[list[np.ndarray]], Images], rate: float = RATE
) -> Path:
    """A copy of the session in which the images of one camera are others."""
    shutil.copytree(good, bad)
    path = recordings(bad / "videos")[camera]
    images = [image for _, image in open_frames(path).stream()]
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    write_video(path.with_suffix(".avi"), change(images), rate)
    return bad
