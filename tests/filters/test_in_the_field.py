"""Gaps, long steps, fill values, jumps: what the default does with recordings of other people."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose, assert_array_equal
from support import through

from robust_filterpy import AdaptiveKalmanFilter, RobustKalmanFilter
from robust_filterpy.correction.spread import NUMBERS
from robust_filterpy.filters import StuckSensorWarning

pytestmark = pytest.mark.usefixtures("path")


def moving(kind, R=1.0, h=1.0, q=1e-3, x=0.0):
    kf = kind(dim_x=2, dim_z=1)
    kf.F, kf.Q = white(h, q)
    kf.H, kf.R, kf.P, kf.x = np.array([[1.0, 0.0]]), R * np.eye(1), 10.0 * np.eye(2), np.array([[x], [0.0]])
    return kf


def white(h, q):
    return np.array([[1.0, h], [0.0, 1.0]]), q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])


def settled(R=1.0, seed=0, steps=60):
    """The default and the Kalman filter after the same ordinary readings, and the Kalman filter's state in both."""
    rng, pair = np.random.default_rng(seed), [moving(kind, R) for kind in (RobustKalmanFilter, KalmanFilter)]
    for z in np.cumsum(0.03 * rng.normal(size=steps)) + rng.normal(size=steps):
        for kf in pair:
            kf.predict()
            kf.update(z)
    pair[0].x, pair[0].P = pair[1].x.copy(), pair[1].P.copy()
    return pair


def gap(kf, size):
    for _ in range(int(size)):
        kf.predict()


def long_step(kf, size):
    F, Q = white(float(size), 1e-3)
    kf.predict(F=F, Q=Q)


def opened(kf, size):
    kf.predict()
    kf.P = kf.P + np.diag([float(size) ** 2, 0.0])


def noisier(kf, size):
    kf.predict(Q=np.diag([float(size) ** 2, 0.0]))


def surer(kf, size):
    kf.predict()
    kf.R = kf.R / float(size) ** 2


@pytest.mark.parametrize("event", [gap, long_step, opened, noisier, surer])
@pytest.mark.parametrize("R", [1.0, 25.0])
def test_as_the_state_becomes_less_certain_x_tends_to_the_kalman_filters(event, R):
    """An innovation of three of the Kalman filter's standard deviations: only the noise has outliers."""
    missed = []
    for size in (1, 1000):
        ours, theirs = settled(R)
        for kf in (ours, theirs):
            event(kf, size)
        z = theirs.x[0, 0] + 3.0 * np.sqrt((theirs.H @ theirs.P @ theirs.H.T + theirs.R)[0, 0])
        before = theirs.x[0, 0]
        ours.update(z)
        theirs.update(z)
        missed.append(abs(ours.x[0, 0] - theirs.x[0, 0]) / abs(theirs.x[0, 0] - before))
    assert missed[1] < 1e-12 and (R > 1.0 or missed[0] > 0.05)


@pytest.mark.parametrize("value", [-9999.0, 0.0, 65535.0])
@pytest.mark.parametrize("run", [4, 40])
@pytest.mark.filterwarnings("ignore::robust_filterpy.filters.StuckSensorWarning")
def test_a_run_of_fill_values_is_missing(value, run):
    rng, worst = np.random.default_rng(run), []
    x = 20.0 + np.cumsum(0.05 * rng.normal(size=260 + run))
    z = np.round(x + 0.1 * rng.normal(size=len(x)), 2)
    z[200 : 200 + run] = value
    for kind in (RobustKalmanFilter, KalmanFilter):
        kf = moving(kind, 0.01, q=1e-4, x=20.0)
        found = [kf.predict() or kf.update(one) or kf.x[0, 0] for one in z]
        worst.append(np.abs(found - x)[200:].max())
    assert worst[0] < 0.1 * worst[1]


