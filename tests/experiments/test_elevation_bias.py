"""The experiment on the bias of real people: its measures on drawn answers, and its first figures on the studies."""

from dataclasses import replace
from pathlib import Path

import crowds
import numpy as np
import pytest
from scipy.special import softmax
from scipy.stats import multivariate_t

from elevation_grid import Grid
from elevation_study import ElevationBias, calibration_error, personal_turns, plain_means, probabilities, reliability
from elevation_wall import Wall
from jaxpoint.io.bias_files import read_bias
from jaxpoint.pointing.bias.fit import fit_bias
from jaxpoint.pointing.bias.spread import Spread


@pytest.fixture(scope="module")
def settings(data_folder):
    return ElevationBias(data=data_folder, triples=5)


def test_honest_probabilities_have_no_calibration_error():
    draw = np.random.default_rng(0)
    given = draw.uniform(0, 1, 200_000)
    assert calibration_error(given, draw.random(given.size) < given) < 0.005
    assert calibration_error(given, draw.random(given.size) < given**2) == pytest.approx(1 / 6, abs=0.01)
    (mean, share, count), *_ = reliability(np.array([0.92, 0.98, 1.0]), np.array([1, 0, 1]))
    assert (mean, share, count) == (pytest.approx(2.9 / 3), pytest.approx(2 / 3), 3)


def test_probabilities_are_bayes_rule():
    people = crowds.crowd(people=3, gestures=2).of_lines(("head",))
    assert people.targets is not None
    scale = np.deg2rad([3.0, 2.0]) ** 2 * np.eye(2)
    directions = people.directions[:, 0]
    found = probabilities(people, directions, people.targets, Spread(scale, np.array(4)))
    for k in range(len(people)):
        to = people.targets - people.origins[k, 0]
        off = np.arctan2(directions[k, 1], directions[k, 0]) - np.arctan2(to[:, 1], to[:, 0])
        up = np.arcsin(directions[k, 2]) - np.arctan2(to[:, 2], np.hypot(*to[:, :2].T))
        left = off * np.hypot(*to[:, :2].T) / np.linalg.norm(to, axis=1)
        expected = softmax(multivariate_t(shape=scale, df=4).logpdf(np.stack([left, up], axis=1)))
        np.testing.assert_allclose(found[k], expected, atol=1e-9)


def test_triples_take_three_targets_and_are_told():
    people = crowds.crowd(people=3, gestures=40).of_lines(("head",))
    bias = fit_bias("constant", people)
    own = people.select(people.who == 1)
    own = replace(own, directions=np.asarray(bias.correct(own.directions))[:, None])
    meant = np.arange(40) % 8
    settings = ElevationBias(data=Path("."), triples=20)
    turns, used = personal_turns(own, meant, bias, settings, 1)
    assert turns.shape == (20, 2)
    assert {len(set(meant[row])) for row in used} == {3}
    assert (used.sum(axis=1) == 3).all()
    again, _ = personal_turns(own, meant, bias, settings, 1)
    np.testing.assert_array_equal(turns, again)


def test_the_wall_reproduces_what_was_recorded(settings):
    wall = Wall(settings)
    hits, surface = wall._hits(wall.own.directions[:, 0])
    assert np.mean(np.linalg.norm(hits - wall.read.hits, axis=1) < 1e-3) == pytest.approx(0.958, abs=5e-4)
    assert np.bincount(surface).tolist() == [4, 0, 1281, 11]
    shares = [row.value for row in wall._nearest_rows("none", wall.own.directions[:, 0], "", ("",) * 4)]
    np.testing.assert_allclose(shares, [95.3, 100, 97.0, 88.9], atol=0.05)


def test_the_forearm_of_the_package_is_the_studys(settings):
    """And it is within the wanted 4.9 degrees on people left out, as the plain means are where their notes say."""
    grid = Grid(settings)
    found = grid.forearm_bias()
    kept = read_bias(Path(__file__).parents[2] / "configs" / "forearm_bias.toml")
    assert kept.fitted.source == found.fitted.source
    np.testing.assert_allclose(np.rad2deg(kept.model.offset), np.rad2deg(found.model.offset), atol=1e-3)
    np.testing.assert_allclose(kept.spread.scale, found.spread.scale, rtol=1e-3)
    assert found.fitted.median_deg == pytest.approx(kept.fitted.median_deg, abs=1e-3)
    assert found.fitted.median_deg <= 4.9
    own = grid.all.of_lines(("forearm",))
    plain = grid._median(own, plain_means(own), "", "", "").value
    assert plain == pytest.approx(5.25, abs=0.005)
