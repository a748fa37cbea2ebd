"""Rooms with other axes, in and out of calibrations and objects; align has its own tests of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.geometry.world_axes import world_of
from jaxpoint.io.exchange import read_calibration, saved_of
from jaxpoint.io.object_files import read_objects
from jaxpoint.io.objects_adding import append_object
from jaxpoint.io.world_conversion import from_world, to_world
from jaxpoint.pointing.objects import Thing
from jaxpoint.pointing.shapes import Sphere


def test_a_calibration_goes_into_another_world_and_back(free_room):
    calibration = free_room[1]
    world = world_of("opengl")
    saved = saved_of(calibration)
    root = np.random.default_rng(0).normal(size=(saved.rig.camera_size * len(saved.rig),) * 2)
    saved = replace(saved, covariance=root @ root.T)
    there = to_world(saved, world)
    points = np.asarray(calibration.points)[calibration.point_valid]
    np.testing.assert_allclose(there.rig.project(world.from_room(points)), saved.rig.project(points), atol=1e-8)
    again = from_world(there, world)
    np.testing.assert_allclose(again.rig.positions, saved.rig.positions, atol=1e-12)
    np.testing.assert_allclose(again.covariance, saved.covariance, atol=1e-9)
    with pytest.raises(UsageError, match="left-handed"):
        to_world(saved, world_of("unity"))


@pytest.fixture
def rig_file(data_folder):
    return data_folder.parent / "cases/17-known-lenses/full.json"


def test_convert_writes_another_world_and_unit(rig_file, tmp_path, capsys):
    out = tmp_path / "calibration.toml"
    assert main(["convert", str(rig_file), str(out), "--to", "anipose", "--world", "opengl", "--out-unit", "mm"]) == 0
    assert "--from-world opengl" in capsys.readouterr().out
    known, found = read_calibration(rig_file).rig, read_calibration(out)
    assert found.unit == "m"  # read from millimetres
    np.testing.assert_allclose(found.rig.positions, np.asarray(known.positions)[:, [0, 2, 1]] * [1, 1, -1], atol=1e-9)
    assert main(["convert", str(out), str(tmp_path / "calibration.json"), "--from-world", "opengl"]) == 0
    np.testing.assert_allclose(
        read_calibration(tmp_path / "calibration.json").rig.positions, known.positions, atol=1e-9
    )


def test_units_that_a_format_does_not_say(rig_file, tmp_path, capsys):
    out = tmp_path / "model"
    assert main(["convert", str(rig_file), str(out), "--to", "colmap", "--out-unit", "mm", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["notes"]
    assert any("these are millimetres): read it with --unit mm" in note for note in said)
    far = np.asarray(read_calibration(out).rig.positions)
    np.testing.assert_allclose(far, 1000 * np.asarray(read_calibration(rig_file).rig.positions), rtol=1e-9)


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (["rig.toml", "--to", "anipose", "--world", "unity"], "x,z,y is left-handed"),
        (["calibration.json", "--world", "opengl"], "always has z up; leave out --world"),
        (["rig.gltf", "--world", "opengl"], "always has y up"),
        (["camera_array.toml", "--out-unit", "mm"], "always in m; leave out --out-unit mm"),
        (["rig.toml", "--to", "anipose", "--world", "up"], "There is no world 'up'"),
    ],
)
def test_what_has_no_other_axes_is_refused(rig_file, tmp_path, capsys, flags, sentence):
    assert main(["convert", str(rig_file), str(tmp_path / flags[0]), *flags[1:]]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_objects_of_another_world(tmp_path):
    table = "name,shape,unit,world,center_x,center_y,center_z,radius\nlamp,sphere,cm,unity,300,210,200,15\n"
    (tmp_path / "objects.csv").write_text(table + "ball,sphere,cm,,300,200,210,15\n")
    lamp, ball = (thing.shape for thing in read_objects(tmp_path / "objects.csv").things)
    np.testing.assert_array_equal(lamp.numbers, ball.numbers)
    text = 'unit = "m"\nworld = "unity"\n[room]\nlow = [0, 0, 1]\nhigh = [6, 3, 5]\n'
    (tmp_path / "objects.toml").write_text(text + '[[sphere]]\nname = "lamp"\ncenter = [3, 2.1, 2]\nradius = 0.15\n')
    whole = read_objects(tmp_path / "objects.toml")
    np.testing.assert_allclose(whole.things[0].shape.numbers, ball.numbers)
    assert (whole.room.low.tolist(), whole.room.high.tolist()) == ([0, 1, 0], [6, 5, 3])
    with pytest.raises(UsageError, match="names the world of its axes"):
        append_object(tmp_path / "objects.toml", Thing("cup", Sphere(np.ones(3), 0.1)))
    (tmp_path / "objects.csv").write_text(table.replace("unity", "up"))
    with pytest.raises(FileFormatError, match="line 2: 'lamp': There is no world 'up'"):
        read_objects(tmp_path / "objects.csv")
