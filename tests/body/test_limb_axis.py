"""The axis of a limb out of slices: exact on exact data, its derivatives and its covariance against sampling."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.body.limb_axis import fit_axis, refit_axis
from jaxpoint.compilation import jit

SPAN = np.array([0.19, 0.39])
TIP = np.array([3.0, 2.0, 1.4])
DIRECTION = np.array([0.8, -0.55, 0.25]) / np.linalg.norm([0.8, -0.55, 0.25])
ORIGINS = np.array([[5.5, 0.5, 2.2], [0.5, 0.5, 2.4], [5.2, 4.5, 2.0], [0.7, 4.4, 2.3]])
FOCAL = np.array([700.0, 650.0, 800.0, 720.0])
SIGMA = np.array([0.8, 0.9, 1.0, 0.8])
SLICES = 24


def rays(noise_px=0.0, rng=None) -> np.ndarray:
    """Unit rays to places along the axis, C S 3; the noise is across the line of sight."""
    behind = np.linspace(SPAN[0] + 0.005, SPAN[1] - 0.005, SLICES)
    places = TIP - behind[:, None] * DIRECTION
    found = places[None] - ORIGINS[:, None]
    found /= np.linalg.norm(found, axis=2, keepdims=True)
    if rng is not None:
        side = np.cross(found, DIRECTION)
        side /= np.linalg.norm(side, axis=2, keepdims=True)
        angle = rng.normal(size=found.shape[:2]) * (noise_px * SIGMA / FOCAL)[:, None]
        found = found + angle[..., None] * side
        found /= np.linalg.norm(found, axis=2, keepdims=True)
    return found


@jit
def fitted(origins, focal, slices, seen, tip, direction, sigma):
    return fit_axis(origins, focal, slices, seen, tip, direction, sigma, jnp.asarray(SPAN))


def fit(slices, seen=None, tip=TIP, direction=DIRECTION):
    seen = np.ones(slices.shape[:2], bool) if seen is None else seen
    return fitted(ORIGINS, FOCAL, slices, seen, tip, direction, SIGMA)


def test_exact_slices_give_the_axis_from_a_start_that_is_off():
    start = DIRECTION + np.array([0.05, 0.06, -0.05])
    axis = fit(rays(), tip=TIP + np.array([0.01, -0.01, 0.01]), direction=start / np.linalg.norm(start))
    np.testing.assert_allclose(axis.direction, DIRECTION, atol=1e-6)
    off = np.asarray(axis.near) - TIP
    assert np.linalg.norm(off - (off @ DIRECTION) * DIRECTION) < 1e-6
    assert float(axis.rms) < 1e-3


def test_slices_that_are_not_seen_do_not_matter():
    seen = np.ones((4, SLICES), bool)
    seen[3] = seen[1, ::2] = False
    slices = rays(1.0, np.random.default_rng(1))
    spoilt = np.where(seen[..., None], slices, np.array([0.0, 0.0, 1.0]))
    first, second = fit(slices, seen), fit(spoilt, seen)
    np.testing.assert_allclose(first.direction, second.direction, atol=1e-12)
    assert float(first.slices[3]) == 0


def test_a_bent_wrist_and_a_wrong_view_hardly_bend_the_axis():
    """Slices nearer to the tip than the span, and one view of four on another limb."""
    slices = rays(0.3, np.random.default_rng(2))
    wrong = slices.copy()
    wrong[2] += np.array([0.0, 0.0, 0.03])
    wrong /= np.linalg.norm(wrong, axis=2, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(np.asarray(fit(wrong).direction) @ DIRECTION, -1, 1)))
    assert angle < 1.0


@pytest.mark.parametrize("of", ["origins", "focal", "slices", "sigma"])
def test_derivatives_are_those_of_finite_differences(of):
    slices = rays(1.0, np.random.default_rng(4))
    inputs = {"origins": ORIGINS, "focal": FOCAL, "slices": slices, "sigma": SIGMA}
    seen = np.ones(slices.shape[:2], bool)

    def answer(value):
        given = {**inputs, of: value}
        axis = fitted(given["origins"], given["focal"], given["slices"], seen, TIP, DIRECTION, given["sigma"])
        return jnp.concatenate([axis.direction, axis.near])

    step = np.random.default_rng(5).normal(size=inputs[of].shape)
    small = 1e-8 * np.abs(inputs[of]).max()  # a robust fit bends quickly
    _, derivative = jax.jvp(answer, (jnp.asarray(inputs[of]),), (jnp.asarray(step),))
    wanted = (answer(inputs[of] + small * step) - answer(inputs[of] - small * step)) / (2 * small)
    np.testing.assert_allclose(derivative, wanted, rtol=1e-3, atol=1e-4 * float(np.abs(wanted).max()) + 1e-8)


def test_covariance_is_that_of_many_noisy_limbs():
    rng = np.random.default_rng(6)
    noise = 0.3  # of the scale of the loss, so that the loss is nearly a square
    sets = np.stack([rays(noise, rng) for _ in range(400)])
    seen = np.ones(sets.shape[1:3], bool)
    axes = jax.vmap(lambda one: fitted(ORIGINS, FOCAL, one, seen, TIP, DIRECTION, SIGMA))(sets)
    sampled = np.cov(np.asarray(axes.direction).T)
    # The covariance is stated for noise of one `sigma_px`; a smaller rms does not shrink it.
    stated = noise**2 * np.asarray(axes.direction_covariance).mean(axis=0)
    np.testing.assert_allclose(np.sqrt(np.trace(sampled)), np.sqrt(np.trace(stated)), rtol=0.12)
    near = np.cov(np.asarray(axes.near).T)
    np.testing.assert_allclose(
        np.sqrt(np.trace(near)), noise * np.sqrt(np.trace(np.asarray(axes.near_covariance).mean(axis=0))), rtol=0.12
    )


def test_a_fitted_axis_is_not_searched_for_again_and_has_the_same_derivatives():
    slices = rays(1.0, np.random.default_rng(6))
    seen = np.ones(slices.shape[:2], bool)
    found = fit(slices, seen)
    start = found.near + SPAN[0] * found.direction, found.direction

    def ends(function, origins):
        axis = function(origins, FOCAL, slices, seen, *start, SIGMA, SPAN)
        return jnp.stack([axis.near, axis.far, axis.direction])

    both = jit(lambda origins: jnp.stack([ends(fit_axis, origins), ends(refit_axis, origins)]))
    searched, kept = both(jnp.asarray(ORIGINS))
    np.testing.assert_allclose(kept, searched, atol=1e-6)
    np.testing.assert_allclose(kept[0], found.near, atol=1e-6)
    searched, kept = jit(jax.jacfwd(both))(jnp.asarray(ORIGINS))
    np.testing.assert_allclose(kept, searched, atol=5e-3 * np.abs(searched).max())  # the search ends 3 um away
