"""The robust likelihood is a density, and it still tells models apart after an outlier."""

import numpy as np
import pytest
import scipy.stats
import support
from filterpy.kalman import IMMEstimator
from statsmodels.robust import norms
from support import of_matrices

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core

SCALINGS = ["innovation", "bounded"]


def predicted(problem, **choices):
    kf = support.make(RobustKalmanFilter, problem, **choices)
    kf.predict()
    return kf


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("z", [[0.1, 0.3], [0.1, 50.0], [-1e5, 1e8]])
def test_log_likelihood_is_that_of_the_least_favourable_density(scaling, information, z):
    problem = support.random_problem(4, 3, 2)
    kf = predicted(problem, scaling=scaling, information=information)
    options = {"scaling": scaling, "information": information}
    found = support.reference_correction(kf.x, kf.P, z, kf.H, kf.R, Huber(), **options)
    kf.update(z)
    expected = support.least_favorable(found.whitened, Huber()).sum() + found.log_det
    assert kf.log_likelihood == pytest.approx(expected, rel=1e-9)


def test_log_likelihood_does_not_depend_on_the_scaling_and_its_exponential_is_never_zero():
    for z in (7.0, 1e12):
        values = []
        for scaling in ("innovation", "bounded", "unit"):
            kf = predicted(support.paper_problem(), scaling=scaling)
            kf.update(z)
            values.append(kf.log_likelihood)
            assert kf.likelihood == pytest.approx(np.exp(kf.log_likelihood)) if z < 1e9 else kf.likelihood > 0.0
        np.testing.assert_allclose(values, values[0], rtol=1e-10)


def test_log_likelihood_of_student():
    kf = predicted(support.random_problem(4, 3, 2), influence=StudentT(4.0))
    kf.update([0.1, np.nan])
    density = scipy.stats.t(4.0, scale=np.sqrt(5 / 4 * kf.S[0, 0]))
    assert kf.log_likelihood == pytest.approx(density.logpdf(kf.y[0, 0]), rel=1e-9)


@pytest.mark.parametrize("influence", [Hampel(), TukeyBiweight(), norms.AndrewWave()], ids=lambda i: type(i).__name__)
def test_log_likelihood_of_a_psi_without_density(influence):
    for z in (0.5, 3.0, 1e4):
        kf = predicted(support.cart(), influence=influence)
        kf.update(z)
        T = kf.S.item() ** -0.5
        rho = np.asarray(influence.rho(np.array([T * kf.y.item()]))).item()
        assert kf.log_likelihood == pytest.approx(-rho - np.log(np.sqrt(2 * np.pi)) + np.log(T), rel=1e-9)


def test_log_likelihood_of_a_measurement():
    """The same as that of an update, with the S of the last one."""
    kf = predicted(support.random_problem(4, 3, 2))
    kf.update([0.1, 0.2])
    z = np.array([[0.4], [90.0]])
    nothing = np.zeros((0, 0))
    found = support.reference_correction(
        nothing.ravel(), nothing, z - kf.H @ kf.x, np.zeros((2, 0)), kf.S, Huber()
    )
    expected = support.least_favorable(found.whitened, Huber()).sum() + found.log_det
    assert kf.log_likelihood_of(z) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("outlier", [300.0, 1e6])
def test_an_imm_still_discriminates_after_an_outlier(outlier):
    """A bank of two levels that drift to either side, the first is the true one; one of eleven samples is wild."""
    filters = [of_matrices(RobustKalmanFilter, 1.0, [[1.0]], 0.01, dim_u=1) for _ in range(2)]
    for kf, drift in zip(filters, (1.0, -1.0), strict=True):
        kf.B = np.array([[drift]])
    bank, rng = IMMEstimator(filters, (0.5, 0.5), np.array([[0.95, 0.05], [0.05, 0.95]])), np.random.default_rng(8)
    for k in range(1, 12):
        bank.predict(np.ones((1, 1)))
        bank.update(np.array([[k + rng.normal() + (outlier if k == 6 else 0.0)]]))
        assert np.all(np.isfinite(bank.mu)) and np.all(np.isfinite(bank.x))
        if k in (4, 5, 9, 10, 11):
            assert bank.mu[0] > 0.5, f"sample {k}"
    assert bank.mu[0] > 0.9
    assert abs(bank.x.item() - 11) < 3
