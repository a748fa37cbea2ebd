"""The whole chain, pixels of the light to the angle of an arm: its derivatives against solving everything again."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration.alignment import align_to_landmarks
from jaxpoint.calibration.assembly import rig_of
from jaxpoint.calibration.chain import Measured, chain_of
from jaxpoint.calibration.recording import Recording, RigState, adjust
from jaxpoint.calibration.result import Verdict
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import FOCAL, adjusted_lenses, size_of
from jaxpoint.compilation import jit_once
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry.line import Ray, angle_between, distance_to_point
from jaxpoint.triangulation import triangulate

NOISE_PX = 2.0
OBJECT_M = np.array([1.0, 4.5, 1.2])
ARM_M = np.array([[2.8, 2.4, 1.4], [2.9, 2.9, 1.3]])


@pytest.fixture(scope="module")
def seen(free_room):
    """A room of 4 cameras and 40 frames, all pixels with 2 px of noise, and an arm in it."""
    known, truth = free_room
    rng = np.random.default_rng(2)
    exact = known.room.seen(truth.points)[0]
    tracks = replace(truth.tracks, pixels=exact + rng.normal(0.0, NOISE_PX, exact.shape))
    verdicts = np.where(truth.verdicts == Verdict.REPROJECTION, Verdict.KEPT, truth.verdicts)
    calibration = replace(truth, tracks=tracks, verdicts=verdicts, sigma_px=NOISE_PX, loss_scale=2 * NOISE_PX)
    arm, visible = known.room.seen(ARM_M)
    landmarks = known.landmarks
    marks = {
        "landmarks": landmarks.points,
        "clicks": known.clicks.pixels[:8] + rng.normal(0.0, NOISE_PX, (8, 4, 2)),
        "clicked": known.clicks.visible[:8],
        "sigmas": np.linspace(0.002, 0.01, 8),
    }
    return calibration, arm + rng.normal(0.0, NOISE_PX, arm.shape), visible, marks


@pytest.fixture(scope="module")
def chain(seen):
    calibration, arm, visible, marks = seen
    return chain_of(calibration, arm, visible, **marks)


def answer(chain, measured):
    """The angle (rad) between the line of an arm and the way to an object, and the object's distance from the line."""
    base, tip = chain.points(measured)
    line = Ray.through(base, tip)
    return angle_between(line.direction, OBJECT_M - tip) + distance_to_point(line, OBJECT_M)


both = jit_once(lambda chain, measured: jax.value_and_grad(lambda measured: answer(chain, measured))(measured))


def direction_of(chain, measured, name, rng):
    """A thousandth of a pixel or metre or of itself; what is hidden, held or has no prior stays."""
    value = np.asarray(getattr(measured, name))
    masks = {"light": measured.weights > 0, "clicks": chain.clicked, "pixels": chain.visible}
    direction = rng.normal(size=value.shape)
    if name in masks:
        direction = direction * np.asarray(masks[name])[..., None]
    elif name == "prior_mean":
        direction = direction * (np.asarray(measured.prior_weight) > 0)
    elif name != "landmarks":
        direction = direction * value
    return 1e-3 * direction / np.abs(direction).max() * (np.abs(value).max() if name == "prior_weight" else 1.0)


@pytest.mark.parametrize("name", Measured.__dataclass_fields__)
def test_the_gradient_is_that_of_solving_everything_again(chain, name):
    function, measured = chain
    gradient = getattr(both(function, measured)[1], name)
    # All entries pull the same way: else they cancel down to the rounding of the solves.
    direction = np.abs(direction_of(function, measured, name, np.random.default_rng(8))) * np.sign(gradient)
    along = float((gradient * direction).sum())

    def at(sign):
        return float(both(function, replace(measured, **{name: getattr(measured, name) + sign * direction}))[0])

    # The answer is about 1, and known to the 1e-10 to which each solve comes to its end.
    assert along == pytest.approx((at(1.0) - at(-1.0)) / 2, rel=1e-5, abs=1e-10)


