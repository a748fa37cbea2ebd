"""What README and docs show works as it stands there."""

import json
import re
import shlex
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from jaxpoint.camera.lenses import LENSES
from jaxpoint.camera.rig import CameraRig
from jaxpoint.cli import parse
from jaxpoint.config import RoomConfig, load_config
from jaxpoint.detection import PeopleRequest, detect_people, unregister_detector
from jaxpoint.geometry.line import Ray
from jaxpoint.io import FORMATS, TRACK_FORMATS, read_calibration, write_calibration
from jaxpoint.io.calibration import read_calibration_json
from jaxpoint.io.object_files import parse_objects
from jaxpoint.io.session import open_session
from jaxpoint.io.track_files import read_tracks, save_tracks
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.shapes import unregister
from jaxpoint.tracks import Tracks

ROOT = Path(__file__).parents[1]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
SHOWN = "|".join(
    [
        "detect",
        "objects",
        "bias",
        "check",
        "calibrate",
        "align",
        "validate",
        "triangulate",
        "diff",
        "convert",
        "simulate",
        "demo",
        "point",
        "board",
        "intrinsics",
        "stereo",
        "undistort",
    ]
)
COMMANDS = sorted(
    {
        line.strip()
        for text in PAGES.values()
        for line in re.findall(rf"jaxpoint (?:{SHOWN}) [^`#\n]*", text)
        if len(line.split()) > (3 if line.split()[1] in ("detect", "objects", "bias") else 2)
    }
)


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_is_understood(line):
    words = shlex.split(line)[1:]
    assert type(parse(words)).__name__.lower() in (words[0], "".join(words[:2]))


def test_the_commands_were_found():
    assert {line.split()[1] for line in COMMANDS} >= {
        "detect",
        "bias",
        "check",
        "calibrate",
        "align",
        "validate",
        "diff",
        "objects",
        "point",
        "demo",
    }


@pytest.mark.parametrize("page", PAGES)
def test_what_pages_link_to_is_there(page):
    """In files; `make docs` also checks anchors."""
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", PAGES[page]):
        assert "://" in target or ((ROOT / page).parent / target).exists(), target


def test_the_readme_is_short():
    assert len(PAGES["README.md"].splitlines()) <= 250


def test_every_python_block_has_a_test_here_or_is_known_to_need_none():
    shown = {(page, number) for page in PAGES for number, _ in enumerate(blocks(page, "python"))}
    run = {("README.md", 0), ("docs/guides/derivatives.md", 0), ("docs/guides/objects.md", 0)}
    run |= {("docs/extend.md", number) for number in range(6)} | {("docs/reference/exchange.md", 0)}
    pages = ("docs/guides/uncertainty.md", "docs/guides/clusters.md", "docs/guides/boards.md")
    imported = {(page, 0) for page in pages}  # by tests/test_public.py
    assert shown == run | imported


def test_the_python_example_runs(tmp_path, monkeypatch, solved_room, capsys):
    calibration = solved_room[1]
    save_tracks(tmp_path / "tracks.npz", calibration.tracks)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxpoint.calibration.selfcal.calibrate", lambda tracks: calibration)
    names: dict = {}
    exec(blocks("README.md", "python")[0], names)
    np.testing.assert_allclose(names["camera"].position, solved_room[0].room.positions[2], atol=1e-9)
    assert names["found"].valid.shape == (calibration.tracks.frames,)
    assert capsys.readouterr().out


def test_the_derivatives_shown_are_there(free_room, capsys):
    known, calibration = free_room
    clicks = known.clicks
    arm = slice(8, 10)  # two clicked points that are no landmarks
    names = {
        "calibration": calibration,
        "arm_pixels": clicks.pixels[arm],
        "arm_visible": clicks.visible[arm],
        "landmarks": known.landmarks.points,
        "clicks": clicks.pixels[:8],
        "clicked": clicks.visible[:8],
    }
    exec(blocks("docs/guides/derivatives.md", "python")[0], names)
    assert names["by"].light.shape == calibration.tracks.pixels.shape
    assert all(np.abs(part).max() > 0 for part in (names["by"].light, names["by"].landmarks, names["by"].clicks))
    assert capsys.readouterr().out


def test_the_objects_shown_are_pointed_at(tmp_path, monkeypatch):
    (tmp_path / "session").mkdir()
    (tmp_path / "session/objects.csv").write_text(blocks("docs/reference/formats.md", "csv")[0])
    monkeypatch.chdir(tmp_path)
    line = PointingLine(Ray.through(np.array([1.5, 3.0, 1.4]), np.array([1.5, 0.0, 1.5])), 1e-4 * np.eye(6))
    names = {"lines": line}
    exec(blocks("docs/guides/objects.md", "python")[0], names)
    assert bool(names["hits"].valid[0])
    assert float(names["answer"].probability[0]) > 0.5


def test_the_formats_shown_are_read_and_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig, names = two_cameras(), {}
    try:
        exec(blocks("docs/extend.md", "python")[4], names)
        assert write_calibration(rig, "room.mine") == ()
        np.testing.assert_allclose(read_calibration("room.mine").rig.positions, rig.positions, atol=1e-12)
    finally:
        FORMATS.pop("mine", None)
    write_calibration(rig, "calibration.json")
    exec(blocks("docs/reference/exchange.md", "python")[0], names)
    assert names["to_mrcal"]("calibration.json") == ()
    assert len(list((tmp_path / "models").glob("*.cameramodel"))) == len(rig)


