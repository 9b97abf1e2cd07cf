"""One test for each numbered equation of section 3.1 of the paper (26-52), on its own problem (31-34).

The right-hand sides are written out here as the paper prints them (with the corrections of the package's
documentation), with a scalar measurement and plain floats; phi, Phi and psi come from scipy and numpy.
"""

import numpy as np
import pytest
import scipy.stats
import support
from scipy.integrate import quad

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter
from robust_filterpy.influence import Linear
from robust_filterpy.influence.information import expected_information
from robust_filterpy.noise import LeastFavorable, fisher_information

pytestmark = pytest.mark.core

CONTAMINATION = 0.1
HUBER = Huber.from_contamination(CONTAMINATION)
K_EPS = HUBER.threshold
SIGMA2 = 0.1
PROBLEM = support.paper_problem()
F, H, W = PROBLEM.F, PROBLEM.H, PROBLEM.Q
MEASUREMENTS = [0.05, -0.2, 0.4, 6.0, -25.0, 0.1]

SCALINGS = ["innovation", "unit"]
INFORMATION = ["realized", "expected"]


def psi(v):
    return np.clip(v, -K_EPS, K_EPS)


def psi_deriv(v):
    return float(abs(v) <= K_EPS)


def expectation():
    return (1 - CONTAMINATION) * (2 * scipy.stats.norm.cdf(K_EPS) - 1)


def steps(scaling, information):
    """Yield (filter after the step, state and covariance before, predicted covariance, z) along one recording."""
    kf = support.make(RobustKalmanFilter, PROBLEM, influence=HUBER, scaling=scaling, information=information)
    for z in MEASUREMENTS:
        x, P = kf.x.copy(), kf.P.copy()
        kf.predict()
        P_predicted = kf.P.copy()
        kf.update(z)
        yield kf, x, P, P_predicted, z


def transformation(scaling, P):
    """T(k), a scalar."""
    return 1.0 if scaling == "unit" else float((H @ P @ H.T).item() + SIGMA2) ** -0.5


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("information", INFORMATION)
def test_equation_26(scaling, information):
    """x(k|k) = F x(k-1|k-1) + P(k|k-1) H' T psi[v]."""
    for kf, x, _, Pp, z in steps(scaling, information):
        T = transformation(scaling, Pp)
        v = T * (z - (H @ F @ x).item())
        support.assert_close(kf.x, F @ x + Pp @ H.T * T * psi(v), what="x")


@pytest.mark.parametrize("scaling", SCALINGS)
def test_equation_27(scaling):
    """P(k|k-1) = F P(k-1|k-1) F' + W."""
    for kf, _, P, Pp, _ in steps(scaling, "expected"):
        support.assert_close(Pp, F @ P @ F.T + W, what="P")
        support.assert_close(kf.P_prior, F @ P @ F.T + W, what="P_prior")


@pytest.mark.parametrize("scaling", SCALINGS)
def test_equation_28(scaling):
    """P(k|k) = P(k|k-1) - P H' T^2 H P E{psi'(v)}."""
    for kf, _, _, Pp, _ in steps(scaling, "expected"):
        T = transformation(scaling, Pp)
        support.assert_close(kf.P, Pp - Pp @ H.T * T**2 @ H @ Pp * expectation(), what="P")


@pytest.mark.parametrize("scaling", SCALINGS)
def test_equation_29(scaling):
    """v(k) = T(k) [y(k) - H F x(k-1|k-1)]."""
    for kf, x, _, Pp, z in steps(scaling, "realized"):
        v = transformation(scaling, Pp) * (z - (H @ F @ x).item())
        support.assert_close(kf.e.item(), v, what="e")


def test_equation_30():
    """I(p) = integral of p'^2 / p; for the least favourable density it is E{psi'} of (40)."""
    density = scipy.stats.t(5)

    def integrand(v):
        slope = -density.pdf(v) * 6 * v / (5 + v**2)
        return slope**2 / density.pdf(v)

    assert fisher_information(density) == pytest.approx(2 * quad(integrand, 0, np.inf)[0], rel=1e-6)
    assert fisher_information(LeastFavorable(CONTAMINATION)) == pytest.approx(expectation(), rel=1e-6)


def test_equation_31():
    """x(k+1) = F x(k): the prediction."""
    kf = support.make(RobustKalmanFilter, PROBLEM)
    kf.x = np.array([[1.0], [2.0], [3.0], [4.0]])
    kf.predict()
    by_hand = [
        0.99 - 0.012 * 2 + 0.001 * 3 - 0.001 * 4,
        -0.005 + 0.98 * 2 - 0.001 * 3 + 0.005 * 4,
        -0.001 + 0.01 * 2 + 3 - 0.001 * 4,
        0.01 + 0.001 * 2 - 0.002 * 3 + 4,
    ]
    support.assert_close(kf.x[:, 0], by_hand)


