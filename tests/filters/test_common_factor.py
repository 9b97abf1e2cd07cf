"""P, Q and R with one wrong factor: AdaptiveKalmanFilter's estimates are, in the end, those without it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from robust_filterpy import AdaptiveKalmanFilter

F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), 1e-3 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])


def run(c, unit=1.0, sensors=1, passed=False, at_first=()):
    """Return the errors of 400 steps, in the first unit, and the filter."""
    rng, x = np.random.default_rng(3), np.zeros(2)
    kf = AdaptiveKalmanFilter(2, sensors)
    kf.F, kf.H = F, np.tile([1.0, 0.0], (sensors, 1))
    kf.Q, kf.R = c * unit**2 * Q, c * unit**2 * np.eye(sensors)
    kf.P *= c * unit**2 * 10.0
    kf.x[0] = 0.5 * unit
    errors = []
    for k in range(400):
        x = F @ x + rng.multivariate_normal([0.0, 0.0], Q)
        z = x[0] + rng.normal(size=sensors) * np.where(rng.random(sensors) < 0.05, 20.0, 1.0)
        z = at_first[k] * np.ones(sensors) if k < len(at_first) else z
        kf.predict(F=F, Q=kf.Q) if passed else kf.predict()
        kf.update(z * unit, H=kf.H, R=kf.R) if passed else kf.update(z * unit)
        errors.append(kf.x[0, 0] / unit - x[0])
    return np.array(errors), kf


@pytest.mark.parametrize("options", [
    {}, {"sensors": 2}, {"unit": 1e3}, {"passed": True}, {"at_first": (np.nan,) * 2}, {"at_first": (0.3, -0.2, 1e300)},
])  # fmt: skip
@pytest.mark.parametrize("c", [1e-8, 1e-5, 1e5, 1e8])
def test_a_common_factor_is_as_if_it_were_not(c, options):
    right, wrong = (np.sqrt(np.mean(run(factor, **options)[0][150:] ** 2)) for factor in (1.0, c))
    assert wrong < 1.05 * right


@pytest.mark.parametrize("c", [1e-8, 1e8])
def test_what_is_learned_of_r_and_q_has_the_factor_in_it(c):
    (_, one), (_, other) = run(1.0), run(c)
    assert_allclose(other.R_learnt, one.R_learnt, rtol=0.3)
    assert 0.1 < c * other.process_scale[0] / one.process_scale[0] < 10.0


def test_no_reading_moves_the_estimate_beyond_bounds_while_the_factor_is_looked_for():
    errors, _ = run(1e-6, at_first=(0.3, -0.2, 0.4, 1e300))
    assert np.isfinite(errors).all() and np.abs(errors[4:]).max() < 20.0
