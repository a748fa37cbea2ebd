"""What the calibration's error does to an arm, against finite differences of everything measured anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from answer_rig import rig_of_three as rig

from jaxpoint.body.predicted_axis import strips_axis
from jaxpoint.body.strip_pixels import strip_pixels
from jaxpoint.body.strips import Strip
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.limb_slices import SLICES
from jaxpoint.pointing.hold_frames import HoldPixels, arm_numbers, by_calibration

HEAD, TIP = np.array([0.1, 0.0, 1.6]), np.array([0.7, -0.2, 1.45])
AHEAD = np.array([0.8, -0.1, 0.2]) / np.linalg.norm([0.8, -0.1, 0.2])
SPAN = np.array([0.19, 0.39])


@pytest.fixture(scope="module")
def seen() -> HoldPixels:
    rng = np.random.default_rng(0)
    places = TIP - np.linspace(SPAN[0] - 0.01, SPAN[1] + 0.01, SLICES)[:, None] * AHEAD
    slices = np.asarray(rig().project(places)).transpose(1, 0, 2)
    held = np.ones(slices.shape[:2], bool)
    held[2, :3] = False

    def noisy(pixels):
        return np.asarray(pixels) + rng.normal(0.0, 0.4, np.shape(pixels))

    both = np.ones(3, bool)
    tip, head = noisy(rig().project(TIP)), noisy(rig().project(HEAD))
    slices = noisy(slices)
    axis = strips_axis(rig(), slices, held, TIP, AHEAD, SPAN)
    strips = [Strip(middle, np.where(own, 20.0, 0.0)) for middle, own in zip(slices, held)]
    return HoldPixels(strip_pixels(strips, tip, axis, SPAN), head, both)


def test_the_arm_is_where_its_pixels_say(seen):
    head, elbow, wrist, tip = np.asarray(arm_numbers(rig(), seen)).reshape(4, 3)
    for got, place in ((head, HEAD), (tip, TIP), (wrist, TIP - SPAN[0] * AHEAD), (elbow, TIP - SPAN[1] * AHEAD)):
        assert np.linalg.norm(got - place) < 0.006


def test_derivatives_by_the_calibration_are_those_of_finite_differences(seen):
    cameras = rig()

    @jax.jit
    def moved(changes):
        own = jax.vmap(Camera.perturbed)(cameras.cameras, changes.reshape(3, 15))
        return arm_numbers(CameraRig(own, cameras.image_sizes, cameras.names), seen)

    stated = np.asarray(by_calibration(cameras, seen))
    assert stated.shape == (12, 45)
    steps = np.tile([*[1e-6] * 6, *[1e-3] * 4, *[1e-6] * 5], 3)
    rng = np.random.default_rng(1)
    for _ in range(4):  # directions in which all numbers change at once
        change = steps * rng.normal(size=45)
        wanted = (moved(jnp.asarray(change)) - moved(jnp.asarray(-change))) / 2
        np.testing.assert_allclose(stated @ change, wanted, rtol=2e-3, atol=2e-3 * np.abs(wanted).max())
