"""The readers of two studies of people who pointed, against the notes that lie beside their data."""

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.pointing.bias.score import errors_deg
from pointing_studies import read_schuetz, read_torsalve


def test_the_markers_are_read_as_their_notes_say(data_folder):
    """Medians and constant errors of README.txt, whose azimuths count to the right."""
    people = read_torsalve(data_folder / "pointing_torsalve")
    noted = {"head": (4.60, 3.80, 0.79), "shoulder": (19.41, -3.65, 18.29), "upper-arm": (19.78, -12.80, 15.86),
             "forearm": (19.65, -14.98, 15.52), "hand": (19.55, -13.15, 16.16)}  # fmt: skip
    assert (len(people), len(people.crowd)) == (945, 7)
    for line, (median, right, high) in noted.items():
        own = people.of_lines((line,))
        found = np.rad2deg(own.errors.mean(axis=0))
        np.testing.assert_allclose(np.median(errors_deg(own, own.directions[:, 0])), median, atol=0.006)
        np.testing.assert_allclose(found, [-right, high], atol=0.006)


def test_the_wall_is_read_as_its_notes_say(data_folder):
    wall = read_schuetz(data_folder / "pointing_schuetz")
    own = wall.pointings
    assert (len(own), len(own.crowd)) == (1296, 12)
    assert [wall.feedback.count(name) for name in ("cursor", "hand", "none")] == [432, 432, 432]
    np.testing.assert_allclose(np.median(errors_deg(own, own.directions[:, 0])), 4.72, atol=0.006)
    gap = wall.hits - own.targets
    np.testing.assert_allclose([np.median(np.linalg.norm(gap, axis=1)), gap[:, 0].mean()], [0.263, 0.154], atol=6e-4)


def test_no_study_there(tmp_path):
    with pytest.raises(FileFormatError, match="no trials"):
        read_schuetz(tmp_path)
