"""Tracks in files: round trips, real corners, and errors that say where."""

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.track_files import load_reasons, load_tracks, read_tracks, save_tracks
from jaxpoint.tracks import Tracks

LONG = """frame,time,camera,x,y
4,0.4,cam_10,1.5,2.5
4,0.42,cam_2,3,4
7,0.7,cam_2,,
7,0.7,cam_10,5,nan
9,0.9,cam_2,6,7
"""


def example(times: bool = True) -> Tracks:
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 400, (6, 3, 2))
    pixels[2, 1] = np.nan
    return Tracks.from_pixels(
        pixels,
        np.array([[640, 480], [640, 480], [1280, 720]]),
        frame_ids=np.arange(6) * 2 + 10,
        times=np.arange(6) / 25.0 if times else None,
        names=("links", "rechts", "oben é"),
    )


def assert_same(first: Tracks, second: Tracks) -> None:
    assert first.names == second.names
    for name in ("pixels", "visible", "image_sizes", "frame_ids"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert (first.times is None) == (second.times is None)
    if first.times is not None and second.times is not None:
        np.testing.assert_array_equal(first.times, second.times)


@pytest.mark.parametrize("times", [True, False])
def test_npz_round_trip(tmp_path, times):
    path = tmp_path / "tracks.npz"
    save_tracks(path, example(times))
    assert_same(read_tracks(path), example(times))
    assert load_reasons(path) is None
    assert [file.name for file in tmp_path.iterdir()] == ["tracks.npz"]  # nothing left beside


def test_reasons_travel_along(tmp_path):
    path = tmp_path / "tracks.npz"
    reasons = np.arange(18).reshape(6, 3) % 2
    save_tracks(path, example(), reasons, ("found", "weak"))
    loaded = load_reasons(path)
    assert loaded is not None
    np.testing.assert_array_equal(loaded[0], reasons)
    assert loaded[1] == ("found", "weak")
    with pytest.raises(ValueError, match="values below 1"):
        save_tracks(path, example(), reasons, ("found",))


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "tracks.npz"
    save_tracks(path, example())

    def break_off(file, **arrays):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", break_off)
    with pytest.raises(KeyboardInterrupt):
        save_tracks(path, example(times=False))
    assert_same(load_tracks(path), example())
    assert [file.name for file in tmp_path.iterdir()] == ["tracks.npz"]


def test_damaged_npz(tmp_path):
    path = tmp_path / "tracks.npz"
    save_tracks(path, example())
    whole = path.read_bytes()
    for content in (b"", b"no archive at all", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=r"not an \.npz file or is cut off"):
            load_tracks(path)
    np.savez(path, pixels=np.zeros((1, 1, 2)))
    with pytest.raises(FileFormatError, match="holds no jaxpoint tracks"):
        load_tracks(path)
    np.savez(path, format="jaxpoint-tracks", version=3)
    with pytest.raises(FileFormatError, match="has version 3, this jaxpoint reads 1 to 2"):
        load_tracks(path)
    np.savez(path, format="jaxpoint-tracks", version=1)
    with pytest.raises(FileFormatError, match="is damaged"):
        load_tracks(path)


def test_long_csv(tmp_path):
    path = tmp_path / "light.csv"
    path.write_text(LONG)
    tracks = read_tracks(path, image_sizes=(640, 480))
    assert tracks.names == ("cam_2", "cam_10")
    assert tracks.frame_ids.tolist() == [4, 7, 9]
    np.testing.assert_array_equal(tracks.visible, [[1, 1], [0, 0], [1, 0]])
    np.testing.assert_array_equal(tracks.pixels[0], [[3, 4], [1.5, 2.5]])
    np.testing.assert_allclose(tracks.times, [0.41, 0.7, 0.9])
    assert read_tracks(path, image_sizes=(640, 480), one_based=True).pixels[2, 0].tolist() == [5, 6]


def test_long_csv_finds_image_sizes(tmp_path):
    path = tmp_path / "light.csv"
    path.write_text(LONG)
    with pytest.raises(FileFormatError, match="does not say how large the images are"):
        read_tracks(path)
    by_name = read_tracks(path, image_sizes={"cam_10": (10, 20), "cam_2": (30, 40)})
    assert by_name.names == ("cam_10", "cam_2")
    assert by_name.image_sizes.tolist() == [[10, 20], [30, 40]]
    with pytest.raises(FileFormatError, match="no image size is known for camera 'cam_2'"):
        read_tracks(path, image_sizes={"cam_10": (10, 20)})
    (tmp_path / "cameras.csv").write_text("camera,width,height\ncam_10,640,480\ncam_2,1280,720\n")
    assert read_tracks(path).image_sizes.tolist() == [[640, 480], [1280, 720]]
    path.write_text("frame,camera,x,y,width,height\n0,b,1,2,640,480\n0,a,1,2,320,240\n")
    assert read_tracks(path).image_sizes.tolist() == [[320, 240], [640, 480]]
    assert read_tracks(path).times is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,time,who,x,y\n1,0,a,1,2\n", r"has no column 'camera' \(it has frame, time, who, x, y\).*commas"),
        ("frame camera x y\n1 a 1 2\n", "separated by commas"),
        (
            "1,a,2,3\n2,a,2,3\n",
            r"starts with values \(1, a, 2, 3\), not names; its first line must be frame,camera,x,y",
        ),
        ("frame,camera,x,y\n", "a header but no rows"),
        ("", "is empty; its first line must be frame,camera,x,y"),
        ("frame,camera,x,y\n1,a,2,3\n1,b,2\n", "line 3: 3 values under 4 columns"),
        ("frame,camera,x,y\n1,a,2,3\n1.5,b,2,3\n", "line 3: column 'frame' is 1.5, which is not a whole number"),
        ("frame,camera,x,y\n1,a,2,three\n", "line 2: column 'y' is 'three', which is not a number"),
        ("frame,camera,x,y\n1,a,2,inf\n", "line 2: column 'y' is inf; give a finite number"),
        ("frame,camera,x,y\n1,,2,3\n", "line 2: column 'camera' is empty"),
        ("frame,camera,x,y\n1,a,2,3\n\n1,a,2,3\n", "line 4: camera 'a' has a second line for frame 1"),
        ("frame,time,camera,x,y\n1,0.5,a,2,3\n2,,a,2,3\n", "frame 2 has no time, others do"),
        (
            "frame,camera,x,y,width,height\n1,a,2,3,64,48\n2,a,2,3,64,40\n",
            r"is \(64, 40\) here and \(64, 48\) before",
        ),
        ("frame,camera,x,y,x\n1,a,2,3,4\n", "column 'x' twice"),
    ],
)
def test_broken_csv_says_where(tmp_path, text, message):
    path = tmp_path / "light.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_tracks(path, image_sizes=(640, 480))


