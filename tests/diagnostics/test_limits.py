"""What a recording cannot show is said; extremes are no errors; a wrong start is called one."""

import numpy as np
import pytest

from robust_filterpy import RobustKalmanFilter, diagnose


def level(x=0.0, P=1.0, Q=0.01):
    kf = RobustKalmanFilter(1, 1)
    kf.F, kf.H, kf.Q, kf.R, kf.P = np.eye(1), np.eye(1), Q * np.eye(1), np.eye(1), P * np.eye(1)
    kf.x = np.array([[x]])
    return kf


def recording(n, seed=10001):
    rng = np.random.default_rng(seed)
    return np.cumsum(0.1 * rng.normal(size=n)) + rng.normal(size=n)


@pytest.mark.parametrize("size", [1e150, 1e160, 1e200, 1e300])
def test_a_spike_of_any_size_is_nothing_unusual(size):
    zs = recording(300)
    zs[100] = size
    assert diagnose(level(), zs).causes == ()


def test_nothing_is_said_of_nothing():
    found = diagnose(level(), np.full(50, np.nan))
    assert found.findings == () and str(found).startswith("Nothing was measured")
    assert "Nothing unusual" not in str(found)


@pytest.mark.parametrize("n", [20, 40, 60])
def test_a_short_recording_names_what_it_cannot_show(n):
    found = diagnose(level(Q=0.1), recording(n))
    assert found.causes == () and "Q ten times too large" in found.unseen
    assert f"In {n} samples these would not have shown: " in str(found)


def test_a_recording_that_shows_them_all_names_none():
    kf = level(Q=1.0)
    rng = np.random.default_rng(10001)
    found = diagnose(kf, np.cumsum(rng.normal(size=400)) + rng.normal(size=400))
    assert found.causes == () and found.unseen == ()


@pytest.mark.parametrize("x, P", [(10.0, 0.01), (30.0, 0.01), (100.0, 0.01), (-1000.0, 1e-4)])
@pytest.mark.parametrize("n", [60, 300])
def test_a_wrong_start_is_not_called_a_small_q(n, x, P):
    assert diagnose(level(x, P), recording(n)).causes == ("wrong start",)


def test_a_right_start_is_not_called_wrong():
    for seed in range(10001, 10011):
        assert "wrong start" not in diagnose(level(), recording(150, seed)).causes
        assert "wrong start" not in diagnose(level(Q=1e-4), recording(150, seed)).causes
