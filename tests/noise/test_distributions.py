"""The contaminated and the least favourable distribution, and Fisher information, by quadrature and sampling."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from robust_filterpy import Contaminated, Huber
from robust_filterpy.noise import LeastFavorable, fisher_information

CONTAMINATED = [Contaminated(0.1), Contaminated(0.3, 8.0, 0.5), Contaminated(0.0, 5.0, 2.0)]
LEAST = [LeastFavorable(0.05), LeastFavorable(0.1, 3.0), LeastFavorable(0.4, 0.2)]
ALL = CONTAMINATED + LEAST
GRID = np.linspace(-9.0, 9.0, 61)


def name(noise):
    """Name the distribution and its parameters for pytest."""
    return f"{type(noise).__name__}-{noise.contamination}-{noise.scale}"


def integrate(function, noise, a=-np.inf, b=np.inf):
    """Integrate in pieces that the density cannot hide between."""
    edges = noise.scale * np.array([-20.0, -5.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 5.0, 20.0])
    return sum(quad(function, *ends, limit=200)[0] for ends in pairwise([a, *edges[(a < edges) & (edges < b)], b]))


@pytest.mark.parametrize("noise", ALL, ids=name)
def test_moments_and_the_distribution_function_are_integrals_of_the_density(noise):
    assert isinstance(noise, (Contaminated, scipy.stats.rv_continuous))
    assert integrate(noise.pdf, noise) == pytest.approx(1.0, abs=1e-8)
    variance = integrate(lambda e: e**2 * noise.pdf(e), noise)
    assert noise.mean() == pytest.approx(0, abs=1e-9) and noise.var() == pytest.approx(variance, rel=1e-6)
    assert noise.std() == pytest.approx(np.sqrt(variance), rel=1e-6)
    for a, b in ((-3.0, -0.4), (-0.5, 0.5), (0.1, 2.0), (1.0, 8.0)):
        area = integrate(noise.pdf, noise, a, b)
        assert noise.cdf(b) - noise.cdf(a) == pytest.approx(area, abs=1e-9)
        assert noise.sf(a) - noise.sf(b) == pytest.approx(area, abs=1e-9)
    q = np.array([1e-6, 0.01, 0.2, 0.5, 0.77, 0.999])
    np.testing.assert_allclose(noise.cdf(noise.ppf(q)), q, rtol=1e-7)


@pytest.mark.parametrize("noise", CONTAMINATED, ids=name)
def test_contaminated_density_is_the_mixture(noise):
    good, bad = scipy.stats.norm(scale=noise.scale), scipy.stats.norm(scale=noise.outlier_scale)
    c = noise.contamination
    for method in ("pdf", "cdf", "sf"):
        expected = (1 - c) * getattr(good, method)(GRID) + c * getattr(bad, method)(GRID)
        np.testing.assert_allclose(getattr(noise, method)(GRID), expected, rtol=1e-12)
    # Also where the density itself is 0 in floating point.
    far = np.r_[GRID, 60.0, 1e4]
    with np.errstate(divide="ignore"):
        expected = np.logaddexp(np.log1p(-c) + good.logpdf(far), np.log(c) + bad.logpdf(far))
    np.testing.assert_allclose(noise.logpdf(far), expected, rtol=1e-9)


@pytest.mark.parametrize("noise", LEAST, ids=name)
def test_least_favourable_density_is_exp_of_minus_hubers_rho_and_a_contaminated_normal(noise):
    k, e = Huber.from_contamination(noise.contamination).threshold, GRID / noise.scale
    rho = np.where(np.abs(e) <= k, e**2 / 2, k * np.abs(e) - k**2 / 2)
    log_density = np.log((1 - noise.contamination) / np.sqrt(2 * np.pi) / noise.scale) - rho
    np.testing.assert_allclose(noise.logpdf(GRID), log_density, rtol=1e-10)
    np.testing.assert_allclose(noise.pdf(GRID), np.exp(log_density), rtol=1e-9)
    # What is not (1 - contamination) of the normal is nowhere negative: f0 belongs to the class (15).
    normal = (1 - noise.contamination) * scipy.stats.norm(scale=noise.scale).pdf(GRID)
    assert np.all(noise.pdf(GRID) - normal >= -1e-15)


@pytest.mark.parametrize("noise", ALL, ids=name)
def test_samples_follow_the_distribution_are_reproducible_and_leave_the_global_state_alone(noise):
    before = pickle.dumps(np.random.get_state())  # noqa: NPY002
    sample = noise.rvs(size=20_000, random_state=np.random.default_rng(7))
    assert scipy.stats.kstest(sample, noise.cdf).pvalue > 1e-6
    twin = pickle.loads(pickle.dumps(noise))
    first, second, other = (n.rvs(size=(3, 2), random_state=np.random.default_rng(k)) for n, k in (
        (noise, 1), (twin, 1), (noise, 2)
    ))  # fmt: skip
    np.testing.assert_array_equal(first, second)
    assert first.shape == (3, 2) and np.any(first != other)
    assert pickle.dumps(np.random.get_state()) == before  # noqa: NPY002


def test_labelled_sample_has_the_two_populations():
    noise, n = Contaminated(0.2, 20.0, 1.5), 50_000
    values, labels = noise.rvs_labelled(size=n, random_state=np.random.default_rng(3))
    again = noise.rvs_labelled(size=(n // 2, 2), random_state=np.random.default_rng(3))
    assert again[0].shape == again[1].shape == (n // 2, 2)
    for one, other in zip(again, noise.rvs_labelled((n // 2, 2), np.random.default_rng(3)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert values.shape == labels.shape == (n,)
    assert labels.dtype == bool
    assert abs(labels.mean() - 0.2) < 5 * np.sqrt(0.2 * 0.8 / n)
    for part, scale in ((values[labels], 30.0), (values[~labels], 1.5)):
        assert abs(part.mean()) < 5 * scale / np.sqrt(len(part))
        assert abs(part.std() / scale - 1) < 5 / np.sqrt(2 * len(part))


INFORMATION = {
    "norm": (scipy.stats.norm(), 1.0), "norm, scale": (scipy.stats.norm(scale=3.0), 1 / 9),
    "norm, shifted": (scipy.stats.norm(loc=5.0, scale=0.01), 1e4), "t3": (scipy.stats.t(3), 4 / 6),
    "t10": (scipy.stats.t(10), 11 / 13), "cauchy": (scipy.stats.cauchy(), 0.5),
    "logistic": (scipy.stats.logistic(), 1 / 3), "laplace": (scipy.stats.laplace(), 1.0),
}  # fmt: skip


@pytest.mark.parametrize("name", INFORMATION)
def test_fisher_information_in_closed_form(name):
    noise, expected = INFORMATION[name]
    assert fisher_information(noise) == pytest.approx(expected, rel=1e-5)


def by_quadrature(noise, edges):
    """Of the density's slope by differences, so that no closed form can vouch for itself."""

    def integrand(e, h=1e-5 * noise.scale):
        slope = (noise.pdf(e + h) - noise.pdf(e - h)) / (2 * h)
        return slope**2 / noise.pdf(e)

    return 2 * sum(quad(integrand, a, b, limit=400)[0] for a, b in pairwise(edges))


