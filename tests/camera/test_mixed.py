"""Cameras with lenses of several models in one rig: each as its own model has it."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.lens import COMMON
from jaxpoint.camera.lenses import chosen_lenses
from jaxpoint.camera.mixed import embedded, mixed_lens, plain_lens
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import UsageError
from jaxpoint.triangulation import triangulate

FOCAL, CENTER = np.array([600.0, 590.0]), np.array([640.0, 470.0])
LENSES = (
    Brown.of(FOCAL, CENTER, np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0])),
    KannalaBrandt.of(0.7 * FOCAL, CENTER, np.array([-0.02, 0.01, -0.004, 0.0005])),
    Pinhole.of(FOCAL, CENTER),
)
POSITIONS = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 1.0, 0.0]])


def mixed_rig() -> CameraRig:
    kind = mixed_lens(type(lens) for lens in LENSES)
    return CameraRig.from_parameters(
        np.stack([lens.focal for lens in LENSES]),
        np.tile(CENTER, (3, 1)),
        np.stack([embedded(kind, type(lens), np.asarray(lens.distortion)) for lens in LENSES]),
        np.tile(np.eye(3), (3, 1, 1)),
        -POSITIONS,
        np.tile([1280, 960], (3, 1)),
        lens=kind,
    )


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return mixed_rig()


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.concatenate([rng.uniform(0.0, 2.0, (30, 2)), rng.uniform(2.5, 5.0, (30, 1))], axis=1)


def test_every_camera_sees_with_its_own_lens(rig, points):
    pixels = np.asarray(rig.project(points))
    for camera, lens in enumerate(LENSES):
        np.testing.assert_allclose(pixels[:, camera], lens.project(points - POSITIONS[camera]), rtol=1e-12)
        ray = rig[camera].lens.unproject(pixels[:, camera])
        wanted = lens.unproject(pixels[:, camera])
        np.testing.assert_array_equal(ray[1], wanted[1])
        np.testing.assert_allclose(ray[0], wanted[0], atol=1e-12)
        assert type(plain_lens(rig[camera].lens)) is type(lens)
        np.testing.assert_array_equal(plain_lens(rig[camera].lens).parameters, lens.parameters)
    assert rig.lens_models == (Brown, KannalaBrandt, Pinhole)


def test_only_a_fisheye_sees_sideways(rig):
    behind = np.array([[1.0, 0.2, -0.3], [3.0, 0.1, -0.2], [0.5, 1.2, -2.0]])
    np.testing.assert_array_equal(rig.sees(behind)[:, [0, 2]], False)
    assert np.asarray(rig.sees(behind))[:2, 1].all()
    pixels = np.asarray(rig.project(behind))
    assert np.isfinite(pixels).all()
    assert (np.abs(pixels[:, [0, 2]] - CENTER).max(axis=-1) > 5000).all()  # far outside, where no light is


@pytest.mark.parametrize("camera", range(3))
def test_derivatives_are_those_of_the_own_lens(rig, camera):
    kind, parameters = type(rig.cameras.lens), np.asarray(rig.cameras.lens.parameters)[camera]
    direction = np.array([0.3, -0.2, 1.1])

    def pixel(aim):
        return jnp.stack(kind.image_of(parameters, tuple(aim)))

    check_grads(pixel, (direction,), order=2)
    backwards = jax.jacrev(pixel)(jnp.asarray(direction))
    slopes, plain = kind.slopes_of(parameters, tuple(direction), np), LENSES[camera]
    own = type(plain).slopes_of(np.asarray(plain.parameters), tuple(direction), np)
    np.testing.assert_allclose(backwards, np.array(slopes.by_direction), rtol=1e-9)
    np.testing.assert_allclose(slopes.by_direction, own.by_direction, rtol=1e-12)
    bent = np.array([np.broadcast_to(part, ()) for part in slopes.by_coefficients[0]])
    assert bent[0] == 0.0
    np.testing.assert_allclose(bent[bent != 0], [part for part in own.by_coefficients[0] if part != 0], rtol=1e-12)


def test_points_are_found_through_unlike_lenses(rig, points):
    pixels = rig.project(points)
    found = triangulate(rig, pixels, np.ones((len(points), 3), bool))
    np.testing.assert_allclose(found.points, points, atol=1e-7)


def test_a_mixed_rig_survives_a_pickle_and_a_selection(rig, points):
    again = pickle.loads(pickle.dumps(rig))
    np.testing.assert_array_equal(again.project(points), rig.project(points))
    np.testing.assert_array_equal(rig.select([1, 0]).project(points), np.asarray(rig.project(points))[:, [1, 0]])


def test_one_model_alone_is_not_mixed():
    assert mixed_lens([Brown, Brown]) is Brown
    choice = chosen_lenses("fisheye", ["a", "b"])
    assert choice.model is KannalaBrandt
    assert choice.free.all()


def test_a_setting_names_cameras():
    choice = chosen_lenses("radial1, b=fisheye,c=brown", ["a", "b", "c"])
    assert choice.model is mixed_lens([KannalaBrandt, Brown])
    assert choice.free.sum(axis=1).tolist() == [1, 4, 5]
    assert not choice.free[:, 0].any()  # which model it is
    assert choice.mean[:, 0].tolist() == [0, 1, 0]
    same = chosen_lenses("radial1,b=brown", ["a", "b"])
    assert same.model is Brown
    assert same.free.sum(axis=1).tolist() == [1, 5]
    assert len(type(LENSES[0]).coefficients) == same.free.shape[1] == COMMON + 1


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("a=fisheye", "leaves out camera 'b'"),
        ("a=fisheye,a=brown,b=brown", "names camera 'a' twice"),
        ("brown,z=fisheye", "names camera 'z'"),
        ("brown,fisheye", "2 choices without a camera"),
        ("a=wide,b=brown", "no lens model 'wide'"),
        ("auto,b=fisheye", "no lens model 'auto'"),
    ],
)
def test_a_wrong_setting_is_refused(setting, said):
    with pytest.raises(UsageError, match=said):
        chosen_lenses(setting, ["a", "b"])
