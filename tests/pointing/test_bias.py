"""Biases of pointing: against scipy's robust fits and distributions, finite differences, and people who are known."""

from dataclasses import replace

import crowds
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.optimize import least_squares
from scipy.stats import multivariate_t

from jaxpoint.body.joints import estimate_joints, is_left
from jaxpoint.compilation import jit_once
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.angles import azimuth_elevation, turn_directions
from jaxpoint.pointing.bias.corrected_lines import corrected_lines
from jaxpoint.pointing.bias.fit import fit_bias, fit_personal_bias, left_out
from jaxpoint.pointing.bias.learn import learn_bias
from jaxpoint.pointing.bias.models import Blend, Constant, Personal, Polynomial
from jaxpoint.pointing.bias.score import errors_deg, score
from jaxpoint.pointing.bias.solve import Observed
from jaxpoint.pointing.bias.spread import Spread, fit_spread

LOSS = np.deg2rad(1.5)
BENT = Blend(np.array([0.1, -0.2]), np.array([[0.4, -0.3], [0.2, 0.5]]), np.array([True, True]))


@pytest.fixture(scope="module")
def people():
    return crowds.crowd()


@pytest.fixture(scope="module")
def constant(people):
    return fit_bias("constant", people, source="drawn")


@pytest.fixture(scope="module")
def blend(people):
    return fit_bias("blend", people)


def test_constant_is_scipys_robust_fit(people, constant):
    errors, level = people.errors, people.level

    def residuals(offset):
        return np.hypot((errors[:, 0] - offset[0]) * level, errors[:, 1] - offset[1])

    expected = least_squares(residuals, np.deg2rad([4.0, 9.0]), loss="cauchy", f_scale=LOSS, xtol=1e-12).x
    np.testing.assert_allclose(constant.model.offset, expected, atol=np.deg2rad(0.01))
    np.testing.assert_allclose(np.rad2deg(constant.model.offset), [4.0, 9.0], atol=1.2)  # slips hardly count


def test_least_squares_are_means(people):
    """Without a loss the elevation is that of the mean, slips and all: the thesis's way."""
    found = fit_bias("constant-elevation", people, loss_deg=None)
    np.testing.assert_allclose(found.model.elevation, people.errors[:, 1].mean(), atol=1e-6)


def test_polynomial_follows_the_elevation():
    people = crowds.crowd(5, between_deg=0.0, within_deg=0.05, slips=0.0, bias_deg=(0.0, 0.0))
    line = people.of_lines(("head",))
    elevation = line.angles[:, 0, 1]
    bent = np.stack([0.05 + 0.1 * elevation, 0.1 - 0.2 * elevation + 0.3 * elevation**2], axis=1)
    # The line that is bent by a function of its new elevation: solved by repetition.
    true = line.to_targets
    for _ in range(50):
        directions = np.asarray(turn_directions(true, bent))
        elevation = np.asarray(azimuth_elevation(directions))[:, 1]
        bent = np.stack([0.05 + 0.1 * elevation, 0.1 - 0.2 * elevation + 0.3 * elevation**2], axis=1)
    found = fit_bias("polynomial", replace(line, directions=directions[:, None]))
    assert errors_deg(line, np.asarray(found.correct(directions[:, None]))).max() < 0.1


def test_a_blend_leaves_out_what_does_not_help(people, constant, blend):
    weights = np.asarray(blend.model.weights)
    assert np.abs(weights[:, 1]).max() < 0.05  # the shoulder's line jumps from side to side
    assert np.abs(weights.sum(axis=1)).max() < 0.5
    assert blend.lines == crowds.LINES


def test_nobody_is_scored_by_a_bias_that_has_seen_them(people):
    """Whatever the first person does, the bias for the first person is the same; the others' changes."""
    first = people.who == 0
    moved = people.directions.copy()
    moved[first] = turn_directions(moved[first], np.broadcast_to(np.deg2rad([20.0, -10.0]), (first.sum(), 3, 2)))
    before, biases = left_out("constant", people.of_lines(("head",)))
    after, changed = left_out("constant", replace(people, directions=moved).of_lines(("head",)))
    np.testing.assert_array_equal(biases[0].model.offset, changed[0].model.offset)
    assert np.abs(biases[1].model.offset - changed[1].model.offset).max() > np.deg2rad(0.1)
    assert score(people, before).median_deg < 3 < score(people, people.directions[:, 0]).median_deg
    np.testing.assert_array_equal(before[~first].shape, after[~first].shape)


