"""The room of the answers: the settings' before the objects' file's before a guess."""

import jax.numpy as jnp
import numpy as np
import pytest
from answer_rig import rig_of_three

from jaxpoint.body.joints import Joints
from jaxpoint.config.pointing import RoomExtent
from jaxpoint.errors import UsageError
from jaxpoint.io.object_scene import read_scene
from jaxpoint.pointing.held_joints import HeldJoints
from jaxpoint.pointing.pipeline import _guessed_room, room_of

LOW, HIGH = (0.0, 0.0, 0.0), (6.0, 5.0, 3.0)
SPHERE = '[[sphere]]\nname = "ball"\ncenter = [{x}, 200.0, 100.0]\nradius = 10.0\n'


@pytest.fixture
def objects(tmp_path):
    """A file with a room of its own."""
    path = tmp_path / "objects.toml"
    path.write_text(f'unit = "cm"\n[room]\nlow = [0, 0, 0]\nhigh = [400, 300, 250]\n{SPHERE.format(x=200.0)}')
    return path


def test_the_settings_go_before_the_file(objects):
    scene, _ = read_scene(objects)
    np.testing.assert_allclose(scene.room.high, [4.0, 3.0, 2.5])
    scene, _ = read_scene(objects, room_of(RoomExtent(LOW, HIGH)))
    np.testing.assert_allclose(scene.room.high, HIGH)
    assert scene.room_known
    assert room_of(RoomExtent()) is None


@pytest.mark.parametrize(
    ("extent", "message"),
    [
        (RoomExtent(LOW), "low and high corner both"),
        (RoomExtent(LOW, (6.0, 0.0, 3.0)), "from 0 to 0 m in y; high must be above low"),
        (RoomExtent(LOW, (6.0, 5.0, -3.0)), "from 0 to -3 m in z"),
        (RoomExtent(LOW, (100.5, 5.0, 3.0)), "from 0 to 100.5 m in x; .* by 100 m at most"),
        (RoomExtent((0.0, float("nan"), 0.0), HIGH), "from nan to 5 m in y"),
        (RoomExtent(LOW, (6.0, 5.0, float("inf"))), "from 0 to inf m in z"),
    ],
)
def test_what_is_no_room_is_refused(extent, message):
    with pytest.raises(UsageError, match=message):
        room_of(extent)


@pytest.mark.parametrize(("x", "grown"), [(200.0, True), (3000.0, False)])
def test_a_guess_holds_cameras_and_people_but_not_of_another_place(tmp_path, x, grown):
    path = tmp_path / "objects.toml"
    path.write_text(f'unit = "cm"\n{SPHERE.format(x=x)}')
    scene, _ = read_scene(path)
    assert not scene.room_known
    rig, arm = rig_of_three(), np.array([[0.5, 0.5, 1.6], [4.0, 0.5, 1.2]])
    joints = Joints.of_flat(jnp.asarray(np.tile(arm, (3, 1)).ravel()[None]))
    held = HeldJoints(joints, jnp.zeros((1, 18, 18)), jnp.zeros((1, 18, 18)), np.zeros(1, int))
    room = _guessed_room(scene, rig, held)
    places = np.concatenate([rig.positions, arm])
    low, high = np.asarray(room.low), np.asarray(room.high)
    assert ((places > low) & (places < high)).all() == grown
    assert low[2] == 0.0
    assert (high > scene.objects.bounds[1]).all()
