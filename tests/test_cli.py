"""The command line: exit codes, JSON, what is written, and what is not."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxpoint.calibration.result import ReadoutTimes, TimeOffsets
from jaxpoint.cli import command_line, main, parse
from jaxpoint.config import RoomConfig
from jaxpoint.io.track_files import load_tracks, save_tracks
from jaxpoint.runs import read_run, write_run
from jaxpoint.simulate.rooms import random_room


@pytest.fixture(autouse=True)
def quick_report(monkeypatch, request):
    """Pages are tested elsewhere and take seconds."""
    if "real_report" not in request.fixturenames:
        monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: Path(path).write_text("page"))


@pytest.fixture
def real_report():
    """Asked for by the tests that want the page itself."""


@pytest.fixture
def tracks_file(tmp_path, solved_room):
    save_tracks(tmp_path / "tracks.npz", solved_room[1].tracks)
    return tmp_path / "tracks.npz"


@pytest.fixture
def run_folder(tmp_path, solved_room, monkeypatch):
    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: Path(path).write_text("page"))
    write_run(tmp_path / "run", solved_room[1], RoomConfig(), command="test")
    return tmp_path / "run"


@pytest.fixture
def known_files(tmp_path, solved_room):
    """landmarks.csv, clicks.csv and lengths.csv of the simulated room."""
    known = solved_room[0]
    lines = ["name,x_m,y_m,z_m,sigma_m"]
    lines += [
        f"{name},{x},{y},{z},{sigma}"
        for name, (x, y, z), sigma in zip(known.landmarks.names, known.landmarks.points, known.landmarks.sigmas)
    ]
    (tmp_path / "landmarks.csv").write_text("\n".join(lines))
    lines = ["name,camera,x,y"]
    for point, camera in np.argwhere(known.clicks.visible):
        x, y = known.clicks.pixels[point, camera]
        lines.append(f"{known.clicks.names[point]},{known.room.tracks.names[camera]},{x},{y}")
    (tmp_path / "clicks.csv").write_text("\n".join(lines))
    lines = ["name,end_a,end_b,length_m"]
    lines += [
        f"{n},{a},{b},{m}" for n, (a, b), m in zip(known.lengths.names, known.lengths.ends, known.lengths.length_m)
    ]
    (tmp_path / "lengths.csv").write_text("\n".join(lines))
    return tmp_path


@pytest.fixture
def solver(monkeypatch, solved_room):
    """Stands in for the solver; change what it returns, or let it raise."""

    class Solver:
        answer = solved_room[1]
        error = None

        def __call__(self, tracks, settings, *, intrinsics, progress):
            progress("adjustment", 1, 1)
            self.settings, self.intrinsics = settings, intrinsics
            if self.error is not None:
                raise self.error
            return self.answer

    stand_in = Solver()
    monkeypatch.setattr("jaxpoint.calibration.selfcal.calibrate", stand_in)
    return stand_in


def run(*arguments, capsys=None):
    """Exit code, and with `capsys` what was printed."""
    code = main([str(argument) for argument in arguments])
    return code if capsys is None else (code, *capsys.readouterr())


def test_time_offsets_and_readout_times_are_shown_and_kept(tmp_path, tracks_file, solver, capsys, real_report):
    late = TimeOffsets(np.array([0, 0.25, -1.5, 2]), np.full(4, 0.003))
    rolling = ReadoutTimes(np.array([0.5, 0.625, -0.75, 0.5]), np.full(4, 0.012))
    solver.answer = replace(solver.answer, time_offsets=late, readout_times=rolling)
    flags = "--time-offsets", "--readout-times"
    code, out, _ = run("calibrate", tracks_file, *flags, "--out", tmp_path / "run", capsys=capsys)
    assert (code, solver.settings.time_offsets, solver.settings.readout_times) == (0, True, True)
    assert "frames first row to last" in out
    assert "-0.750 ± 0.012" in out
    assert "--readout cam_0=0.5 --readout cam_1=0.625 --readout cam_2=-0.75 --readout cam_3=0.5" in out
    assert "frames after cam_0" in out
    assert "-1.500 ± 0.003" in out
    found = read_run(tmp_path / "run")
    np.testing.assert_array_equal(found.calibration.time_offsets.frames, [0, 0.25, -1.5, 2])
    np.testing.assert_array_equal(found.calibration.readout_times.frames, rolling.frames)
    assert found.metrics["time_offsets"]["frames"] == [0, 0.25, -1.5, 2]
    assert found.metrics["readout_times"]["sigma"] == [0.012] * 4
    assert "-0.750 ± 0.012" in (tmp_path / "run" / "report.html").read_text()
    assert "-1.500 ± 0.003" in (tmp_path / "run" / "report.html").read_text()
    # The tracks of the run stand on one clock: its halves have no offsets to solve for.
    run("validate", tmp_path / "run", "--held-out", capsys=capsys)
    assert solver.settings.time_offsets is solver.settings.readout_times is False


def test_flags_override_the_file_and_the_file_overrides_the_defaults(tmp_path):
    (tmp_path / "room.toml").write_text("[calibrate]\nseed = 3\nheld_out = 0.2\n[calibrate.lens]\ndistortion = 'brown'")
    config = ["--config", str(tmp_path / "room.toml")]
    command = parse(["calibrate", "tracks.npz", *config, "--held-out", "0.3", "--init", "factorisation"])
    assert (command.settings.seed, command.settings.held_out, command.settings.init) == (3, 0.3, "factorisation")
    assert command.settings.lens.distortion == "brown"
    assert parse(["calibrate", "tracks.npz"]).settings.seed == 0


def test_calibrate_writes_a_run_and_says_so(tmp_path, tracks_file, solver, capsys):
    (tmp_path / "tracks.json").write_text('{"seconds": 12.5}')
    code, out, err = run("calibrate", tracks_file, "--out", tmp_path / "run", "--seed", 5, capsys=capsys)
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == f"Report: {tmp_path / 'run' / 'report.html'}"
    found = read_run(tmp_path / "run")
    assert solver.settings.seed == found.config.calibrate.seed == 5
    assert found.metrics["seconds"]["detect"] == 12.5
    assert str(tracks_file) in json.loads((tmp_path / "run" / "provenance.json").read_text())["inputs"]


def test_json_is_one_object_and_nothing_else(tmp_path, tracks_file, solver, capsys):
    code, out, err = run("calibrate", tracks_file, "--out", tmp_path / "run", "--json", capsys=capsys)
    assert (code, err) == (0, "")
    figures = json.loads(out)
    assert figures["reprojection"].keys() == {"mean_px", "std_px", "rms_px", "per_camera_mean_px", "mean_all_px"}
    assert figures["run"] == str(tmp_path / "run")
    code, out, err = run("calibrate", tmp_path / "none.npz", "--out", tmp_path / "x", "--json", capsys=capsys)
    assert code == json.loads(out)["exit_code"] == 7
    assert err == f"jaxpoint: {json.loads(out)['error']}\n"


def test_a_missed_gate_keeps_the_results(tmp_path, tracks_file, solver, capsys):
    code, _, err = run("calibrate", tracks_file, "--out", tmp_path / "a", "--max-mean-px", 0.01, capsys=capsys)
    assert code == 5
    assert "above the 0.01 px allowed" in err
    assert read_run(tmp_path / "a").metrics["passed"] is False
    solver.answer = replace(solver.answer, converged=False)
    code, _, err = run("calibrate", tracks_file, "--out", tmp_path / "b", capsys=capsys)
    assert code == 6
    assert read_run(tmp_path / "b").metrics["converged"] is False


def test_a_poor_alignment_is_kept_and_marked(run_folder, known_files, solved_room, capsys):
    room = solved_room[0].room
    wrong = room.positions + np.random.default_rng(0).normal(0.0, 0.3, room.positions.shape)
    lines = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(room.tracks.names, wrong)]
    (known_files / "tape.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]))
    given = ["--camera-centres", known_files / "tape.csv", "--out", known_files / "out"]
    code, _, err = run("align", run_folder, *given, capsys=capsys)
    assert code == 5
    assert "above the 50 mm allowed" in err
    assert read_run(known_files / "out").metrics["passed"] is False


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["calibrate", "TRACKS"], 2, "Say where the results go: --out"),
        (["calibrate", "TRACKS", "--out", "FULL"], 2, "is not empty"),
        (["calibrate", "TRACKS", "--out", "FULL", "--force"], 2, "holds no run of jaxpoint"),
        (["calibrate", "TRACKS", "--out", "NEW", "--held-out", "2"], 2, "'held_out' cannot be used"),
        (["calibrate", "TRACKS", "--out", "NEW", "--config", "BAD"], 2, "unknown key 'calibrate.colour'"),
        (["calibrate", "TRACKS", "--out", "NEW", "--config", "NONE"], 2, "There is no configuration file"),
        (["calibrate", "TRACKS", "--out", "NEW", "--lens.known", "hold"], 2, "--intrinsics FILE"),
        (["calibrate", "TRACKS", "--out", "NEW", "--intrinsics", "NONE"], 2, "--lens.known hold"),
        (["calibrate", "NONE", "--out", "NEW"], 7, "no file or folder"),
        (["check", "BAD"], 7, "is no tracks file"),
        (["align", "FULL", "--out", "NEW", "--floor", "1"], 7, "give the folder of a run"),
        (["validate", "FULL"], 2, "--lengths, --tracks or --held-out"),
        (["detect", "led", "FULL", "--out", "NEW"], 2, "ends in .npz"),
        (["detect", "led", "FULL", "--out", "TRACKS"], 2, "exists; choose another"),
        (["detect", "person", "FULL", "--out", "NEW", "--head.nearest-m", "7"], 2, "'head.nearest_m' cannot be used"),
        (["detect", "person", "FULL", "--out", "NEW", "--background.threshold", "inf"], 2, "expected a finite number"),
    ],
)
def test_bad_usage_is_one_line_with_its_code_and_leaves_nothing(
    tmp_path, tracks_file, capsys, arguments, code, message
):
    (tmp_path / "FULL").mkdir()
    (tmp_path / "FULL" / "letter.txt").write_text("dear")
    (tmp_path / "BAD").write_text("[calibrate]\ncolour = 1")
    before = sorted(tmp_path.rglob("*"))
    names = {"TRACKS": tracks_file} | {name: tmp_path / name for name in ("FULL", "BAD", "NEW", "NONE")}
    found, out, err = run(*(names.get(argument, argument) for argument in arguments), capsys=capsys)
    assert found == code
    assert out == ""
    assert message in err
    assert err.startswith("jaxpoint: ")
    assert err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_an_unknown_flag_says_what_was_meant(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["calibrate", "tracks.npz", "--lens.distorsion", "none"])
    assert stop.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "--lens.distortion" in printed.err


def test_too_little_data_is_code_4(tmp_path, solved_room, capsys):
    save_tracks(tmp_path / "two.npz", solved_room[1].tracks.select_cameras([0, 1]))
    code, _, err = run("calibrate", tmp_path / "two.npz", "--out", tmp_path / "run", capsys=capsys)
    assert code == 4
    assert "needs at least 3 cameras" in err
    code, out, err = run("check", tmp_path / "two.npz", "--json", capsys=capsys)
    assert code == 4
    assert json.loads(out)["sufficient"] is False
    assert not (tmp_path / "run").exists()


def test_interruption_is_130_and_says_where_the_finished_lies(tmp_path, tracks_file, solver, capsys, monkeypatch):
    solver.error = KeyboardInterrupt()
    assert run("calibrate", tracks_file, "--out", tmp_path / "run", capsys=capsys)[0] == 130
    assert not (tmp_path / "run").exists()
    solver.error = None

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxpoint.runs.write_report", interrupted)
    code, _, err = run("calibrate", tracks_file, "--out", tmp_path / "run", capsys=capsys)
    assert code == 130
    assert f"what was finished lies in {tmp_path / 'run.unfinished'}" in err
    assert (tmp_path / "run.unfinished" / "calibration.json").exists()
    assert not (tmp_path / "run").exists()


def test_a_bug_is_code_1_and_shows_its_place_only_when_asked(tmp_path, tracks_file, solver, capsys):
    solver.error = ZeroDivisionError("division by zero")
    code, _, err = run("calibrate", tracks_file, "--out", tmp_path / "run", capsys=capsys)
    assert code == 1
    assert err == "jaxpoint: ZeroDivisionError: division by zero (a bug; -v shows where)\n"
    code, _, err = run("calibrate", tracks_file, "--out", tmp_path / "run", "-v", capsys=capsys)
    assert code == 1
    assert "Traceback" in err


def test_our_own_value_error_is_bad_input_and_a_foreign_one_a_bug(tmp_path, tracks_file, solver, monkeypatch, capsys):
    def refuse(*_, **__):
        return load_tracks(tracks_file).from_pixels(np.full((1, 1, 2), np.inf), np.array([[4, 4]]))

    monkeypatch.setattr("jaxpoint.io.track_files.read_tracks", refuse)
    code, _, err = run("check", tracks_file, capsys=capsys)
    assert (code, "is infinite" in err) == (4, True)
    monkeypatch.setattr("jaxpoint.io.track_files.read_tracks", lambda *_, **__: np.zeros(3).reshape(2, 2))
    assert run("check", tracks_file, capsys=capsys)[0] == 1


def test_a_missing_package_is_code_3(tracks_file, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "jaxpoint.io.track_files", None)
    code, _, err = run("check", tracks_file, capsys=capsys)
    assert code == 3
    assert "jaxpoint doctor" in err


def test_known_intrinsics_reach_the_solver_in_the_order_of_the_tracks(tmp_path, run_folder, solved_room, solver):
    tracks = solved_room[1].tracks
    save_tracks(tmp_path / "turned.npz", tracks.select_cameras([2, 0, 1]))
    known = ["--intrinsics", run_folder / "calibration.json", "--lens.known", "hold"]
    assert run("calibrate", tmp_path / "turned.npz", *known, "--out", tmp_path / "new") == 0
    assert solver.intrinsics.names == (tracks.names[2], tracks.names[0], tracks.names[1])
    np.testing.assert_allclose(solver.intrinsics.cameras.focal[0, 0], solved_room[0].room.focal[2])


def test_align_by_landmarks_then_validate_by_lengths(run_folder, known_files, capsys):
    clicks = ["--landmark-pixels", known_files / "clicks.csv"]
    out = known_files / "aligned"
    code, text, _ = run(
        "align", run_folder, "--landmarks", known_files / "landmarks.csv", *clicks, "--out", out, capsys=capsys
    )
    assert code == 0
    assert "aligned by landmarks" in text
    found = read_run(out)
    assert found.calibration.unit == "m"
    assert found.config.align.landmarks == known_files / "landmarks.csv"
    assert json.loads((out / "calibration.json").read_text())["unit"] == "m"
    measured = ["--lengths", known_files / "lengths.csv", *clicks]
    code, text, _ = run("validate", out, *measured, "--json", "--out", known_files / "kept", capsys=capsys)
    figures = json.loads(text)["lengths"]
    assert code == 0
    assert figures["count"] == 12
    assert figures["mean_mm"] < 20  # the thesis's claim
    assert json.loads((known_files / "kept" / "validation.json").read_text())["lengths"] == figures
    assert run("validate", out, *measured, "--max-mean-mm", 0.001, capsys=capsys)[0] == 5


def test_align_by_camera_centres_and_by_floor(run_folder, known_files, solved_room, capsys):
    room = solved_room[0].room
    centres = room.positions + np.array([1.0, 2.0, 0.0])
    lines = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(room.tracks.names, centres)]
    (known_files / "tape.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]))
    out = known_files / "by-centres"
    assert run("align", run_folder, "--camera-centres", known_files / "tape.csv", "--out", out) == 0
    np.testing.assert_allclose(read_run(out).calibration.rig.positions, centres, atol=1e-6)
    heights = np.where(solved_room[1].point_valid, room.points[:, 2], np.inf)
    lowest = np.argsort(heights)[[0, 5, 10]]  # neighbours on the path would lie almost on a line
    frames = [str(frame) for frame in room.tracks.frame_ids[lowest]]
    floor = ["--floor", *frames, "--max-rms-mm", 1000]
    code, _, err = run("align", run_folder, *floor, "--out", known_files / "x", capsys=capsys)
    assert (code, "--length-m" in err) == (2, True)
    length = float(np.linalg.norm(room.points[lowest[1]] - room.points[lowest[0]]))
    out = known_files / "by-floor"
    assert run("align", run_folder, *floor, "--length-m", length, "--out", out) == 0
    placed = read_run(out).calibration.points[lowest]
    np.testing.assert_allclose(placed[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(placed[1], [length, 0, 0], atol=1e-9)


def test_align_by_one_length(run_folder, known_files, solved_room, capsys):
    room, frames = solved_room[0].room, np.flatnonzero(solved_room[1].point_valid)[[0, -1]]
    ends = [str(frame) for frame in room.tracks.frame_ids[frames]]
    out, length = known_files / "by-length", ["--length", *ends]
    code, _, err = run("align", run_folder, *length, "--out", out, capsys=capsys)
    assert (code, "--length A B --length-m METRES" in err) == (2, True)
    assert run("align", run_folder, *length, "--length-m", 2.5, "--out", out) == 0
    end = read_run(out).calibration
    assert (end.unit, end.in_room) == ("m", False)
    np.testing.assert_allclose(np.linalg.norm(np.diff(end.points[frames], axis=0)), 2.5, rtol=1e-12)
    np.testing.assert_allclose(end.rig.project(end.points), solved_room[1].rig.project(room.points), atol=1e-6)
    code, _, err = run("align", out, *length, "--length-m", 2.5, "--out", known_files / "x", capsys=capsys)
    assert (code, "has metres already" in err) == (2, True)


def test_cameras_moved_since_they_were_measured_are_left_out(run_folder, known_files, solved_room, capsys):
    room = solved_room[0].room
    centres = room.positions + np.array([1.0, 2.0, 0.0])
    tape = centres + np.array([[0, 0, 0], [0, 0, 0], [0.4, -0.3, 0.2], [0, 0, 0]])
    lines = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(room.tracks.names, tape)]
    (known_files / "old.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]))
    out = known_files / "again"
    code, printed, _ = run(
        "align", run_folder, "--camera-centres", known_files / "old.csv", "--out", out, capsys=capsys
    )
    assert (code, "aligned without: cam_2" in printed) == (0, True)
    np.testing.assert_allclose(read_run(out).calibration.rig.positions, centres, atol=1e-6)


def test_check_shows_what_the_cameras_share(tmp_path, tracks_file, solved_room, capsys):
    code, out, _ = run("check", tracks_file, "--json", capsys=capsys)
    assert code == 0
    visible = solved_room[1].tracks.visible
    assert json.loads(out)["shared"][1][2] == int((visible[:, 1] & visible[:, 2]).sum())
    code, out, _ = run("check", tracks_file, "--out", tmp_path / "page", capsys=capsys)
    assert code == 0
    assert (tmp_path / "page" / "report.html").stat().st_size > 10_000


def test_detect_writes_tracks_and_how_it_went(tmp_path, capsys):
    rng = np.random.default_rng(0)
    places = rng.uniform(15, 60, (40, 2, 2))
    y, x = np.mgrid[:80, :100]
    for camera in range(2):
        folder = tmp_path / f"cam{camera}"
        folder.mkdir()
        for frame in range(40):
            u, v = places[frame, camera]
            light = 200 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 1.4**2))
            image = np.clip(10 + light + rng.normal(0, 1.5, light.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / f"{frame:03d}.png"), image)
    options = ["--min-frames", 20, "--workers", 1, "--out", tmp_path / "tracks.npz"]
    code, out, _ = run("detect", "led", tmp_path / "cam0", tmp_path / "cam1", *options, "--json", capsys=capsys)
    assert code == 0
    tracks = load_tracks(tmp_path / "tracks.npz")
    assert tracks.visible.mean() > 0.9
    errors = np.linalg.norm(tracks.pixels - places, axis=2)[tracks.visible]
    assert np.median(errors) < 0.05
    figures = json.loads(out)
    assert figures == json.loads((tmp_path / "tracks.json").read_text())
    assert [camera["found"] for camera in figures["cameras"]] == tracks.visible.sum(axis=0).tolist()


def test_doctor_examines_this_machine(capsys):
    code, out, _ = run("doctor", "--json", capsys=capsys)
    assert code == 0
    findings = {finding["name"]: finding for finding in json.loads(out)["findings"]}
    assert findings["float64"]["state"] == "works"
    assert findings["jax"]["state"] == __import__("jax").__version__
    assert findings["extra 'tables'"]["remedy"] in ("", 'pip install "jaxpoint[tables]"')


def test_doctor_names_the_extras_of_users_alone(monkeypatch, capsys):
    wanted = [f"{extra}-package; extra == '{extra}'" for extra in ("dev", "docs", "tables")]
    monkeypatch.setattr("jaxpoint.environment.requires", lambda name: wanted)
    code, out, _ = run("doctor", "--json", capsys=capsys)
    named = [finding["name"] for finding in json.loads(out)["findings"] if finding["name"].startswith("extra")]
    assert (code, named) == (0, ["extra 'tables'"])


@pytest.mark.parametrize(("code", "leave"), [(0, "sys.exit"), (5, "sys.exit"), (130, "os._exit")])
def test_the_process_ends_with_the_code_of_its_command(monkeypatch, code, leave):
    """An interrupted one at once: the orderly way crashes in threads of XLA."""
    left = []

    def leaving(how):
        def leave_with(value):
            left.append((how, value))
            raise SystemExit

        return leave_with

    monkeypatch.setattr("jaxpoint.cli.main", lambda arguments: code)
    monkeypatch.setattr("sys.exit", leaving("sys.exit"))
    monkeypatch.setattr("os._exit", leaving("os._exit"))
    with pytest.raises(SystemExit):
        command_line()
    assert left == [(leave, code)]


def test_a_simulation_that_is_asked_to_end_leaves_nothing_hidden(tmp_path):
    (tmp_path / "small.toml").write_text("[simulate.viewpoints]\ncameras = 1\nsize = [64, 36]")
    code = """