def test_the_room_may_be_turned(people, blend):
    """Azimuths count relative to one another: turned with the room, corrected lines turn alike."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for model in (BENT, Polynomial(np.array([[0.1, 0.2], [0.0, 0.1]]))):
        bias = replace(blend, model=model)
        np.testing.assert_allclose(
            bias.correct(people.directions @ quarter.T), bias.correct(people.directions) @ quarter.T, atol=1e-12
        )


def test_correct_is_differentiable(people, blend):
    bias = replace(blend, model=Personal(BENT, np.array([0.02, 0.03])))
    check_grads(
        bias.correct,
        (people.directions[:3],),
        order=1,
        modes=("fwd", "rev"),
        atol=1e-6,
        rtol=1e-6,
    )
    numbers = jax.grad(lambda model: jnp.sum(replace(bias, model=model).correct(people.directions[:3])[:, 2]),
                       allow_int=True)(bias.model)  # fmt: skip
    assert all(np.abs(leaf).max() > 0 for leaf in (numbers.offset, numbers.shared.offset, numbers.shared.weights))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_drawn_line_knows_that_its_lines_share_joints(side):
    """Against drawn joints, for a blend of lines that share the wrist; a left arm is the right one in a mirror."""
    draw = np.random.default_rng(1)
    kinds, model = ("forearm", "finger"), Blend(np.array([0.1, 0.15]), np.array([[0.4], [0.3]]), np.array([True]))
    mirror = np.array([1.0, side, 1.0])
    head, elbow, wrist, tip = (
        np.array([[0, 0, 1.6], [0.2, -0.25, 1.25], [0.42, -0.18, 1.4], [0.58, -0.12, 1.46]]) * mirror
    )
    middle = estimate_joints(head, elbow, wrist, tip)
    assert bool(is_left(middle)) == (side < 0)
    half = 0.002 * draw.normal(size=(18, 18))
    joints = np.asarray(middle.flat) + draw.normal(size=(20000, 18)) @ half.T
    found = corrected_lines(kinds, model, jax.tree.map(lambda leaf: leaf[None], middle), (half @ half.T)[None])

    def turned_by_hand(flat):
        own = flat.reshape(-1, 6, 3) * mirror
        ways = np.stack([own[:, 4] - own[:, 3], own[:, 5] - own[:, 4]], axis=1)
        ways /= np.linalg.norm(ways, axis=2, keepdims=True)
        straight = turn_directions(ways[:, 0], -model.turn(azimuth_elevation(ways)))
        return np.concatenate([own[:, 5] * mirror, np.asarray(straight) * mirror], axis=1)

    moved = turned_by_hand(joints)
    (exact,) = turned_by_hand(np.asarray(middle.flat)[None])
    np.testing.assert_allclose(np.concatenate([found.ray.origin[0], found.ray.direction[0]]), exact, atol=1e-12)
    np.testing.assert_allclose(found.covariance[0], np.cov(moved.T), atol=0.06 * np.abs(np.cov(moved.T)).max())


@pytest.mark.parametrize("freedom", [4, 20])
def test_spread_is_scipys_student(freedom):
    scale = np.deg2rad(1.0) ** 2 * np.array([[9.0, 2.0], [2.0, 4.0]])
    drawn = multivariate_t(shape=scale, df=freedom, seed=2).rvs(6000)
    found = fit_spread(drawn, np.ones(len(drawn)))
    assert (found.freedom < 8) == (freedom < 8)
    np.testing.assert_allclose(found.scale, scale, atol=0.08 * scale.max())
    same = Spread(scale, np.array(freedom)).log_density(drawn[:9])
    np.testing.assert_allclose(same, multivariate_t(shape=scale, df=freedom).logpdf(drawn[:9]), rtol=1e-9)


def test_spread_tells_people_from_gestures():
    people = crowds.crowd(8, people=7, gestures=36, between_deg=4.0, within_deg=1.0, slips=0.0)
    found = fit_bias("constant", people.of_lines(("head",)))
    within = np.sqrt(np.diagonal(found.within.scale))
    between = np.sqrt(np.diagonal(found.between))
    np.testing.assert_allclose(np.rad2deg(within), 1.0, atol=0.2)
    assert (np.rad2deg(between) > 2).all()
    assert (np.sqrt(np.diagonal(found.spread.scale)) > 2 * within).all()


@pytest.mark.parametrize("each", [2, 4])
def test_few_gestures_each_tell_people_from_gestures(each):
    people = crowds.crowd(3, people=150, gestures=each, between_deg=3.0, within_deg=2.0, slips=0.0)
    found = fit_bias("constant", people.of_lines(("head",)))
    np.testing.assert_allclose(np.rad2deg(np.sqrt(np.diagonal(found.within.scale))), 2.0, rtol=0.15)
    np.testing.assert_allclose(np.rad2deg(np.sqrt(np.diagonal(found.between))), 3.0, rtol=0.2)


def test_one_gesture_each_tells_nothing_of_a_person():
    people = crowds.crowd(3, people=30, gestures=1, between_deg=3.0, slips=0.0).of_lines(("head",))
    found = fit_bias("constant", people)
    np.testing.assert_allclose(found.within.scale, found.spread.scale)
    assert np.rad2deg(np.sqrt(np.linalg.eigvalsh(found.between))).max() < 0.2
    with pytest.raises(InsufficientDataError, match=r"30 gestures of 30 people.*twice or more"):
        fit_personal_bias(found, people.select(np.arange(1)))


def test_a_personal_offset_is_the_posterior_mean(people, constant):
    """For Gaussian gestures; and it moves to the truth as gestures come in."""
    shared = replace(
        constant, between=np.deg2rad(3.0) ** 2 * np.eye(2), model=Constant(np.zeros(2)),
        within=Spread(np.deg2rad(2.0) ** 2 * np.eye(2), np.array(20)),
    )  # fmt: skip
    draw = np.random.default_rng(4)
    own = people.of_lines(("head",)).select(np.flatnonzero(people.who == 2))
    errors = np.deg2rad([5.0, -4.0]) + np.deg2rad(0.5) * draw.normal(size=(len(own), 2))
    own = replace(own, directions=np.asarray(turn_directions(own.to_targets, errors))[:, None])
    three = own.select(np.arange(3))
    level = three.level
    tight = np.diag([(level**2).sum() / 4 + 1 / 9, 3 / 4 + 1 / 9])
    expected = np.linalg.solve(tight, [(level**2 * errors[:3, 0]).sum() / 4, errors[:3, 1].sum() / 4])
    found = fit_personal_bias(shared, three)
    np.testing.assert_allclose(found.model.offset, expected, atol=np.deg2rad(0.25))  # Student's t of 20 degrees
    assert np.linalg.eigvalsh(found.between).max() < np.linalg.eigvalsh(shared.between).min()
    many = fit_personal_bias(shared, own)
    np.testing.assert_allclose(np.rad2deg(many.model.offset), [5.0, -4.0], atol=0.4)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        (lambda p: p.select(p.who < 2), "constant", "Pointings of 2 people"),
        (lambda p: replace(p, targets=None), "constant", "without targets"),
        (lambda p: p.of_lines(("hand",)), "blend", "2 to 7 lines a gesture, but these have 1"),
    ],
)
def test_too_little_is_said(people, change, kind, message):
    with pytest.raises(InsufficientDataError, match=message):
        fit_bias(kind, change(people))


def test_a_personal_bias_is_one_persons(people, constant):
    with pytest.raises(InsufficientDataError, match="6 here"):
        fit_personal_bias(constant, people)
    one = people.select(people.who == 0)
    with pytest.raises(InsufficientDataError, match="is personal already"):
        fit_personal_bias(fit_personal_bias(constant, one), one)


def test_learning_is_a_function_for_jit_vmap_and_grad():
    """From directions to a blend, to what it leaves, and to people's covariance; one gesture counts for nothing."""
    people = crowds.crowd(9, people=5, gestures=6, slips=0.0).of_lines(("head", "hand"))
    gone = np.ones(len(people))
    gone[3] = 0.0

    def told(directions, weights):
        found = learn_bias("blend", Observed.at_targets(directions, people.to_targets), people.who, 5, weights)
        parts = found.model.offset, found.spread.scale, found.between, found.within.scale
        return sum(
            jnp.sum(jnp.sin(1.0 + jnp.arange(part.size)) * part.ravel() * 10.0**k) for k, part in enumerate(parts)
        )

    both = jit_once(jax.vmap(jax.value_and_grad(told), in_axes=(None, 0)))
    weights = np.stack([np.ones(len(people)), gone])
    _, slope = both(people.directions, weights)
    np.testing.assert_allclose(slope[1, 3], 0.0, atol=1e-12)
    step = 1e-5 * np.random.default_rng(0).normal(size=people.directions.shape)
    after, before = (both(people.directions + sign * step, weights)[0] for sign in (1, -1))
    np.testing.assert_allclose(np.sum(slope * step[None], axis=(1, 2, 3)), (after - before) / 2, rtol=1e-2)
