"""The experiment on the thesis's ends of a forearm, on drawn arms that no simulator made."""

from dataclasses import replace

import capsules
import numpy as np
import pytest

import thesis_endpoints as rule
from jaxpoint.camera.rig import CameraRig
from jaxpoint.simulate.simulated_session import simulate_session

ARM = 9


def rig_beside():
    """Two cameras that see the arm, which points along x, from both sides of its front, and one from the side."""
    angle = np.deg2rad([50.0, -50.0, 90.0])
    positions = np.stack([0.4 + 2.5 * np.cos(angle), 2.5 * np.sin(angle), [1.7, 2.0, 1.9]], axis=1)
    rotation = []
    for position in positions:
        forward = np.array([0.4, -0.2, 1.3]) - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation.append(np.stack([right, np.cross(forward, right), forward]))
    rotation = np.array(rotation)
    return CameraRig.from_parameters(
        np.full((3, 2), 900.0), np.tile([640.0, 360.0], (3, 1)), np.zeros((3, 5)), rotation,
        -np.einsum("cij,cj->ci", rotation, positions), np.tile([1280, 720], (3, 1)),
    )  # fmt: skip


@pytest.mark.parametrize("elevation", [-10.0, 0.0])
def test_joined_ends_rise_above_a_straight_arm_and_planes_do_not(elevation):
    along = np.array([np.cos(np.deg2rad(elevation)), 0.0, np.sin(np.deg2rad(elevation))])
    person = capsules.capsule_person((0.0, 0.0), along, along)
    arm = capsules.CapsulePerson(
        person.joints,
        tuple(
            capsules.Capsule(one.a, one.b, one.radius_a, one.radius_b, ARM) if k >= len(person.capsules) - 3 else one
            for k, one in enumerate(person.capsules)
        ),
    )
    rig = rig_beside()
    labels = [capsules.draw(arm, rig, camera).labels for camera in range(3)]
    views = [rule.viewed(camera, own == ARM, own > 0) for camera, own in enumerate(labels)]
    assert all(view is not None for view in views)
    errors = [
        rule.elevation_deg(line) - elevation
        for line in (
            rule.joined(rig, views[:2], lambda view: view.ends),
            rule.common_direction(rig, views[:2], along),
            rule.common_direction(rig, views, along),
        )
    ]
    assert errors[0] > 1.0
    assert np.abs(errors[1:]).max() < 1.0


def test_one_simulated_gesture_of_perfect_people():
    settings = rule.perfect(people=1, gestures=2)
    settings = replace(
        settings,
        viewpoints=replace(settings.viewpoints, cameras=4, size=(640, 360)),
        people=replace(settings.people, pointing=replace(settings.people.pointing, accurate_share=0.0)),
    )
    session = simulate_session(settings, 3)
    rows = {row.line: row for row in rule.measure(session, session.gestures[1], any_shape=True)}
    assert set(rows) == set(rule.LINES)
    truth = rows["true elbow-wrist axis"]
    assert truth.to_axis == 0.0
    assert abs(truth.to_target) < 0.2  # this law carries the forearm's own axis to the target
    assert abs(rows["axis planes, all views"].to_axis) < 5.0


def test_rays_of_a_projected_point_meet_in_it():
    rig, point = rig_beside(), np.array([0.5, -0.1, 1.3])
    pixels = np.asarray(rig.project(point))
    np.testing.assert_allclose(rule.meeting(rig, [(c, pixels[c]) for c in range(3)]), point, atol=1e-9)


def test_the_table_shows_mean_and_spread_by_law():
    rows = [rule.Row("forearm", "thesis", error, error + 1, 20.0) for error in (4.0, 6.0)]
    text = rule.markdown(rows)
    assert "| 2 | +5.00 (1.41) | +5.00 (1.48) | +6.00 (1.41) | +6.00 (1.48) |" in text
    assert "| above 15 | 2 | +6.00 (1.41) | +6.00 (1.48) |" in text
    assert "atan(1.5 / 17) = 5.04" in text