def test_that_a_run_is_missing_is_said_once_and_weighs_nothing():
    kf, rng = moving(RobustKalmanFilter), np.random.default_rng(1)
    with pytest.warns(StuckSensorWarning, match="missing") as said:
        through(kf, [*rng.normal(size=50), *[-9999.0] * 5, *rng.normal(size=5), *[-9999.0] * 5])
    assert len(said) == 1 and kf.weights == 0.0


@pytest.mark.filterwarnings("ignore::robust_filterpy.filters.StuckSensorWarning")
def test_a_coarse_sensor_at_rest_that_steps_is_followed():
    rng, kf = np.random.default_rng(3), moving(RobustKalmanFilter, 0.01, q=1e-4, x=20.0)
    found = []
    for z in [*np.round(20.0 + 0.3 * rng.normal(size=300)), *[20.0] * 300, *[35.0] * 30]:
        kf.predict()
        kf.update(z)
        found.append(kf.x[0, 0])
    assert abs(found[-1] - 35.0) < 1.0


def test_a_step_of_what_is_measured_leaves_the_speed():
    rng, kf, worst = np.random.default_rng(5), moving(RobustKalmanFilter, 0.09, 0.1, 1.0), 0.0
    for k in range(400):
        kf.predict()
        kf.update(0.7 * k + (5.0 if k >= 200 else 0.0) + 0.05 * rng.normal())
        worst = max(worst, abs(kf.x[1, 0] - 7.0) if k >= 190 else 0.0)
    assert worst < 0.5


@pytest.mark.parametrize("far", [1e155, 1e200, 1e300])
def test_sensors_that_see_the_same_bear_any_finite_reading(far):
    kf, rng = RobustKalmanFilter(2, 3), np.random.default_rng(0)
    kf.H, kf.x = np.ones((3, 2)), np.zeros(2)
    for _ in range(30):
        kf.predict()
        kf.update(rng.normal(size=3))
    kf.predict()
    kf.update([far, 0.1, 0.2])
    assert np.abs(kf.x).max() < 1.0


@pytest.mark.parametrize("width", [10, 15, 17])
def test_a_state_with_fewer_columns_is_read(width):
    kf, _ = settled()
    state = kf.state()
    state["spread"] = state["spread"][:, :width]
    other = moving(RobustKalmanFilter)
    other.restore(state)
    assert other._memory.shape == (1, NUMBERS)
    assert_array_equal(other.spread, kf.spread)
    assert_allclose(other.x, kf.x)


def test_a_state_of_learned_noise_without_jumps_is_read():
    kf, rng = moving(AdaptiveKalmanFilter), np.random.default_rng(5)
    through(kf, rng.normal(size=40))
    state, other = kf.state(), moving(AdaptiveKalmanFilter)
    assert state["learnt"][0, -15] == 0.0, "no jump has been believed"
    state["learnt"] = np.delete(state["learnt"], np.s_[-15:-10], axis=1)
    other.restore(state)
    for one in (kf, other):
        one.predict()
        one.update(0.3)
    assert_allclose(other.x, kf.x, rtol=1e-9)
    apart = np.s_[-15:-10]
    assert_allclose(np.delete(other.learnt, apart, axis=1), np.delete(kf.learnt, apart, axis=1), rtol=1e-9)


def test_what_a_jump_opens_does_not_depend_on_the_order_of_the_sensors():
    H, rng = np.array([[1.0, 0.2], [0.3, 1.0]]), np.random.default_rng(7)
    pair, noise = [moving(RobustKalmanFilter) for _ in range(2)], rng.normal(size=(70, 2))
    for kf, order in zip(pair, ([0, 1], [1, 0]), strict=True):
        kf.dim_z, kf.H, kf.R = 2, H[order], np.eye(2)
        for k, y in enumerate(noise):
            kf.predict()
            kf.update((y + (300.0 if k >= 60 else 0.0))[order])
            if k == 63:
                assert kf.S[0, 0] > 1e3
    assert_allclose(pair[0].x, pair[1].x, rtol=1e-9)
    assert_allclose(pair[0].P, pair[1].P, rtol=1e-9)


