"""`detect board`, `intrinsics`, `stereo` and `undistort` on real images, from the command line to the files."""

import json
import shutil

import cv2
import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.io.board_sources import open_board_sources
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.track_files import load_tracks, read_tracks
from jaxpoint.runs import read_run

BOARD = ("--board", "chessboard:9x6:25mm")


def run(capsys, *words):
    code = main([*map(str, words)])
    out, err = capsys.readouterr()
    return code, " ".join(out.split()), " ".join(err.split())


@pytest.fixture(scope="module")
def images(data_folder):
    folder = data_folder / "opencv_chess_stereo"
    return folder / "left*.jpg", folder / "right*.jpg"


@pytest.fixture(scope="module")
def stereo_run(images, tmp_path_factory):
    out = tmp_path_factory.mktemp("stereo") / "run"
    assert main(["stereo", *map(str, images), *BOARD, "--out", str(out), "--frame", "3"]) == 0
    return out


def test_detect_board_writes_tracks_pictures_and_figures(images, tmp_path, capsys):
    out = tmp_path / "tracks.npz"
    code, said, _ = run(capsys, "detect", "board", *images, *BOARD, "--out", out)
    assert code == 0
    assert "left 13/13 702" in said
    tracks = load_tracks(out)
    assert tracks.names == ("left", "right")
    assert len(tracks.targets[0].points) == 54
    assert json.loads(out.with_suffix(".json").read_text())["frames_with_the_board"] == 13
    assert out.with_suffix(".html").read_text().count("<img") == 2
    code, _, said = run(
        capsys, "detect", "board", images[0], "--board", "aprilgrid:6x6:25mm:0.3", "--out", tmp_path / "b.npz"
    )
    assert code == 4
    assert "was found in 0 of 13 images" in said


def test_intrinsics_writes_a_run(images, tmp_path, capsys):
    out = tmp_path / "lens"
    code, said, _ = run(capsys, "intrinsics", images[0], *BOARD, "--out", out)
    assert code == 0
    assert "left brown 532.8±0.4 532.9±0.5 342.5±0.5 233.9±0.5 702/702" in said
    figures = json.loads((out / "metrics.json").read_text())
    assert figures["reprojection"]["rms_px"] == pytest.approx(0.1954, abs=2e-4)
    assert figures["observations"]["used"] == 702
    assert figures["views"] == 13
    assert figures["poor_views"] == []
    assert figures["lenses"][0]["coverage"] > 0.6
    assert "left" in figures["lenses"][0]["hold_board_next"]["in_words"]
    saved = read_calibration(out)
    assert saved.unit == "m"
    np.testing.assert_allclose(np.asarray(saved.rig.cameras.cam_from_world.rotation)[0], np.eye(3), atol=1e-12)
    assert read_run(out).calibration.tracks.targets[0].name == "chessboard"
    page = (out / "report.html").read_text()
    assert "This calibration can be trusted" in page
    assert page.count("<img") == 4


def test_usage_errors(images, tmp_path, capsys):
    code, _, said = run(capsys, "intrinsics", *images, *BOARD, "--out", tmp_path / "a")
    assert (code, "2 cameras were given (left, right), and `intrinsics` takes one" in said) == (2, True)
    code, _, said = run(capsys, "stereo", images[0], *BOARD, "--out", tmp_path / "a")
    assert (code, "Stereo takes two cameras, and 1 were given" in said) == (2, True)
    code, _, said = run(capsys, "stereo", *images, "--out", tmp_path / "a")
    assert (code, "either --board" in said) == (2, True)
    code, _, said = run(capsys, "stereo", *images, *BOARD, "--out", tmp_path / "a", "--stereo.block", "4")
    assert (code, "odd number, not 4" in said) == (2, True)
    assert not (tmp_path / "a").exists()


