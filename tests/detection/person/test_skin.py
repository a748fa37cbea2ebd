"""Colours of skin against OpenCV's own conversions, scipy's densities, and real skin."""

import cv2
import numpy as np
import pytest
from scipy import stats

from jaxpoint.config.person import SkinSettings
from jaxpoint.detection.colour import is_grey
from jaxpoint.detection.person.skin import fit_skin, skin_likelihood, skin_mask, skin_model, white_balance, white_gains

MODELS = ("fitted", "box", "thesis")


@pytest.fixture(scope="module")
def colours():
    return np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)


def test_the_boxes_are_written_out(colours):
    in_colour = cv2.cvtColor(colours, cv2.COLOR_BGR2YCrCb).astype(int)
    box = np.zeros(colours.shape[:2], bool)
    thesis = np.zeros_like(box)
    for row, column in np.ndindex(box.shape):
        _, cr, cb = in_colour[row, column]
        blue, green, red = (colours[row, column] / 255).tolist()
        high, low = max(blue, green, red), min(blue, green, red)
        box[row, column] = 133 <= cr <= 173 and 77 <= cb <= 127
        if high == low or red < high:
            continue  # grey, or a hue of green or blue
        hue = (green - blue) / (high - low) / 6  # of 1; negative just below red
        floors = (high - low) / high >= 40 / 255 and high >= 40 / 255
        thesis[row, column] = box[row, column] and floors and 0.01 <= hue <= 0.1
    np.testing.assert_array_equal(skin_mask(colours, skin_model(SkinSettings("box"))), box)
    found = skin_mask(colours, skin_model(SkinSettings("thesis")))
    assert np.count_nonzero(found != thesis) <= 2  # hues on the very edge, in float32
    wrapped = skin_mask(colours, skin_model(SkinSettings("thesis", red_wrap=True)))
    assert np.count_nonzero(wrapped & ~thesis) > 0
    assert (wrapped >= found).all()
    assert 0 < np.count_nonzero(thesis) < np.count_nonzero(box)


def test_the_likelihood_is_scipys(colours):
    model = skin_model(SkinSettings())

    def density(mixture, points):
        parts = []
        for part in mixture:
            a, b, c = part.covariance
            parts.append(stats.multivariate_normal(part.mean, [[a, b], [b, c]]).logpdf(points))
        return np.logaddexp.reduce(parts) - np.log(len(parts))

    points = cv2.cvtColor(colours, cv2.COLOR_BGR2YCrCb)[..., 1:].astype(float)
    wanted = density(model.skin, points) - density(model.other, points)
    found = skin_likelihood(colours, model)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-4)
    np.testing.assert_array_equal(skin_mask(colours, model), found >= model.threshold)


def test_a_fitted_model_has_the_moments_of_its_pixels():
    rng = np.random.default_rng(1)
    skin = np.clip(rng.normal((120, 150, 200), 12, (4000, 3)), 0, 255).astype(np.uint8)
    other = rng.integers(0, 256, (4000, 3)).astype(np.uint8)
    model = fit_skin(skin, other)
    points = cv2.cvtColor(skin[None], cv2.COLOR_BGR2YCrCb)[0, :, 1:]
    np.testing.assert_allclose(model.skin[0].mean, points.mean(axis=0))
    a, b, c = model.skin[0].covariance
    np.testing.assert_allclose([[a, b], [b, c]], np.cov(points.T) + np.eye(2))
    assert skin_mask(skin[None], model).mean() > 0.97
    assert skin_mask(other[None], model).mean() < 0.15
    assert len(fit_skin([skin, skin], other).skin) == 2


def test_grey_pixels_and_too_few_are_refused():
    grey = np.repeat(np.arange(200, dtype=np.uint8)[:, None], 3, axis=1)
    colour = np.random.default_rng(2).integers(0, 256, (200, 3)).astype(np.uint8)
    with pytest.raises(ValueError, match="pixels of skin are grey"):
        fit_skin(grey, colour)
    with pytest.raises(ValueError, match="10 pixels of anything else are too few"):
        fit_skin(colour, colour[:10])
    with pytest.raises(ValueError, match="no likelihood"):
        skin_likelihood(colour[None], skin_model(SkinSettings("box")))


def test_grey_images_are_recognised(drawn):
    rng = np.random.default_rng(3)
    scene = drawn.exposed(drawn.room(rng), rng)
    assert not is_grey(scene)
    grey = cv2.cvtColor(cv2.cvtColor(scene, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    assert is_grey(grey)
    for kind in MODELS:
        assert not skin_mask(grey, skin_model(SkinSettings(kind))).any()


def test_white_balance_undoes_a_cast(drawn):
    rng = np.random.default_rng(4)
    grey_room = np.repeat(drawn.room(rng).mean(axis=-1, keepdims=True), 3, axis=-1)
    cast = np.array([0.75, 1.0, 1.2])
    image = drawn.exposed(grey_room * cast, rng, noise=1.0)
    np.testing.assert_allclose(white_gains(image), 1 / cast, rtol=0.02)
    assert is_grey(white_balance(image)[8:-8, 8:-8]) or np.abs(white_balance(image).mean(axis=(0, 1)).std()) < 1.0
    assert (white_gains(np.zeros_like(image)) == 1).all()
