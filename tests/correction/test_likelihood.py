"""The robust likelihood is a density, and it still tells models apart after an outlier."""

from itertools import pairwise

import numpy as np
import pytest
import scipy.stats
import support
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.integrate import quad
from statsmodels.robust import norms

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.noise import LeastFavorable

pytestmark = pytest.mark.core

PROPER = [Huber(), Huber(0.5), Linear(), StudentT(4.0)]
SCALINGS = ["innovation", "bounded"]


def predicted(problem, **choices):
    kf = support.make(RobustKalmanFilter, problem, **choices)
    kf.predict()
    return kf


def log_likelihood(kf, z):
    """The log-likelihood of z given the filter's prediction, which is left as it was."""
    x, P = kf.x.copy(), kf.P.copy()
    kf.update(z)
    kf.x, kf.P = x, P
    return kf.log_likelihood


@pytest.mark.parametrize("influence", PROPER, ids=repr)
def test_likelihood_of_a_scalar_integrates_to_one(influence):
    kf = predicted(support.with_(support.cart(), R=np.array([[3.0]])), influence=influence)
    edges = [-np.inf, -30, -10, -3, 0, 3, 10, 30, np.inf]
    with np.errstate(over="ignore"):
        total = sum(
            quad(lambda z: np.exp(log_likelihood(kf, z)), a, b, limit=60, epsabs=1e-7)[0] for a, b in pairwise(edges)
        )
    assert total == pytest.approx(1.0, abs=1e-5)


def test_likelihood_of_a_vector_integrates_to_one():
    kf = predicted(support.with_(support.random_problem(3, 2, 2), P=0.1 * np.eye(2)), influence=Huber(2.0))
    kf.update([0.0, 0.0])
    root = np.linalg.inv(support.whitening(kf.S))
    kf.x = np.zeros((2, 1))

    # Midpoints: the density is even, has no corner, and what lies beyond 9 is 1e-6 of it.
    axis, step = np.linspace(-9.0, 9.0, 61)[1:] - 0.15, 0.3
    total = sum(np.exp(kf.log_likelihood_of(root @ np.array([[a], [b]]))) for a in axis for b in axis) * step**2
    assert total * np.linalg.det(root) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("z", [[0.1, 0.3], [0.1, 50.0], [-1e5, 1e8]])
def test_log_likelihood_is_that_of_the_least_favourable_density(scaling, information, z):
    problem = support.random_problem(4, 3, 2)
    kf = predicted(problem, scaling=scaling, information=information)
    options = {"scaling": scaling, "information": information}
    found = support.reference_correction(kf.x, kf.P, z, kf.H, kf.R, support.HuberFormulas(1.345), **options)
    kf.update(z)
    expected = LeastFavorable(Huber().contamination).logpdf(found.whitened).sum() + found.log_det
    assert kf.log_likelihood == pytest.approx(expected, rel=1e-9)


def test_log_likelihood_does_not_depend_on_the_scaling():
    problem = support.paper_problem()
    values = [log_likelihood(predicted(problem, scaling=s), 7.0) for s in ("innovation", "bounded", "unit")]
    np.testing.assert_allclose(values, values[0], rtol=1e-10)


def test_log_likelihood_of_student():
    kf = predicted(support.random_problem(4, 3, 2), influence=StudentT(4.0))
    kf.update([0.1, np.nan])
    density = scipy.stats.t(4.0, scale=np.sqrt(5 / 4 * kf.S[0, 0]))
    assert kf.log_likelihood == pytest.approx(density.logpdf(kf.y[0, 0]), rel=1e-9)


@pytest.mark.parametrize("influence", [Hampel(), TukeyBiweight(), norms.AndrewWave()], ids=lambda i: type(i).__name__)
def test_log_likelihood_of_a_psi_without_density(influence):
    kf = predicted(support.cart(), influence=influence)
    for z in (0.5, 3.0, 1e4):
        value = log_likelihood(kf, z)
        T = kf.S.item() ** -0.5
        rho = np.asarray(influence.rho(np.array([T * kf.y.item()]))).item()
        assert value == pytest.approx(-rho - np.log(np.sqrt(2 * np.pi)) + np.log(T), rel=1e-9)


