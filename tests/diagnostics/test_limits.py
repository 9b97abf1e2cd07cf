"""What a short recording cannot show is said; extremes are no errors; a wrong start is called one."""

import numpy as np
import pytest
from support import by_night, of_matrices

from robust_filterpy import RobustKalmanFilter, diagnose
from robust_filterpy.diagnostics import recording as statistics


def level(x=0.0, P=1.0, Q=0.01):
    return of_matrices(RobustKalmanFilter, 1.0, [[1.0]], Q, 1.0, P, [[x]])


def recording(n, seed=10001):
    rng = np.random.default_rng(seed)
    return np.cumsum(0.1 * rng.normal(size=n)) + rng.normal(size=n)


@pytest.mark.parametrize("size", by_night([1e150, 1e160, 1e200, 1e300], 1e150, 1e300))
def test_a_spike_of_any_size_and_a_tiny_unit_are_nothing_unusual(size):
    zs = recording(150)
    zs[100] = size
    assert diagnose(level(), zs).causes == ()
    kf = of_matrices(RobustKalmanFilter, 1.0, np.eye(2), 1e150, 1e152, 1e152)
    assert diagnose(kf, 1e76 * np.random.default_rng(0).normal(size=(200, 2))).causes == ()


@pytest.mark.parametrize("seed", by_night(range(3), 0))
def test_outliers_of_any_size_in_several_sensors_are_diagnosed(seed):
    rng = np.random.default_rng(seed)
    kf, z = RobustKalmanFilter(2, 3), rng.normal(size=(150, 3))
    kf.H, kf.Q = rng.normal(size=(3, 2)), 0.01 * np.eye(2)
    bad = rng.random((150, 3)) < 0.1
    z[bad] *= 10.0 ** rng.uniform(100.0, 300.0, bad.sum())
    assert str(diagnose(kf, z))


@pytest.mark.parametrize(("n", "short"), [(20, True), (501, False)])
def test_a_short_recording_says_that_it_shows_little(n, short):
    found = diagnose(level(), recording(n))
    assert found.causes == () and (f"In {n} samples an R or Q that is wrong may not show" in str(found)) == short


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("x, P", [(10.0, 0.01), (30.0, 0.01), (100.0, 0.01), (-1000.0, 1e-4)])
@pytest.mark.parametrize("n", [60, 300])
def test_a_wrong_start_is_not_called_a_small_q(n, x, P):
    assert diagnose(level(x, P), recording(n)).causes == ("wrong start",)
    assert "wrong start" not in diagnose(level(Q=1e-4), recording(n, 10002)).causes


def turning(seed, period, n=400):
    """Return a heading that turns, wrapped at a period: from 0, or symmetric about it."""
    rng = np.random.default_rng([seed, 5])
    walk = np.cumsum(np.cumsum(rng.normal(size=n)) * 2e-4 + rng.choice([-1, 1]) * 4e-3) + rng.random()
    walk += 2e-3 * rng.normal(size=n)
    z = (walk % 1.0 - rng.choice([0.0, 0.5])) * period
    z[rng.random(n) < 0.05] = np.nan
    return z, walk * period


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("period", [360.0, 2 * np.pi, 400.0, 24.0, 2.0**16], ids="deg rad gon hours counter".split())
@pytest.mark.parametrize("seed", range(6))
def test_a_signal_that_wraps_is_called_so_with_its_period(period, seed):
    z, walk = turning(seed, period)
    assert np.nanmax(np.abs(np.diff(z))) > period / 2
    F, Q = [[1.0, 1.0], [0.0, 1.0]], np.array([[0.25, 0.5], [0.5, 1.0]]) * (2e-4 * period) ** 2
    P, R = np.diag([1.0, 1e-4]) * period**2, (2e-3 * period) ** 2
    kf = of_matrices(RobustKalmanFilter, F, [[1.0, 0.0]], Q, R, P)
    (found,) = diagnose(kf, z).findings
    assert found.cause == "wrapping" and found.value == pytest.approx(period)
    assert f"wraps at {period:.6g}" in found.text and "numpy.unwrap" in found.text
    assert statistics.wraps(walk) is None


@pytest.mark.parametrize("seed", range(4))
def test_what_only_jumps_does_not_wrap(seed):
    rng = np.random.default_rng([seed, 6])
    step, there = np.arange(400), recording(400, seed)
    for z in (
        180.0 + there + np.where(step > 200, 160.0, -160.0), 180.0 + there + 170.0 * np.sign(np.sin(step / 15.0)),
        step % 97 + 0.1 * there, rng.random(400) * 360.0, np.where(rng.random(400) < 0.1, 359.0, 5.0 + there),
    ):  # fmt: skip
        assert statistics.wraps(z) is None
