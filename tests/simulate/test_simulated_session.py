"""Sessions: the truth agrees with the pictures, the folder with the readers, and the seed with itself."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.config import load_config
from jaxpoint.config.people import PeopleSettings
from jaxpoint.config.pointing import RoomExtent
from jaxpoint.config.simulation import FaultSettings, SimulationSettings, ViewpointSettings
from jaxpoint.errors import UsageError
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.session import open_session
from jaxpoint.io.timestamps import read_timestamps
from jaxpoint.io.video import open_frames
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Part
from jaxpoint.simulate.session_folder import write_session
from jaxpoint.simulate.simulated_session import simulate_session

SETTINGS = SimulationSettings(
    empty_frames=3,
    frames_per_second=5.0,
    viewpoints=ViewpointSettings(cameras=3, size=(384, 216)),
    people=PeopleSettings(play="gestures", gestures=2, people=1, empty_s=0.4),
    faults=FaultSettings(stops=((1, 3.0),), dropped=0.05, doubled=0.1),
)


@pytest.fixture(scope="module")
def session():
    return simulate_session(SETTINGS, 11)


@pytest.fixture(scope="module")
def folder(session, tmp_path_factory):
    folder = tmp_path_factory.mktemp("session")
    write_session(folder, session, masks=True)
    return folder


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def hold(session, gesture):
    return session.frame_at((gesture.hold_first_s + gesture.hold_last_s) / 2)


def test_the_same_seed_gives_the_same_frames_in_any_order(session):
    again = simulate_session(SETTINGS, 11)
    moment = hold(session, session.gestures[0])
    first, second = next(session.frames([moment], [0])), next(again.frames([moment + 1, moment], [0]))
    del second
    np.testing.assert_array_equal(again.frame(moment, 0).image, first.image)
    np.testing.assert_array_equal(session.empty(1, 0), again.empty(1, 0))
    assert (session.empty(1, 0) != session.empty(2, 0)).any()
    assert (session.frame(moment, 0).image != session.frame(moment + 1, 0).image).any()


def test_truth_in_the_image_is_the_truth_in_the_room_through_the_rig(session):
    rig, seen = session.rig, 0
    for gesture in session.gestures:
        moment = hold(session, gesture)
        for frame in session.frames([moment]):
            (actor,) = session.present(frame.time_s)
            joints = actor.joints(frame.time_s)
            (view,) = frame.views
            assert view.hand == gesture.hand
            for name, pixel in (("head", view.head), (f"{view.hand}_wrist", view.wrist)):
                if np.isfinite(pixel).all():
                    np.testing.assert_allclose(np.asarray(rig.project(joints[name]))[frame.camera], pixel, atol=1e-6)
            if view.forearm_visible > 0.95 and view.forearm_angle_deg > 45:
                x, y = np.rint((view.elbow + view.wrist) / 2).astype(int)
                forearm = Part.RIGHT_FOREARM if view.hand == "right" else Part.LEFT_FOREARM
                assert frame.labels[y, x] == forearm + PARTS_A_PERSON * view.person
                seen += 1
            assert view.silhouette_px == (frame.labels > 0).sum()
            inside = np.isfinite(view.head).all() and (view.head > 8).all() and (view.head < [376, 208]).all()
            if inside and view.silhouette_px > 500:
                x, y = np.rint(view.head).astype(int)
                assert frame.labels[y, x] > 0
    assert seen >= 2


def test_nobody_is_seen_before_the_play_begins(session):
    frame = next(session.frames([0, 1]))
    assert frame.views == ()
    assert not frame.labels.any()
    change = cv2.absdiff(frame.image, session.empty(2, frame.camera))
    assert np.median(change) < 12


def test_the_folder_is_read_as_any_session(folder, session):
    found = open_session(folder)
    assert found.names == session.rig.names
    np.testing.assert_allclose(np.asarray(found.rig.positions), np.asarray(session.rig.positions), atol=1e-9)
    assert read_calibration(folder / "calibration.json").unit == "m"
    stamps = read_timestamps(folder / "timestamps.csv")
    np.testing.assert_array_equal(stamps.frame_index, session.clocks.frame_index[: len(stamps.frame_index)])
    np.testing.assert_array_equal(found.frame_index, stamps.frame_index)
    for camera, video in enumerate(found.videos):
        source = open_frames(video)
        assert len(source) == session.clocks.present[:, camera].sum()
        assert source.size == (384, 216)
    moment = hold(session, session.gestures[0])
    shown = session.frame(moment, 0).image.astype(float)
    stored = open_frames(found.videos[0]).read(int(found.frame_index[moment, 0])).astype(float)
    assert np.abs(stored - shown).mean() < 6  # mp4 loses a little
    assert len(open_frames(found.empty[2])) == 3
    assert "--seed 11" in (folder / "session.toml").read_text()
    assert load_config(folder / "session.toml").simulate == SETTINGS
    assert load_config(folder / "session.toml").point.room == RoomExtent((0.0, 0.0, 0.0), tuple(session.scene.size))


def test_the_written_truth_is_that_of_the_session(folder, session):
    gestures = rows(folder / "truth" / "gestures.csv")
    assert len(gestures) == 2
    assert [g["law"] for g in gestures] == [g.law for g in session.gestures]
    joints = rows(folder / "truth" / "joints.csv")
    row = next(r for r in joints if r["frame"] == gestures[0]["hold_first"] and r["joint"] == "head")
    time_s = session.time_of(int(row["frame"]))
    expected = session.present(time_s)[0].joints(time_s)["head"]
    np.testing.assert_allclose([float(row[f"{axis}_m"]) for axis in "xyz"], expected, atol=1e-5)
    views = rows(folder / "truth" / "views.csv")
    moments, cameras = np.nonzero(session.clocks.present)
    shown = session.clocks.shown_s[moments, cameras]
    assert len(views) == sum(len(session.present(float(time_s))) for time_s in shown)
    assert {view["camera"] for view in views} == {session.rig.names[camera] for camera in cameras}
    objects = rows(folder / "objects.csv")
    assert len(objects) >= 20
    assert {thing["unit"] for thing in objects} == {"m"}
    assert len(rows(folder / "truth" / "people.csv")) == 1
    frame = next(frame for frame in session.frames() if frame.labels.any())
    mask = cv2.imread(str(folder / "truth" / "masks" / f"cam_{frame.camera}" / f"{frame.frame:06d}.png"), -1)
    np.testing.assert_array_equal(mask, frame.labels)


def test_a_camera_that_repeats_itself_gives_the_same_image(session):
    clocks = session.clocks
    repeated = (clocks.source[1:] == clocks.source[:-1]) & clocks.present[1:] & clocks.present[:-1]
    moment, camera = np.argwhere(repeated)[0].tolist()
    np.testing.assert_array_equal(session.frame(moment, camera).image, session.frame(moment + 1, camera).image)


def test_light_flickers_and_drifts_by_what_is_asked(session):
    steady = replace(session, settings=replace(SETTINGS, light=replace(SETTINGS.light, drift=0.0)))
    levels = np.array([steady.brightness(moment, moment / 5) for moment in range(400)])
    assert levels.std() == pytest.approx(SETTINGS.light.flicker, rel=0.15)
    calm = replace(session, settings=replace(SETTINGS, light=replace(SETTINGS.light, flicker=0.0)))
    levels = np.array([calm.brightness(moment, moment / 5) for moment in range(400)])
    assert np.abs(levels - 1).max() == pytest.approx(SETTINGS.light.drift, rel=0.02)
    assert np.abs(np.diff(levels)).max() < 0.005


def test_asking_a_stopped_camera_is_an_error(session):
    with pytest.raises(ValueError, match="Camera 1 has no image of moment"):
        session.frame(session.clocks.moments - 1, 1)


def test_a_play_shorter_than_a_frame_is_refused():
    slow = replace(SETTINGS, frames_per_second=0.01, people=PeopleSettings(play="empty", empty_s=4.0))
    with pytest.raises(UsageError, match=r"lasts 4\.0 s.* at 0\.01 frames a second; .* to 0\.25 or more"):
        simulate_session(slow, 11)


def test_flags_go_before_the_file_and_the_file_before_the_defaults(tmp_path, monkeypatch):
    (tmp_path / "room.toml").write_text("[simulate]\nviewpoints.size = [64, 36]\npeople = { gestures = 3, people = 5 }")
    asked = []

    def noted(settings, *_):
        asked.append(settings)
        raise UsageError("noted")

    monkeypatch.setattr("jaxpoint.simulate.simulated_session.simulate_session", noted)
    command = ["simulate", "--config", str(tmp_path / "room.toml"), "--out", str(tmp_path / "out"), "--people", "1"]
    assert main(command) == 2
    (settings,) = asked
    assert (settings.people.people, settings.people.gestures) == (1, 3)
    assert (settings.viewpoints.size, settings.viewpoints.cameras) == ((64, 36), 6)


def test_half_an_image_size_is_refused_in_plain_words(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "--size", "640", "--out", "session"])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "'--size'. Expected 2 values." in said
    assert "[" not in said


def test_the_command_writes_once_and_replaces_only_by_force(tmp_path, capsys, monkeypatch, session):
    config = tmp_path / "room.toml"
    config.write_text(
        "[simulate]\nempty_frames = 2\nframes_per_second = 2.0\n[simulate.people]\nplay = 'gestures'\nempty_s = 0.5\n"
    )
    small = ["--config", config, "--gestures", 1, "--people", 1, "--cameras", 2, "--size", 160, 90, "--seed", 3]
    command = [str(part) for part in ("simulate", "--out", tmp_path / "out", *small)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "1 gestures among" in said
    assert open_session(tmp_path / "out").names == ("cam_0", "cam_1")
    assert main(command) == 2
    assert "is not empty" in capsys.readouterr().err
    before = (tmp_path / "out" / "objects.csv").read_bytes()

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("jaxpoint.simulate.simulated_session.simulate_session", lambda *_: session)
        patch.setattr("jaxpoint.simulate.session_folder._write_joints", full)
        assert main([*command, "--force"]) == 3
    assert (tmp_path / "out" / "objects.csv").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "room.toml"]
    assert main(["simulate", "--cameras", "2"]) == 2
    assert "--out session" in capsys.readouterr().err
