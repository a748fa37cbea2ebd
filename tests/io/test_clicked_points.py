"""Points of DLTdv, Argus and easyWand, and wands in other tables."""

import numpy as np
import pytest

from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.cli import main
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.clicked_points import read_clicked_points, wand_tracks, with_static_points
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.track_files import read_tracks
from jaxpoint.triangulation import triangulate

SIZE = (2336, 1728)


def test_dltdv_points_lie_where_its_own_coefficients_have_them(data_folder):
    """The mean of the residuals that DLTdv stored, 0.1 px, is met only with its origin and direction of y."""
    folder = data_folder / "formats" / "dlt" / "dltdv7_2018-08-17_3cam"
    name = "DLTdv7_data_2018-08-17_P03_1000TMC{}.csv"
    tracks = read_tracks(folder / name.format("xypts"), image_sizes=(640, 512))
    rig = read_calibration(folder / "2018-08-17_wand_dltCoefs_round4.csv", size=(640, 512)).rig
    points = np.genfromtxt(folder / name.format("xyzpts"), delimiter=",", skip_header=1)
    known = np.isfinite(points).all(axis=1)
    seen = tracks.visible & known[:, None]
    assert seen.sum() > 100
    away = np.linalg.norm(np.asarray(rig.project(np.where(known[:, None], points, 0.0))) - tracks.pixels, axis=-1)
    assert np.median(away[seen]) < 0.2


@pytest.fixture(scope="module")
def wand(data_folder):
    """The published tutorial of easyWand; the wand's length is not stated, so 1 stands for it."""
    folder = data_folder / "easywand"
    tracks = wand_tracks(read_tracks(folder / "wandpts.csv", image_sizes=SIZE), 1.0, "wandpts.csv")
    return with_static_points(tracks, folder / "bkgdPts.csv", SIZE)


def test_a_wand_and_points_at_rest_calibrate_unknown_lenses(wand):
    assert (wand.frames, wand.visible.sum(), wand.cameras) == (110, 330, 3)
    end = with_covariance(calibrate(wand))
    assert end.kept.sum() >= 320
    assert end.unit == "m"
    sigmas = np.sqrt(np.diag(end.camera_covariance)).reshape(3, -1)[:, 6]
    assert (sigmas / np.asarray(end.rig.cameras.focal)[:, 0] < 0.01).all()
    places = np.asarray(triangulate(end.rig, wand.pixels, end.kept).points)
    ends = [np.flatnonzero((wand.target_ids == 0) & (wand.point_ids == i)) for i in (0, 1)]
    both = (end.kept[ends[0]].sum(axis=1) >= 2) & (end.kept[ends[1]].sum(axis=1) >= 2)
    lengths = np.linalg.norm(places[ends[0]] - places[ends[1]], axis=1)[both]
    assert len(lengths) == 50
    assert lengths.std() / lengths.mean() < 0.005


def test_a_wand_in_a_long_table(tmp_path):
    lines = [f"{f},{p},cam_{c},{10 * f + p},{20 * c + p}" for f in range(3) for p in (0, 1, 7) for c in (0, 1)]
    path = tmp_path / "tracks.csv"
    path.write_text("\n".join(["frame,point,camera,x,y", *lines]))
    found = wand_tracks(read_tracks(path, image_sizes=(640, 480)), 0.66, path)
    assert sorted(set(zip(found.point_ids.tolist(), found.target_ids.tolist()))) == [(0, 0), (1, 0), (7, -1)]
    np.testing.assert_allclose(found.targets[0].points[1], [0.66, 0, 0])
    with pytest.raises(UsageError, match="has a target of known shape already"):
        wand_tracks(found, 0.66, path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3,4,5,6\n", "has 6 columns; ends of a wand need 4 for each of two cameras or more"),
        ("1,2,3,4,5,6,7,8\n1,2,3\n", "line 2: 3 values where the first line has 8"),
        ("1,2,3,4,5,6,7,8\n1,2,3,4,5,6,7,oops\n", "line 2: 'oops' is no number"),
        ("pt1_cam1_X,pt1_cam1_Y,pt1_cam2_X,pt2_cam2_Y\n1,2,3,4\n", "names 4 columns; 2 points in 2 cameras need"),
        ("pt1_cam1_X,pt1_cam1_Y\n", "holds no points"),
    ],
)
def test_damaged_files(tmp_path, text, message):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_clicked_points(path, SIZE)


def test_the_command_line_asks_for_what_is_missing(tmp_path, capsys):
    path = tmp_path / "wand.csv"
    path.write_text("1,2,3,4,5,6,7,8\n" * 3)
    assert main(["check", str(path)]) == 2
    assert "give --image-size" in capsys.readouterr().err
    long = tmp_path / "tracks.csv"
    long.write_text("frame,camera,x,y\n0,a,1,1\n0,b,1,2\n")
    assert main(["check", str(long), "--image-size", "9", "9", "--wand-m", "1"]) == 2
    assert "has no two points a frame" in capsys.readouterr().err
