"""The arm from joints: what it keeps of its pixels gives the same arm again, and its derivatives by the cameras."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from answer_rig import rig_of_three as rig

from jaxpoint.body.joint_arms import SeenArms, joint_arms
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.body_landmarks import LandmarkPerson
from jaxpoint.evidence.person_evidence import SeenJoints
from jaxpoint.pointing.hold_frames import HoldPixels, arm_numbers, by_calibration

HEAD = np.array([0.1, 0.0, 1.6])
JOINTS = {
    "right_elbow": np.array([0.35, -0.05, 1.3]),
    "right_wrist": np.array([0.58, -0.15, 1.4]),
    "right_index": np.array([0.72, -0.2, 1.45]),
}


def arm_of(joints: dict[str, np.ndarray], hidden: dict[str, int] | None = None):
    """The arm out of its joints in three views, each joint hidden in one of them if named."""
    pixels = {name: np.asarray(rig().project(place)) for name, place in joints.items()}
    noise = np.random.default_rng(3).normal(0.0, 0.3, (3, 3, 2))
    views = [
        LandmarkPerson(
            SeenJoints.of(
                {
                    name: own[camera] + noise[k, camera]
                    for k, (name, own) in enumerate(pixels.items())
                    if (hidden or {}).get(name) != camera
                }
            )
        )
        for camera in range(3)
    ]
    (arm,) = joint_arms(rig(), SeenArms.of([views]), HEAD[None])
    return arm


def kept(arm) -> HoldPixels:
    return HoldPixels(arm.pixels, np.asarray(rig().project(HEAD)), np.ones(3, bool))


@pytest.mark.parametrize("names", [tuple(JOINTS), ("right_elbow", "right_wrist")])
def test_what_is_kept_gives_the_same_arm(names):
    arm = arm_of({name: JOINTS[name] for name in names}, {"right_elbow": 2})
    assert arm is not None
    head, elbow, wrist, tip = np.asarray(arm_numbers(rig(), kept(arm))).reshape(4, 3)
    np.testing.assert_allclose(head, HEAD, atol=1e-9)
    for got, place in ((elbow, arm.axis.far), (wrist, arm.axis.near), (tip, arm.tip)):
        np.testing.assert_allclose(got, place, atol=1e-9)
    assert np.linalg.norm(arm.tip - JOINTS["right_index"]) < 0.05
    assert [view.base.any() for view in arm.views] == [True, True, False]  # one view lacks the elbow


@pytest.mark.parametrize("names", [tuple(JOINTS), ("right_elbow", "right_wrist")])
def test_derivatives_by_the_calibration_are_those_of_finite_differences(names):
    cameras, seen = rig(), kept(arm_of({name: JOINTS[name] for name in names}))

    @jax.jit
    def moved(changes):
        own = jax.vmap(Camera.perturbed)(cameras.cameras, changes.reshape(3, 15))
        return arm_numbers(CameraRig(own, cameras.image_sizes, cameras.names), seen)

    stated = np.asarray(by_calibration(cameras, seen))
    steps = np.tile([*[1e-6] * 6, *[1e-3] * 4, *[1e-6] * 5], 3)
    change = steps * np.random.default_rng(1).normal(size=45)
    wanted = (moved(jnp.asarray(change)) - moved(jnp.asarray(-change))) / 2
    np.testing.assert_allclose(stated @ change, wanted, rtol=2e-3, atol=2e-3 * np.abs(wanted).max())


def test_without_joints_there_is_no_arm():
    assert arm_of({"right_elbow": JOINTS["right_elbow"]}) is None
    assert joint_arms(rig(), SeenArms.of([]), np.zeros((0, 3))) == []
