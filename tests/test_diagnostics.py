"""A diagnosis names the true cause of a broken set-up, and finds nothing in a healthy one."""

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter

from robust_filterpy import Huber, Linear, RobustKalmanFilter
from robust_filterpy.diagnostics import Diagnosis, diagnose

N = 500
DT = 0.5
F = np.array([[1.0, DT], [0.0, 1.0]])
Q = 0.05 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
H = np.array([[1.0, 0.0], [0.0, 1.0]])
R = np.diag([0.3, 0.1])


def world(seed, sensors=2, contamination=0.05, memory=0.0, coupling=0.0, Q=Q, jump=0.0):
    """Draw a moving point and its position (and velocity) with outliers."""
    rng = np.random.default_rng(seed)
    x = np.zeros((N, 2))
    root = np.linalg.cholesky(Q)
    for k in range(1, N):
        x[k] = F @ x[k - 1] + root @ rng.normal(size=2)
        if k == 300:
            x[k, 0] += jump
    noise = rng.normal(size=(N, 2)) @ np.linalg.cholesky([[1.0, coupling], [coupling, 1.0]]).T
    for k in range(1, N):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    noise[rng.random((N, 2)) < contamination] *= 10.0
    return x, (x @ H.T + noise * np.sqrt(np.diag(R)))[:, :sensors]


def robust(sensors=2, R_factor=1.0, Q_factor=1.0, H=H, **choices):
    kf = RobustKalmanFilter(2, sensors, **choices)
    kf.F, kf.H, kf.Q, kf.R = F.copy(), H[:sensors].copy(), Q_factor * Q, (R_factor * R)[:sensors, :sensors]
    kf.P = np.diag([0.3, 0.1])
    return kf


def healthy(seed):
    return robust(), world(seed)[1]


def healthy_single(seed):
    return robust(1), world(seed, 1)[1]


def clean(seed):
    return robust(), world(seed, contamination=0.0)[1]


def R_too_small(seed):
    return robust(1, R_factor=1 / 9), world(seed, 1)[1]


def R_too_small_of_both(seed):
    return robust(R_factor=1 / 25), world(seed)[1]


def R_too_large(seed):
    return robust(R_factor=25.0), world(seed)[1]


def R_of_one_too_small(seed):
    kf = robust()
    kf.R[1, 1] /= 16
    return kf, world(seed)[1]


def Q_too_small(seed):
    return robust(Q_factor=1e-3), world(seed)[1]


def Q_too_small_single(seed):
    return robust(1, Q_factor=1e-3), world(seed, 1)[1]


def Q_too_large(seed):
    return robust(Q_factor=1e3), world(seed)[1]


def R_and_Q_too_small(seed):
    return robust(R_factor=1 / 25, Q_factor=1 / 25), world(seed)[1]


def wrong_row(seed):
    wrong = H.copy()
    wrong[1] = [1.0, 0.0]
    return robust(H=wrong), world(seed)[1]


def wrong_sign(seed):
    wrong = H.copy()
    wrong[1, 1] = -1.0
    return robust(H=wrong), world(seed)[1]


def millimetres(seed):
    return robust(), world(seed)[1] * [1000.0, 1.0]


def kilometres_an_hour(seed):
    return robust(), world(seed)[1] * [1.0, 3.6]


def millimetres_single(seed):
    return robust(1), world(seed, 1)[1] * 1000.0


def sensor_shifts(seed):
    z = world(seed)[1]
    z[200:, 1] += 4.0
    return robust(), z


def sensor_biased(seed):
    return robust(), world(seed)[1] + [0.0, 3.0]


def state_jumps(seed):
    return robust(), world(seed, jump=30.0)[1]


def state_jumps_single(seed):
    return robust(1), world(seed, 1, jump=30.0)[1]


def saturating(seed):
    z = world(seed)[1]
    return robust(), np.minimum(z, np.quantile(z, 0.7, axis=0))


def frozen(seed):
    z = world(seed)[1]
    z[100:160, 0] = z[100, 0]
    return robust(), z


def correlated(seed):
    return robust(), world(seed, memory=0.9)[1]


def coupled(seed):
    return robust(), world(seed, coupling=0.8)[1]


def contaminated(seed):
    return robust(), world(seed, contamination=0.3)[1]


SETUPS = {
    "healthy": (healthy, None, None),
    "healthy, one sensor": (healthy_single, None, None),
    "clean": (clean, None, None),
    "R too small": (R_too_small, "R too small", None),
    "R too small, both": (R_too_small_of_both, "R too small", None),
    "R too large": (R_too_large, "R too large", None),
    "R of one sensor too small": (R_of_one_too_small, "R too small", 1),
    "Q too small": (Q_too_small, "Q too small", None),
    "Q too small, one sensor": (Q_too_small_single, "Q too small", None),
    "Q too large": (Q_too_large, "Q too large", None),
    "R and Q too small": (R_and_Q_too_small, "R and Q too small", None),
    "wrong row of H": (wrong_row, "wrong H", 1),
    "wrong sign in H": (wrong_sign, "wrong H", 1),
    "mm instead of m": (millimetres, "lost units", 0),
    "km/h instead of m/s": (kilometres_an_hour, "lost units", 1),
    "mm instead of m, one sensor": (millimetres_single, "lost units", None),
    "one sensor shifts": (sensor_shifts, "level shift", 1),
    "one sensor biased": (sensor_biased, "bias", 1),
    "state jumps": (state_jumps, "level shift", 0),
    "state jumps, one sensor": (state_jumps_single, "level shift", 0),
    "saturating sensor": (saturating, "saturation", 0),
    "frozen sensor": (frozen, "frozen sensor", 0),
    "correlated noise": (correlated, "correlated noise", None),
    "coupled noise": (coupled, "coupled noise", None),
    "30 % outliers": (contaminated, "more outliers", 0),
}


def assert_named(name, seed):
    setup, cause, sensor = SETUPS[name]
    d = diagnose(*setup(seed))
    if cause is None:
        assert not d.findings and str(d).startswith("Nothing unusual")
        return
    assert d.causes[:1] == (cause,), str(d)
    if sensor is not None:
        assert d.findings[0].sensor == sensor


@pytest.mark.parametrize("name", SETUPS)
def test_names_the_true_cause(name):
    assert_named(name, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("name", SETUPS)
def test_names_the_true_cause_for_every_seed(name, seed):
    assert_named(name, seed)
