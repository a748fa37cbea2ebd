"""Sessions without timestamps.csv: what belongs together by names and by time stamps."""

import cv2
import numpy as np
import pytest
from videos import picture, write_stamped

from jaxpoint.errors import InsufficientDataError
from jaxpoint.io.session import open_session

LOST = [5, 6, 17]


def folder_of(path, name, frames):
    path.mkdir(parents=True)
    for k in frames:
        cv2.imwrite(str(path / f"{name(k)}.png"), picture(k))


def test_lost_images_stay_gaps(tmp_path):
    folder_of(tmp_path / "videos" / "cam0", lambda k: f"{k:04d}_cam0", range(24))
    folder_of(tmp_path / "videos" / "cam1", lambda k: f"{k:04d}_cam1", np.delete(np.arange(24), LOST))
    (tmp_path / "videos" / "masks").mkdir()
    cv2.imwrite(str(tmp_path / "videos" / "masks" / "cam0.png"), picture(0))
    session = open_session(tmp_path)
    assert session.names == ("cam0", "cam1")
    np.testing.assert_array_equal(session.frame_ids, np.arange(24))
    np.testing.assert_array_equal(np.flatnonzero(session.frame_index[:, 1] < 0), LOST)
    assert "Images are paired by the number at the start of the names." in session.notes


def test_names_that_contradict_ask_for_timestamps(tmp_path):
    folder_of(tmp_path / "cam0", lambda k: f"a{k}", range(24))
    folder_of(tmp_path / "cam1", lambda k: f"b{k + 1}", range(24))
    with pytest.raises(InsufficientDataError, match="as if each counted for itself; say which belong together in a t"):
        open_session(tmp_path)


def test_dropped_frames_of_a_video_stay_gaps(tmp_path):
    (tmp_path / "videos").mkdir()
    kept = np.delete(np.arange(40), LOST)
    write_stamped(tmp_path / "videos" / "cam0.mp4", [picture(k) for k in range(40)], np.arange(40) / 30)
    write_stamped(tmp_path / "videos" / "cam1.mp4", [picture(k) for k in kept], kept / 30)
    session = open_session(tmp_path)
    np.testing.assert_array_equal(np.flatnonzero(session.frame_index[:, 1] < 0), LOST)
    np.testing.assert_allclose(session.times, np.arange(40) / 30, atol=1e-3)
    assert session.notes == ("The time stamps of 'cam1' skip 3 frames; they stay gaps.",)