def test_it_is_what_the_pipeline_computes(seen, chain):
    """The same answer as from the adjustment, triangulation and alignment that users call one by one."""
    calibration, arm, visible, marks = seen
    recording = Recording.of(calibration.tracks)
    start = RigState(*(np.zeros(shape) for shape in ((4, size_of(Brown)), (4, 3, 3), (len(recording.visible), 3))))
    pose = calibration.rig.cameras.cam_from_world
    start.base[:], start.cameras[:, 3:6] = pose.rotation, pose.translation
    start.cameras[:, FOCAL:], start.points[: len(calibration.points)] = (
        adjusted_lenses(calibration.rig),
        calibration.points,
    )
    freedom = calibration.freedom.at_noise(NOISE_PX)
    kept = np.zeros(recording.visible.shape, bool)
    kept[:40, :4] = calibration.kept
    end = adjust(recording, start, kept, freedom, loss_scale=2 * NOISE_PX, rtol=1e-12)
    rig = rig_of(end.state, calibration.tracks)
    found = triangulate(rig, marks["clicks"], marks["clicked"]).points
    similarity = align_to_landmarks(found, marks["landmarks"], marks["sigmas"]).similarity
    base, tip = triangulate(rig.transformed(similarity), arm, visible, refine_steps=20).points
    line = Ray.through(base, tip)
    wanted = angle_between(line.direction, OBJECT_M - tip) + distance_to_point(line, OBJECT_M)
    assert float(both(*chain)[0]) == pytest.approx(float(wanted), rel=1e-7)


def test_without_landmarks_an_angle_has_its_derivative(seen):
    """The gauge is free then; what no similarity changes does not notice."""
    calibration, arm, visible, _ = seen
    third = calibration.tracks.pixels[:1], calibration.tracks.visible[:1]
    chain, measured = chain_of(calibration, np.concatenate([arm, third[0]]), np.concatenate([visible, third[1]]))
    direction = direction_of(chain, measured, "light", np.random.default_rng(9))

    @jit_once
    def turned(measured):
        def angle(measured):
            base, tip, other = chain.points(measured)
            return angle_between(tip - base, other - base)

        return jax.value_and_grad(angle)(measured)

    ahead, behind = (turned(replace(measured, light=measured.light + sign * direction))[0] for sign in (1, -1))
    assert float((turned(measured)[1].light * direction).sum()) == pytest.approx(float(ahead - behind) / 2, rel=1e-5)


def test_what_is_hidden_has_no_influence(chain):
    function, measured = chain
    gradient = both(function, measured)[1]
    assert not np.asarray(gradient.light)[np.asarray(measured.weights) == 0].any()
    assert not np.asarray(gradient.clicks)[~np.asarray(function.clicked)].any()
    assert not np.asarray(gradient.pixels)[~np.asarray(function.visible)].any()
    assert np.asarray(gradient.prior_mean)[:, FOCAL].any() == np.asarray(measured.prior_weight)[:, FOCAL].any()


@pytest.mark.usefixtures("any_shape")
def test_bad_input_is_named(seen):
    calibration, arm, visible, marks = seen
    with pytest.raises(UsageError, match="which of its parameters were free"):
        chain_of(replace(calibration, freedom=None), arm, visible)
    with pytest.raises(UsageError, match="clicks on the 8 landmarks are missing"):
        chain_of(calibration, arm, visible, landmarks=marks["landmarks"])
    with pytest.raises(InsufficientDataError, match="2 landmarks do not hold"):
        chain_of(calibration, arm, visible, **{name: part[:2] for name, part in marks.items()})
    with pytest.raises(InsufficientDataError, match="Point 1 is seen by 1 cameras"):
        chain_of(calibration, arm, np.array([[1, 1, 0, 0], [1, 0, 0, 0]], bool))
    function, measured = chain_of(calibration, arm, visible)
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        function.points(measured)
    assert jnp.isfinite(function.landmark_weights).all()
