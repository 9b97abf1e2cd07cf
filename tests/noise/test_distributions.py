"""The contaminated normal distribution, by quadrature and sampling."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
import scipy.stats
from scipy.integrate import quad

from robust_filterpy import Contaminated

CONTAMINATED = [Contaminated(0.1), Contaminated(0.3, 8.0, 0.5), Contaminated(0.0, 5.0, 2.0)]
GRID = np.linspace(-9.0, 9.0, 61)


def name(noise):
    """Name the distribution and its parameters for pytest."""
    return f"{type(noise).__name__}-{noise.contamination}-{noise.scale}"


def integrate(function, noise, a=-np.inf, b=np.inf):
    """Integrate in pieces that the density cannot hide between."""
    edges = noise.scale * np.array([-20.0, -5.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 5.0, 20.0])
    return sum(quad(function, *ends, limit=200)[0] for ends in pairwise([a, *edges[(a < edges) & (edges < b)], b]))


@pytest.mark.parametrize("noise", CONTAMINATED, ids=name)
def test_moments_and_the_distribution_function_are_integrals_of_the_density(noise):
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


@pytest.mark.parametrize("noise", CONTAMINATED, ids=name)
def test_samples_follow_the_distribution_are_reproducible_and_leave_the_global_state_alone(noise):
    before = pickle.dumps(np.random.get_state())  # noqa: NPY002
    sample = noise.rvs(size=20_000, random_state=np.random.default_rng(7))
    assert scipy.stats.kstest(sample, noise.cdf).pvalue > 1e-6
    twin = pickle.loads(pickle.dumps(noise))
    assert twin == noise == eval(repr(noise))
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


@pytest.mark.parametrize("arguments", [(1.0,), (-0.1,), (np.nan,), ("a",), (0.1, 0.0), (0.1, -1.0), (0.1, np.nan)])
def test_refuses(arguments):
    with pytest.raises((ValueError, TypeError), match="expected"):
        Contaminated(*arguments)
    for outliers in (0.0, -1.0, np.nan):
        with pytest.raises((ValueError, TypeError), match="expected"):
            Contaminated(0.1, outliers)
