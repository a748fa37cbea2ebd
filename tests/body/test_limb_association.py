"""Long ends of several views to limbs, on lines whose truth is known."""

import numpy as np
import pytest

from jaxpoint.body.limb_association import LimbRays, agreeing_views, associate, common_point
from jaxpoint.evidence.limb_slices import SLICE_M, SLICES

HEAD = np.array([3.0, 2.5, 1.62])
POSITIONS = np.array([[5.5, 0.5, 2.2], [0.5, 0.6, 2.4], [5.2, 4.5, 2.0], [0.7, 4.4, 2.3]])
POINTING = np.array([3.5, 1.9, 1.4]), np.array([0.7, -0.7, 0.1]) / np.linalg.norm([0.7, -0.7, 0.1])
HANGING = np.array([3.0, 2.75, 0.75]), np.array([0.05, 0.05, -1.0]) / np.linalg.norm([0.05, 0.05, -1.0])


def toward(places: np.ndarray, camera: int) -> np.ndarray:
    rays = places - POSITIONS[camera]
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def limb_rays(limbs, cameras, spoil_deg=0.0, seed=0) -> LimbRays:
    """Each limb as each camera sees it."""
    rng = np.random.default_rng(seed)
    tips, slices, views = [], [], []
    for camera in cameras:
        for tip, direction in limbs:
            turned = direction + np.radians(spoil_deg) * rng.normal(size=3)
            places = tip - (np.arange(SLICES) * SLICE_M)[:, None] * turned
            tips.append(toward(tip, camera))
            slices.append(toward(places, camera))
            views.append(camera)
    count = len(views)
    return LimbRays(
        np.array(views), POSITIONS[views], np.array(tips), np.array(slices),
        np.ones((count, SLICES), bool), np.ones(count),
    )  # fmt: skip


@pytest.mark.parametrize("cameras", [(0, 1), (0, 1, 2, 3)])
def test_both_limbs_are_found_and_the_best_supported_are_not_mixed(cameras):
    arms = associate(limb_rays([POINTING, HANGING], cameras), HEAD)
    for tip, direction in (POINTING, HANGING):
        arm = min(arms[:2], key=lambda one: np.linalg.norm(one.tip - tip))
        np.testing.assert_allclose(arm.tip, tip, atol=1e-6)
        np.testing.assert_allclose(arm.direction, direction, atol=1e-6)
        assert len(arm.members) == len(cameras)
    assert not set(arms[0].members) & set(arms[1].members)


def test_no_limb_comes_twice():
    arms = associate(limb_rays([POINTING, HANGING], (0, 1, 2, 3), spoil_deg=2.0), HEAD)
    for i, one in enumerate(arms):
        for other in arms[:i]:
            apart = np.degrees(np.arccos(np.clip(one.direction @ other.direction, -1, 1)))
            assert np.linalg.norm(one.tip - other.tip) > 0.08 or apart > 15


def test_noisy_planes_still_give_the_limb():
    arm = associate(limb_rays([POINTING], (0, 1, 2, 3), spoil_deg=2.0), HEAD)[0]
    assert np.degrees(np.arccos(arm.direction @ POINTING[1])) < 4.0


def test_one_view_or_somebody_elses_limb_is_no_arm():
    assert associate(limb_rays([POINTING], (0,)), HEAD) == []
    assert associate(limb_rays([POINTING], (0, 1, 2)), HEAD + np.array([1.8, 0.0, 0.0])) == []


def test_common_point_takes_one_candidate_a_view_and_says_which():
    place, short = np.array([3.2, 2.1, 1.3]), np.array([3.15, 2.15, 1.3])
    ahead = (place - short) / np.linalg.norm(place - short)
    places = [short, place, place, short, place]
    views = np.array([0, 0, 1, 1, 2])
    rays = np.array([toward(p, c) for p, c in zip(places, views)])
    point, spread, members = common_point(POSITIONS[views], rays, views, ahead)
    np.testing.assert_allclose(point, place, atol=1e-6)
    assert spread < 1e-6
    assert members == [1, 2, 4]
    assert common_point(POSITIONS[views[:1]], rays[:1], views[:1], ahead) is None


def test_a_view_on_another_limb_is_told_from_those_that_agree():
    tip, direction = POINTING
    places = tip - np.linspace(0.2, 0.4, SLICES)[:, None] * direction
    rays = np.array([toward(places, c) for c in range(4)])
    rays[2] = toward(places + np.array([0.0, 0.0, 0.15]), 2)
    held = np.ones((4, SLICES), bool)
    agreed, found = agreeing_views(POSITIONS, rays, held, np.full(4, 700.0), tip, direction, 2.5)
    assert agreed.tolist() == [True, True, False, True]
    np.testing.assert_allclose(found, direction, atol=1e-6)
