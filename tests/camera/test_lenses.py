"""Every lens against OpenCV, finite differences and its own inverse; their register."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.conversion import convert
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.lenses import LENSES, lens_of_choice, register_lens
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.rational import Rational
from jaxpoint.errors import UsageError

FOCAL, CENTER = np.array([900.0, 880.0]), np.array([650.3, 370.8])
K = np.array([[FOCAL[0], 0, CENTER[0]], [0, FOCAL[1], CENTER[1]], [0, 0, 1]])
COEFFICIENTS = {
    Pinhole: [],
    Brown: [-0.25, 0.06, 1e-3, -5e-4, -0.005],
    Rational: [0.3, 0.1, 1e-3, -5e-4, 0.01, 0.55, 0.2, 0.02],
    KannalaBrandt: [-0.02, 0.01, -0.004, 0.0005],
}
RNG = np.random.default_rng(0)
AHEAD = np.concatenate([RNG.uniform(-0.7, 0.7, (40, 2)), np.ones((40, 1))], axis=1)
STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
EVERY = pytest.mark.parametrize("kind", COEFFICIENTS, ids=lambda kind: kind.name)


def lens_of(kind: type[AbstractLens]) -> AbstractLens:
    return kind.of(FOCAL, CENTER, np.array(COEFFICIENTS[kind]))


def opencv_pixels(kind: type[AbstractLens], directions: np.ndarray) -> np.ndarray:
    values, none = np.array(COEFFICIENTS[kind]), np.zeros(3)
    if kind is KannalaBrandt:
        return cv2.fisheye.projectPoints(directions[:, None], none, none, K, values)[0][:, 0]
    return cv2.projectPoints(directions, none, none, K, values if len(values) else None)[0][:, 0]


@EVERY
def test_pixels_are_opencvs(kind):
    far = AHEAD * [4.0, 4.0, 1.0]  # also beyond the range
    for directions in (AHEAD, far):
        pixels = opencv_pixels(kind, directions)
        np.testing.assert_allclose(lens_of(kind).project(directions), pixels, rtol=1e-12, atol=1e-9)


@EVERY
def test_directions_are_opencvs(kind):
    pixels, values = opencv_pixels(kind, AHEAD), np.array(COEFFICIENTS[kind])
    if kind is KannalaBrandt:
        plane = cv2.fisheye.undistortPoints(pixels[:, None], K, values, criteria=STOP)[:, 0]
    else:
        plane = cv2.undistortPoints(pixels[:, None], K, values if len(values) else None, None, None, None, STOP)[:, 0]
    directions, valid = lens_of(kind).unproject(pixels)
    assert np.asarray(valid).all()
    np.testing.assert_allclose(directions[:, :2] / directions[:, 2:], plane, atol=1e-9)
    unit = AHEAD / np.linalg.norm(AHEAD, axis=1, keepdims=True)
    np.testing.assert_allclose(directions, unit, atol=1e-13)


@EVERY
def test_slopes_are_finite_differences(kind):
    """Written out, by numpy and by JAX, in an adjustment and elsewhere."""
    parameters = np.asarray(lens_of(kind).parameters)
    directions = np.concatenate([AHEAD[:6], [[1e-7, 0.0, 1.0], [0.0, 0.0, 2.0]]])
    for xp, wild in ((np, False), (jnp, False), (np, True)):
        found = kind.slopes_of(parameters, tuple(directions.T), xp, wild=wild)

        def pixels(moved, aim):
            return np.asarray(kind(moved).project(aim)).T

        np.testing.assert_allclose(found.pixel, pixels(parameters, directions), atol=1e-9)
        for axis in range(3):
            step = 1e-6 * np.eye(3)[axis]
            numeric = (pixels(parameters, directions + step) - pixels(parameters, directions - step)) / 2e-6
            np.testing.assert_allclose([row[axis] for row in found.by_direction], numeric, atol=2e-5)
        for k in range(len(kind.coefficients)):
            step = 1e-6 * np.eye(len(parameters))[4 + k]
            numeric = (pixels(parameters + step, directions) - pixels(parameters - step, directions)) / 2e-6
            np.testing.assert_allclose([row[k] for row in found.by_coefficients], numeric, atol=2e-5)


@EVERY
def test_derivatives_of_both_ways(kind):
    lens = lens_of(kind)

    def both(parameters, direction):
        moved = kind(parameters)
        pixel = moved.project(direction)
        return pixel / 1e3, moved.unproject(pixel + jnp.array([[3.0, -2.0]]))[0]

    directions = np.array([[0.2, -0.3, 1.0], [0.4, 0.1, 1.2]])
    check_grads(jax.jit(both), (np.asarray(lens.parameters), directions), 1, modes=["fwd", "rev"], atol=1e-6, rtol=1e-5)


def test_a_fisheye_sees_behind_itself():
    lens = KannalaBrandt.of(np.array([300.0, 300.0]), np.array([640.0, 480.0]))
    angles = np.deg2rad([0.0, 60.0, 90.0, 110.0, 150.0, 179.0])
    directions = np.stack([np.sin(angles), np.zeros(6), np.cos(angles)], axis=1)
    pixels = lens.project(directions)
    np.testing.assert_allclose(pixels[:, 0] - 640.0, 300.0 * angles, atol=1e-9)
    back, valid = lens.unproject(pixels)
    assert np.asarray(valid).all()
    assert np.asarray(lens.reaches(directions)).all()
    np.testing.assert_allclose(back, directions, atol=1e-12)


@pytest.mark.parametrize("kind", [Brown, Rational, KannalaBrandt], ids=lambda kind: kind.name)
def test_where_a_lens_folds_back_it_says_so(kind):
    bend = np.zeros(len(kind.coefficients))
    bend[0] = -0.3
    lens = kind.of(np.ones(2), np.zeros(2), bend)
    radius = 1.0 / np.sqrt(0.9)  # where r (1 - 0.3 r^2) stops growing
    edge = radius if kind is not KannalaBrandt else np.tan(radius)
    for share, inside in ((0.97, True), (1.03, False)):
        assert bool(lens.reaches(np.array([edge * share, 0.0, 1.0]))) is inside
    rim = radius * (1 - 0.3 * radius**2)
    for pixel, inside in ((0.99 * rim, True), (1.01 * rim, False), (1e6, False)):
        direction, valid = lens.unproject(np.array([pixel, 0.0]))
        assert bool(valid) is inside
        assert np.isfinite(direction).all()


@pytest.mark.parametrize("kind", [Rational, KannalaBrandt], ids=lambda kind: kind.name)
def test_one_lens_as_another(kind):
    brown = Brown.of(FOCAL, CENTER, np.array([-0.25, 0.06, 0.0, 0.0, -0.005]))
    pixels = np.stack(np.meshgrid(np.linspace(100, 1200, 9), np.linspace(50, 700, 7)), axis=-1).reshape(-1, 2)
    free = np.array([name in ("k1", "k2", "k3", "k4") for name in kind.parameter_names()[4:]])
    parameters = convert(np.asarray(brown.parameters), Brown, kind, pixels, free)
    directions, _ = brown.unproject(pixels)
    away = np.linalg.norm(np.asarray(kind(parameters).project(directions)) - pixels, axis=1)
    assert away.max() < 0.05  # px


def test_settings_name_lenses():
    assert lens_of_choice("radial2") == (Brown, ("k1", "k2"))
    assert lens_of_choice("fisheye")[0] is KannalaBrandt
    with pytest.raises(UsageError, match=r"no lens model 'wide'; choose auto or one of .*fisheye"):
        lens_of_choice("wide")

    class Other(AbstractLens):
        name = "other"
        choices = {"brown": ()}  # noqa: RUF012 (never used)

    with pytest.raises(ValueError, match="called 'brown' is known"):
        register_lens(Other)
    assert LENSES["brown"] is Brown


@EVERY
def test_values_and_gradients_are_finite_everywhere(kind):
    lens = lens_of(kind)
    directions = np.array([[0.0, 0, 0], [1, 1, 0], [1, -2, 1e-15], [0.5, 0.5, -2], [0, 0, 3.0], [0, 0, -1.0]])
    gradient = jax.jit(jax.grad(lambda p, d: jnp.sum(kind(p).project(d)), argnums=(0, 1)))(lens.parameters, directions)
    assert np.isfinite(lens.project(directions)).all()
    assert all(np.isfinite(part).all() for part in gradient)
