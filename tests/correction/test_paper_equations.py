"""One test for each numbered equation of section 3.1 of the paper (26-52) but those of its own problem (31-34).

The right-hand sides are written out here as the paper prints them (with the corrections of the package's
documentation), with a scalar measurement and plain floats; phi, Phi and psi come from scipy and numpy.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
import support
from scipy.integrate import quad

from robust_filterpy import Huber, RobustKalmanFilter
from robust_filterpy.influence.information import expected_information

pytestmark = pytest.mark.core

CONTAMINATION = 0.1
HUBER = Huber.from_contamination(CONTAMINATION)
K_EPS = HUBER.threshold
SIGMA2 = 0.1
PROBLEM = support.paper_problem()
F, H, W = PROBLEM.F, PROBLEM.H, PROBLEM.Q
MEASUREMENTS = [0.05, -0.2, 0.4, 6.0, -25.0, 0.1]
UNIT, INNOVATION, BOTH = ("unit",), ("innovation",), ("unit", "innovation")
EXPECTED, REALIZED = ("expected",), ("realized",)


def psi(v):
    return np.clip(v, -K_EPS, K_EPS)


def psi_deriv(v):
    return float(abs(v) <= K_EPS)


#: E{psi'} (40).
EXPECTATION = (1 - CONTAMINATION) * (2 * scipy.stats.norm.cdf(K_EPS) - 1)


def density(v, influence):
    return np.exp(support.least_favorable(v, influence))


def steps(scaling, information, influence=HUBER):
    """Yield each step along one recording: before it, between its halves (P), after it (kf); T and v (29) by hand."""
    kf = support.make(RobustKalmanFilter, PROBLEM, influence=influence, scaling=scaling, information=information)
    for z in MEASUREMENTS:
        x, before = kf.x.copy(), kf.P.copy()
        kf.predict()
        P = kf.P.copy()
        kf.update(z)
        T, y = 1.0 if scaling == "unit" else ((H @ P @ H.T).item() + SIGMA2) ** -0.5, z - (H @ F @ x).item()
        yield SimpleNamespace(kf=kf, x=x, before=before, P=P, y=y, T=T, v=T * y, S=(H @ P @ H.T).item() + SIGMA2)


def predicted(s):
    return s.kf.P_prior, F @ s.before @ F.T + W


# Each equation, where it is meant to hold, and its two sides.
EQUATIONS = {
    # x(k|k) = F x(k-1|k-1) + P(k|k-1) H' T psi[v]
    26: (BOTH, EXPECTED + REALIZED, lambda s: (s.kf.x, F @ s.x + s.P @ H.T * s.T * psi(s.v))),
    # P(k|k-1) = F P(k-1|k-1) F' + W, with each form of the correction
    27: (BOTH, EXPECTED, predicted),
    38: (INNOVATION, EXPECTED, predicted),
    43: (UNIT, EXPECTED, predicted),
    48: (UNIT, REALIZED, predicted),
    # P(k|k) = P(k|k-1) - P H' T^2 H P E{psi'(v)}
    28: (BOTH, EXPECTED, lambda s: (s.kf.P, s.P - s.P @ H.T * s.T**2 @ H @ s.P * EXPECTATION)),
    # v(k) = T(k) [y(k) - H F x(k-1|k-1)]
    29: (BOTH, REALIZED, lambda s: (s.kf.e, [[s.v]])),
    # T^2 [H P H' + sigma_N^2] = 1
    35: (INNOVATION, REALIZED, lambda s: (s.kf.T**2 * s.S, [[1.0]])),
    # T = [H P H' + sigma_N^2]^(-1/2), the positive root
    36: (INNOVATION, REALIZED, lambda s: (s.kf.T, [[s.S**-0.5]])),
    # x(k|k) = F x + P H' S^(-1/2) psi(y / S^(1/2))
    37: (INNOVATION, EXPECTED + REALIZED,
         lambda s: (s.kf.x, F @ s.x + s.P @ H.T / np.sqrt(s.S) * psi(s.y / np.sqrt(s.S)))),
    # P(k|k) = P - P H' H P / S E{psi'}
    39: (INNOVATION, EXPECTED, lambda s: (s.kf.P, s.P - s.P @ H.T @ H @ s.P / s.S * EXPECTATION)),
    # x(k|k) = F x + P H' psi(y - H F x), T(k) = 1
    42: (UNIT, EXPECTED, lambda s: (s.kf.x * s.kf.T, F @ s.x + s.P @ H.T * psi(s.y))),
    # P(k|k) = P - P H' H P E{psi'}
    44: (UNIT, EXPECTED, lambda s: (s.kf.P, s.P - s.P @ H.T @ H @ s.P * EXPECTATION)),
    # E{psi'} = (1 - contamination) [2 Phi(k) - 1] whatever the scaling and the innovation
    45: (BOTH, EXPECTED, lambda s: (((s.P - s.kf.P) / (s.P[0, 0] * s.T) ** 2)[0, 0], EXPECTATION)),
    # E{psi'} is approximated by psi' of the innovation itself, which is 1 or 0 for Huber's function
    46: (BOTH, REALIZED, lambda s: (((s.P - s.kf.P) / (s.P[0, 0] * s.T) ** 2)[0, 0] + 1.0, psi_deriv(s.v) + 1.0)),
    # x(k|k) = F x + P H' psi(y - H F x), with (49)
    47: (UNIT, REALIZED, lambda s: (s.kf.x, F @ s.x + s.P @ H.T * psi(s.y))),
    # P(k|k) = P - P H' H P psi'(y - H F x)
    49: (UNIT, REALIZED, lambda s: (s.kf.P, s.P - s.P @ H.T @ H @ s.P * psi_deriv(s.y))),
}  # fmt: skip


@pytest.mark.parametrize("equation", EQUATIONS)
def test_equation(equation):
    scalings, informations, sides = EQUATIONS[equation]
    clipped = set()
    for scaling in scalings:
        for information in informations:
            for step in steps(scaling, information):
                support.assert_close(*sides(step), rtol=1e-9, what=f"({equation}), {scaling}, {information}")
                clipped.add(abs(step.v) > K_EPS)
    assert clipped == {True, False}


def test_equation_30():
    """I(p) = integral of p'^2 / p; for the least favourable density, whose score is psi, it is E{psi'} of (40)."""
    parts = (quad(lambda v: psi(v) ** 2 * density(v, HUBER), *ends)[0] for ends in ((0, K_EPS), (K_EPS, np.inf)))
    assert 2 * sum(parts) == pytest.approx(EXPECTATION, rel=1e-6)


@pytest.mark.parametrize("threshold", [1.0, 1.14, 1.345, 2.0, 3.0])
def test_equations_40_and_41(threshold):
    """E{psi'} = (1 - contamination) [Phi(k) - Phi(-k)], Phi from -infinity; not, as printed, from 0."""
    c, information = Huber(threshold).contamination, expected_information(Huber(threshold))
    Phi = quad(lambda v: np.exp(-(v**2) / 2) / np.sqrt(2 * np.pi), -np.inf, threshold)[0]
    assert information == pytest.approx((1 - c) * (2 * Phi - 1), rel=1e-8)
    assert information == pytest.approx(quad(density, -threshold, threshold, Huber(threshold))[0], rel=1e-7)
    assert (1 - c) * (2 * (Phi - 0.5) - 1) < 0 < information


def gain_after(P, believed):
    """K(k) = F [P(k-1|k-2) - P H' H P psi'(nu(k-1))] F' H' + W H'."""
    return F @ (P - P @ H.T @ H @ P * believed) @ F.T @ H.T + W @ H.T


def test_equations_50_to_52():
    """|nu(k)| > k_eps is where psi' = 0: there P keeps what was predicted, and the next gain is above (50)'s."""
    last, seen = None, set()
    for s in steps("unit", "realized"):
        if last is not None:
            P, nu = last
            support.assert_close(s.kf.K, gain_after(P, psi_deriv(nu)), what="K")
            if abs(nu) > K_EPS:
                support.assert_close(s.kf.K, F @ P @ F.T @ H.T + W @ H.T, what="K")
                assert s.kf.K[0, 0] > gain_after(P, 1.0)[0, 0]
        large = abs(s.kf.y.item()) > K_EPS
        assert bool(s.kf.clipped) == large == (HUBER.psi_deriv(s.kf.y.item()) == 0) == np.array_equal(s.kf.P, s.P)
        last = s.P, s.kf.y.item()
        seen.add(large)
    assert seen == {True, False}
