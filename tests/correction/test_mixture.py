"""The score of a contaminated innovation: against quadrature, finite differences and the mixture itself."""

import numpy as np
import pytest
import scipy.stats
from scipy.integrate import quad
from support import spd

from robust_filterpy import Huber, RobustKalmanFilter
from robust_filterpy.correction import SingularInnovationError
from robust_filterpy.correction.merging import Hypothesis, merge
from robust_filterpy.correction.mixture import ContaminatedScore
from robust_filterpy.influence import Influence

pytestmark = pytest.mark.core
NOISE = ContaminatedScore(0.1, 10.0)


def mixture_pdf(y, S, R, noise):
    """p(y) written with scipy's multivariate normal."""
    wide = S + (noise.scale_ratio**2 - 1) * R
    normal = scipy.stats.multivariate_normal
    return (1 - noise.contamination) * normal.pdf(y, cov=S) + noise.contamination * normal.pdf(y, cov=wide)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_score_is_the_gradient_of_minus_log_density(dim):
    rng = np.random.default_rng(dim)
    R = spd(rng, dim)
    S = R + spd(rng, dim)
    law = NOISE.for_innovation(S, R)
    for y in rng.normal(size=(20, dim)) * 4:
        assert law.log_density(y) == pytest.approx(np.log(mixture_pdf(y, S, R, NOISE)), rel=1e-10)
        h = 1e-5
        steps = h * np.eye(dim)
        gradient = [(law.log_density(y - d) - law.log_density(y + d)) / (2 * h) for d in steps]
        np.testing.assert_allclose(law.score(y), gradient, rtol=1e-5, atol=1e-7)
        jacobian = np.column_stack([(law.score(y + d) - law.score(y - d)) / (2 * h) for d in steps])
        np.testing.assert_allclose(law.information(y), jacobian, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("y", [0.0, 0.7, 2.0, 4.0, 9.0])
def test_masreliez_moments_are_those_of_the_posterior(y):
    """Mean and variance of x given z = x + v by quadrature of the exact posterior."""
    P, R = 0.7, 0.5

    def posterior(x, power):
        likelihood = mixture_pdf(np.array([y - x]), np.eye(1) * R, np.eye(1) * R, NOISE)
        return x**power * scipy.stats.norm.pdf(x, scale=P**0.5) * likelihood

    mass, first, second = (quad(posterior, -12, 12, args=(k,), points=[0, y], limit=300)[0] for k in range(3))
    law = NOISE.for_innovation([[P + R]], [[R]])
    assert P * law.score(y)[0] == pytest.approx(first / mass, rel=1e-6, abs=1e-9)
    assert P - P * law.information(y)[0, 0] * P == pytest.approx(second / mass - (first / mass) ** 2, rel=1e-6)
    merged = merge(
        np.zeros(1), np.array([y]), np.eye(1),
        [Hypothesis(0.9, np.eye(1) * P, np.eye(1) * R), Hypothesis(0.1, np.eye(1) * P, np.eye(1) * 100 * R)],
    )  # fmt: skip
    assert merged.x[0] == pytest.approx(first / mass, rel=1e-6, abs=1e-9)
    assert merged.P[0, 0] == pytest.approx(second / mass - (first / mass) ** 2, rel=1e-6)
    assert merged.log_density == pytest.approx(np.log(mass), rel=1e-6)


@pytest.mark.parametrize("grouping", ["joint", "component"])
def test_merging_hypotheses_is_the_score(grouping):
    rng = np.random.default_rng(7)
    n, m = 4, 2
    P, R, H = spd(rng, n), spd(rng, m), rng.normal(size=(m, n))
    S, C = H @ P @ H.T + R, P @ H.T
    law = NOISE.for_innovation(S, R, grouping)
    hypotheses = [Hypothesis(probability, P, np.outer(s, s) * R) for probability, s in NOISE.patterns(m, grouping)]
    assert len(hypotheses) == (2 if grouping == "joint" else 4)
    assert sum(h.probability for h in hypotheses) == pytest.approx(1.0)
    for y in rng.normal(size=(10, m)) * 5:
        merged = merge(np.ones(n), y, H, hypotheses)
        np.testing.assert_allclose(merged.x, 1 + C @ law.score(y), rtol=1e-10)
        np.testing.assert_allclose(merged.P, P - C @ law.information(y) @ C.T, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(merged.probabilities, law.posterior(y), rtol=1e-8, atol=1e-300)
        np.testing.assert_allclose(merged.score, law.score(y), rtol=1e-9)
        np.testing.assert_allclose(merged.information, law.information(y), rtol=1e-8, atol=1e-12)


def test_sensors_that_fail_each_on_its_own_are_independent():
    S, R = np.diag([2.0, 3.0]), np.diag([1.0, 0.5])
    law = NOISE.for_innovation(S, R, "component")
    alone = [NOISE.for_innovation(S[i : i + 1, i : i + 1], R[i : i + 1, i : i + 1]) for i in range(2)]
    for y in ([0.3, -1.0], [8.0, 0.0], [5.0, -20.0]):
        assert law.log_density(y) == pytest.approx(sum(one.log_density(v) for one, v in zip(alone, y, strict=True)))


def test_for_one_sensor_it_is_an_influence_function():
    law = NOISE.for_innovation([[1.6]], [[0.9]])
    assert isinstance(law, Influence)
    e = np.linspace(-9, 9, 181)
    h = 1e-6
    np.testing.assert_allclose((law.rho(e + h) - law.rho(e - h)) / (2 * h), law.psi(e), atol=1e-7)
    np.testing.assert_allclose((law.psi(e + h) - law.psi(e - h)) / (2 * h), law.psi_deriv(e), atol=1e-7)
    np.testing.assert_allclose(law.weights(e) * e, law.psi(e), atol=1e-12)
    assert law.rho(np.zeros(1)) == 0.0 and law.weights(np.zeros(1))[0] <= 1.0


def test_without_outliers_it_is_the_identity():
    for noise in (ContaminatedScore(0.0, 10.0), ContaminatedScore(0.3, 1.0)):
        law = noise.for_innovation([[2.0]], [[1.0]])
        np.testing.assert_allclose(law.psi([-3.0, 0.5, 100.0]), [-3.0, 0.5, 100.0])
        assert noise.is_ordinary and noise.variance_ratio == 1.0


def test_moments_of_the_patterns():
    assert NOISE.variance_ratio == pytest.approx(10.9)
    law = NOISE.for_innovation([[1.0]], [[1.0]])
    assert law.probabilities @ law.covariances[:, 0, 0] == pytest.approx(10.9)


@pytest.mark.parametrize("size", [1e3, 1e10, 1e155, 1e300, 1.7e308])
def test_influence_is_bounded(size):
    hypotheses = [Hypothesis(0.9, np.eye(2), np.eye(2)), Hypothesis(0.1, np.eye(2), 100 * np.eye(2))]
    merged = merge(np.zeros(2), size * np.array([1.0, -0.3]), np.diag([1.0, 2.0]), hypotheses)
    assert np.linalg.norm(merged.x) < 3.0 and np.isfinite(merged.P).all() and np.isfinite(merged.log_density)
    assert np.linalg.eigvalsh(merged.P)[0] > 0
    np.testing.assert_allclose(merged.probabilities, [0, 1], atol=1e-12)


def test_covariance_of_the_mixture_is_positive_definite_however_small_the_noise():
    hypotheses = [Hypothesis(0.5, np.eye(3), np.eye(3) * r) for r in (1e-12, 1e-6)]
    merged = merge(np.zeros(3), np.array([1.0, 0, 0]), np.eye(3), hypotheses)
    assert np.linalg.eigvalsh(merged.P)[0] > 0


def test_singular_innovation_is_named_and_pinv_ignores_it():
    H = np.array([[1.0, 0], [1.0, 0]])
    hypotheses = [Hypothesis(1.0, np.eye(2), np.full((2, 2), 1e-300))]
    with pytest.raises(SingularInnovationError, match="S = H P H'"):
        merge(np.zeros(2), np.ones(2), H, hypotheses)
    merged = merge(np.zeros(2), np.ones(2), H, hypotheses, np.linalg.pinv)
    np.testing.assert_allclose(merged.x, [1.0, 0.0], atol=1e-12)
    assert np.isfinite(merged.log_density)


@pytest.mark.parametrize(
    "arguments", [(-0.1, 10.0), (1.0, 10.0), (0.1, 0.5), (0.1, np.inf), (0.1, np.nan), (np.nan, 10.0)], ids=str
)
def test_bad_noise_is_refused(arguments):
    with pytest.raises(ValueError, match="expected"):
        ContaminatedScore(*arguments)


def test_what_it_cannot_be_used_for_is_refused():
    with pytest.raises(TypeError, match="influence"):
        RobustKalmanFilter(1, 1, influence=NOISE)
    with pytest.raises(ValueError, match="one sensor"):
        NOISE.for_innovation(np.eye(2) * 2, np.eye(2)).psi([1.0])
    with pytest.raises(ValueError, match="S, R"):
        NOISE.for_innovation(np.eye(2), np.eye(3))
    assert isinstance(Huber(), Influence)
