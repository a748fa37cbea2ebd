"""The evaluation's own arithmetic, and the thesis's line on regions whose place is known."""

import numpy as np
import pytest
from answer_rig import rig_of_three
from scipy.stats import binom, binomtest

from jaxpoint.detection.person.endpoints import Endpoints
from jaxpoint.detection.person.thesis_regions import ThesisReason, ThesisRegion
from jaxpoint.detection.region import Region
from pointing_evaluation import _error_by_chance, _reliability, _share, summary
from thesis_line import thesis_line


def test_shares_have_wilson_intervals():
    right = np.arange(20) < 15
    interval = binomtest(15, 20).proportion_ci(method="wilson")
    assert _share(right) == f"75 ({100 * interval.low:.0f} to {100 * interval.high:.0f})"


def row(law, target, name, probability, found=True):
    answer = {"name": name, "probability": probability, "error_deg": 1.0 if found else None}
    return {"law": law, "target": target, "found": found, "views": 4, "raw": answer, "with the model": answer,
            "thesis": {"name": None, "error_deg": None}}  # fmt: skip


def test_a_gesture_that_is_not_found_counts_as_wrong():
    rows = [row("accurate", "book", "book", 0.9), row("accurate", "book", None, 0.0, found=False)]
    table = summary(rows)
    assert "2 gestures, 1 of them found." in table
    assert "| accurate (n = 2) | 50 (" in table
    assert table.count("| 0 (") >= 2  # the thesis has no answer


def test_the_expected_calibration_error_is_that_of_a_hand():
    rows = [row("accurate", "book", "book" if i < 6 else "lamp", 0.85) for i in range(10)]
    rows += [row("accurate", "book", "book", 0.99) for _ in range(10)]
    assert _reliability(rows)[-1].startswith(f"Expected calibration error: {0.5 * 0.25 + 0.5 * 0.01:.3f};")


def test_the_error_of_true_probabilities_is_that_of_the_binomial():
    """In one bin it is the binomial's mean absolute deviation; bins of unlike answers add theirs."""
    deviation = [binom(20, p).expect(lambda k, p=p: abs(k - 20 * p)) for p in (0.6, 0.85)]
    assert _error_by_chance(np.repeat([0.6, 0.85], 20)) == pytest.approx(sum(deviation) / 40, rel=0.03)


def region(tip, base, eccentricity, area) -> ThesisRegion:
    found = Region(area, np.zeros(2), 40.0, 8.0, eccentricity, 0.0, (0, 0, 1, 1), 1)
    return ThesisRegion(np.ones((1, 1), bool), found, Endpoints(np.asarray(tip), np.asarray(base)), ThesisReason.FOUND)


def test_the_thesis_takes_its_two_best_views():
    rig = rig_of_three()
    tip, base = np.array([0.5, 0.1, 1.4]), np.array([0.2, 0.0, 1.3])
    ends = np.asarray(rig.project(np.stack([tip, base])))
    views = [region(ends[0, c], ends[1, c], 0.95, 400) for c in range(3)]
    views[1] = region([5.0, 5.0], [90.0, 7.0], 0.8, 120)  # another limb, rounder and smaller
    line = thesis_line(rig, views)
    assert line is not None
    np.testing.assert_allclose(line.origin, tip, atol=1e-6)
    np.testing.assert_allclose(line.direction, (tip - base) / np.linalg.norm(tip - base), atol=1e-6)
    missing = ThesisRegion(np.zeros((0, 0), bool), None, None, ThesisReason.TOO_SMALL)
    assert thesis_line(rig, [views[0], missing, missing]) is None


@pytest.mark.parametrize("seeds", [(), (1, 2)])
def test_nobody_evaluates_nothing(seeds):
    assert summary([row("accurate", "book", "book", 0.9) for _ in seeds]).startswith(f"{len(seeds)} gestures")
