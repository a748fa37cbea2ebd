"""What the report says about accuracy: numbers with their deviations, maps, and where more light helps."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.expected import Gain, expected_error
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.config import LensSettings
from jaxpoint.report.accuracy import accuracy_of, camera_table, on_accuracy, sentence, with_sigmas
from jaxpoint.report.figures_uncertainty import error_levels, error_maps
from jaxpoint.report.html import write_report
from jaxpoint.report.reading import summarise
from jaxpoint.report.style import style


def freed(calibration):
    parts = Freedom.of(Recording.of(calibration.tracks), LensSettings(), "radial2")
    count = calibration.tracks.cameras
    free = Freedom(parts.free[:count], parts.prior_mean[:count], parts.prior_weight[:count])
    return with_covariance(replace(calibration, freedom=free))


@pytest.fixture(scope="module")
def stated(calibration):
    return freed(calibration)


@pytest.fixture(scope="module")
def accuracy(stated):
    return accuracy_of(stated, summarise(stated))


def test_the_maps_are_the_expected_error_in_mm(stated, accuracy):
    floor, head = accuracy.planes
    assert (accuracy.unit, "floor" in floor.title, "1.7 m" in head.title) == ("mm", True, True)
    row, column = np.argwhere(np.isfinite(head.error))[7]
    place = np.array([[head.x[column], head.y[row], 1.7]])
    found = expected_error(stated.rig, stated.camera_covariance, stated.sigma_px, place)
    assert head.error[row, column] == pytest.approx(1e3 * found.total[0])
    assert head.views[row, column] == found.seen.sum()
    assert (np.isinf(floor.error) | (floor.views >= 2)).all()
    assert 0.5 < accuracy.mean < 20
    assert 0 < accuracy.share < 1


def test_an_unaligned_room_has_the_same_accuracy_turned_upright(stated, accuracy):
    """The error has no direction: turning the frame does not change it."""
    unaligned = replace(stated, unit="arbitrary", alignment=None)
    found = accuracy_of(unaligned, summarise(unaligned))
    assert found.unit == "thousandths of the solver's unit"
    assert found.mean == pytest.approx(accuracy.mean, rel=0.1)
    assert found.planes[0].title.startswith("Low")


def test_the_scale_is_round_and_holds_the_errors(accuracy):
    levels = error_levels(accuracy)
    known = np.concatenate([plane.error[np.isfinite(plane.error)] for plane in accuracy.planes])
    assert levels == sorted(set(levels))
    assert levels[0] <= known.min()
    assert all(float(f"{level:.2g}") == level for level in levels)
    with style():
        figure = error_maps(accuracy, ("a", "b", "c", "d"))
    assert [ax.get_title() for ax in figure.axes[:2]] == [""] * 2
    assert [ax.get_title(loc="left") for ax in figure.axes[:2]] == [plane.title for plane in accuracy.planes]


def test_numbers_and_their_deviations(stated):
    assert with_sigmas(np.array([1011.82, 3.0]), np.array([9.51, 0.0])) == "1011.8 ± 9.5, 3 (held)"
    assert with_sigmas(np.array([-0.16411, 0.0]), np.array([0.00872, 0.0])) == "-0.1641 ± 0.0087"
    table = camera_table(stated, summarise(stated))
    assert len(table.rows) == 4
    sigma = np.sqrt(np.diag(stated.camera_covariance))
    assert table.rows[1][1].endswith(f"± {sigma[21]:.2g}")
    assert camera_table(replace(stated, camera_covariance=None), summarise(stated)) is None


def test_the_advice_names_the_best_places(accuracy):
    names = ("a", "b", "c", "d")
    best = (Gain(3, (0, 1, 2, 3), 4.0, 3.0), Gain(1, (0, 2), 4.0, 3.2), Gain(0, (1, 3), 4.0, 3.6))
    (told,) = on_accuracy(replace(accuracy, gains=best), names)
    low, high = accuracy.boxes[1]
    assert f"x {low[0]:.1f} to {high[0]:.1f}, y {low[1]:.1f} to {high[1]:.1f}" in told.remedy
    assert told.remedy.index("all cameras: −25%") < told.remedy.index("a and c: −20%") < told.remedy.index("−10%")
    (told,) = on_accuracy(replace(accuracy, gains=(Gain(0, (0, 1), 4.0, 3.96),)), names)
    assert "hardly helps" in told.remedy
    assert list(on_accuracy(None, names)) == []
    # Along a corridor every place is seen by two cameras, but no camera sees most of a part.
    (told,) = on_accuracy(replace(accuracy, gains=(Gain(1, (), 4.0, 3.0), Gain(0, (3,), 4.0, 3.2))), names)
    assert "seen by :" not in told.remedy
    assert "seen by d: −20%" in told.remedy
    assert ": −25%;" in told.remedy


def test_the_sentence_says_which_source_dominates(accuracy):
    assert "The calibration dominates: of the squared error 80%" in sentence(replace(accuracy, share=0.8))
    assert "The noise of the pixels dominates" in sentence(replace(accuracy, share=0.2))
    assert "Both weigh about alike" in sentence(replace(accuracy, share=0.45))


def test_the_page_shows_it_or_says_why_not(stated, tmp_path):
    write_report(tmp_path / "r.html", stated)
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert 'id="accuracy"' in page
    assert "Expected error of a triangulated place" in page
    assert "The expected error over the volume of the light is" in page
    unknown = replace(stated, camera_covariance=None, gauge=None, undetermined="The rig is loose.")
    write_report(tmp_path / "r.html", unknown)
    assert "The expected error is not known: The rig is loose." in (tmp_path / "r.html").read_text(encoding="utf-8")