import os, signal, sys
import jaxpoint.simulate.session_folder
from jaxpoint.cli import command_line

def asked_to_end(folder, *_, **__):
    (folder / "begun").touch()
    os.kill(os.getpid(), signal.SIGTERM)

jaxpoint.simulate.session_folder.write_session = asked_to_end
command_line()
"""
    command = [sys.executable, "-c", code, "simulate", "--config", "small.toml", "--out", "session"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 130
    assert "interrupted; what was finished lies in" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["session.unfinished", "small.toml"]


@pytest.mark.parametrize("command", ["check", "calibrate"])
def test_tracks_that_no_calibration_can_use_leave_nothing(tmp_path, solved_room, command, capsys):
    """One camera, a blind one, an image size that cannot be, a number too long, and no folder to write to."""
    tracks = solved_room[1].tracks
    blind = tracks.visible & (np.arange(tracks.cameras) != 2)
    save_tracks(tmp_path / "one.npz", tracks.select_cameras([0]))
    save_tracks(tmp_path / "none.npz", tracks.select_frames(np.arange(0)))
    save_tracks(tmp_path / "blind.npz", replace(tracks, visible=blind))
    save_tracks(tmp_path / "small.npz", replace(tracks, image_sizes=tracks.image_sizes // 2))
    (tmp_path / "long.csv").write_text(f"frame,camera,x,y,width,height\n{'9' * 25},a,1,2,640,480")
    before = sorted(tmp_path.rglob("*"))
    for name, code, message in (
        ("one.npz", 4, "at least 3 cameras, but there is 1"),
        ("none.npz", 4, "holds 0 frames"),
        ("blind.npz", 4, "Camera 'cam_2' shares 0 frames"),
        ("small.npz", 7, "lie outside its image of 640 x 360 px; correct the image size"),
        ("long.csv", 7, "line 2: column 'frame' is 9999"),
    ):
        found, _, err = run(command, tmp_path / name, "--out", tmp_path / "out" / name, capsys=capsys)
        assert (found, err.count("\n")) == (code, 1)
        assert message in err
        (tmp_path / "out" / name / "report.html").unlink(missing_ok=True)
    found, _, err = run(command, tmp_path / "one.npz", "--out", tmp_path / "long.csv" / "out", capsys=capsys)
    assert (found, "Nothing can be written" in err) == (2, True)
    if command == "calibrate":
        assert sorted(tmp_path.rglob("*")) == before


def test_check_names_the_late_camera_and_the_flag_that_helps(tmp_path, capsys):
    late = random_room(
        9, cameras=4, frames=500, layout="around", visibility=0.9, outliers=0.02, noise_px=0.5, stride=24,
        time_offsets=np.array([0.0, 0.0, 23.0, 0.0]),
    )  # fmt: skip
    save_tracks(tmp_path / "late.npz", late.tracks)
    code, out, err = run("check", tmp_path / "late.npz", capsys=capsys)
    assert code == 4
    assert "Camera cam_2 shows the light 23 frames late." in err
    assert "--offset cam_2=23" in err
    assert "Enough for a calibration." not in out
    code, out, _ = run("check", tmp_path / "late.npz", "--offset", "cam_2=23", "--json", capsys=capsys)
    figures = json.loads(out)
    assert code == 0
    assert figures["sufficient"]
    assert [clock["name"] for clock in figures["clocks"]] == list(late.tracks.names)
    assert max(abs(clock["offset_frames"]) for clock in figures["clocks"]) < 0.2
    assert min(clock["share_before"] for clock in figures["clocks"]) > 0.7


def test_check_says_that_a_camera_never_saw_the_light(tmp_path, solved_room, capsys):
    tracks = solved_room[1].tracks
    save_tracks(tmp_path / "blind.npz", replace(tracks, visible=tracks.visible & (np.arange(4) != 2)))
    _, out, _ = run("check", tmp_path / "blind.npz", capsys=capsys)
    assert "Camera cam_2 never saw the light." in out
    assert "cam_2 and cam_2" not in out


def test_a_camera_without_light_fails_the_detection_but_keeps_it(tmp_path, capsys):
    rng = np.random.default_rng(0)
    (tmp_path / "cam").mkdir()
    for frame in range(20):
        cv2.imwrite(str(tmp_path / "cam" / f"{frame}.png"), rng.normal(10, 1.5, (40, 50)).astype(np.uint8))
    given = ["--min-frames", 20, "--workers", 1, "--out", tmp_path / "tracks.npz"]
    code, _, err = run("detect", "led", tmp_path / "cam", *given, capsys=capsys)
    assert code == 4
    assert "0 of 20 frames of camera 'cam'" in err
    assert not load_tracks(tmp_path / "tracks.npz").visible.any()


def test_a_camera_without_a_known_centre_is_named(run_folder, known_files, solved_room, capsys):
    room = solved_room[0].room
    lines = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(room.tracks.names[1:], room.positions[1:])]
    (known_files / "tape.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]))
    given = ["--camera-centres", known_files / "tape.csv", "--out", known_files / "out"]
    code, out, _ = run("align", run_folder, *given, capsys=capsys)
    assert code == 0
    assert "tape.csv' does not have cam_0: aligned without." in out


def test_a_full_disk_is_no_bug(tmp_path, tracks_file, solver, monkeypatch, capsys):
    solver.error = OSError(28, "No space left on device", "somewhere")
    code, _, err = run("calibrate", tracks_file, "--out", tmp_path / "run", capsys=capsys)
    assert (code, "No space left on device at 'somewhere'" in err) == (3, True)


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert (stop.value.code, capsys.readouterr().out.split()[0]) == (0, "jaxpoint")


def test_force_never_replaces_what_is_read(run_folder, tmp_path, capsys):
    """A session that was simulated carries the mark of a run; read and replaced at once it would be lost."""
    before = sorted(path.name for path in run_folder.iterdir())
    for read in (run_folder, run_folder / "calibration.json"):
        assert main(["diff", str(read), str(run_folder), "--out", str(run_folder), "--force"]) == 2
        assert "is read and lies where the results go; choose another --out" in capsys.readouterr().err
    table = tmp_path / "lines.csv"
    table.write_text("person\n")
    assert main(["bias", "apply", str(table), "--bias", "b.toml", "--out", str(table), "--force"]) == 2
    assert table.read_text() == "person\n"
    assert sorted(path.name for path in run_folder.iterdir()) == before