def test_stereo_writes_everything(stereo_run):
    figures = json.loads((stereo_run / "metrics.json").read_text())
    assert figures["stereo"]["rows_rms_px"] < 0.2
    assert figures["stereo"]["baseline"] == pytest.approx(0.0832, abs=1e-4)
    assert figures["stereo"]["frame"] == 3
    depth = cv2.imread(str(stereo_run / "depth_mm.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    assert (depth > 0).mean() == pytest.approx(figures["stereo"]["filled"], abs=0.05)
    header = (stereo_run / "points.ply").read_bytes()[:300]
    assert f"element vertex {figures['stereo']['points']}\n".encode() in header
    turned = json.loads((stereo_run / "rectification.json").read_text())
    np.testing.assert_allclose(np.array(turned["R1"]) @ np.array(turned["R1"]).T, np.eye(3), atol=1e-12)
    page = (stereo_run / "report.html").read_text()
    assert "Cameras against each other" in page
    assert "rectified" in page


def test_depth_that_fails_costs_no_calibration(images, tmp_path, capsys, caplog, monkeypatch):
    def broken(*_):
        raise RuntimeError("no depth")

    monkeypatch.setattr("jaxpoint.commands.stereo_results.rectify", broken)
    out = tmp_path / "run"
    assert run(capsys, "stereo", *images, *BOARD, "--out", out)[0] == 0
    assert "Missing: the rectification and depth" in caplog.text
    assert len(read_calibration(out).rig) == 2
    code, _, said = run(capsys, "stereo", *images, *BOARD, "--frame", 999, "--out", tmp_path / "x")
    assert (code, "no frame 999" in said) == (2, True)


def test_a_marked_run_says_so_wherever_it_is_used(stereo_run, images, tmp_path, capsys, caplog):
    shutil.copytree(stereo_run, tmp_path / "marked")
    metrics = tmp_path / "marked" / "metrics.json"
    metrics.write_text(json.dumps(json.loads(metrics.read_text()) | {"failure": "it did not settle"}))
    mark = f"'{tmp_path / 'marked'}' was marked when it was made: it did not settle"
    code, said, _ = run(capsys, "convert", tmp_path / "marked", tmp_path / "out.toml", "--to", "anipose")
    assert (code, mark in said) == (0, True)
    known = ("--calibration", tmp_path / "marked", "left", "right")
    assert run(capsys, "stereo", *images, *known, "--out", tmp_path / "depth")[0] == 0
    assert mark in caplog.text


def test_the_board_lies_as_far_as_the_depths_say(stereo_run):
    """Corners of the board in the frame whose depths were found, by the calibration and by matching."""
    found = read_run(stereo_run).calibration
    turned = json.loads((stereo_run / "rectification.json").read_text())
    depth = cv2.imread(str(stereo_run / "depth_mm.png"), cv2.IMREAD_UNCHANGED) / 1e3
    points = found.points[found.tracks.frame_ids == 3] @ np.array(turned["R1"]).T
    pixels = points @ np.array(turned["P1"])[:, :3].T
    x, y = np.rint(pixels[:, :2] / pixels[:, 2:]).astype(int).T
    seen = depth[y, x]
    assert (seen > 0).sum() > 15
    assert np.median(np.abs(seen - points[:, 2])[seen > 0]) < 0.01


def test_depth_of_a_calibrated_pair(stereo_run, images, tmp_path, capsys):
    out = tmp_path / "depth"
    known = ("--calibration", stereo_run, "left", "right")
    same = ("--stereo.disparities", json.loads((stereo_run / "metrics.json").read_text())["stereo"]["disparities"])
    code, said, _ = run(capsys, "stereo", *images, *known, *same, "--frame", 3, "--out", out)
    assert code == 0
    assert "baseline 83.2 mm" in said
    assert (out / "disparity.png").read_bytes() == (stereo_run / "disparity.png").read_bytes()
    assert (out / "report.html").is_file()
    code, _, said = run(
        capsys, "stereo", *images, "--calibration", stereo_run, "left", "middle", "--out", tmp_path / "a"
    )
    assert (code, "no camera 'middle'; it has left, right" in said) == (2, True)
    code, _, said = run(capsys, "stereo", *images, *known, "--frame", 10, "--out", tmp_path / "a")
    assert (code, "no frame 10" in said) == (2, True)


def test_undistort_as_opencv_does(stereo_run, images, tmp_path, capsys):
    out = tmp_path / "flat"
    code, said, _ = run(capsys, "undistort", images[0], "--calibration", stereo_run, "--out", out)
    assert code == 0
    assert "left: 13 images" in said
    camera = read_calibration(stereo_run).rig["left"]
    flat = read_calibration(out).rig["left"]
    assert not np.asarray(flat.distortion).any()
    image = cv2.imread(str(images[0].parent / "left01.jpg"))
    theirs = cv2.undistort(
        image, np.asarray(camera.intrinsics), np.asarray(camera.distortion), None, np.asarray(flat.intrinsics)
    )
    ours = cv2.imread(str(out / "left" / "left01.png"))
    assert np.abs(ours.astype(int) - theirs.astype(int)).mean() < 0.5
    maps = np.load(out / "left_maps.npz")
    assert maps["x"].shape == (480, 640)
    code, _, said = run(
        capsys, "undistort", images[0], "--calibration", stereo_run, "--camera", "a", "--out", tmp_path / "b"
    )
    assert (code, "say which is which by --camera" in said) == (2, True)


def test_a_video_is_undistorted(stereo_run, images, tmp_path, capsys):
    video = tmp_path / "left.mp4"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (640, 480))
    for number in (1, 2, 3, 4):
        writer.write(cv2.imread(str(images[0].parent / f"left{number:02d}.jpg")))
    writer.release()
    code, said, _ = run(capsys, "undistort", video, "--calibration", stereo_run, "--out", tmp_path / "flat")
    assert code == 0
    assert "left: 4 images" in said
    capture = cv2.VideoCapture(str(tmp_path / "flat" / "left.mp4"))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(25.0, abs=0.1)
    assert int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) == 4


