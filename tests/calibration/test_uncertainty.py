"""Covariance of a calibration: against dense algebra, finite differences, and simulated recalibrations."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration import propagation as prop
from jaxpoint.calibration import uncertainty as unc
from jaxpoint.calibration.alignment import Alignment, align_to_landmarks, apply_alignment, umeyama
from jaxpoint.calibration.recording import Freedom
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import size_of
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.pose import Similarity
from jaxpoint.landmarks import LandmarkPixels, locate
from jaxpoint.simulate.recalibration import Recalibrated
from jaxpoint.triangulation import triangulate

SIGMA_PX, CLICK_PX, MEASURED_M = 0.5, 0.8, 0.005
UNTOUCHED = Alignment(Similarity.identity(), "landmarks", (), np.zeros(0), (), 0.0, 0.0, True)


@pytest.fixture(scope="module")
def tiny():
    """Three cameras and 20 points, as if solved exactly, with its dense normal equations."""
    room = Recalibrated.of(7, cameras=3, frames=20, noise_px=SIGMA_PX)
    calibration = replace(room.truth(), alignment=UNTOUCHED)
    return SimpleNamespace(room=room, calibration=calibration, dense=dense_covariance(calibration))


def rig_from_numbers(rig: CameraRig, numbers):
    """The rig moved by the numbers of `bundle`, (C, 15), written out independently."""
    cameras = rig.cameras
    focal = jnp.stack([cameras.focal[:, 0] * jnp.exp(numbers[:, 6] + numbers[:, 7]),
                       cameras.focal[:, 1] * jnp.exp(numbers[:, 6])], axis=1)  # fmt: skip
    turned = jax.vmap(so3.exp)(numbers[:, :3]) @ cameras.cam_from_world.rotation
    shifted = cameras.cam_from_world.translation + numbers[:, 3:6]
    lens = cameras.distortion + numbers[:, 10:]
    return CameraRig.from_parameters(focal, cameras.center + numbers[:, 8:10], lens, turned, shifted, rig.image_sizes)


def dense_covariance(calibration):
    """The pseudo-inverse of the whole of J^T J, its null space, and the derivative of all centres and points."""
    rig, kept, freedom = calibration.rig, calibration.kept, calibration.freedom
    cameras, frames = len(rig), len(calibration.points)
    size = size_of(Brown) * cameras

    def pixels(unknown):
        moved = rig_from_numbers(rig, unknown[:size].reshape(cameras, size_of(Brown)))
        return moved.project(calibration.points + unknown[size:].reshape(frames, 3))[kept].ravel()

    def lengths(unknown):
        moved = rig_from_numbers(rig, unknown[:size].reshape(cameras, size_of(Brown)))
        return jnp.concatenate([moved.positions.ravel(), unknown[size:]])

    zero = jnp.zeros(size + 3 * frames)
    free = np.concatenate([freedom.free.ravel(), np.ones(3 * frames, bool)])
    jacobian = np.asarray(jax.jacfwd(pixels)(zero))[:, free]
    prior = freedom.at_noise(calibration.sigma_px).prior_weight.ravel()
    normal = jacobian.T @ jacobian + np.diag(np.concatenate([prior, np.zeros(3 * frames)])[free])
    scale = 1 / np.sqrt(np.diag(normal))
    values, vectors = np.linalg.eigh(scale[:, None] * normal * scale)
    assert values[6] < 1e-10 < 1e-9 < values[7]
    ways, rest = scale[:, None] * vectors[:, :7], scale[:, None] * vectors[:, 7:]
    return SimpleNamespace(
        free=free,
        loose=calibration.sigma_px**2 * (rest / values[7:]) @ rest.T,
        ways=ways,
        metric=np.asarray(jax.jacfwd(lengths)(zero))[:, free],
        size=size,
    )


def spread_out(covariance, free):
    """With zeros for what was held."""
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = covariance
    return whole


def in_perturbed(covariance, rig):
    """From log focal and log aspect to fx and fy."""
    jacobian = np.eye(len(covariance))
    for camera, (fx, fy) in enumerate(np.asarray(rig.cameras.focal)):
        at = size_of(Brown) * camera + 6
        jacobian[at : at + 2, at : at + 2] = [[fx, fx], [fy, 0.0]]
    return jacobian @ covariance @ jacobian.T


def test_inner_constraints_against_the_dense_pseudo_inverse(tiny):
    found, dense = unc.uncertainty_of(tiny.calibration), tiny.dense
    pull = dense.metric.T @ dense.metric @ dense.ways
    project = np.eye(len(pull)) - dense.ways @ np.linalg.solve(pull.T @ dense.ways, pull.T)
    expected = project @ dense.loose @ project.T
    whole = spread_out(expected, dense.free)
    cameras = in_perturbed(whole[: dense.size, : dense.size], tiny.calibration.rig)
    sigma = np.sqrt(np.diag(cameras))
    safe = np.where(sigma > 0, sigma, 1.0)
    np.testing.assert_allclose(found.covariance / np.outer(safe, safe), cameras / np.outer(safe, safe), atol=1e-6)
    np.testing.assert_allclose(np.asarray(found.camera_sigmas).ravel(), sigma, rtol=1e-6)
    points = np.stack([whole[i : i + 3, i : i + 3] for i in range(dense.size, len(whole), 3)])
    np.testing.assert_allclose(found.point_covariance, points, atol=1e-6 * np.abs(points).max())
    assert found.gauge == "free"
    # Held numbers: no tangential distortion, no k3.
    assert (np.asarray(found.camera_sigmas)[:, 12:] == 0).all()
    # Of all frames this one has the smallest trace over centres and points.
    lengths = dense.metric @ expected @ dense.metric.T
    traced = np.trace(np.asarray(found.centre_covariance).sum(0)) + np.trace(np.asarray(found.point_covariance).sum(0))
    assert traced == pytest.approx(np.trace(lengths), rel=1e-6)
    assert traced < np.trace(dense.metric @ dense.loose @ dense.metric.T)


@pytest.mark.parametrize("kind", ["clicked", "centres and light"])
def test_landmarks_against_derivatives_of_the_alignment_itself(tiny, kind):
    rig, truth, dense = tiny.calibration.rig, tiny.room, tiny.dense
    places, pixels, visible = truth.landmarks, truth.landmark_pixels, truth.landmark_visible
    cameras, size = len(rig), dense.size
    lit = np.flatnonzero(tiny.calibration.point_valid)[[0, 5, 9]]
    clicked = kind == "clicked"
    sigmas = np.linspace(0.003, 0.008, 6)

    def aligned_centres(unknown, measured, clicks):
        moved = rig_from_numbers(rig, unknown[:size].reshape(cameras, size_of(Brown)))
        points = (tiny.calibration.points + unknown[size:].reshape(-1, 3))[lit]
        seen = triangulate(moved, pixels + clicks, visible).points if clicked else None
        source = seen if clicked else jnp.concatenate([moved.positions, points])
        return (umeyama(source, source_at_truth + measured, sigmas**-2.0) @ moved.positions).ravel()

    at_truth = np.concatenate([np.asarray(rig.positions), tiny.calibration.points[lit]])
    source_at_truth = places if clicked else at_truth
    zeros = jnp.zeros(size + tiny.calibration.points.size), jnp.zeros((6, 3)), jnp.zeros(pixels.shape)
    by_rig, by_places, by_clicks = jax.jacfwd(aligned_centres, argnums=(0, 1, 2))(*zeros)
    by_rig = np.asarray(by_rig)[:, dense.free]
    by_places = (np.asarray(by_places) * sigmas[:, None]).reshape(3 * cameras, -1)
    by_clicks = CLICK_PX * np.asarray(by_clicks).reshape(3 * cameras, -1)
    expected = by_rig @ dense.loose @ by_rig.T + by_places @ by_places.T + by_clicks @ by_clicks.T
    clicks = LandmarkPixels(tuple("abcdef"), pixels, visible)
    names = clicks.names if clicked else (*rig.names, *(str(frame) for frame in lit))
    anchors = unc.anchors_of(tiny.calibration, names, sigmas, clicks, CLICK_PX)
    found = unc.uncertainty_of(tiny.calibration, anchors)
    blocks = np.stack([expected[i : i + 3, i : i + 3] for i in range(0, 3 * cameras, 3)])
    np.testing.assert_allclose(found.centre_covariance, blocks, atol=1e-5 * np.abs(blocks).max())
    assert found.gauge == "landmarks"


@pytest.fixture(scope="module")
def seen(tiny):
    """Two places and noisy pixels of them."""
    rng = np.random.default_rng(3)
    visible = np.array([[True, True, True], [True, False, True]])
    places = tiny.room.places[:2]
    pixels = np.asarray(tiny.calibration.rig.project(places)) + rng.normal(0, 2.0, (2, 3, 2))
    return SimpleNamespace(places=places, pixels=pixels, visible=visible)


def along(tiny, direction):
    """An uncertainty of one direction only, with which a derivative can be read off."""
    found = unc.uncertainty_of(tiny.calibration)
    covariance = jnp.outer(direction, direction)
    return unc.Uncertainty(found.rig, covariance, found.point_covariance, found.sigma_px, "free")


def moved_rig(rig, change):
    each = jnp.asarray(change).reshape(len(rig), -1)
    return CameraRig(jax.vmap(lambda camera, by: camera.perturbed(by))(rig.cameras, each), rig.image_sizes, rig.names)


def angles_of(ends):
    x, y, z = ends[1] - ends[0]
    return np.array([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def test_propagation_against_finite_differences_of_the_cameras(tiny, seen):
    rng = np.random.default_rng(0)
    sizes = np.repeat([1e-3, 1e-3, 1.0, 1.0, 1e-3], [3, 3, 2, 2, 5])
    direction = np.tile(sizes, 3) * rng.normal(size=45)
    uncertain, step = along(tiny, direction), 1e-3
    rigs = [moved_rig(tiny.calibration.rig, sign * step * direction) for sign in (1, -1)]

    def change(function):
        values = [np.asarray(function(rig)) for rig in rigs]
        return (values[0] - values[1]) / (2 * step)

    def points(rig):
        return np.asarray(triangulate(rig, seen.pixels, seen.visible, refine_steps=12).points)

    pixels = prop.pixel_uncertainty(uncertain, seen.places)
    by_pixel = change(lambda rig: rig.project(seen.places))
    check(pixels.covariance, np.einsum("nci,ncj->ncij", by_pixel, by_pixel))
    by_point = change(points)
    found = prop.point_uncertainty(uncertain, seen.pixels, seen.visible)
    check(found.calibration, np.einsum("ni,nj->nij", by_point, by_point))
    joint = prop.joint_uncertainty(uncertain, seen.pixels, seen.visible)
    check(joint.calibration, np.outer(by_point, by_point))
    length = prop.length_uncertainty(uncertain, seen.pixels, seen.visible)
    by_length = change(lambda rig: np.linalg.norm(np.diff(points(rig), axis=0)))
    check(length.calibration, by_length[None, None] ** 2)
    line = prop.line_uncertainty(uncertain, seen.pixels, seen.visible)
    by_angle = change(lambda rig: angles_of(points(rig)))
    check(line.angles.calibration, np.outer(by_angle, by_angle))
    np.testing.assert_allclose(line.angles.value, angles_of(points(tiny.calibration.rig)), atol=1e-9)
    np.testing.assert_allclose(line.ray.origin, points(tiny.calibration.rig)[0], atol=1e-9)


def check(found, expected):
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_propagation_against_finite_differences_of_the_pixels(tiny, seen):
    uncertain, step = along(tiny, np.zeros(45)), 1e-3
    found = prop.joint_uncertainty(uncertain, seen.pixels, seen.visible, 0.7)
    by_pixels = np.zeros((6, seen.pixels.size))
    for i in range(seen.pixels.size):
        shift = np.zeros(seen.pixels.size)
        shift[i] = step
        ends = [
            triangulate(tiny.calibration.rig, seen.pixels + sign * shift.reshape(seen.pixels.shape), seen.visible)
            for sign in (1, -1)
        ]
        by_pixels[:, i] = np.ravel(ends[0].points - ends[1].points) / (2 * step)
    check(found.observation, 0.49 * by_pixels @ by_pixels.T)
    assert (np.asarray(found.calibration) == 0).all()
    each = prop.point_uncertainty(uncertain, seen.pixels, seen.visible, 0.7)
    np.testing.assert_allclose(each.observation[1], found.observation[3:, 3:], rtol=1e-9)
    np.testing.assert_allclose(each.covariance, each.observation)


def test_points_share_the_cameras_errors(tiny, seen):
    uncertain = unc.uncertainty_of(tiny.calibration)
    joint = prop.joint_uncertainty(uncertain, seen.pixels, seen.visible)
    each = prop.point_uncertainty(uncertain, seen.pixels, seen.visible)
    np.testing.assert_allclose(joint.covariance[:3, :3], each.covariance[0], rtol=1e-9)
    assert np.abs(joint.calibration[:3, 3:]).max() > 0
    np.testing.assert_allclose(joint.observation[:3, 3:], 0.0, atol=1e-18)
    np.testing.assert_allclose(joint.sigma, np.sqrt(np.diag(joint.covariance)))


def test_functions_are_pure_and_hidden_pixels_never_matter(tiny, seen):
    uncertain = unc.uncertainty_of(tiny.calibration)
    plain = prop.length_uncertainty(uncertain, seen.pixels, seen.visible)
    wild = np.where(seen.visible[..., None], seen.pixels, np.nan)
    inside = jax.jit(lambda u, pixels: prop.length_uncertainty(u, pixels, seen.visible).covariance)(uncertain, wild)
    np.testing.assert_allclose(inside, plain.covariance, rtol=1e-9)
    few = seen.visible & np.array([True, False, False])
    lost = prop.point_uncertainty(uncertain, seen.pixels, few)
    assert np.isinf(np.diagonal(lost.observation, axis1=1, axis2=2)).all()
    assert (np.asarray(lost.calibration) == 0).all()
    assert np.isinf(prop.length_uncertainty(uncertain, seen.pixels, few).observation).all()


def test_a_robust_loss_costs_nine_percent(tiny):
    calibration = tiny.calibration
    assert unc.variance_px2(calibration) == SIGMA_PX**2
    robust = replace(calibration, loss_scale=2 * SIGMA_PX)
    square = 2 * np.random.default_rng(0).exponential(size=400_000)
    weight = 1 / (1 + square / 4)
    expected = (weight**2 * square / 2).mean() / (weight**2).mean() ** 2
    assert unc.variance_px2(robust) == pytest.approx(SIGMA_PX**2 * expected, rel=5e-3)
    assert unc.variance_px2(replace(calibration, loss_scale=1e8)) == SIGMA_PX**2
    almost = unc.variance_px2(replace(calibration, loss_scale=9.9 * SIGMA_PX))
    assert SIGMA_PX**2 < almost < 1.02 * SIGMA_PX**2


def test_what_is_missing_is_named(tiny):
    calibration = tiny.calibration
    with pytest.raises(UsageError, match="calibrate again"):
        unc.uncertainty_of(replace(calibration, freedom=None))
    anchors = unc.anchors_of(calibration, calibration.rig.names[:2], np.full(2, 0.01))
    with pytest.raises(UsageError, match="align it so first"):
        unc.uncertainty_of(replace(calibration, alignment=None), anchors)
    with pytest.raises(InsufficientDataError, match="2 anchors"):
        unc.uncertainty_of(calibration, anchors)
    with pytest.raises(InsufficientDataError, match="'lamp'"):
        unc.anchors_of(calibration, ("lamp",), np.ones(1))
    with pytest.raises(ValueError, match="positive"):
        unc.anchors_of(calibration, calibration.rig.names, np.array([0.01, 0.0, 0.01]))


def test_a_calibration_brings_what_its_uncertainty_needs(noisy):
    """The whole pipeline: what was free is remembered, and stays through the alignment."""
    found = calibrate(noisy.room.tracks)
    assert isinstance(found.freedom, Freedom)
    assert found.freedom.free.shape == (4, size_of(Brown))
    assert found.loss_scale == pytest.approx(2 * found.sigma_px)
    names = noisy.room.tracks.names
    measured = noisy.room.positions + np.random.default_rng(0).normal(0, MEASURED_M, (4, 3))
    points, _ = locate(found, names)
    aligned = apply_alignment(found, align_to_landmarks(points, measured, np.full(4, MEASURED_M), names=names))
    uncertain = unc.uncertainty_of(aligned, unc.anchors_of(aligned, names, np.full(4, MEASURED_M)))
    error = np.asarray(aligned.rig.positions) - noisy.room.positions
    sigma = np.sqrt(np.diagonal(uncertain.centre_covariance, axis1=1, axis2=2))
    assert (np.abs(error) < 4 * sigma).all()
    assert 0.001 < sigma.mean() < 0.02  # m
    free = unc.uncertainty_of(found)
    assert free.gauge == "free"
    focal = np.asarray(found.rig.cameras.focal)[:, 0] - noisy.room.focal
    assert (np.abs(focal) < 4 * np.asarray(free.camera_sigmas)[:, 6]).all()
    np.testing.assert_allclose(free.camera_sigmas[:, 6:], uncertain.camera_sigmas[:, 6:], rtol=1e-5)
