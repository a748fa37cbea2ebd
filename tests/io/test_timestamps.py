"""Frames of unsynchronised files on common moments."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.commands.inputs import tracks_from
from jaxpoint.config import InputSettings
from jaxpoint.errors import FileFormatError, InsufficientDataError
from jaxpoint.io.timestamps import read_timestamps, synchronise
from jaxpoint.tracks import PointPrior, Tracks

# Camera 1 starts one frame later and camera 0 drops sync index 12; rows in no order.
ROWS = [(10, 0, 0, 1.0), (12, 1, 1, 1.21), (11, 1, 0, 1.11), (11, 0, 1, 1.1), (13, 0, 2, 1.3), (13, 1, 2, 1.31)]


def write(path, rows, frame_index=True, camera="cam_id"):
    columns = ["sync_index", camera, "frame_index", "frame_time"]
    kept = columns if frame_index else [columns[i] for i in (0, 1, 3)]
    lines = [",".join(kept)] + [",".join(str(row[columns.index(column)]) for column in kept) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("frame_index", [True, False])
@pytest.mark.parametrize("camera", ["cam_id", "port"])
def test_frames_of_each_moment(tmp_path, frame_index, camera):
    stamps = read_timestamps(write(tmp_path / "timestamps.csv", ROWS, frame_index, camera))
    assert stamps.cameras == ("0", "1")
    assert stamps.sync_indices.tolist() == [10, 11, 12, 13]
    np.testing.assert_array_equal(stamps.frame_index, [[0, -1], [1, 0], [-1, 1], [2, 2]])
    np.testing.assert_allclose(stamps.times, [1.005, 1.105, 1.205, 1.305])


def test_tracks_come_to_common_moments(tmp_path):
    stamps = read_timestamps(write(tmp_path / "timestamps.csv", ROWS))
    own = np.stack([np.array([[1.0, 2], [3, 4], [5, 6]]), np.array([[10.0, 20], [30, 40], [50, 60]])], axis=1)
    own[1, 0] = np.nan  # camera 1 sees nothing in its own frame 1
    tracks = Tracks.from_pixels(own, np.array([[640, 480], [1280, 720]]), names=("cam_1", "cam_0"))
    together = synchronise(tracks, stamps)
    nothing = [0, 0]
    expected = [[nothing, [10, 20]], [[1, 2], [30, 40]], [nothing, nothing], [[5, 6], [50, 60]]]
    np.testing.assert_array_equal(together.pixels, expected)
    np.testing.assert_array_equal(together.visible, [[0, 1], [1, 1], [0, 0], [1, 1]])
    assert together.names == ("cam_1", "cam_0")
    assert together.frame_ids.tolist() == [10, 11, 12, 13]
    np.testing.assert_allclose(together.times, [1.005, 1.105, 1.205, 1.305])
    with pytest.raises(InsufficientDataError, match="frame 2 of camera 'cam_1', but the tracks end at frame 1"):
        synchronise(tracks.select_frames(np.arange(2)), stamps)


def test_several_points_come_each_to_common_moments(tmp_path):
    """As each does that is alone, but for moments in which nobody sees it."""
    stamps = read_timestamps(write(tmp_path / "timestamps.csv", ROWS))
    pixels = np.random.default_rng(0).uniform(1, 400, (2, 3, 2, 2))  # points, frames, cameras
    pixels[0, 1] = pixels[1, 0, 0] = np.nan
    sizes, names = np.array([[640, 480], [1280, 720]]), ("cam_0", "cam_1")
    both = Tracks.from_pixels(
        pixels.reshape(6, 2, 2), sizes, frame_ids=np.tile(np.arange(3), 2), names=names,
        point_ids=np.repeat([3, 7], 3), point_names=[f"p{i}" for i in range(8)],
    )  # fmt: skip
    together = synchronise(both, stamps)
    assert together.point_names == both.point_names
    for place, point in enumerate((3, 7)):
        alone = synchronise(Tracks.from_pixels(pixels[place], sizes, names=names), stamps)
        seen, own = alone.visible.any(axis=1), together.point_ids == point
        for name in ("pixels", "visible", "frame_ids", "times"):
            np.testing.assert_array_equal(getattr(together, name)[own], getattr(alone, name)[seen])
    known = replace(both, prior=PointPrior(np.zeros((6, 3)), np.ones(6)))
    with pytest.raises(InsufficientDataError, match="Points of known place have no moments"):
        synchronise(known, stamps)


def test_times_rise_where_cameras_of_other_clocks_drop_out(tmp_path):
    """Three clocks, one 5 s ahead and one that runs fast; the mean over those that have a frame would jump."""
    rows = [
        (moment, camera, moment, moment / 25 * rate + ahead)
        for camera, (ahead, rate) in enumerate([(0.0, 1.0), (5.0, 1.0), (0.2, 1.01)])
        for moment in range(100)
        if (moment + camera) % 4 and not (camera == 2 and moment > 60)
    ]
    times = read_timestamps(write(tmp_path / "timestamps.csv", rows)).times
    np.testing.assert_allclose(np.diff(times), 0.04, atol=0.001)


def test_select_by_any_spelling(tmp_path):
    stamps = read_timestamps(write(tmp_path / "timestamps.csv", ROWS))
    for name in ("1", "cam_1", "cam1", "cam_01", "camera-1", "port_1"):
        assert stamps.select([name]).frame_index[:, 0].tolist() == [0, 1, 2]
    assert stamps.select(["0"]).sync_indices.tolist() == [10, 11, 13]
    with pytest.raises(InsufficientDataError, match="no camera 'left', only 0, 1"):
        stamps.select(["left"])


def test_a_command_brings_its_tracks_together(tmp_path):
    lines = ["frame,camera,x,y", "0,cam_0,10,20", "0,cam_1,1,2", "2,cam_1,5,6", "2,cam_0,50,60"]
    (tmp_path / "light.csv").write_text("\n".join(lines) + "\n")
    stamps = write(tmp_path / "timestamps.csv", ROWS)
    tracks = tracks_from(tmp_path / "light.csv", InputSettings(image_size=(640, 480), timestamps=stamps))
    np.testing.assert_array_equal(tracks.visible, [[1, 0], [0, 1], [0, 0], [1, 1]])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([(10, 0, 0, 1.0), (10, 0, 1, 1.1)], "line 3: camera 0 has a second frame in sync_index 10"),
        ([(10, 0, 0, 1.0), (11, 0, 0, 1.1)], "line 3: frame_index 0 is negative or used twice"),
        ([(10, 0, 0, "nan")], "line 2: column 'frame_time' is nan"),
    ],
)
def test_contradictions(tmp_path, rows, message):
    with pytest.raises(FileFormatError, match=message):
        read_timestamps(write(tmp_path / "timestamps.csv", rows))


def test_caliscope_files(data_folder):
    folder = data_folder / "caliscope_charuco4/calibration/extrinsic"
    without = read_timestamps(folder / "timestamps.csv")
    assert without.frame_index.shape == (57, 4)  # its videos have 57 frames each
    np.testing.assert_array_equal(without.frame_index, np.arange(57)[:, None] + np.zeros((1, 4)))
    given = read_timestamps(folder / "CHARUCO/timestamps.csv")
    assert given.frame_index.shape == (56, 4)
    assert np.ptp(given.frame_time, axis=1).max() < 0.05
