"""Keypoints of DeepLabCut, Lightning Pose and SLEAP, on files that these tools wrote."""

import pickle
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError, MissingDependencyError, UsageError
from jaxpoint.io import TRACK_FORMATS, CameraKeypoints, keypoint_format, register_tracks
from jaxpoint.io.track_files import load_tracks, read_tracks, save_tracks
from jaxpoint.io.track_formats.deeplabcut_h5 import _columns
from jaxpoint.io.track_formats.keypoint_cameras import camera_names
from jaxpoint.tracks import join_tracks

SIZE = (1280, 1024)


@pytest.fixture
def formats(data_folder):
    return data_folder / "formats"


def test_a_folder_of_files_is_a_recording(formats, tmp_path):
    """Every value as numpy reads it, and the names survive our own file."""
    folder = formats / "lightning_pose/eks_fly_3cam"
    tracks = read_tracks(folder, image_sizes=SIZE)
    assert tracks.names == ("Cam-A", "Cam-B", "Cam-C")
    assert tracks.point_names[:2] == ("L1A", "L1B")
    for camera, file in enumerate(sorted(folder.glob("*.csv"))):
        table = np.genfromtxt(file, delimiter=",", skip_header=3)[:, 1:].reshape(500, 12, 3)
        np.testing.assert_array_equal(tracks.pixels[:, camera].reshape(12, 500, 2), table[..., :2].swapaxes(0, 1))
    save_tracks(tmp_path / "tracks.npz", tracks)
    assert load_tracks(tmp_path / "tracks.npz").point_names == tracks.point_names


def test_csv_and_hdf5_of_deeplabcut_agree(formats, tmp_path):
    pytest.importorskip("h5py")
    for ending in ("csv", "h5"):
        shutil.copy(formats / f"deeplabcut/openfield_CollectedData.{ending}", tmp_path / f"one.{ending}")
    table, binary = (read_tracks(tmp_path / f"one.{ending}", image_sizes=SIZE) for ending in ("csv", "h5"))
    assert table.frame_ids.tolist() == binary.frame_ids.tolist()
    assert table.point_names == binary.point_names == ("snout", "leftear", "rightear", "tailbase")
    np.testing.assert_allclose(table.pixels, binary.pixels, atol=1e-9)
    assert read_tracks(tmp_path, image_sizes=SIZE).names == ("one",)  # the pair is one camera


def test_unsure_keypoints_are_not_seen(formats):
    h5py = pytest.importorskip("h5py")
    path = formats / "deeplabcut/m3v1mp4DeepCut_resnet50_openfieldOct30shuffle1_15001.h5"
    with h5py.File(path) as file:
        values = file["df_with_missing/table"]["values_block_0"].reshape(-1, 4, 3)
    assert read_tracks(path, image_sizes=SIZE).visible.sum() == (values[..., 2] >= 0.6).sum() < values[..., 2].size
    assert read_tracks(path, image_sizes=SIZE, min_likelihood=0.0).visible.sum() == values[..., 2].size
    assert read_tracks(path, image_sizes=SIZE).names == ("m3v1mp4",)


def test_a_sleap_session_has_a_folder_for_each_camera(formats):
    h5py = pytest.importorskip("h5py")
    folder = formats / "sleap_anipose_session"
    tracks = read_tracks(folder, image_sizes=SIZE)
    assert tracks.names == ("back", "mid", "side", "top")
    for camera, name in enumerate(tracks.names):
        (file,) = (folder / name).glob("*.h5")
        with h5py.File(file) as opened:
            whole = opened["tracks"][0].transpose(1, 2, 0).reshape(-1, 2)  # node, frame, xy
        seen = np.isfinite(whole).all(axis=1)
        assert seen.sum() == tracks.visible[:, camera].sum()
        np.testing.assert_array_equal(tracks.pixels[tracks.visible[:, camera], camera], whole[seen])


def test_sleap_csv(formats):
    path = formats / "sleap/minimal_instance.000_centered_pair_low_quality.analysis.csv"
    tracks = read_tracks(path, image_sizes=SIZE)
    assert tracks.point_names == ("A", "B")
    np.testing.assert_allclose(tracks.pixels[0, 0], [205.9300539013689, 187.88964024])


@pytest.mark.parametrize("name", ["madlc_testdata.csv", "madlc_testdata_v2.csv"])
def test_individuals_are_chosen(formats, name):
    path = formats / "deeplabcut/sleap_tests" / name
    with pytest.raises(UsageError, match=r"2 individuals \(Animal1, Animal2\).*--individual NAME"):
        read_tracks(path, image_sizes=SIZE)
    with pytest.raises(UsageError, match="no individual 'Rex'"):
        read_tracks(path, image_sizes=SIZE, individual="Rex")
    tracks = read_tracks(path, image_sizes=SIZE, individual="Animal2")
    assert tracks.frame_ids[0] == 0
    np.testing.assert_array_equal(tracks.pixels[0, 0], [6, 7])


