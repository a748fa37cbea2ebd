"""Three cameras around somebody who points."""

import numpy as np

from jaxpoint.camera.rig import CameraRig


def rig_of_three() -> CameraRig:
    """At 3 m, 90 degrees from each other."""
    angle = np.deg2rad([-80.0, 10.0, 100.0])
    positions = np.stack([3 * np.cos(angle), 3 * np.sin(angle), [1.8, 2.3, 2.0]], axis=1)
    forward = np.array([0.2, 0.0, 1.2]) - positions
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return CameraRig.from_parameters(
        np.full((3, 2), 500.0), np.tile([320.0, 240.0], (3, 1)), np.tile([-0.1, 0.01, 0, 0, 0], (3, 1)), rotation,
        -np.einsum("cij,cj->ci", rotation, positions), np.tile([640, 480], (3, 1)),
    )  # fmt: skip