def test_times_have_the_unit_that_the_column_says(tmp_path):
    path = tmp_path / "light.csv"
    for column, a_second in (("time", 1), ("time_s", 1), ("time_ms", 10**3), ("time_us", 10**6), ("time_ns", 10**9)):
        start = 1_700_000_000 * a_second
        path.write_text(f"frame,{column},camera,x,y\n0,{start},a,1,2\n1,{start + a_second},a,3,4\n")
        times = read_tracks(path, image_sizes=(64, 48)).times
        assert times is not None
        np.testing.assert_allclose(times, [1.7e9, 1.7e9 + 1], rtol=0, atol=1e-6)
    path.write_text("frame,time_s,camera,x,y\n0,0,a,1,2\n1,60,a,3,4\n")  # a light put down here and there
    assert read_tracks(path, image_sizes=(64, 48)).times is not None


@pytest.mark.parametrize(("step", "unit"), [(33, "time_ms"), (33_333, "time_us"), (33_333_333, "time_ns")])
def test_times_that_are_no_seconds_are_asked_for_their_unit(tmp_path, step, unit):
    lines = [f"{frame},{step * frame},a,{frame},2" for frame in range(5)]
    (tmp_path / "light.csv").write_text("\n".join(["frame,time,camera,x,y", *lines]))
    with pytest.raises(FileFormatError, match=f"rises by .* from frame to frame.*name it {unit} if"):
        read_tracks(tmp_path / "light.csv", image_sizes=(64, 48))