@settings(max_examples=15, deadline=None)
@given(contamination=st.floats(0.01, 0.8), scale=st.floats(0.1, 10.0))
def test_fisher_information_of_the_least_favourable_and_of_a_contaminated_density(contamination, scale):
    k, noise = Huber.from_contamination(contamination).threshold, LeastFavorable(contamination, scale)
    closed = (1 - contamination) * (2 * scipy.stats.norm.cdf(k) - 1) / scale**2
    assert by_quadrature(noise, [0, k * scale, (k + 50 / k) * scale]) == pytest.approx(closed, rel=1e-4)
    assert fisher_information(noise) == pytest.approx(closed, rel=1e-5)
    mixture = Contaminated(min(contamination, 0.5), 12.0, scale)
    expected = by_quadrature(mixture, scale * np.array([0.0, 2.0, 4.0, 8.0, 160.0]))
    assert fisher_information(mixture) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("kind", [Contaminated, LeastFavorable])
@pytest.mark.parametrize("arguments", [(1.0,), (-0.1,), (np.nan,), ("a",), (0.1, 0.0), (0.1, -1.0), (0.1, np.nan)])
def test_refuses(kind, arguments):
    with pytest.raises((ValueError, TypeError), match="expected"):
        kind(*arguments)
    for outliers in (0.0, -1.0, np.nan):
        with pytest.raises((ValueError, TypeError), match="expected"):
            Contaminated(0.1, outliers)
