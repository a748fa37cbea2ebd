import cv2
import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.video import open_frames


def picture(value, size=(48, 32)):
    """A picture that tells its number: a bright square whose place depends on it."""
    image = np.full((size[1], size[0], 3), 20, dtype=np.uint8)
    x, y = value % 10 * 4, value // 10 * 4
    image[y : y + 4, x : x + 4] = 250
    return image


def value_of(image):
    """The number of a picture."""
    rows, columns = np.nonzero(image[..., 1] > 150)
    return round(columns.mean() - 1.5) // 4 + 10 * (round(rows.mean() - 1.5) // 4)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "wave.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 20.0, (48, 32))
    for frame in range(60):
        writer.write(picture(frame))
    writer.release()
    return path


def test_a_video_knows_its_frames(video):
    source = open_frames(video)
    assert len(source) == 60
    assert source.size == (48, 32)
    assert not source.numbered
    np.testing.assert_array_equal(source.frame_ids, np.arange(60))
    np.testing.assert_allclose(source.times, np.arange(60) / 20.0)


def test_a_video_streams_and_seeks_the_same_frames(video):
    source = open_frames(video)
    assert [(index, value_of(image)) for index, image in source.stream()] == [(i, i) for i in range(60)]
    assert [value_of(image) for _, image in source.stream(np.array([3, 17, 59]))] == [3, 17, 59]
    assert [value_of(source.read(index)) for index in (41, 0, 59)] == [41, 0, 59]
    with pytest.raises(IndexError, match="60 frames, no position 60"):
        source.read(60)


def test_folders_come_in_natural_order_with_the_numbers_of_their_names(tmp_path):
    for number in (2, 10, 9, 30):
        cv2.imwrite(str(tmp_path / f"cam1_{number}.png"), picture(number))
    (tmp_path / "notes.txt").write_text("not an image")
    (tmp_path / "._cam1_2.png").write_bytes(b"left by another system")
    source = open_frames(tmp_path)
    assert source.numbered
    assert source.times is None
    np.testing.assert_array_equal(source.frame_ids, [2, 9, 10, 30])
    assert [value_of(image) for _, image in source.stream()] == [2, 9, 10, 30]
    assert value_of(source.read(3)) == 30
    with pytest.raises(IndexError, match="no position -1"):
        source.read(-1)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "bmp", "PNG"])
def test_all_kinds_of_images(tmp_path, suffix):
    cv2.imwrite(str(tmp_path / f"0.{suffix}"), picture(7))
    assert value_of(open_frames(tmp_path).read(0)) == 7


def test_names_without_rising_numbers_count_by_position(tmp_path):
    for name in ("a1.png", "b1.png", "c.png"):
        cv2.imwrite(str(tmp_path / name), picture(1))
    source = open_frames(tmp_path)
    assert not source.numbered
    np.testing.assert_array_equal(source.frame_ids, [0, 1, 2])


def test_an_empty_folder_and_a_missing_path(tmp_path):
    with pytest.raises(FileFormatError, match="holds no images"):
        open_frames(tmp_path)
    with pytest.raises(FileFormatError, match="no video or folder"):
        open_frames(tmp_path / "nothing.mp4")


def test_a_single_image_is_not_a_recording(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), picture(0))
    with pytest.raises(FileFormatError, match="single image"):
        open_frames(tmp_path / "a.png")


def test_the_first_image_of_another_size_is_named(tmp_path):
    for number in range(4):
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture(0, (40 if number >= 2 else 48, 32)))
    source = open_frames(tmp_path)
    with pytest.raises(FileFormatError, match=r"2\.png' is 40 x 32 px but '0\.png' is 48 x 32"):
        list(source.stream())


@pytest.mark.parametrize("content", [b"", b"this is no image"])
def test_an_image_that_cannot_be_decoded_is_named(tmp_path, content):
    cv2.imwrite(str(tmp_path / "0.png"), picture(0))
    (tmp_path / "1.png").write_bytes(content)
    with pytest.raises(FileFormatError, match=rf"1\.png' \({len(content)} bytes\) cannot be decoded"):
        list(open_frames(tmp_path).stream())


@pytest.mark.parametrize("content", [b"", b"no video at all" * 100])
def test_an_empty_or_foreign_video(tmp_path, content):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="0 frames decoded"):
        open_frames(path)


def test_a_truncated_video_says_how_many_frames_were_decoded(tmp_path):
    """An AVI keeps the count in its header, so a copy that was cut off still opens."""
    whole, cut = tmp_path / "whole.avi", tmp_path / "cut.avi"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (48, 32))
    for frame in range(60):
        writer.write(picture(frame))
    writer.release()
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    source = open_frames(cut)
    with pytest.raises(FileFormatError, match=r"ends early: \d\d of 60 frames"):
        list(source.stream())


def test_what_cannot_be_decoded_is_left_out_where_that_is_asked_for(tmp_path, video):
    for number in range(4):
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture(number))
    (tmp_path / "1.png").write_bytes(b"")
    lost = []
    assert [index for index, _ in open_frames(tmp_path).readable(np.arange(4), lost)] == [0, 2, 3]
    assert "1.png' (0 bytes) cannot be decoded" in str(lost[0])
    assert [index for index, _ in open_frames(video).readable(np.arange(2))] == [0, 1]
