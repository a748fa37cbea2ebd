"""Targets, and tracks of several points."""

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.track_files import load_tracks, read_tracks, save_tracks
from jaxpoint.targets import Target
from jaxpoint.tracks import PointPrior, Tracks, join_tracks

SIZES = np.array([[640, 480], [640, 480]])


def tracks_of(frames, points, **more):
    pixels = 10.0 + np.arange(len(frames) * 4.0).reshape(-1, 2, 2)
    return Tracks.from_pixels(pixels, SIZES, frame_ids=np.array(frames), point_ids=np.array(points), **more)


def test_shapes_are_rigid_about_their_middle():
    board = Target.chessboard(4, 3, 0.1)
    assert board.points.shape == (12, 3)
    np.testing.assert_allclose(board.points[5], [0.1, 0.1, 0.0])
    for target, freedoms in ((board, 6), (Target.wand(0.5), 5), (Target("line", np.outer([0, 1, 3], [1, 2, 2.0])), 5)):
        assert target.freedoms == freedoms
        apart = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (target.points, target.centred)]
        np.testing.assert_allclose(*apart, atol=1e-12)
        assert (target.centred[:, 1:] == 0).all() == (freedoms == 5)


@pytest.mark.parametrize(
    ("points", "sigma", "said"),
    [
        (np.zeros((1, 3)), 0.0, "needs two points"),
        (np.array([[0.0, 0, 0], [0, 0, np.nan]]), 0.0, "not finite"),
        (np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]), 0.0, "Points 1 and 2 .* at one place"),
        (np.eye(3), -1.0, "sigma -1.0; it must be 0 or more"),
    ],
)
def test_what_is_no_target_is_refused(points, sigma, said):
    with pytest.raises(ValueError, match=said):
        Target("thing", points, sigma)


def test_rows_are_sorted_by_point_and_frame_and_their_series_do_not_touch():
    tracks = tracks_of([3, 1, 2, 1, 3], [1, 0, 0, 1, 0])
    assert tracks.point_ids.tolist() == [0, 0, 0, 1, 1]
    assert tracks.frame_ids.tolist() == [1, 2, 3, 1, 3]
    steps = np.diff(tracks.series_ids)
    assert steps[[0, 1, 3]].tolist() == [1, 1, 2]
    assert steps[2] > 1e9
    assert tracks.of_one_point().frame_ids.tolist() == [1, 2, 3]
    assert tracks.rows_by_name() == {"1": 0, "2": 1, "3": 2}
    assert tracks.extent == "5 points in 3 frames"
    assert tracks.of_one_point().select_cameras([0]).frames == 3


def test_rows_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="Point 1 has two rows in frame 3"):
        tracks_of([3, 3], [1, 1])
    with pytest.raises(ValueError, match="has points 0 to 1, but a row has point 2"):
        tracks_of([3, 4], [1, 2], target=Target.wand(1.0))
    with pytest.raises(ValueError, match="positive sigmas"):
        tracks_of([3, 4], [1, 2], prior=PointPrior(np.zeros((2, 3)), np.zeros(2)))


def test_joined_tracks_keep_targets_points_and_priors(tmp_path):
    light = Tracks.from_pixels(np.full((3, 2, 2), 5.0), SIZES)
    wand = tracks_of([0, 0, 1, 1], [0, 1, 0, 1], target=Target.wand(0.4))
    marks = tracks_of([0, 0], [0, 1], prior=PointPrior(np.ones((2, 3)), np.array([0.01, np.inf])))
    both = join_tracks(light, wand, marks)
    assert both.frames == 9
    assert both.target_ids.tolist() == [-1] * 5 + [0] * 4
    assert both.point_ids.tolist() == [0, 0, 0, 1, 2, 0, 0, 1, 1]  # marks are other points than the light
    assert np.isfinite(both.prior.sigmas).sum() == 1
    save_tracks(tmp_path / "tracks.npz", both)
    again = load_tracks(tmp_path / "tracks.npz")
    assert again.targets == both.targets
    for name in ("pixels", "frame_ids", "point_ids", "target_ids"):
        np.testing.assert_array_equal(getattr(again, name), getattr(both, name))
    np.testing.assert_array_equal(again.prior.sigmas, both.prior.sigmas)
    with pytest.raises(ValueError, match="Targets need different names"):
        join_tracks(wand, wand)
    with pytest.raises(ValueError, match="same cameras"):
        join_tracks(light, Tracks.from_pixels(np.full((3, 2, 2), 5.0), SIZES + 1))


def test_a_table_tells_points_apart(tmp_path):
    lines = ["frame,point,camera,x,y,width,height"]
    lines += [f"{f},{p},cam_{c},{10 * f + p + c},{20 + f},640,480" for f in range(3) for p in (0, 1) for c in (0, 1)]
    (tmp_path / "wand.csv").write_text("\n".join(lines))
    tracks = read_tracks(tmp_path / "wand.csv")
    assert tracks.point_ids.tolist() == [0, 0, 0, 1, 1, 1]
    assert tracks.pixels[4, 1].tolist() == [12.0, 21.0]
    (tmp_path / "wand.csv").write_text("\n".join([*lines, lines[-1]]))
    with pytest.raises(
        FileFormatError, match="camera 'cam_1' has a second line for frame 2 and point 1; keep one line"
    ):
        read_tracks(tmp_path / "wand.csv")