def test_stand_ins_for_not_seen_are_no_lights(data_folder, tmp_path):
    cases = data_folder.parent / "cases" / "08-missing-as-zero"
    for name, place in (("00", "0, 0"), ("minus1", "-1, -1")):
        with pytest.raises(FileFormatError, match=rf"has \d+ of 600 .*\({place}\).*leave the cells of x and y empty"):
            read_tracks(cases / f"{name}.csv")
    seen = read_tracks(cases / "nan.csv")
    assert (seen.frames, int(seen.visible.sum())) == (600, 1915)
    pixels = np.where(seen.visible[..., None], seen.pixels, 0.0)
    save_tracks(tmp_path / "tracks.npz", Tracks.from_pixels(pixels, seen.image_sizes))
    with pytest.raises(FileFormatError, match=r"at one and the same pixel, \(0, 0\)"):
        read_tracks(tmp_path / "tracks.npz")


def test_caliscope_corners(data_folder):
    path = data_folder / "caliscope_charuco4/calibration/extrinsic/CHARUCO/xy_CHARUCO.csv"
    tracks = read_tracks(path)
    assert tracks.names == ("cam_0", "cam_1", "cam_2", "cam_3")
    assert tracks.visible.sum() == 2175  # its README
    assert tracks.frames == 660
    assert (tracks.image_sizes == [1280, 720]).all()
    (first,) = np.flatnonzero((tracks.point_ids == 4) & (tracks.frame_ids == 35))
    np.testing.assert_allclose(tracks.pixels[first, 0], [628.250977, 213.715607])
    np.testing.assert_allclose(tracks.targets[0].points[4], [0.108, 0.108, 0.0])
    assert read_tracks(path, image_sizes=(640, 480)).image_sizes[0].tolist() == [640, 480]


def test_what_is_no_tracks_file(tmp_path):
    with pytest.raises(FileFormatError, match=r"has no points\.dat"):
        read_tracks(tmp_path)
    with pytest.raises(FileFormatError, match="There is no file or folder"):
        read_tracks(tmp_path / "nothing")
    with pytest.raises(FileFormatError, match="There is no file"):
        read_tracks(tmp_path / "nothing.npz")
    (tmp_path / "tracks.mat").write_bytes(b"\0")
    with pytest.raises(FileFormatError, match="is no tracks file"):
        read_tracks(tmp_path / "tracks.mat")
    (tmp_path / "light.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="is not UTF-16 text"):
        read_tracks(tmp_path / "light.csv")


def test_points_dat_itself(data_folder):
    assert read_tracks(data_folder / "svoboda_strawlab2010" / "points.dat").frames == 1125


def test_points_of_a_long_table_may_have_names(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("frame,camera,point,x,y\n0,a,nose,1,2\n0,a,tail,3,4\n1,b,nose,5,6\n")
    tracks = read_tracks(path, image_sizes=(640, 480))
    assert tracks.point_names == ("nose", "tail")
    assert list(zip(tracks.point_ids.tolist(), tracks.frame_ids.tolist())) == [(0, 0), (0, 1), (1, 0)]
    path.write_text("frame,camera,point,x,y\n0,a,1,1,2\n0,a,tail,3,4\n")
    with pytest.raises(FileFormatError, match="line 3: column 'point' is 'tail', which is not a number"):
        read_tracks(path, image_sizes=(640, 480))
