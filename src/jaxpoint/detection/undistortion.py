"""Images without the distortion of their lens, of a whole recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rectification import flat_focal
from jaxpoint.camera.remap import undistortion_map
from jaxpoint.io.depth_files import write_image
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.images import ImageFolder

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Undistortion:
    """The maps of one camera, and K of its undistorted images."""

    intrinsics: Float[np.ndarray, "3 3"]  # px
    map_x: Float[np.ndarray, "H W"]  # px of the recorded image
    map_y: Float[np.ndarray, "H W"]

    @staticmethod
    def of(camera: Camera, size: tuple[int, int], zoom: float = 1.0) -> Undistortion:
        """Square pixels, the principal point where it was; `zoom` below 1 shows more of the image's surroundings."""
        with jax.enable_x64(True):
            focal = zoom * flat_focal([camera], size)
            cx, cy = np.asarray(camera.center, float)
            matrix = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1.0]])
            x, y = undistortion_map(camera, size, matrix)
        return Undistortion(matrix, np.asarray(x), np.asarray(y))

    def image(self, image: np.ndarray) -> np.ndarray:
        """The undistorted image; black where the recorded one shows nothing."""
        return np.asarray(cv2.remap(image, self.map_x, self.map_y, cv2.INTER_LINEAR))


def write_undistorted(source: FrameSource, undistortion: Undistortion, place: Path, progress: Progress) -> Path:
    """Write every frame: images into the folder `place` under their names, a video as `place`.mp4.

    Raises:
        OSError: it cannot be written.
        FileFormatError: a frame cannot be read.
    """
    frames = _undistorted(source, undistortion, progress)
    if isinstance(source, ImageFolder):
        place.mkdir(parents=True)
        for index, image in frames:
            write_image(place / f"{source.files[index].stem}.png", image)
        return place
    path = place.with_suffix(".mp4")
    rate = 30.0 if source.times is None or len(source.times) < 2 else 1.0 / float(np.median(np.diff(source.times)))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, source.size)
    if not writer.isOpened():
        raise OSError(f"No video of {source.size[0]} x {source.size[1]} px can be written as '{path.name}'")
    try:
        for _, image in frames:
            writer.write(image)
    finally:
        writer.release()
    return path


def _undistorted(
    source: FrameSource, undistortion: Undistortion, progress: Progress
) -> Iterator[tuple[int, np.ndarray]]:
    for done, (index, image) in enumerate(source.stream()):
        yield index, undistortion.image(image)
        progress(done + 1, len(source))
