"""Sessions scored from pixels: one pass gives every score, and files that do not fit are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

import scored_sessions
from jaxpoint.body.joints import Joints
from jaxpoint.config.people import Uniform
from jaxpoint.errors import FileFormatError, UsageError
from scored_sessions import LAYOUT, Asked, read_session, score_session, settings_of


@pytest.fixture(scope="module")
def session():
    """One gesture in three cameras of half the size."""
    settings = settings_of(1)
    viewpoints = replace(settings.viewpoints, cameras=3, size=(640, 360), field_of_view_deg=Uniform(60.0, 65.0))
    return score_session(replace(settings, viewpoints=viewpoints, empty_frames=51), 43, every=3)


def test_one_pass_gives_what_both_evaluations_read(session):
    (gesture,), (pointing,) = session["gestures"], session["pointing"]
    assert len(session["views"]) == 3 * gesture["frames"] > 3
    assert gesture["answered"] >= 1
    assert gesture["direction_deg"] < 15.0
    assert np.median(gesture["head_m"]) < 0.1
    assert pointing["found"]
    tip = np.asarray(Joints.of_flat(np.array(pointing["joints"])).tip)
    assert np.linalg.norm(tip - pointing["true_tip_m"]) < 0.1
    assert json.loads(json.dumps(session))["objects"]


def test_what_is_kept_is_not_rendered_again(tmp_path, monkeypatch):
    kept = {"layout": LAYOUT, "asked": 8, "every": 2, "views": []}
    for seed in (3, 4):
        (tmp_path / f"seed_{seed}.json").write_text(json.dumps(kept | {"seed": seed}))
    monkeypatch.setattr(scored_sessions.multiprocessing, "get_context", lambda name: pytest.fail("rendered"))
    found = scored_sessions.scored_sessions(range(3, 5), 8, 2, 1, tmp_path)
    assert [one["seed"] for one in found] == [3, 4]


def test_files_that_do_not_fit_are_refused_before_anything_is_rendered(tmp_path):
    path = tmp_path / "seed_0.json"
    path.write_text(json.dumps({"views": [], "gestures": []}))  # as earlier versions wrote it
    with pytest.raises(FileFormatError, match=r"layout 1.*layout 2.*--out"):
        scored_sessions.scored_sessions(range(2), 8, 2, 1, tmp_path)
    path.write_text("[")
    with pytest.raises(FileFormatError, match="no kept session"):
        read_session(path, Asked(8, 1, 2))
    path.write_text(json.dumps({"layout": LAYOUT, "asked": 4, "every": 2}))
    with pytest.raises(UsageError, match=r"--gestures 4 --each 1 --every 2.*--gestures 8 --each 1 --every 2"):
        read_session(path, Asked(8, 1, 2))
    with pytest.raises(UsageError, match="1 to 8 people"):
        scored_sessions.scored_sessions(range(2), 9, 2, 1, tmp_path)
    assert sorted(tmp_path.iterdir()) == [path]