def test_a_long_step_among_the_first_is_not_what_is_usual():
    pair = [moving(kind, R=25.0, q=0.1) for kind in (RobustKalmanFilter, KalmanFilter)]
    for h, z in ((1.0, 2.0), (1.0, -1.5), (20.0, 17.0), (20.0, -28.0)):
        for kf in pair:
            F, Q = white(h, 0.1)
            kf.predict(F=F, Q=Q)
            kf.update(z)
    assert_allclose(pair[0].x[0], pair[1].x[0], atol=1.0)


def test_where_the_growth_of_P_varies_an_outlier_beyond_all_such_readings_is_clipped():
    rng, kf = np.random.default_rng(0), moving(RobustKalmanFilter)
    for k in range(400):
        kf.predict()
        # One prior in five is much less certain than usual, as where F is linearized at each estimate.
        kf.P[0, 0] += 100.0 if k % 5 == 0 else 0.0
        kf.update(rng.normal())
    kf.predict()
    kf.P[0, 0] += 100.0
    kf.update(50.0)
    assert abs(kf.x[0, 0]) < 15.0


def after_jumps(sizes, seed=0, every=60):
    """The default after jumps of some sizes, and where the position is then."""
    rng, kf, level = np.random.default_rng(seed), moving(RobustKalmanFilter), 0.0
    for size in (*sizes, 0.0):
        through(kf, level + rng.normal(size=every))
        level += size
    return kf, level


def test_where_jumps_are_usual_the_first_reading_of_one_is_believed():
    """The first takes four; an outlier far beyond jumps is bounded as ever, one as far as they go is undone at once."""
    for jumps, believed in (((), False), ((30.0, 30.0, 30.0), True)):
        kf, level = after_jumps(jumps)
        kf.predict()
        kf.update(level + 28.0)
        assert (abs(kf.x[0, 0] - level - 28.0) < 3.0) == believed
        speed = kf.x[1, 0]
        kf.predict()
        kf.update(level)
        assert abs(kf.x[0, 0] - level) < 3.0 and abs(kf.x[1, 0] - speed) < 0.2
    for far in (300.0, 1e4, 1e300):
        kf, level = after_jumps((30.0, -30.0, 30.0, -30.0))
        kf.predict()
        kf.update(level + far)
        assert abs(kf.x[0, 0] - level) < 3.0


def test_where_runs_come_to_nothing_jumps_need_as_many_readings_as_ever():
    rng, kf = np.random.default_rng(2), moving(RobustKalmanFilter)
    for k in range(400):
        kf.predict()
        kf.update(rng.normal() + (30.0 if k > 200 and k % 10 == 5 else 0.0) + (30.0 if 100 <= k < 140 else 0.0))
    for _ in range(2):
        kf.predict()
        kf.update(30.0)
        assert abs(kf.x[0, 0]) < 5.0


@pytest.mark.parametrize("jumps", [True, False], ids=["with jumps", "without"])
def test_a_state_of_learned_noise_without_typical_innovations_is_read(jumps):
    def learning():
        return moving(lambda **sizes: RobustKalmanFilter(**sizes, noise="learnt"))

    kf, other, rng = learning(), learning(), np.random.default_rng(5)
    through(kf, rng.normal(size=40))
    state = kf.state()
    absent = np.r_[-17 - NUMBERS : -17, () if jumps else np.r_[-15:-10]].astype(int)
    state["learnt"] = np.delete(state["learnt"], absent, axis=1)
    other.restore(state)
    assert_array_equal(np.delete(other.learnt, absent, axis=1), state["learnt"])
    for one in (kf, other):
        one.predict()
        one.update(0.3)
    assert_allclose(other.x, kf.x, rtol=1e-9)
