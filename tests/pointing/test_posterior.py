"""Masses against Monte Carlo and scipy, probabilities against relative frequencies, words."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from furnished import things
from scipy.stats import multivariate_normal, multivariate_t

from jaxpoint.compilation import jit_once
from jaxpoint.geometry.line import Ray
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.mass import OutlineView, across, angle
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import Behaviour, posterior
from jaxpoint.pointing.shapes import Box, Rectangle, Sphere
from jaxpoint.pointing.word_evidence import words_evidence

TIP = np.array([3.0, 2.5, 1.3])
AHEAD = np.array([1.0, 0.2, -0.1]) / np.linalg.norm([1.0, 0.2, -0.1])
SPREAD = np.deg2rad([4.0, 3.0])


@partial(jit_once, static_argnames="freedom")
def masses(line, shapes, spread, freedom):
    view = OutlineView.of(line, spread, freedom)
    return shapes.each(lambda own: own.masses(view))


def line(covariance=None, direction=AHEAD) -> PointingLine:
    return PointingLine(Ray(TIP, direction), np.zeros((6, 6)) if covariance is None else covariance)


def screen(middle, right, down) -> Rectangle:
    corner = np.asarray(middle) - (np.asarray(right) + np.asarray(down)) / 2
    return Rectangle(np.stack([corner, corner + right, corner + down, corner + right + down]))


def facing(left, up, width, height, depth=2.0) -> Rectangle:
    """A rectangle square to the line, given by tangents."""
    to_left, to_up = np.asarray(across(jnp.asarray(AHEAD)))
    middle = TIP + depth * (AHEAD + left * to_left + up * to_up)
    return screen(middle, -depth * width * to_left, -depth * height * to_up)


DRAWN = [(0.0, 0.0, 0.1, 0.2), (0.05, -0.03, 0.04, 0.02), (0.2, 0.1, 0.3, 0.25), (-0.03, 0.0, 2.0, 0.01)]


def furnished() -> list[Thing]:
    """All that masses are tested on, so that one shape of database is compiled."""
    table = Thing("table", screen(TIP - [0, 0, 0.1], [3.0, 0, 0], [0, 2.0, 0]))
    return [Thing(str(i), facing(*one)) for i, one in enumerate(DRAWN)] + [table, *things(4)]


def masses_of(line, freedom):
    return np.asarray(masses(line, Objects.of(furnished()).shapes, jnp.diag(jnp.asarray(SPREAD) ** 2), freedom=freedom))


@pytest.mark.parametrize("freedom", [None, 1, 2, 3, 4, 7, 10])
def test_masses_are_scipys(freedom):
    found = masses_of(line(), freedom)
    for mass, (left, up, width, height) in zip(found, DRAWN):
        low, high = np.array([left - width / 2, up - height / 2]), np.array([left + width / 2, up + height / 2])
        if freedom is None:
            expected = multivariate_normal(mean=np.zeros(2), cov=SPREAD**2).cdf(high, lower_limit=low)
        else:
            law = multivariate_t(shape=np.diag(SPREAD**2), df=freedom)
            expected = law.cdf(high, lower_limit=low, random_state=np.random.default_rng(0))
        assert float(mass) == pytest.approx(expected, abs=1e-4)


@pytest.mark.usefixtures("any_shape")
@pytest.mark.parametrize("freedom", [0, -2, 2.5])
def test_degrees_of_freedom_that_no_distribution_has_are_refused(freedom):
    with pytest.raises(ValueError, match=f"`freedom` cannot be {freedom:g}; give a whole number"):
        Behaviour(freedom=freedom)


@pytest.mark.parametrize("freedom", [None, 4])
def test_masses_are_those_of_monte_carlo_for_every_shape(freedom):
    listed = furnished()
    objects = Objects.of(listed)
    rng = np.random.default_rng(5)
    mixed = rng.normal(size=(6, 6)) * np.repeat([2e-3, 8e-3], 3)[:, None]
    covariance = mixed @ mixed.T
    count = 100_000
    worst = 0.0
    for k in (7, 17, 21):  # a rectangle, a box, a sphere
        shape = listed[k].shape
        middle = np.mean(shape.corners, axis=0) if isinstance(shape, Rectangle) else shape.center
        direction = (middle - TIP) / np.linalg.norm(middle - TIP)
        found = masses_of(line(covariance, direction), freedom)
        error = rng.normal(size=(count, 6)) @ mixed.T
        error[:, 3:] += rng.normal(size=(count, 2)) * SPREAD @ np.asarray(across(jnp.asarray(direction)))
        if freedom is not None:
            error /= np.sqrt(rng.chisquare(freedom, count) / freedom)[:, None]
        worst = max(worst, np.abs(met_share(objects, TIP + error[:, :3], direction + error[:, 3:]) - found).max())
    assert worst < 5e-3  # three deviations of the sampling, and what the origin's error leaves


def met_share(objects, origins, directions):
    """The share of rays that meet each primitive, in numpy."""
    faces, *spheres = jax.tree.map(np.asarray, objects.shapes.primitives)
    shares = []
    for corner, right, down, solid in zip(faces.corner, faces.right, faces.down, faces.solid):
        normal = np.cross(down, right)
        closing = directions @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (corner - origins) @ normal / closing
            place = origins + reach[:, None] * directions - corner
            u, v = place @ right / (right @ right), place @ down / (down @ down)
            ahead = (reach > 0) & ((closing < 0) | ~solid)
            shares.append(np.mean(ahead & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)))
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    for center, radius in zip(spheres[0].center, spheres[0].radius) if spheres else ():
        gap = center - origins
        along = np.sum(gap * unit, axis=1)
        shares.append(np.mean((along > 0) & (np.sum(gap**2, axis=1) - along**2 < radius**2)))
    return np.array(shares)


def test_a_table_around_the_tip_has_the_mass_of_its_part_ahead():
    down = np.array([1.0, 0, -0.3]) / np.hypot(1, 0.3)
    found = masses_of(line(direction=down), None)
    rng = np.random.default_rng(1)
    error = rng.normal(size=(200_000, 2)) * SPREAD @ np.asarray(across(jnp.asarray(down)))
    table = Objects.of(furnished()[4:5])
    hits = met_share(table, np.tile(TIP, (len(error), 1)), down + error)
    assert found[4] == pytest.approx(hits[0], abs=3e-3)
    assert 0.5 < hits[0] < 1


def test_solid_angles():
    listed = [Thing("wall", facing(0, 0, 0.02, 0.01, 3.0)), Thing("ball", Sphere(TIP + 2 * AHEAD, 1.0))]
    tip, shapes = jnp.asarray(TIP), Objects.of(listed).shapes
    found = jit_once(lambda tip, shapes: shapes.each(lambda own: own.solid_angles(tip)))(tip, shapes)
    assert float(found[0]) == pytest.approx(2e-4, rel=1e-3)
    assert float(found[8]) == pytest.approx(2 * np.pi * (1 - np.sqrt(3) / 2))


def test_spheres_alone():
    balls = Objects.of([Thing("ahead", Sphere(TIP + 2 * AHEAD, 0.3)), Thing("behind", Sphere(TIP - 2 * AHEAD, 0.3))])
    found = posterior(line(), balls, Behaviour())
    assert float(found.probability[0]) > 0.5 > float(found.nothing) > 0.0
    assert float(found.probability[1]) < 1e-3
    np.testing.assert_array_equal(np.asarray(intersect(line().ray, balls).count), 1)


def test_derivatives_of_probabilities_forward_and_reverse():
    """Along a step, of one number that tells of all answers, by one program; a sphere is among the objects."""
    listed = things(8, rectangles=4, boxes=1, spheres=1)
    objects = Objects.of(listed)
    middle = np.asarray(listed[0].shape.corners).mean(axis=0) - TIP
    start = np.concatenate([TIP, middle / np.linalg.norm(middle), [0.07, 0.05]])
    rng = np.random.default_rng(0)
    step, told = rng.normal(size=8) * np.repeat([0.1, 1.0, 0.3], [3, 3, 2]), jnp.asarray(rng.normal(size=13))

    def answer(x):
        one = PointingLine(Ray(x[:3], x[3:6]), jnp.eye(6) * 1e-4)
        found = posterior(one, objects, Behaviour(x[6], x[7]))
        return told @ jnp.concatenate([found.probability, found.nothing[None], found.mass])

    @jit_once
    def slopes(x):
        return answer(x), jax.jvp(answer, (x,), (jnp.asarray(step),))[1], jax.grad(answer)(x)

    _, forward, reverse = slopes(jnp.asarray(start))
    there, back = (slopes(jnp.asarray(start + sign * 1e-6 * step))[0] for sign in (1, -1))
    assert float(forward) == pytest.approx(float(there - back) / 2e-6, rel=1e-4)
    assert float(reverse @ step) == pytest.approx(float(forward), rel=1e-9)
    assert abs(float(forward)) > 0.1


def test_reverse_derivatives_of_the_angle_of_an_edge():
    """Compiled by plain `jax.jit`: XLA made wrong numbers of those that it derived itself, by its default options."""
    h, a, b = np.random.default_rng(3).normal(size=(3, 64))

    def seen(h, a, b):
        return jnp.sum(angle(h * (b - a), h**2 + a * b))

    slopes = jax.jit(jax.grad(seen, argnums=(0, 1, 2)))(h, a, b)
    of_b, of_a = h / (h**2 + b**2), -h / (h**2 + a**2)
    np.testing.assert_allclose(slopes, [a / (h**2 + a**2) - b / (h**2 + b**2), of_a, of_b], rtol=1e-9)


@pytest.mark.parametrize("aimed", [1.0, 0.5])
def test_probabilities_are_relative_frequencies_for_people_who_behave_as_assumed(aimed):
    """Of the answers given with a probability p, p are right: simulated people mean any object, or none."""
    rng = np.random.default_rng(2)
    listed = [Thing(str(i), facing(*rng.uniform(-0.5, 0.5, 2), *rng.uniform(0.04, 0.3, 2))) for i in range(12)]
    behaviour = Behaviour(*SPREAD, freedom=4, nothing=0.1, hidden=1.0, aimed=aimed)
    count = 3000
    meant = rng.integers(0, 12, count)
    none = rng.random(count) < 0.1
    target = np.stack([listed[k].shape.corners for k in meant])
    u, v = 0.5 + aimed * (rng.random((2, count, 1)) - 0.5)
    aim = target[:, 0] + u * (target[:, 1] - target[:, 0]) + v * (target[:, 2] - target[:, 0]) - TIP
    free = rng.normal(size=(count, 3))
    free *= np.sign(free @ AHEAD)[:, None]
    aim = np.where(none[:, None], free, aim)
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    error = rng.normal(size=(count, 2)) * SPREAD / np.sqrt(rng.chisquare(4, (count, 1)) / 4)
    shown = aim + np.einsum("gi,gij->gj", error, np.asarray(jax.vmap(across)(jnp.asarray(aim))))
    shown /= np.linalg.norm(shown, axis=1, keepdims=True)
    lines = PointingLine(Ray(np.tile(TIP, (count, 1)), shown), np.zeros((count, 6, 6)))
    found = posterior(lines, Objects.of(listed), behaviour)
    chances = np.concatenate([np.asarray(found.probability), np.asarray(found.nothing)[:, None]], axis=1)
    np.testing.assert_allclose(chances.sum(axis=1), 1.0, atol=1e-9)
    right = chances.argmax(axis=1) == np.where(none, 12, meant)
    best = chances.max(axis=1)
    bins = np.clip((best * 10).astype(int), 0, 9)
    gaps = [abs(right[bins == b].sum() - best[bins == b].sum()) for b in range(10)]
    assert sum(gaps) / count < 0.05
    assert best.min() < 0.5 < 0.9 < best.max()  # all kinds of answers are among them


def test_occluded_parts_count_less_and_ambiguity_is_reported():
    listed = [Thing("front", facing(0, 0, 0.2, 0.2, 1.0)), Thing("back", facing(0, 0, 0.2, 0.2, 2.0))]
    objects = Objects.of(listed)
    found = posterior(line(), objects, Behaviour(hidden=0.1, nothing=0.01))
    np.testing.assert_allclose(found.visible, [1.0, 0.0], atol=1e-12)
    assert float(found.probability[0] / found.probability[1]) == pytest.approx(10, rel=1e-6)
    assert not bool(found.ambiguous)
    alike = posterior(line(), objects, Behaviour(hidden=0.5, nothing=0.01))
    assert bool(alike.ambiguous)
    assert alike.order.tolist() == [0, 1]
    weighed = posterior(line(), objects, Behaviour(hidden=0.5, nothing=0.01), prior=np.array([1.0, 10.0]))
    assert weighed.order.tolist() == [1, 0]
    beyond = posterior(line(direction=-AHEAD), objects, Behaviour())
    assert float(beyond.nothing) > 0.99


def test_invalid_lines_have_no_probabilities():
    """Their neighbours keep theirs; a variance that is rounded to just below 0 is valid."""
    objects = Objects.of([Thing("front", facing(0, 0, 0.2, 0.2, 1.0)), Thing("back", facing(0.1, 0, 0.2, 0.2, 2.0))])
    each = [
        line(np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, -1e-13])),
        PointingLine(Ray(TIP * np.nan, AHEAD), np.zeros((6, 6))),
        line(direction=AHEAD * np.inf),
        line(direction=np.zeros(3)),
        line(np.diag([0, 0, 0, 0, -1e-5, 0])),
        line(np.full((6, 6), np.nan)),
        line(),
        line(),
    ]
    evidence = np.ones((8, 2))
    evidence[6, 0] = np.nan
    found = posterior(jax.tree.map(lambda *leaves: jnp.stack(leaves), *each), objects, evidence=evidence)
    for numbers in (found.probability, found.nothing[:, None], found.mass, found.visible, found.marginal[:, None]):
        np.testing.assert_array_equal(np.isnan(numbers).all(axis=1), [False, *6 * [True], False])
        assert np.isfinite(np.asarray(numbers)[[0, 7]]).all()
    assert found.ambiguous[1:7].all()


def test_the_density_of_a_line_is_that_of_one_object_and_of_none():
    """Of a small object square to the line, whose mass scipy knows and whose solid angle is its area."""
    wide, high = 0.06, 0.03
    behind = Thing("behind", facing(0, 0, 0.2, 0.2, -1.0))
    objects = Objects.of([Thing("card", facing(0.02, -0.01, wide, high)), behind])
    found = posterior(line(), objects, Behaviour(*SPREAD, nothing=0.2))
    low, top = np.array([0.02 - wide / 2, -0.01 - high / 2]), np.array([0.02 + wide / 2, -0.01 + high / 2])
    mass = multivariate_t(shape=np.diag(SPREAD**2), df=4).cdf(top, lower_limit=low, random_state=0)
    card, none = 0.8 / 2 * mass / (wide * high), 0.2 * (1 - mass) / (2 * np.pi)
    assert float(found.marginal) == pytest.approx(card + none, rel=3e-3)
    assert float(found.nothing * found.marginal) == pytest.approx(none, rel=3e-3)


def test_lines_may_have_a_behaviour_each():
    objects = Objects.of([Thing("front", facing(0, 0, 0.2, 0.2, 1.0)), Thing("back", facing(0.1, 0, 0.2, 0.2, 2.0))])
    one, other = Behaviour(*SPREAD), Behaviour(0.02, 0.03, nothing=0.3, hidden=0.6)
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), one, other)
    lines = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), line())
    found, alone = posterior(lines, objects, both), [posterior(line(), objects, own) for own in (one, other)]
    np.testing.assert_allclose(found.probability, [own.probability for own in alone], rtol=1e-12)
    np.testing.assert_allclose(found.nothing, [own.nothing for own in alone], rtol=1e-12)
    assert float(found.nothing[0] / found.nothing[1]) > 1.5


def test_people_aim_at_the_middle_part_of_every_shape():
    """As if each object were smaller, about its own middle."""
    center, size = TIP + 1.2 * AHEAD, np.array([0.2, 0.3, 0.1])
    beside = center + np.array([0.1, 0.3, 0.1])
    shapes = [facing(0.1, 0.05, 0.4, 0.2), Box(center, size, 0.4), Sphere(beside, 0.2)]
    small = [facing(0.1, 0.05, 0.2, 0.1), Box(center, size / 2, 0.4), Sphere(beside, 0.1)]
    whole, half = (Objects.of([Thing(str(i), one) for i, one in enumerate(some)]) for some in (shapes, small))
    found = posterior(line(), whole, Behaviour(*SPREAD, aimed=0.5))
    np.testing.assert_allclose(found.mass, posterior(line(), half, Behaviour(*SPREAD)).mass, rtol=1e-9)
    with pytest.raises(ValueError, match=r"0\.\.1; it is 1\.5"):
        Behaviour(aimed=1.5)


def test_a_small_thing_on_a_large_one_does_not_take_its_lines():
    listed = [Thing("table", facing(0, 0, 0.6, 0.3)), Thing("book", facing(0.13, 0, 0.1, 0.07, 0.999))]
    objects, spread = Objects.of(listed), np.deg2rad([2.0, 2.0])
    anywhere, middle = (posterior(line(), objects, Behaviour(*spread, aimed=aimed)) for aimed in (1.0, 0.4))
    to_book = np.asarray(listed[1].shape.corners).mean(axis=0) - TIP
    at_book = line(direction=np.asarray(to_book) / np.linalg.norm(to_book))
    book = posterior(at_book, objects, Behaviour(*spread, aimed=0.4))
    assert middle.probability[0] > 1.3 * anywhere.probability[0]
    assert middle.order[0] == 0
    assert book.order[0] == 1


def test_large_objects_are_meant_more_often_where_the_prior_says_so():
    listed = [Thing("small", facing(0, 0, 0.02, 0.02, 1.0)), Thing("large", facing(0, 0, 0.4, 0.4, 1.01))]
    objects = Objects.of(listed)
    alike, by_size = (
        posterior(line(), objects, Behaviour(hidden=1.0, prior=prior)).probability for prior in ("equal", "size")
    )
    assert alike[0] > alike[1]
    shares = posterior(line(), objects, Behaviour(hidden=1.0)).mass
    np.testing.assert_allclose(by_size[0] / by_size[1], shares[0] / shares[1], rtol=1e-9)


def test_words_help():
    listed = [
        Thing("desk lamp", facing(0, 0, 0.1, 0.1), "lamp"),
        Thing("poster", facing(0.05, 0, 0.1, 0.1), "", ("paper",)),
    ]
    objects = Objects.of(listed)
    assert words_evidence(objects, ["give", "me", "that"]).tolist() == [1, 1]
    assert words_evidence(objects, ["the", "Lamps", "there"], 0.2).tolist() == [1, 0.2]
    plain = posterior(line(), objects, Behaviour())
    told = posterior(line(), objects, Behaviour(), evidence=words_evidence(objects, ["paper"]))
    assert plain.order[0] == 0
    assert told.order[0] == 1
