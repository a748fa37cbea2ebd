"""A board, a wand and a light in one adjustment, and points of known place."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.bundle import CameraModel
from jaxpoint.calibration.chain import chain_of
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.eliminated import TargetPoses
from jaxpoint.calibration.gauge import centres_by_parameters
from jaxpoint.calibration.planar_pose import from_homography, homography
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import Freedom, Recording, RigState, _problem, adjust
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.calibration.sight import centres
from jaxpoint.camera.parameters import adjusted_lenses
from jaxpoint.config import LensSettings
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.formats.anipose_toml import write_calibration_toml
from jaxpoint.io.result_files import load_result, save_result
from jaxpoint.io.rig_entries import needs_metres
from jaxpoint.simulate.rooms import random_room
from jaxpoint.targets import Target
from jaxpoint.tracks import PointPrior, Tracks, join_tracks

WAND, BOARD = Target.wand(0.5), Target.chessboard(4, 3, 0.12)
NOISE = 0.3


@pytest.fixture(scope="module")
def room():
    return random_room(3, cameras=5, frames=80, layout="around", visibility=0.9, outliers=0.0, noise_px=NOISE)


def observed(room, points, rng, seen=0.9):
    """Pixels of points, NaN where a camera does not see them."""
    pixels, sizes = np.asarray(room.rig.project(points)), np.asarray(room.rig.image_sizes)
    inside = ((pixels >= 0) & (pixels <= sizes - 1)).all(axis=-1) & np.asarray(room.rig.sees(points))
    shown = inside & (rng.random(inside.shape) < seen)
    return np.where(shown[..., None], pixels + NOISE * rng.normal(size=pixels.shape), np.nan)


def shown_target(room, target, frames, seed, size=1.0):
    """Tracks of a target held anywhere in the room, `size` times as large as it says."""
    rng, everywhere = np.random.default_rng(seed), np.asarray(room.points)
    middles = np.median(everywhere, axis=0) + 0.8 * (rng.random((frames, 3)) - 0.5) * np.ptp(everywhere, axis=0)
    turns = Rotation.random(frames, random_state=seed).as_matrix()
    points = np.einsum("mij,kj->mki", turns, size * target.points) + middles[:, None]
    count = len(target.points)
    return Tracks.from_pixels(
        observed(room, points.reshape(-1, 3), rng),
        np.asarray(room.rig.image_sizes),
        names=room.tracks.names,
        frame_ids=np.repeat(np.arange(frames), count) + 1000 * seed,
        point_ids=np.tile(np.arange(count), frames),
        target=target,
    )


def lengths(rig):
    """Distances between the cameras."""
    places = centres(rig)
    return np.linalg.norm(places[:, None] - places[None], axis=-1)[np.triu_indices(len(places), 1)]


@pytest.fixture(scope="module")
def mixed(room):
    return join_tracks(room.tracks, shown_target(room, WAND, 40, 1), shown_target(room, BOARD, 12, 2))


@pytest.fixture(scope="module")
def solved(mixed):
    return with_covariance(calibrate(mixed))


def test_light_wand_and_board_are_calibrated_in_metres(room, mixed, solved):
    assert solved.converged
    assert solved.unit == "m"
    assert solved.gauge == "free"
    assert solved.kept.sum() >= 0.99 * mixed.visible.sum()
    ratios = lengths(solved.rig) / lengths(room.rig)
    assert abs(np.median(ratios) - 1.0) < 3e-3
    assert ratios.std() < 2e-3
    assert abs(solved.sigma_px / NOISE - 1.0) < 0.1
    for number, target in enumerate((WAND, BOARD)):
        rows = solved.tracks.target_ids == number
        frames = solved.tracks.frame_ids[rows]
        points = solved.points[rows][frames == frames[0]]
        ids = solved.tracks.point_ids[rows][frames == frames[0]]
        stated = target.points[ids]
        apart = [np.linalg.norm(part[:, None] - part[None], axis=-1) for part in (points, stated)]
        np.testing.assert_allclose(*apart, atol=1e-9)


def test_the_lens_is_known_better_and_the_covariance_holds_it(room, solved):
    alone = with_covariance(calibrate(room.tracks))
    truth = np.asarray(room.rig.cameras.focal)[:, 0]
    sigmas, pulls = [], []
    for found in (alone, solved):
        size = found.rig.camera_size
        own = np.sqrt(np.diagonal(found.camera_covariance)).reshape(-1, size)[:, 6]
        sigmas.append(own)
        pulls.append((np.asarray(found.rig.cameras.focal)[:, 0] - truth) / own)
    assert (sigmas[1] < 0.5 * sigmas[0]).all()
    assert np.abs(pulls).max() < 4.0


def test_the_scale_is_as_uncertain_as_the_stated_sizes(room, solved):
    surer = replace(solved, hold=replace(solved.hold, scale_sigma=0.0))
    assert solved.hold.scale_sigma == WAND.size_sigma
    spreads = []
    for found in (solved, with_covariance(surer)):
        by = _by_parameters(found.rig)
        spreads.append(float(np.sqrt(by @ found.camera_covariance @ by)))
    length = float(lengths(solved.rig)[0])
    np.testing.assert_allclose(spreads[0] ** 2 - spreads[1] ** 2, (WAND.size_sigma * length) ** 2, rtol=1e-3)
    assert spreads[1] < spreads[0]


def _by_parameters(rig):
    """The derivative of the distance between the first two cameras."""
    places, by_camera = centres(rig), centres_by_parameters(rig)
    along = (places[0] - places[1]) / np.linalg.norm(places[0] - places[1])
    by = np.zeros((len(rig), rig.camera_size))
    by[0], by[1] = along @ by_camera[0], -along @ by_camera[1]
    return by.ravel()


def test_files_keep_targets_and_what_they_hold(solved, tmp_path):
    save_result(tmp_path, solved, {})
    again = load_result(tmp_path)
    assert again.tracks.targets == solved.tracks.targets
    assert again.hold == solved.hold
    np.testing.assert_array_equal(again.tracks.point_ids, solved.tracks.point_ids)
    np.testing.assert_allclose(with_covariance(again).camera_covariance, solved.camera_covariance, rtol=1e-6)
    metres = {"unit": "m", "metadata": {"in_room": False}}
    write_calibration_toml(tmp_path / "calibration.toml", solved.rig, **metres)
    for name in ("calibration.json", "calibration.toml"):
        with pytest.raises(UsageError, match=r"has metres, but neither floor nor up .* `jaxpoint align`"):
            needs_metres(name, read_calibration(tmp_path / name), None)


def test_the_gate_passes_it(solved):
    assert assess(solved).passed


@pytest.fixture(scope="module")
def small(room):
    """An adjustment of a few points, poses and known points, away from its optimum."""
    rng = np.random.default_rng(5)
    light = room.tracks.select_frames(np.arange(12))
    tracks = join_tracks(light, shown_target(room, BOARD, 3, 3), shown_target(room, WAND, 4, 4))
    known = np.zeros((tracks.frames, 3))
    sigmas = np.full(tracks.frames, np.inf)
    loose = np.flatnonzero(tracks.target_ids < 0)[:4]
    known[loose], sigmas[loose] = np.asarray(room.points)[:4], 0.01
    recording = Recording.of(replace(tracks, prior=PointPrior(known, sigmas)))
    pose = room.rig.cameras.cam_from_world
    free = Freedom.of(recording, LensSettings(), "radial2")
    cameras = np.zeros((len(recording.image_sizes), free.free.shape[1]))
    cameras[:5, 3:6], cameras[:5, 6:] = np.asarray(pose.translation), adjusted_lenses(room.rig)
    base = np.tile(np.eye(3), (len(cameras), 1, 1))
    base[:5] = np.asarray(pose.rotation)
    points = np.zeros((len(recording.pixels), 3))
    points[: tracks.frames] = np.median(np.asarray(room.points), axis=0) + 0.3 * rng.normal(size=(tracks.frames, 3))
    poses = []
    for owned in recording.targets:
        turns = Rotation.random(len(owned.rows), random_state=7).as_matrix().reshape(-1, 9)
        poses.append(np.concatenate([turns, points[: len(turns)]], axis=1))
    return recording, RigState(cameras, base, points, poses=tuple(poses), anchored=True), free


def test_no_direction_lowers_the_whole_cost_at_the_optimum(small):
    """That cost knows nothing of elimination."""
    recording, state, freedom = small
    scale, rng = 20.0, np.random.default_rng(9)
    ours = adjust(recording, state, recording.visible, freedom, loss_scale=scale, steps=400, rtol=1e-13)
    problem, start = _problem(recording, ours.state.rebased(), recording.visible, freedom, scale, 0)
    model = CameraModel(state.lens)

    @jax.jit
    def cost(start, change):
        return sum((part**2).sum() for part in model.residuals(_moved(start, change), problem))

    still = start.cameras, start.points, tuple(part[:, :6] for part in start.poses)
    still = jax.tree.map(np.zeros_like, still)
    before = float(cost(_problem(recording, state.rebased(), recording.visible, freedom, scale, 0)[1], still))
    least = float(cost(start, still))
    assert least == pytest.approx(ours.cost, rel=1e-9)
    assert least < 1e-2 * before
    steps = (1e-6 * np.asarray(problem.free), 1e-6, (1e-6, 1e-6))
    for _ in range(30):
        along = jax.tree.map(lambda part: rng.normal(size=part.shape), still)
        way = steps[0] * along[0], steps[1] * along[1], tuple(a * b for a, b in zip(steps[2], along[2]))
        up, down = (float(cost(start, jax.tree.map(lambda part, sign=sign: sign * part, way))) for sign in (1, -1))
        assert min(up, down) > least - 1e-9 * least
        assert abs(up - down) < 1e-2 * (up + down - 2.0 * least)  # the slope is nothing beside the curvature


def _moved(start, change):
    cameras, points, steps = change
    still = TargetPoses(jnp.zeros((1, 3)))
    poses = tuple(jax.vmap(still.moved)(part, step) for part, step in zip(start.poses, steps))
    return replace(start, cameras=start.cameras + cameras, points=start.points + points, poses=poses)


def known_marks(room, wrong=0.0):
    """Eight static points, each known to 2 mm; the first is said to be elsewhere by `wrong` (m)."""
    rng = np.random.default_rng(8)
    everywhere = np.asarray(room.points)
    marks = np.median(everywhere, axis=0) + 0.6 * (rng.random((8, 3)) - 0.5) * np.ptp(everywhere, axis=0)
    pixels = observed(room, marks, rng, seen=1.0)
    stated = marks + 0.002 * rng.normal(size=marks.shape)
    stated[0, 0] += wrong
    return Tracks.from_pixels(
        pixels,
        np.asarray(room.rig.image_sizes),
        names=room.tracks.names,
        frame_ids=np.zeros(8, int),
        point_ids=np.arange(8),
        prior=PointPrior(stated, np.full(8, 0.002)),
    )


def test_known_points_hold_the_frame_of_the_room(room):
    found = with_covariance(calibrate(join_tracks(room.tracks, known_marks(room))))
    assert found.unit == "m"
    assert found.in_room
    assert found.gauge == "landmarks"
    assert "known point" not in assess(found).causes
    away = centres(found.rig) - np.asarray(room.rig.positions)
    assert np.linalg.norm(away, axis=1).max() < 0.06
    size = found.rig.camera_size
    translation = np.asarray(found.rig.cameras.cam_from_world.translation)
    truth = np.asarray(room.rig.cameras.cam_from_world.translation)
    own = np.sqrt(np.diagonal(found.camera_covariance)).reshape(-1, size)[:, 3:6]
    assert np.abs((translation - truth) / own).max() < 4.5


@pytest.mark.parametrize("wrong", [0.05, 0.5])
def test_a_known_point_that_is_elsewhere_is_named(room, wrong):
    found = with_covariance(calibrate(join_tracks(room.tracks, known_marks(room, wrong))))
    causes = {item.cause: item.finding for item in assess(found).findings if item.level == "bad"}
    assert "point 1 (frame 0)" in causes["known point"]  # the light is point 0


def test_one_camera_alone_adds_what_it_saw_of_the_board(room):
    board = shown_target(room, BOARD, 14, 6)
    only = board.visible.copy()
    late = board.frame_ids >= 6000 + 10
    only[late, 1:] = False
    alone = replace(board, visible=only, pixels=np.where(only[..., None], board.pixels, 0.0))
    found = calibrate(join_tracks(room.tracks, shown_target(room, WAND, 40, 1), alone))
    rows = (found.tracks.target_ids == 1) & (found.tracks.frame_ids >= 6000 + 10)
    assert found.kept[rows, 0].sum() >= 0.95 * found.tracks.visible[rows, 0].sum() > 20


def test_a_wrong_size_is_named_where_another_speaks_against_it(room):
    both = join_tracks(room.tracks, shown_target(room, WAND, 40, 1), shown_target(room, BOARD, 12, 2, size=1.1))
    found = calibrate(both)
    assert "target size" in {item.cause for item in found.findings}
    assert not assess(with_covariance(found)).passed


def test_targets_of_unknown_size_give_shape_but_no_metres(room, mixed):
    unknown = Target.wand(1.0, size_sigma=np.inf), replace(BOARD, size_sigma=np.inf)
    found = calibrate(replace(mixed, targets=unknown))
    assert found.unit == "arbitrary"
    np.testing.assert_allclose(lengths(found.rig) / lengths(room.rig), 2.0, rtol=5e-3)


def test_what_cannot_be_is_said(room, solved):
    few = join_tracks(room.tracks, shown_target(room, BOARD, 2, 2))
    with pytest.raises(InsufficientDataError, match="Target 'chessboard' has 2 frames"):
        calibrate(few)
    with pytest.raises(UsageError, match="targets, known points or shared lenses"):
        chain_of(solved, solved.tracks.pixels[:2], solved.tracks.visible[:2])
    prior = PointPrior(np.zeros((room.tracks.frames, 3)), np.full(room.tracks.frames, np.inf))
    with pytest.raises(InsufficientDataError, match="0 known points"):
        calibrate(replace(room.tracks, prior=prior))


def test_a_homography_gives_the_pose_of_a_plane():
    turn, shift = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([0.1, -0.2, 2.0])
    seen = BOARD.centred @ turn.T + shift
    found = from_homography(homography(BOARD.centred[:, :2], seen[:, :2] / seen[:, 2:]))
    np.testing.assert_allclose(found[0], turn, atol=1e-9)
    np.testing.assert_allclose(found[1], shift, atol=1e-9)