def test_equation_32():
    """y(k) = [1 0 0 0] x(k)."""
    kf = support.make(RobustKalmanFilter, PROBLEM)
    assert kf.measurement_of_state(np.array([[1.0], [2.0], [3.0], [4.0]])).item() == 1.0
    kf.x = np.array([[1.0], [2.0], [3.0], [4.0]])
    kf.update(3.5)
    assert kf.y.item() == pytest.approx(2.5)


def test_equation_33():
    """W = 0.001 I is what a prediction adds to the covariance."""
    kf = support.make(RobustKalmanFilter, PROBLEM)
    P = kf.P.copy()
    kf.predict()
    np.testing.assert_allclose(kf.P - F @ P @ F.T, 0.001 * np.eye(4), atol=1e-16)


def test_equation_34():
    """The noise 0.9 N(0, 0.1) + 0.1 N(0, 10), the second arguments being variances."""
    noise = Contaminated(0.1, 10.0, np.sqrt(0.1))
    v = np.linspace(-12, 12, 49)
    by_hand = 0.9 * np.exp(-(v**2) / 0.2) / np.sqrt(2 * np.pi * 0.1) + 0.1 * np.exp(-(v**2) / 20) / np.sqrt(20 * np.pi)
    np.testing.assert_allclose(noise.pdf(v), by_hand, rtol=1e-12)
    assert noise.var() == pytest.approx(0.9 * 0.1 + 0.1 * 10)


def test_equation_35():
    """T^2 [H P H' + sigma_N^2] = 1."""
    for kf, _, _, Pp, _ in steps("innovation", "realized"):
        assert kf.T.item() ** 2 * ((H @ Pp @ H.T).item() + SIGMA2) == pytest.approx(1.0, rel=1e-12)


def test_equation_36():
    """T = [H P H' + sigma_N^2]^(-1/2), the positive root."""
    for kf, _, _, Pp, _ in steps("innovation", "realized"):
        assert kf.T.item() == pytest.approx(((H @ Pp @ H.T).item() + SIGMA2) ** -0.5, rel=1e-12)


@pytest.mark.parametrize("information", INFORMATION)
def test_equation_37(information):
    """x(k|k) = F x + P H' S^(-1/2) psi(y / S^(1/2))."""
    for kf, x, _, Pp, z in steps("innovation", information):
        S = (H @ Pp @ H.T).item() + SIGMA2
        support.assert_close(kf.x, F @ x + Pp @ H.T / np.sqrt(S) * psi((z - (H @ F @ x).item()) / np.sqrt(S)))


def test_equation_38():
    """P(k|k-1) = F P F' + W, beside (37)."""
    for kf, _, P, _, _ in steps("innovation", "expected"):
        support.assert_close(kf.P_prior, F @ P @ F.T + W)


def test_equation_39():
    """P(k|k) = P - P H' H P / S E{psi'}."""
    for kf, _, _, Pp, _ in steps("innovation", "expected"):
        S = (H @ Pp @ H.T).item() + SIGMA2
        support.assert_close(kf.P, Pp - Pp @ H.T @ H @ Pp / S * expectation())


@pytest.mark.parametrize("threshold", [1.0, 1.14, 1.345, 2.0, 3.0])
def test_equation_40(threshold):
    """E{psi'} = (1 - contamination) [Phi(k) - Phi(-k)]."""
    huber, normal = Huber(threshold), scipy.stats.norm
    expected = (1 - huber.contamination) * (normal.cdf(threshold) - normal.cdf(-threshold))
    assert expected_information(huber) == pytest.approx(expected, rel=1e-9)
    assert expected_information(huber) == pytest.approx(
        quad(lambda v: LeastFavorable(huber.contamination).pdf(v), -threshold, threshold)[0], rel=1e-7
    )


def test_equation_41():
    """Phi is the distribution function, from -infinity; as printed, from 0, (40) would be negative here."""
    Phi = quad(lambda v: np.exp(-(v**2) / 2) / np.sqrt(2 * np.pi), -np.inf, K_EPS)[0]
    assert expected_information(HUBER) == pytest.approx((1 - CONTAMINATION) * (2 * Phi - 1), rel=1e-8)
    assert (1 - CONTAMINATION) * (2 * (Phi - 0.5) - 1) < 0 < expected_information(HUBER)


@pytest.mark.parametrize("information", INFORMATION)
def test_equation_42(information):
    """x(k|k) = F x + P H' psi(y - H F x), T(k) = 1."""
    for kf, x, _, Pp, z in steps("unit", information):
        support.assert_close(kf.x, F @ x + Pp @ H.T * psi(z - (H @ F @ x).item()))
        assert kf.T.item() == 1.0


