"""Signs of an arm that points, on a drawn person whose joints are known."""

from dataclasses import astuple, replace

import equinox as eqx
import numpy as np
import pytest
from tests.person.capsules import capsule_person, draw
from tests.person.test_arms import PLACE, degrees_between, random_rig, unit

from jaxpoint.detect.arm import Crop, Pixel
from jaxpoint.person.arms import measured_limbs
from jaxpoint.person.signs import WEIGHTS, signs_of

FOREARM = unit(0.5, -0.8, 0.15)


@pytest.fixture(scope="module")
def drawn():
    """Joints, rig, crops and the head of somebody who points with a straight hand."""
    rig = random_rig(np.random.default_rng(3))
    person = capsule_person(PLACE, FOREARM, unit(0.4, -0.7, -0.1))
    head = person.joints["head"]
    return person.joints, rig, [draw(person, rig, camera) for camera in range(len(rig))], head


def limbs_of(rig, crops, head):
    return list(measured_limbs(rig, crops, head, np.asarray(rig.project(head))))


def the_arm(limbs):
    return min(limbs, key=lambda limb: degrees_between(limb.direction, FOREARM))


def test_signs_are_those_of_the_drawn_arm(drawn):
    joints, rig, crops, head = drawn
    signs = the_arm(limbs_of(rig, crops, head)).signs
    out = joints["tip"] - (head - [0.0, 0.0, 0.28])
    assert signs.stretch == pytest.approx(np.hypot(*out[:2]) + max(0.0, out[2]), abs=0.02)
    assert signs.outward == pytest.approx(FOREARM[:2] @ out[:2] / np.hypot(*out[:2]), abs=0.03)
    assert signs.skin > 0.8
    assert signs.beyond < 0.1
    assert signs.bent < 0.015
    # Radii of 28 mm at the wrist and 42 mm at the elbow, 0.26 m apart, over a span of 0.132 of 1.74 m.
    assert signs.widens == pytest.approx(0.014 / 0.035 * 0.132 * 1.74 / 0.26, abs=0.12)
    assert signs.past == 0


def test_the_same_limb_the_other_way_round_is_no_arm_that_points(drawn):
    joints, rig, crops, head = drawn
    arm = the_arm(limbs_of(rig, crops, head))
    axis = eqx.tree_at(
        lambda one: (one.near, one.far, one.direction), arm.axis, (arm.axis.far, arm.axis.near, -arm.direction)
    )
    strips = [
        None
        if view.strip is None
        else replace(view.strip, width=view.strip.width[::-1], middle=view.strip.middle[::-1])
        for view in arm.views
    ]
    shoulder_end = joints["elbow"] - 0.1 * FOREARM
    reversed_signs = signs_of(rig, crops, head, axis, shoulder_end, strips, (0.19, 0.44), 0)
    assert reversed_signs.widens == pytest.approx(-arm.signs.widens)
    assert arm.signs.log_odds > 3
    assert reversed_signs.log_odds < -3


def test_without_colour_a_hand_says_nothing_of_skin(drawn):
    _, rig, crops, head = drawn
    grey = [Crop(np.minimum(crop.labels, np.uint8(Pixel.PERSON)), crop.corner, crop.image_size) for crop in crops]
    assert the_arm(limbs_of(rig, grey, head)).signs.skin == 0.6


def test_log_odds_grow_with_every_sign_as_its_weight_says(drawn):
    _, rig, crops, head = drawn
    signs = the_arm(limbs_of(rig, crops, head)).signs
    for name, weight, value in zip(signs.__dataclass_fields__, WEIGHTS, astuple(signs), strict=True):
        more = replace(signs, **{name: value + 0.1})
        assert more.log_odds - signs.log_odds == pytest.approx(0.1 * weight)
