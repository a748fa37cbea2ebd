"""Views that look past an arm."""

import numpy as np
import pytest

from jaxpoint.body.contradicting_views import looks_past
from jaxpoint.detection.person.crop import Crop
from jaxpoint.detection.person.silhouette_evidence import SilhouetteEvidence
from jaxpoint.evidence.limb_slices import Pixel

SIZE = (200, 100)
ALONG = np.linspace([60.0, 50.0], [100.0, 50.0], 24)


def crop(rows: slice) -> Crop:
    """A person that fills columns 50 to 119 of these rows of the image."""
    labels = np.zeros((80, 100), np.uint8)
    labels[rows.start - 10 : rows.stop - 10, 10:80] = Pixel.PERSON
    return Crop(labels, (40, 10), SIZE)


@pytest.mark.parametrize(
    ("own", "places", "past"),
    [
        (crop(slice(40, 60)), ALONG, False),  # on the person
        (crop(slice(70, 80)), ALONG, True),  # the person is elsewhere
        (crop(slice(40, 60)), np.add(ALONG, [0.0, 30.0]), True),
        (crop(slice(40, 60)), np.add(ALONG, [55.0, 0.0]), True),  # but for a tenth of it
        (crop(slice(40, 60)), np.add(ALONG, [35.0, 0.0]), False),  # more than a third of it is on the person
        (crop(slice(70, 80)), np.add(ALONG, [-70.0, 0.0]), False),  # partly outside the image: nothing is known
        (None, ALONG, False),
    ],
)
def test_a_view_looks_past_an_arm_where_it_sees_the_room(own, places, past):
    found = looks_past([own and SilhouetteEvidence(own)], places[None], np.array([SIZE]))
    assert found.tolist() == [past]