def test_equation_43():
    """P(k|k-1) = F P F' + W, beside (42)."""
    for kf, _, P, _, _ in steps("unit", "expected"):
        support.assert_close(kf.P_prior, F @ P @ F.T + W)


def test_equation_44():
    """P(k|k) = P - P H' H P E{psi'}."""
    for kf, _, _, Pp, _ in steps("unit", "expected"):
        support.assert_close(kf.P, Pp - Pp @ H.T @ H @ Pp * expectation())


def test_equation_45():
    """E{psi'} = (1 - contamination) [2 Phi(k) - 1] whatever the scaling and the innovation."""
    reductions = set()
    for scaling in SCALINGS:
        for kf, _, _, Pp, _ in steps(scaling, "expected"):
            T = transformation(scaling, Pp)
            reductions.add(round(float((Pp - kf.P)[0, 0] / (Pp[0, 0] * T) ** 2), 9))
    assert reductions == {round(expectation(), 9)}


def test_equation_46():
    """E{psi'} is approximated by psi' of the innovation itself, which is 1 or 0 for Huber's function."""
    seen = set()
    for scaling in SCALINGS:
        for kf, _, _, Pp, _ in steps(scaling, "realized"):
            T = transformation(scaling, Pp)
            d = float((Pp - kf.P)[0, 0] / (Pp[0, 0] * T) ** 2)
            assert d == pytest.approx(psi_deriv(kf.e.item()), abs=1e-9)
            seen.add(round(d))
    assert seen == {0, 1}


def test_equation_47():
    """x(k|k) = F x + P H' psi(y - H F x), beside (49)."""
    for kf, x, _, Pp, z in steps("unit", "realized"):
        support.assert_close(kf.x, F @ x + Pp @ H.T * psi(z - (H @ F @ x).item()))


def test_equation_48():
    """P(k|k-1) = F P F' + W, beside (47)."""
    for kf, _, P, _, _ in steps("unit", "realized"):
        support.assert_close(kf.P_prior, F @ P @ F.T + W)


def test_equation_49():
    """P(k|k) = P - P H' H P psi'(y - H F x)."""
    for kf, x, _, Pp, z in steps("unit", "realized"):
        support.assert_close(kf.P, Pp - Pp @ H.T @ H @ Pp * psi_deriv(z - (H @ F @ x).item()))


def test_with_psi_the_identity_equations_37_to_39_are_the_kalman_filter():
    x, P, z = PROBLEM.x, PROBLEM.P, 1.7
    kf = support.make(RobustKalmanFilter, PROBLEM, influence=Linear())
    kf.predict()
    kf.update(z)
    Pp = F @ P @ F.T + W
    S = (H @ Pp @ H.T).item() + SIGMA2
    support.assert_close(kf.x, F @ x + Pp @ H.T / S * (z - (H @ F @ x).item()))
    support.assert_close(kf.P, Pp - Pp @ H.T @ H @ Pp / S)


def gains():
    """Yield (filter after the step, predicted covariance and innovation of the step before) along one recording."""
    before = None
    for kf, _, _, Pp, _ in steps("unit", "realized"):
        if before is not None:
            yield kf, *before
        before = Pp, kf.y.item()


def test_equation_50():
    """K(k) = F [P(k-1|k-2) - P H' H P psi'(nu(k-1))] F' H' + W H'."""
    for kf, P, nu in gains():
        corrected = P - P @ H.T @ H @ P * psi_deriv(nu)
        support.assert_close(kf.K, F @ corrected @ F.T @ H.T + W @ H.T, what="K")


def test_equation_51():
    """|nu(k)| > k_eps is where psi' = 0: where the sample is clipped, and P keeps what was predicted."""
    seen = set()
    for kf, _, _, Pp, _ in steps("unit", "realized"):
        large = abs(kf.y.item()) > K_EPS
        assert bool(kf.clipped) == large == (HUBER.psi_deriv(kf.y.item()) == 0)
        assert np.array_equal(kf.P, Pp) == large
        seen.add(large)
    assert seen == {True, False}


def test_equation_52():
    """Where (51) held for sample k-1: K(k) = F P(k-1|k-2) F' H' + W H', above the gain (50) of a believed sample."""
    compared = 0
    for kf, P, nu in gains():
        if abs(nu) > K_EPS:
            support.assert_close(kf.K, F @ P @ F.T @ H.T + W @ H.T, what="K")
            believed = F @ (P - P @ H.T @ H @ P) @ F.T @ H.T + W @ H.T
            assert kf.K[0, 0] > believed[0, 0]
            compared += 1
    assert compared
