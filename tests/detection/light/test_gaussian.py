import numpy as np
import pytest
from scipy.optimize import least_squares

from jaxpoint.detection.light.gaussian import correlate_template, fit_gaussians

HALF = 4
ROWS, COLUMNS = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1]


def drawn(center, amplitude=60.0, sigma=1.3, offset=7.0):
    """Patches of Gaussians at `center` (N, 2)."""
    x, y = (np.asarray(center)[:, i, None, None] for i in (0, 1))
    return offset + amplitude * np.exp(-((COLUMNS - x) ** 2 + (ROWS - y) ** 2) / (2 * sigma**2))


@pytest.fixture(scope="module")
def noisy():
    """Centres at uniform phases, and their patches with noise of 2 grey levels, rounded."""
    rng = np.random.default_rng(3)
    center = rng.uniform(-0.5, 0.5, (3000, 2))
    return center, np.round(drawn(center) + rng.normal(0, 2, (3000, 9, 9)))


@pytest.mark.parametrize("radius", [None, 1.3])
def test_fit_is_unbiased_and_its_covariance_is_the_empirical_one(noisy, radius):
    center, patches = noisy
    fit = fit_gaussians(patches, np.ones(patches.shape, bool), radius=radius)
    errors = fit.center - center
    assert fit.converged.all()
    assert np.sqrt((errors**2).mean()) < 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    np.testing.assert_allclose(np.cov(errors.T), fit.covariance.mean(axis=0), rtol=0.1, atol=5e-5)
    distance = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(fit.covariance), errors)
    assert distance.mean() == pytest.approx(2, rel=0.1)


def test_template_is_unbiased_over_phases(noisy):
    center, patches = noisy
    errors = np.array([correlate_template(patch, 1.5) for patch in patches[:1000]]) - center[:1000]
    assert np.sqrt((errors**2).mean()) < 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.02


@pytest.mark.parametrize("scale", [4, 5])
def test_template_remembers_half_a_pixel(scale):
    """At even scales no fine pixel lies on the coarse one, so the nearest two are equally right."""
    for shift in (-0.3, 0.0, 0.3):
        place = correlate_template(drawn([(shift, -shift)])[0], 1.5, scale)
        np.testing.assert_allclose(place, [shift, -shift], atol=0.5 / scale + 0.02)


def test_fit_finds_scipys_optimum(noisy):
    _, patches = noisy
    fit = fit_gaussians(patches[:5], np.ones((5, 9, 9), bool))

    def residuals(state, patch):
        x, y, amplitude, offset, l11, l21, l22 = state
        u, v = l11 * (COLUMNS - x) + l21 * (ROWS - y), l22 * (ROWS - y)
        return (amplitude * np.exp(-(u**2 + v**2) / 2) + offset - patch).ravel()

    for i in range(5):
        best = least_squares(residuals, [0, 0, 50, 5, 0.7, 0, 0.7], args=(patches[i],), xtol=1e-12, ftol=1e-12)
        np.testing.assert_allclose(fit.center[i], best.x[:2], atol=1e-5)
        variance = 2 * best.cost / (81 - 7)
        covariance = np.linalg.inv(best.jac.T @ best.jac)[:2, :2] * variance
        np.testing.assert_allclose(fit.covariance[i], covariance, rtol=1e-3, atol=1e-7)
        assert fit.amplitude[i] == pytest.approx(best.x[2], rel=1e-4)


def test_fit_gives_the_axes_of_an_ellipse():
    angle, axes = 0.4, (2.0, 1.0)
    along = COLUMNS * np.cos(angle) + ROWS * np.sin(angle)
    across = -COLUMNS * np.sin(angle) + ROWS * np.cos(angle)
    patch = 90 * np.exp(-0.5 * ((along / axes[0]) ** 2 + (across / axes[1]) ** 2))
    fit = fit_gaussians(patch[None], np.ones((1, 9, 9), bool))
    np.testing.assert_allclose(fit.radii[0], axes, rtol=1e-4)


def test_saturated_core_is_left_out_and_does_no_harm():
    """A cut-off light: masking what is cut recovers place and height, believing it does not recover the height."""
    center = np.random.default_rng(5).uniform(-0.5, 0.5, (50, 2))
    true = drawn(center, amplitude=400.0, sigma=1.6)
    seen = np.minimum(true, 255.0)
    masked = fit_gaussians(seen, seen < 250)
    believed = fit_gaussians(seen, np.ones(seen.shape, bool))
    np.testing.assert_allclose(masked.center, center, atol=1e-3)
    np.testing.assert_allclose(masked.amplitude, 400.0, rtol=1e-2)
    assert (believed.amplitude < 350).all()


def test_hopeless_patches_do_not_converge_and_do_not_warn():
    patches = np.stack([np.zeros((9, 9)), np.tile(np.arange(9.0), (9, 1)), np.full((9, 9), 255.0)])
    usable = np.ones(patches.shape, bool)
    usable[2] = False
    fit = fit_gaussians(patches, usable)
    trusted = fit.converged & (fit.significance > 8) & (fit.radii[:, 0] < 3)
    assert not trusted.any()
