"""The learnt noise: a density, its score, and the mixture that made the residuals."""

import numpy as np
import pytest
from scipy.integrate import quad

from robust_filterpy import Huber
from robust_filterpy.correction.contaminated import START, Contaminated
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.influence.functions import Influence
from robust_filterpy.influence.regression import mad_scale

E = np.linspace(-30.0, 30.0, 601)
MIXTURE = Contaminated(0.1, 7.0)


def density(e, share=0.1, ratio=7.0):
    """Normal, and one that is normal up to 3 standard deviations and exponential beyond."""
    wide = lambda z: np.exp(-np.where(np.abs(z) < 3.0, 0.5 * z**2, 3.0 * np.abs(z) - 4.5))  # noqa: E731
    total = quad(wide, -60, 60, points=[-3, 3])[0]
    return (1 - share) * np.exp(-0.5 * e**2) / np.sqrt(2 * np.pi) + share * wide(e / ratio) / ratio / total


def test_it_is_an_influence_function():
    assert isinstance(MIXTURE, Influence)


def test_rho_and_the_normalizer_are_the_density():
    np.testing.assert_allclose(-MIXTURE.rho(E) - MIXTURE.log_normalizer(1), np.log(density(E)), rtol=1e-7)
    total = quad(lambda e: np.exp(-float(MIXTURE.rho(e))), -400, 400, points=[-21, -3, 3, 21], limit=200)[0]
    assert np.log(total) == pytest.approx(MIXTURE.log_normalizer(1), abs=1e-8)


def test_psi_is_the_derivative_of_rho_and_psi_deriv_that_of_psi():
    h = 1e-5
    np.testing.assert_allclose((MIXTURE.rho(E + h) - MIXTURE.rho(E - h)) / (2 * h), MIXTURE.psi(E), atol=1e-7)
    smooth = E[np.abs(np.abs(E) - 21.0) > 0.05]
    slope = (MIXTURE.psi(smooth + h) - MIXTURE.psi(smooth - h)) / (2 * h)
    np.testing.assert_allclose(slope, MIXTURE.psi_deriv(smooth), atol=1e-7)
    away = E[E != 0.0]
    np.testing.assert_allclose(MIXTURE.weights(away), MIXTURE.psi(away) / away, rtol=1e-12)


@pytest.mark.parametrize("e", [1e10, 1e160, 1e300])
def test_huge_residuals_stay_finite(e):
    for function in (MIXTURE.rho, MIXTURE.psi, MIXTURE.psi_deriv, MIXTURE.weights, MIXTURE.ordinary):
        assert np.isfinite(function([e, -e])).all()


@pytest.mark.parametrize(("share", "ratio"), [(0.05, 10.0), (0.2, 6.0), (0.3, 20.0)])
def test_expectation_maximisation_finds_the_mixture(share, ratio):
    rng = np.random.default_rng(3)
    r = 0.4 * np.where(rng.random(20_000) < share, ratio, 1.0) * rng.normal(size=20_000)
    found = Noise(START, mad_scale(r) ** 2).refitted(r, steps=300)
    # Five standard errors of a share, and of variances with a few hundredths more for what the labels would tell.
    assert found.influence.contamination == pytest.approx(share, abs=5 * np.sqrt(share / r.size) + 0.005)
    assert found.influence.scale_ratio == pytest.approx(ratio, rel=5 * np.sqrt(0.5 / (share * r.size)) + 0.03)
    assert found.R == pytest.approx(0.16, rel=5 * np.sqrt(2.0 / r.size) + 0.02)


def test_each_step_raises_the_likelihood_of_many_residuals():
    rng = np.random.default_rng(4)
    r = np.where(rng.random(5000) < 0.2, 8.0, 1.0) * rng.normal(size=5000)
    noise, likelihoods = Noise(START, 4.0), []
    for _ in range(30):
        noise = noise.refitted(r, steps=1)
        likelihoods.append(noise.log_likelihood(r))
    # The priors are worth a dozen samples.
    assert np.diff(likelihoods).min() > -0.1 and likelihoods[-1] > likelihoods[0] + 100.0


def test_clean_residuals_have_hardly_any_outliers():
    r = np.random.default_rng(5).normal(size=2000)
    found = Noise(START, 1.0).refitted(r, steps=200)
    assert found.influence.contamination < 0.01 and found.R == pytest.approx(1.0, rel=5 * np.sqrt(2 / 2000))


def test_a_known_variance_stays():
    r = np.random.default_rng(6).normal(size=500)
    for influence in (Huber(), START):
        assert Noise(influence, 9.0, given=True).refitted(r).R == 9.0


def test_another_influence_function_gets_the_median_absolute_deviation():
    r = np.random.default_rng(7).normal(size=500)
    assert Noise(Huber(), 1.0).refitted(r).R == (1.482602218505602 * np.median(np.abs(r))) ** 2


@pytest.mark.parametrize("arguments", [(1.0, 8.0), (-0.1, 8.0), (0.1, 0.9), (0.1, np.inf), (0.1, 8.0, 0.0)])
def test_bad_mixtures_are_refused(arguments):
    with pytest.raises(ValueError, match=r"contamination|scale"):
        Contaminated(*arguments)


def test_without_outliers_psi_is_the_kalman_filters():
    np.testing.assert_array_equal(Contaminated(0.0, 8.0).psi(E), E)
    np.testing.assert_array_equal(Contaminated(0.0, 8.0).rho(E), 0.5 * E**2)
    np.testing.assert_array_equal(Contaminated(0.0, 8.0).psi_deriv(E), np.ones(E.shape))


def test_with_outliers_of_two_sizes_the_likelihood_tells_less_noise_from_more():
    rng = np.random.default_rng(11)
    r = np.where(rng.random(2000) < 0.1, 20.0, 1.0) * rng.normal(size=2000)
    gross = np.where(rng.random(2000) < 0.01, 1e6, 0.0) * rng.normal(size=2000)
    fitted = [Noise(START, mad_scale(one) ** 2).settled(one) for one in (r + gross, 10.0 * r + gross)]
    less, more = (noise.log_likelihood(one) for noise, one in zip(fitted, (r + gross, 10.0 * r + gross), strict=True))
    # Nearly log(10) a sample; the largest are the same in both.
    assert less - more == pytest.approx(2000 * np.log(10.0), rel=0.05)


def test_within_its_reach_the_likelihood_is_that_of_the_density():
    e = np.linspace(-20.9, 20.9, 101)
    assert Noise(MIXTURE, 1.0).log_likelihood(e) == pytest.approx(np.log(density(e)).sum(), rel=1e-7)