def test_labelled_frames_of_four_cameras(formats, tmp_path):
    """Frames are the numbers of the images, whose paths are those of Windows."""
    for folder in sorted((formats / "deeplabcut/freemocap_juggling_4cam").glob("*172709*")):
        shutil.copytree(folder, tmp_path / folder.name)
    tracks = read_tracks(tmp_path, image_sizes=SIZE)
    assert tracks.names == ("Cam1", "Cam2", "Cam3", "Cam4")
    assert tracks.point_names == ("PinkBall", "GreenBall", "RedBall")
    row = np.flatnonzero((tracks.frame_ids == 311) & (tracks.point_ids == 1))[0]
    np.testing.assert_allclose(tracks.pixels[row, 0], [276.9820556640625, 207.6787872314453])


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["cam_1.csv", "cam_2.csv"], ("cam_1", "cam_2")),
        (["run7_cam1DLC_resnet50_x.csv", "run7_cam2DLC_resnet50_x.csv"], ("cam1", "cam2")),
        (["labels.v001.000_left.analysis.h5", "labels.v001.000_right.analysis.h5"], ("left", "right")),
        (["a/tracked.csv", "b/tracked.csv"], ("a", "b")),
        (["only_one.csv"], ("only_one",)),
        (["x.train=75.bot.csv", "x.train=75.top.csv"], ("bot", "top")),
    ],
)
def test_cameras_are_named_by_what_differs(files, names):
    assert camera_names([Path(file) for file in files]) == names


def test_bad_files_are_refused_in_a_sentence(formats, tmp_path):
    folder = formats / "deeplabcut"
    with pytest.raises(FileFormatError, match="does not say how large the images are"):
        read_tracks(folder / "openfield_CollectedData.csv")
    with pytest.raises(FileFormatError, match=r"several formats \(sleap, sleap-csv\)"):
        read_tracks(formats / "sleap", image_sizes=SIZE)
    with pytest.raises(FileFormatError, match="line 7: 12 values under 16 columns"):
        read_tracks(folder / "sleap_tests/maudlc_testdata_v2.csv", image_sizes=SIZE)
    with pytest.raises(FileFormatError, match=r"no points\.dat and no keypoints"):
        read_tracks(tmp_path)
    text = (folder / "openfield_CollectedData.csv").read_text()
    (tmp_path / "bad.csv").write_text(text.replace("21.521", "x21"))
    with pytest.raises(FileFormatError, match="line 4: 'x21' is not a number"):
        read_tracks(tmp_path / "bad.csv", image_sizes=SIZE)
    (tmp_path / "bad.csv").write_text(text.replace("img0001", "first"))
    with pytest.raises(FileFormatError, match=r"'labeled-data/m4s1/first.png' has no number"):
        read_tracks(tmp_path / "bad.csv", image_sizes=SIZE)


def test_a_filtered_file_beside_the_other_is_named(formats, tmp_path):
    for name in ("leftDLC_resnet50_x", "leftDLC_resnet50_x_filtered", "rightDLC_resnet50_x"):
        shutil.copy(formats / "deeplabcut/openfield_CollectedData.csv", tmp_path / f"{name}.csv")
    with pytest.raises(FileFormatError, match=r"x\.csv and leftDLC_resnet50_x_filtered\.csv are both of camera 'left'"):
        read_tracks(tmp_path, image_sizes=SIZE)


def test_points_in_3d_are_no_tracks(formats):
    pytest.importorskip("h5py")
    with pytest.raises(FileFormatError, match="points in 3-D"):
        read_tracks(formats / "deeplabcut/dlc2kinematics_reachingDEMO_3D.h5", image_sizes=SIZE)


def test_without_h5py_the_extra_is_named(formats, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    for name in ("deeplabcut/openfield_CollectedData.h5", "sleap_anipose_session"):
        with pytest.raises(MissingDependencyError, match=r"pip install 'jaxpoint\[h5\]'"):
            read_tracks(formats / name, image_sizes=SIZE)


def test_pickled_code_in_a_file_is_not_run(tmp_path):
    class Code:
        def __reduce__(self):
            return (tmp_path.joinpath("ran").touch, ())

    with pytest.raises(FileFormatError, match="names of its columns cannot be read"):
        _columns(tmp_path / "file.h5", pickle.dumps([Code()], 0))
    assert not (tmp_path / "ran").exists()


def test_a_format_of_ones_own(tmp_path):
    def read_camera(request, path):
        values = np.loadtxt(path, skiprows=1, ndmin=2)
        return CameraKeypoints(("tip",), values[:, 0].astype(int), values[:, None, 1:])

    mine = keypoint_format("mine", "my keypoints", lambda path, head: head.startswith("my keypoints"), read_camera)
    for name in ("left", "right"):
        (tmp_path / f"{name}.txt").write_text("my keypoints\n0 10 20\n2 30 40\n")
    (tmp_path / "cameras.csv").write_text("camera,width,height\nleft,640,480\nright,320,240\n")
    register_tracks(mine)
    try:
        tracks = read_tracks(tmp_path)
        assert (tracks.names, tracks.frame_ids.tolist()) == (("left", "right"), [0, 2])
        assert tracks.image_sizes.tolist() == [[640, 480], [320, 240]]
        with pytest.raises(ValueError, match="known already"):
            register_tracks(keypoint_format("mine", "another", mine.recognise, read_camera))
    finally:
        TRACK_FORMATS.pop("mine")


def test_joined_tracks_keep_the_names(formats):
    path = formats / "deeplabcut/sleap_tests/dlc_testdata.csv"
    one = read_tracks(path, image_sizes=SIZE)
    both = join_tracks(one, one)
    assert both.point_names == ("A", "B", "C", "A", "B", "C")
    assert sorted(set(both.point_ids.tolist())) == [0, 1, 2, 3, 4, 5]
