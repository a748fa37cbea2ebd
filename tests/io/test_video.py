import struct
from fractions import Fraction

import cv2
import numpy as np
import pytest
from videos import picture, value_of, write_stamped

from jaxpoint.errors import FileFormatError
from jaxpoint.io.video import open_frames


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


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "bmp", "PNG", "ppm"])
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
    (tmp_path / "cameras" / "cam_0").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "cameras" / "cam_0" / "0.png"), picture(0))
    with pytest.raises(FileFormatError, match="the folder of images 'cam_0', but no images; give these"):
        open_frames(tmp_path / "cameras")
    with pytest.raises(FileFormatError, match="no video or folder"):
        open_frames(tmp_path / "nothing.mp4")


def test_a_frame_in_two_formats_is_not_two(tmp_path):
    for name in ("0.png", "1.png", "1.jpg"):
        cv2.imwrite(str(tmp_path / name), picture(0))
    with pytest.raises(FileFormatError, match=r"1\.jpg' and '1\.png' are one frame in two formats"):
        open_frames(tmp_path)


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


def test_dropped_frames_leave_gaps_in_the_time_stamps(tmp_path):
    kept = np.delete(np.arange(60), [10, 11, 40])
    for suffix in ("mp4", "mkv"):
        source = open_frames(write_stamped(tmp_path / f"a.{suffix}", [picture(k) for k in kept], kept / 30))
        assert len(source) == 57
        np.testing.assert_allclose(source.times, kept / 30, atol=1e-3)
        assert [value_of(image) for _, image in source.stream(np.array([9, 10, 56]))] == [9, 12, 59]
        # A seek by number ends elsewhere where the rate varies.
        assert [value_of(source.read(index)) for index in (0, 10, 38, 56)] == kept[[0, 10, 38, 56]].tolist()


def test_an_empty_chunk_of_an_avi_is_a_gap(tmp_path):
    """Capture programs write these for frames that did not arrive."""
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (48, 32))
    for frame in range(30):
        writer.write(picture(frame))
    writer.release()
    content = (tmp_path / "a.avi").read_bytes()
    start = place = content.find(b"movi") + 4
    chunks = []
    while content[place : place + 4] == b"00dc":
        length = 8 + struct.unpack("<I", content[place + 4 : place + 8])[0]
        chunks.append(content[place : place + length + length % 2])
        place += length + length % 2
    chunks[10] = chunks[11] = b"00dc" + struct.pack("<I", 0)
    body = b"movi" + b"".join(chunks)
    (tmp_path / "b.avi").write_bytes(content[: start - 8] + struct.pack("<I", len(body)) + body)
    source = open_frames(tmp_path / "b.avi")
    np.testing.assert_allclose(source.times, np.delete(np.arange(30), [10, 11]) / 20)
    assert [value_of(image) for _, image in source.stream()] == np.delete(np.arange(30), [10, 11]).tolist()


def test_a_video_may_state_the_aspect_of_its_pixels(tmp_path, video):
    images, times = [picture(k) for k in range(4)], np.arange(4) / 30
    stated = write_stamped(tmp_path / "pal.mp4", images, times, Fraction(16, 15))
    assert open_frames(stated).pixel_aspect == pytest.approx(16 / 15)
    avi = tmp_path / "silent.avi"
    writer = cv2.VideoWriter(str(avi), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (48, 32))
    for image in images:
        writer.write(image)
    writer.release()
    assert open_frames(avi).pixel_aspect is None


def test_a_video_whose_stamps_start_late_is_not_cut_off(tmp_path):
    """Matroska counts its frames by the length, the time before the first one among it."""
    source = open_frames(write_stamped(tmp_path / "a.mkv", [picture(k) for k in range(30)], 0.5 + np.arange(30) / 30))
    assert len(list(source.stream())) == len(source) == 30
    assert source.start == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(source.times, np.arange(30) / 30, atol=1e-3)