CHARUCO = ("--board", "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted")


def test_a_sessions_timestamps_say_which_frames_belong_together(data_folder, tmp_path):
    """Corners as caliscope found them in the same videos, under its numbers of the moments."""
    folder = data_folder / "caliscope_charuco4/calibration/extrinsic"
    out = tmp_path / "tracks.npz"
    assert main(["detect", "board", str(folder), *CHARUCO, "--every", "8", "--out", str(out)]) == 0
    assert json.loads(out.with_suffix(".json").read_text())["paired_by"] == "timestamps.csv"
    found, known = load_tracks(out), read_tracks(folder / "CHARUCO/xy_CHARUCO.csv")
    rows = {key: i for i, key in enumerate(zip(known.frame_ids.tolist(), known.point_ids.tolist()))}
    both = [
        (i, rows[key]) for i, key in enumerate(zip(found.frame_ids.tolist(), found.point_ids.tolist())) if key in rows
    ]
    mine, theirs = np.array(both).T
    seen = found.visible[mine] & known.visible[theirs]
    away = np.linalg.norm(found.pixels[mine] - known.pixels[theirs], axis=-1)[seen]
    assert seen.sum() > 200
    assert np.median(away) < 0.5
    assert np.quantile(away, 0.95) < 3.0  # the board moves by hundreds of pixels from one of these frames to the next


def test_timestamps_may_be_given(data_folder, tmp_path):
    """One camera that began a frame late: its image k is of moment k + 1."""
    folder = data_folder / "caliscope_charuco4/calibration/extrinsic"
    videos = [folder / "cam_0.mp4", folder / "cam_1.mp4"]
    stamps = tmp_path / "timestamps.csv"
    lines = [f"{k},{camera},{k - camera},{k / 6}" for k in range(57) for camera in (0, 1) if k >= camera]
    stamps.write_text("\n".join(["sync_index,cam_id,frame_index,frame_time", *lines]))
    pairing = open_board_sources(videos, timestamps=stamps).pairing
    np.testing.assert_array_equal(pairing.index, np.stack([np.arange(57), np.arange(57) - 1], axis=1))
    assert pairing.notes[0] == "Camera 'cam_1' has no image in 1 of 57 frames."
    code = main(
        ["detect", "board", str(videos[0]), *CHARUCO, "--timestamps", str(tmp_path / "no.csv"), "--out", "x.npz"]
    )
    assert code == 7
