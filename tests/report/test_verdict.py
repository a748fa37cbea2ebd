"""The verdict states its thresholds and fails where the gates of the settings fail."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.result import Verdict
from jaxpoint.config import AlignSettings, CalibrateSettings
from jaxpoint.report.advice import Advice
from jaxpoint.report.reading import summarise
from jaxpoint.report.verdict import judge_summary, judge_tracks


def judged(calibration, settings=None, advice=(), align=None):
    settings = settings or CalibrateSettings()
    return judge_summary(summarise(calibration), assess(calibration, settings, align), list(advice), settings)


def test_a_good_calibration_is_trusted_and_says_why(calibration):
    judgement = judged(calibration)
    assert judgement.level == "good"
    assert "limit 1 px" in judgement.sentence
    assert "at least 70%" in judgement.sentence


def test_gates_fail_exactly_where_the_command_fails(calibration):
    mean = summarise(calibration).mean_px
    for settings in (CalibrateSettings(max_mean_px=0.99 * mean), CalibrateSettings(min_kept=0.999)):
        assert not assess(calibration, settings).passed
        assert judged(calibration, settings).level == "bad"
    stuck = replace(calibration, converged=False, message="out of steps")
    assert not assess(stuck).passed
    assert "did not converge (out of steps)" in judged(stuck).sentence


def test_an_alignment_that_misses_its_points_fails(calibration):
    assert judged(calibration, align=AlignSettings(max_rms_mm=10.0)).level == "bad"
    flat = replace(calibration, alignment=replace(calibration.alignment, handedness_verified=False))
    judgement = judged(flat)
    assert judgement.level == "care"
    assert "Handedness" in judgement.sentence


@pytest.mark.parametrize(("every", "level"), [(3, "care"), (2, "bad")])
def test_a_camera_that_is_often_rejected_is_named(calibration, every, level):
    verdicts = calibration.verdicts.copy()
    verdicts[::every, 1] = np.where(verdicts[::every, 1] == Verdict.KEPT, Verdict.REPROJECTION, verdicts[::every, 1])
    judgement = judged(replace(calibration, verdicts=verdicts))
    assert judgement.level == level
    assert "cam_1" in judgement.sentence


def test_urgent_advice_is_part_of_the_sentence(calibration):
    judgement = judged(calibration, advice=[Advice("The door was open.", "Close it.", urgent=True)])
    assert judgement.level == "care"
    assert "The door was open." in judgement.sentence


def test_nothing_kept_is_bad_and_no_crash(calibration):
    nothing = replace(
        calibration, verdicts=np.where(calibration.verdicts == Verdict.KEPT, Verdict.UNDECIDED, calibration.verdicts)
    )
    assert judged(nothing).level == "bad"


def test_tracks_are_ready_or_not(calibration):
    tracks, pairs = calibration.tracks, calibration.pairs
    assert judge_tracks(tracks, pairs, [], None).level == "good"
    assert judge_tracks(tracks, pairs, [], "Camera 'a' is blind.").sentence == "Camera 'a' is blind."
    few = tracks.select_frames(np.flatnonzero(tracks.visible.sum(axis=1) >= 2)[:10])
    assert judge_tracks(few, pairs, [], None).level == "bad"
