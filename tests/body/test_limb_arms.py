"""Arms out of drawn people: a person of capsules in rooms with other cameras each time; the joints are the truth."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from tests.body.capsules import capsule_person, draw, evidence

from jaxpoint.body.arm import ArmReason
from jaxpoint.body.limb_arms import find_arm, find_arm_again
from jaxpoint.camera.rig import CameraRig
from jaxpoint.detection.person.crop import Crop
from jaxpoint.evidence.limb_slices import Pixel

PLACE = (3.0, 2.5)
PEOPLE = 20


def looking_at(positions: np.ndarray, targets: np.ndarray, focal: np.ndarray) -> CameraRig:
    """Upright cameras of 1280 x 720 px with a little barrel distortion."""
    forward = targets - positions
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    count = len(positions)
    return CameraRig.from_parameters(
        np.stack([focal, focal], axis=1),
        np.tile([639.5, 359.5], (count, 1)),
        np.tile([-0.12, 0.02, 0.0, 0.0, 0.0], (count, 1)),
        rotation,
        -np.einsum("cij,cj->ci", rotation, positions),
        np.tile([1280, 720], (count, 1)),
    )


def random_rig(rng: np.random.Generator, count: int = 5) -> CameraRig:
    """Cameras all round the person, 2.5 to 3.5 m away, a little above."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count + rng.uniform(0, 2 * np.pi)
    far = rng.uniform(2.5, 3.5, count)
    positions = np.stack([PLACE[0] + far * np.cos(angle), PLACE[1] + far * np.sin(angle), rng.uniform(1.6, 2.6, count)])
    targets = np.array([*PLACE, 1.2]) + rng.uniform(-0.2, 0.2, (count, 3))
    return looking_at(positions.T, targets, rng.uniform(600, 800, count))


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def random_person(rng: np.random.Generator):
    """A person who points away from the trunk, the elbow bent a little, the hand out of line by up to 15 degrees."""
    azimuth, elevation = rng.uniform(-2.2, 0.6), rng.uniform(-0.3, 0.5)
    forearm = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    upper = unit(*(forearm + rng.uniform(-0.4, 0.4, 3) - [0.0, 0.0, 0.3]))
    return capsule_person(PLACE, forearm, upper, hand_bend=rng.uniform(-0.26, 0.26)), forearm


def seen(person, rig: CameraRig) -> tuple[list[Crop | None], np.ndarray, np.ndarray]:
    """Crops, the head, and its pixels."""
    head = person.joints["head"]
    return [draw(person, rig, camera) for camera in range(len(rig))], head, np.asarray(rig.project(head))


def arm_of(rig: CameraRig, crops: list[Crop | None], head: np.ndarray, head_px: np.ndarray):
    """The arm of a person whose pixels views hold."""
    return find_arm(rig, evidence(crops), head, head_px)


def degrees_between(a, b) -> float:
    return float(np.degrees(np.arccos(np.clip(np.asarray(a) @ np.asarray(b), -1, 1))))


@pytest.fixture(scope="module")
def example():
    """One person whose arm every camera can tell."""
    rng = np.random.default_rng(3)
    rig = random_rig(rng)
    forearm = unit(0.5, -0.8, 0.15)
    person = capsule_person(PLACE, forearm, unit(0.4, -0.7, -0.1))
    return rig, *seen(person, rig), person.joints, forearm


def test_direction_and_tip_of_many_people():
    rng = np.random.default_rng(0)
    angles, tips = [], []
    for _ in range(PEOPLE):
        rig = random_rig(rng)
        person, forearm = random_person(rng)
        arm = arm_of(rig, *seen(person, rig))
        assert arm is not None
        angles.append(degrees_between(arm.direction, forearm))
        tips.append(np.linalg.norm(arm.tip - person.joints["tip"]))
    assert np.median(angles) < 1.0
    assert np.median(tips) < 0.015
    # The other arm hangs: its fingertip is more than 0.3 m from every tip drawn here.
    assert max(tips) < 0.15
    assert max(angles) < 10.0


def test_order_of_cameras_does_not_matter(example):
    rig, crops, head, head_px, _, _ = example
    order = [3, 0, 4, 1, 2]
    arm = arm_of(rig, crops, head, head_px)
    other = arm_of(
        CameraRig(rig.select(order).cameras, rig.image_sizes, rig.names),
        [crops[c] for c in order],
        head,
        head_px[order],
    )
    assert arm is not None
    assert other is not None
    # The fit of the axis stops some micrometres before its optimum, wherever rounding has brought it.
    np.testing.assert_allclose(other.direction, arm.direction, atol=1e-4)
    np.testing.assert_allclose(other.tip, arm.tip, atol=1e-4)
    assert [arm.views[c].reason for c in order] == [view.reason for view in other.views]


def test_what_hidden_views_hold_does_not_matter(example):
    rig, crops, head, head_px, _, _ = example
    without = arm_of(rig, [*crops[:4], None], head, head_px)
    assert without is not None
    assert without.views[4].reason == ArmReason.NO_PERSON
    elsewhere = head_px.copy()
    elsewhere[4] = -1e4
    same = arm_of(rig, [*crops[:4], None], head, elsewhere)
    assert same is not None
    np.testing.assert_array_equal(same.direction, without.direction)
    np.testing.assert_array_equal(same.tip, without.tip)


