"""Images of more than 8 bits."""

import cv2
import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.depth import full_scale
from jaxpoint.io.images import share_white
from jaxpoint.io.video import open_frames

SCENE = np.linspace(0.02, 0.9, 48 * 32).reshape(32, 48)  # of white
EIGHT = np.round(255 * SCENE).astype(np.uint8)


def folder_of(tmp_path, images, suffix="png"):
    for k, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{k}.{suffix}"), image)
    return open_frames(tmp_path)


def whole(bits):
    return np.round((2**bits - 1) * SCENE).astype(np.uint16)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("suffix", ["png", "tif", "pgm"])
def test_whole_numbers_are_scaled_by_what_the_recording_holds(tmp_path, bits, suffix):
    source = folder_of(tmp_path, [whole(bits) // 4, whole(bits)], suffix)
    assert source.white == 2**bits - 1
    for place, wanted in ((0, EIGHT // 4), (1, EIGHT)):  # the dark image like the bright one
        image = source.read(place)
        assert image.dtype == np.uint8
        assert np.abs(image[..., 1].astype(int) - wanted).max() <= 1


def test_a_pgm_keeps_its_high_byte_first(tmp_path):
    for k in range(2):
        (tmp_path / f"{k}.pgm").write_bytes(b"P5\n48 32\n1023\n" + whole(10).astype(">u2").tobytes())
    assert np.abs(open_frames(tmp_path).read(1)[..., 0].astype(int) - EIGHT).max() <= 1


def test_numbers_aligned_to_the_left_need_no_scale():
    assert full_scale([whole(12) << 4]) == 65535
    assert full_scale([whole(12) // 3 << 4]) == 65535  # the brightest of a dim recording
    assert full_scale([EIGHT.astype(np.uint16) * 4]) == 1023  # 8 bits in 10, not 14 aligned to the left
    assert full_scale([EIGHT.astype(np.uint16)]) == 255


@pytest.mark.parametrize("white", [1.0, 255.0, 4095.0])
def test_fractions_are_scaled_by_one_or_by_what_they_hold(tmp_path, white):
    image = (white * SCENE).astype(np.float32)
    source = folder_of(tmp_path, [image, image - white * 0.1], "tif")
    assert np.abs(source.read(0)[..., 2].astype(int) - EIGHT).max() <= 1
    assert source.read(1).min() == 0  # negative ones are black


def test_two_recordings_of_a_camera_are_scaled_alike(tmp_path):
    for name, image in (("wave", whole(12)), ("empty", whole(12) // 8)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "0.png"), image)
    wave, empty = open_frames(tmp_path / "wave"), open_frames(tmp_path / "empty")
    share_white(wave, empty)
    assert (wave.white, empty.white) == (4095, 4095)


def test_images_that_cannot_be_of_one_recording(tmp_path):
    source = folder_of(tmp_path, [whole(12), EIGHT])
    with pytest.raises(FileFormatError, match=r"1\.png' holds 8-bit numbers but '0\.png' 16-bit numbers"):
        source.read(1)
    broken = np.where(SCENE > 0.5, np.nan, SCENE).astype(np.float32)
    cv2.imwrite(str(tmp_path / "2.tif"), broken)
    with pytest.raises(FileFormatError, match=rf"holds {np.isnan(broken).sum()} non-finite values"):
        open_frames(tmp_path).read(2)
