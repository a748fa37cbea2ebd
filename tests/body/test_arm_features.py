"""Features of an arm that points, on a drawn person whose joints are known."""

from dataclasses import astuple, replace

import equinox as eqx
import numpy as np
import pytest
from tests.body.capsules import capsule_person, draw, evidence
from tests.body.test_limb_arms import PLACE, degrees_between, random_rig, unit

from jaxpoint.body.arm_features import WEIGHTS, arm_features
from jaxpoint.body.limb_arms import measure_limbs
from jaxpoint.body.strips import Strip
from jaxpoint.detection.person.crop import Crop
from jaxpoint.evidence.limb_slices import Pixel

FOREARM = unit(0.5, -0.8, 0.15)


@pytest.fixture(scope="module")
def drawn():
    """Joints, rig, crops and the head of somebody who points with a straight hand."""
    rig = random_rig(np.random.default_rng(3))
    person = capsule_person(PLACE, FOREARM, unit(0.4, -0.7, -0.1))
    head = person.joints["head"]
    return person.joints, rig, [draw(person, rig, camera) for camera in range(len(rig))], head


def limbs_of(rig, crops, head):
    return list(measure_limbs(rig, evidence(crops), head, np.asarray(rig.project(head))))


def the_arm(limbs):
    return min(limbs, key=lambda limb: degrees_between(limb.direction, FOREARM))


def test_features_are_those_of_the_drawn_arm(drawn):
    joints, rig, crops, head = drawn
    features = the_arm(limbs_of(rig, crops, head)).features
    out = joints["tip"] - (head - [0.0, 0.0, 0.28])
    assert features.stretch == pytest.approx(np.hypot(*out[:2]) + max(0.0, out[2]), abs=0.02)
    assert features.outward == pytest.approx(FOREARM[:2] @ out[:2] / np.hypot(*out[:2]), abs=0.03)
    assert features.skin > 0.8
    assert features.beyond < 0.1
    assert features.bent < 0.015
    # Radii of 28 mm at the wrist and 42 mm at the elbow, 0.26 m apart, over a span of 0.132 of 1.74 m.
    assert features.widens == pytest.approx(0.014 / 0.035 * 0.132 * 1.74 / 0.26, abs=0.12)
    assert features.past == 0


def test_the_same_limb_the_other_way_round_is_no_arm_that_points(drawn):
    joints, rig, crops, head = drawn
    arm = the_arm(limbs_of(rig, crops, head))
    axis = eqx.tree_at(
        lambda one: (one.near, one.far, one.direction), arm.axis, (arm.axis.far, arm.axis.near, -arm.direction)
    )
    strips = [
        Strip(pixels[::-1], width[::-1]) if width.any() else None
        for pixels, width in zip(arm.pixels.slices, arm.pixels.width)
    ]
    shoulder_end = joints["elbow"] - 0.1 * FOREARM
    reversed_features = arm_features(rig, evidence(crops), head, axis, shoulder_end, strips, (0.19, 0.44), 0)
    assert reversed_features.widens == pytest.approx(-arm.features.widens)
    assert arm.features.log_odds > 3
    assert reversed_features.log_odds < -3


def test_without_colour_a_hand_says_nothing_of_skin(drawn):
    _, rig, crops, head = drawn
    grey = [Crop(np.minimum(crop.labels, np.uint8(Pixel.PERSON)), crop.corner, crop.image_size) for crop in crops]
    assert the_arm(limbs_of(rig, grey, head)).features.skin == 0.6


def test_log_odds_grow_with_every_feature_as_its_weight_says(drawn):
    _, rig, crops, head = drawn
    features = the_arm(limbs_of(rig, crops, head)).features
    for name, weight, value in zip(features.__dataclass_fields__, WEIGHTS, astuple(features), strict=True):
        more = replace(features, **{name: value + 0.1})
        assert more.log_odds - features.log_odds == pytest.approx(0.1 * weight)