def test_a_covered_forearm_is_not_used(example):
    """A board before the person in one view: that view is said to be hidden, and the answer stays."""
    rig, crops, head, head_px, joints, forearm = example
    arm = arm_of(rig, crops, head, head_px)
    assert arm is not None
    view = next(c for c in range(5) if arm.views[c].reason == ArmReason.FOUND)
    ends = np.asarray(rig.project(np.stack([joints["elbow"], joints["tip"]])))[:, view]
    (left, top), (right, bottom) = (
        np.floor(ends.min(axis=0) - 60).astype(int),
        np.ceil(ends.max(axis=0) + 60).astype(int),
    )
    labels = crops[view].labels.copy()
    labels[max(top, 0) : bottom, max(left, 0) : right] = Pixel.NOTHING
    covered = [*crops]
    covered[view] = Crop(labels, crops[view].corner, crops[view].image_size)
    rest = arm_of(rig, covered, head, head_px)
    assert rest is not None
    assert rest.views[view].reason in (ArmReason.HIDDEN, ArmReason.DISAGREES)
    assert degrees_between(rest.direction, forearm) < 3.0


def test_an_arm_along_the_line_of_sight_is_told():
    forearm = unit(0.0, -1.0, 0.1)
    person = capsule_person(PLACE, forearm, forearm)
    middle = (person.joints["elbow"] + person.joints["wrist"]) / 2
    positions = np.array([middle + 2.5 * forearm, [5.5, 2.0, 2.0], [0.5, 2.0, 2.0], [5.0, 4.5, 2.2], [1.0, 4.5, 2.2]])
    rig = looking_at(positions, np.tile(middle, (5, 1)), np.full(5, 700.0))
    arm = arm_of(rig, *seen(person, rig))
    assert arm is not None
    assert arm.views[0].reason == ArmReason.FORESHORTENED
    assert arm.views[0].angle < np.radians(15)
    assert degrees_between(arm.direction, forearm) < 2.0


@pytest.mark.parametrize("kept", [0, 1])
def test_fewer_than_two_views_give_no_arm(example, kept):
    rig, crops, head, head_px, _, _ = example
    assert arm_of(rig, [*crops[:kept], *[None] * (5 - kept)], head, head_px) is None


def test_the_same_people_without_colour_are_measured_by_their_outline(example):
    rig, crops, head, head_px, _, forearm = example
    grey = [Crop(np.minimum(c.labels, np.uint8(Pixel.PERSON)), c.corner, c.image_size) for c in crops]
    arm = arm_of(rig, grey, head, head_px)
    assert arm is not None
    assert degrees_between(arm.direction, forearm) < 3.0


def merged_behind(crop: Crop, elbow: np.ndarray, wrist: np.ndarray, sides: tuple[float, ...]) -> Crop:
    """The crop with skin painted all along these sides of the forearm's axis, as a bare shoulder behind it would be."""
    labels = crop.labels.copy()
    y, x = np.indices(labels.shape)
    places = np.stack([x, y], axis=-1) + np.array(crop.corner) - wrist
    along = (elbow - wrist) / np.linalg.norm(elbow - wrist)
    behind, across = places @ along, places @ np.array([-along[1], along[0]])
    beside = (behind > -10) & (behind < np.linalg.norm(elbow - wrist) + 10)
    for side in sides:
        labels[beside & (side * across > 0) & (side * across < 120)] = Pixel.SKIN
    return Crop(labels, crop.corner, crop.image_size)


@pytest.mark.parametrize(("sides", "says"), [((1.0,), True), ((-1.0,), True), ((1.0, -1.0), False)])
def test_one_edge_is_enough_where_others_know_the_width(example, sides, says):
    rig, crops, head, head_px, joints, forearm = example
    arm = arm_of(rig, crops, head, head_px)
    assert arm is not None
    view = next(c for c in range(5) if arm.views[c].reason == ArmReason.FOUND)
    ends = np.asarray(rig.project(np.stack([joints["elbow"], joints["wrist"]])))[:, view]
    merged = [*crops]
    merged[view] = merged_behind(crops[view], *ends, sides)
    again = arm_of(rig, merged, head, head_px)
    assert again is not None
    assert (again.views[view].reason == ArmReason.FOUND) == says
    assert degrees_between(again.direction, forearm) < 2.0


def test_a_neighbouring_frame_predicts_the_arm(example):
    rig, crops, head, head_px, joints, forearm = example
    arm = arm_of(rig, crops, head, head_px)
    assert arm is not None
    moved = np.array([0.03, -0.02, 0.01])
    ends = (arm.axis.near - moved, arm.axis.far - moved)
    axis = eqx.tree_at(lambda one: (one.near, one.far), arm.axis, ends)
    before = replace(arm, tip=arm.tip - moved, axis=axis)
    again = find_arm_again(rig, evidence(crops), head, before, moved)
    assert again is not None
    assert degrees_between(again.direction, forearm) < 1.0
    assert np.linalg.norm(again.tip - joints["tip"]) < 0.02
    assert find_arm_again(rig, evidence([crops[0], *[None] * 4]), head, before, moved) is None