def test_the_format_of_tracks_shown_is_read(tmp_path):
    for name in ("left", "right"):
        (tmp_path / f"{name}.txt").write_text("my wings\n0 10 20\n2 30 40\n")
    try:
        exec(blocks("docs/extend.md", "python")[5], {})
        tracks = read_tracks(tmp_path, image_sizes=(640, 480))
        assert (tracks.names, tracks.point_names, tracks.frame_ids.tolist()) == (("left", "right"), ("tip",), [0, 2])
    finally:
        TRACK_FORMATS.pop("wings", None)


def two_cameras() -> CameraRig:
    turns = np.tile(np.eye(3), (2, 1, 1))
    places = np.array([[0.0, 0.0, 4.0], [1.0, 0.0, 4.0]])
    sizes = np.tile([640, 480], (2, 1))
    return CameraRig.from_parameters(sizes + 100.0, sizes / 2.0, np.zeros((2, 5)), turns, places, sizes)


def test_the_files_of_objects_shown_can_be_read():
    tables = blocks("docs/reference/formats.md", "csv")
    (rooms,) = blocks("docs/reference/formats.md", "toml")
    rectangles, shapes = (parse_objects(Path("objects.csv"), table) for table in tables)
    room = parse_objects(Path("objects.toml"), rooms)
    assert [thing.shape.name for thing in (*rectangles.things, *shapes.things)] == ["rectangle", "box", "sphere"]
    assert [thing.shape.name for thing in room.things] == ["rectangle", "box", "sphere"]
    np.testing.assert_allclose(room.things[2].shape.numbers, shapes.things[1].shape.numbers)
    assert room.room is not None


def test_the_lens_shown_is_a_lens(capsys):
    names: dict = {}
    try:
        exec(blocks("docs/extend.md", "python")[0], names)
        lens = names["lens"]
        assert LENSES["field_of_view"] is type(lens)
        directions = np.random.default_rng(1).normal([0, 0, 2], 0.5, (20, 3))
        back, valid = lens.unproject(lens.project(directions))
        assert valid.all()
        np.testing.assert_allclose(back, directions / np.linalg.norm(directions, axis=1, keepdims=True), atol=1e-12)
    finally:
        LENSES.pop("field_of_view", None)
    assert capsys.readouterr().out


def test_the_shape_shown_is_met():
    names: dict = {}
    try:
        exec(blocks("docs/extend.md", "python")[1], names)
        table = "name,shape,unit,foot_x,foot_y,foot_z,width,height\npole,post,m,2,0,0,0.2,1\n"
        (pole,) = parse_objects(Path("objects.csv"), table).things
        objects = Objects.of([pole, Thing("other", names["Post"](np.array([3.0, 0.0, 0.0]), 0.2, 0.4))])
        hits = intersect(Ray(np.array([0.0, 0.0, 0.5]), np.array([1.0, 0.0, 0.0])), objects)
        assert (int(hits.object[0]), float(hits.distance[0])) == (0, pytest.approx(1.9))
        assert not hits.valid[1]
    finally:
        unregister("post")


def test_the_target_shown_joins_a_light():
    names: dict = {}
    exec(blocks("docs/extend.md", "python")[3], names)
    light = Tracks.from_pixels(np.full((4, 2, 2), 5.0), np.array([[640, 480], [640, 480]]))
    both = names["with_cube"](light, np.full((8, 2, 2), 7.0), np.zeros(8, int), np.arange(8))
    assert both.frames == 12
    assert both.targets[0].freedoms == 6


def test_the_detector_shown_detects():
    folder = Path(str(files("jaxpoint"))) / "data" / "session"
    whole = open_session(folder)
    session = replace(whole, names=whole.names[:2], sizes=whole.sizes[:2], frame_index=whole.frame_index[:, :2])
    try:
        exec(blocks("docs/extend.md", "python")[2], {})
        views = detect_people(PeopleRequest(session), "mine")
        for view, own in zip(views, session.frame_index.T, strict=True):
            np.testing.assert_array_equal(view.frame, np.flatnonzero(own >= 0))
        assert views[0].head_found.all()
        joints = views[1].person(0).joints()
        assert joints.seen.sum() == 3
        np.testing.assert_array_equal(joints.pixels[joints.seen][0], [100.0, 50.0])
    finally:
        unregister_detector("mine")


def test_the_calibration_shown_can_be_read(tmp_path):
    (example,) = blocks("docs/reference/formats.md", "json")
    (tmp_path / "calibration.json").write_text(example)
    read = read_calibration_json(tmp_path / "calibration.json")
    shown = json.loads(example)["cameras"][0]
    np.testing.assert_array_equal(read.rig.cameras.focal[0], [shown["K"][0][0], shown["K"][1][1]])


def test_the_settings_shown_can_be_read(tmp_path):
    example = blocks("docs/reference/settings.md", "toml")[0]  # the others are files of configs/
    (tmp_path / "room.toml").write_text(example)
    assert load_config(tmp_path / "room.toml") != RoomConfig()