def test_log_likelihood_is_linear_in_a_large_residual():
    kf = predicted(support.cart())
    one, two, three = (log_likelihood(kf, kf.x[0, 0] + size) for size in (1e6, 2e6, 3e6))
    assert three - two == pytest.approx(two - one, rel=1e-9)
    assert (two - one) / 1e6 == pytest.approx(-1.345 / np.sqrt(kf.S.item()), rel=1e-9)


def test_log_likelihood_of_a_measurement():
    """The same as that of an update, with the S of the last one."""
    kf = predicted(support.random_problem(4, 3, 2))
    kf.update([0.1, 0.2])
    z = np.array([[0.4], [90.0]])
    nothing = np.zeros((0, 0))
    found = support.reference_correction(
        nothing.ravel(), nothing, z - kf.H @ kf.x, np.zeros((2, 0)), kf.S, support.HuberFormulas(1.345)
    )
    expected = LeastFavorable(Huber().contamination).logpdf(found.whitened).sum() + found.log_det
    assert kf.log_likelihood_of(z) == pytest.approx(expected, rel=1e-9)


def test_likelihood_is_the_exponential_and_never_zero():
    kf = predicted(support.cart())
    kf.update(1.0)
    assert kf.likelihood == pytest.approx(np.exp(kf.log_likelihood))
    kf.update(1e12)
    assert kf.likelihood > 0
    assert np.isfinite(kf.log_likelihood)


def two_models(cls, **choices):
    """A bank of two levels that drift to either side; the first is the true one."""
    filters = []
    for drift in (1.0, -1.0):
        kf = cls(1, 1, 1, **choices)
        kf.x, kf.P, kf.F, kf.H = np.zeros((1, 1)), np.eye(1), np.eye(1), np.eye(1)
        kf.Q, kf.R, kf.B = 0.01 * np.eye(1), np.eye(1), np.array([[drift]])
        filters.append(kf)
    return IMMEstimator(filters, (0.5, 0.5), np.array([[0.95, 0.05], [0.05, 0.95]]))


def run(bank, outlier):
    """Five good samples, the outlier, five good samples; yield the bank after each."""
    rng = np.random.default_rng(8)
    for k in range(1, 12):
        bank.predict(np.ones((1, 1)))
        bank.update(np.array([[k + rng.normal() + (outlier if k == 6 else 0.0)]]))
        yield k


@pytest.mark.parametrize("outlier", [300.0, 1e6])
def test_an_imm_still_discriminates_after_an_outlier(outlier):
    robust, plain = two_models(RobustKalmanFilter), two_models(KalmanFilter)
    for k in run(robust, outlier):
        assert np.all(np.isfinite(robust.mu)) and np.all(np.isfinite(robust.x))
        if k in (4, 5, 9, 10, 11):
            assert robust.mu[0] > 0.5, f"sample {k}"
    assert robust.mu[0] > 0.9
    assert abs(robust.x.item() - 11) < 3

    # What it is measured against: the same bank of filterpy's filters.
    smallest = []
    for _ in run(plain, outlier):
        smallest.append(max(kf.likelihood for kf in plain.filters) <= np.finfo(float).tiny)
    assert any(smallest[5:]), "filterpy's likelihood did not underflow, so nothing was shown"


def test_likelihoods_can_be_compared_at_the_outlier_where_filterpys_underflow():
    robust, plain = two_models(RobustKalmanFilter), two_models(KalmanFilter)
    for bank in (robust, plain):
        for k in run(bank, 100.0):
            if k == 6:
                break
    np.testing.assert_array_equal(plain.likelihood, np.finfo(float).tiny)
    logarithms = [kf.log_likelihood for kf in robust.filters]
    assert abs(logarithms[0] - logarithms[1]) > 1
    np.testing.assert_allclose(np.log(robust.likelihood), logarithms, rtol=1e-12)
