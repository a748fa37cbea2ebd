"""Small videos whose frames tell their number, with whatever time stamps a test wants."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SIZE = (48, 32)  # px
TICKS = 90_000  # a second


def picture(value: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A picture that tells its number: a bright square whose place depends on it."""
    image = np.full((size[1], size[0], 3), 20, dtype=np.uint8)
    x, y = value % 10 * 4, value // 10 * 4
    image[y : y + 4, x : x + 4] = 250
    return image


def value_of(image: np.ndarray) -> int:
    """The number of a picture."""
    rows, columns = np.nonzero(image[..., 1] > 150)
    return round(columns.mean() - 1.5) // 4 + 10 * (round(rows.mean() - 1.5) // 4)


def write_stamped(path: Path, images, times, aspect: Fraction | None = None) -> Path:
    """A video with these time stamps (s), and with this width over height of a pixel where one is given."""
    container = av.open(str(path), "w")
    stream = container.add_stream("libx264", rate=30)
    height, width = images[0].shape[:2]
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
    stream.codec_context.time_base = Fraction(1, TICKS)
    stream.options = {"crf": "12"}
    if aspect is not None:
        stream.codec_context.sample_aspect_ratio = aspect
    for image, time in zip(images, times):
        frame = av.VideoFrame.from_ndarray(image, format="bgr24")
        frame.time_base, frame.pts = Fraction(1, TICKS), round(time * TICKS)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))
    container.close()
    return path
