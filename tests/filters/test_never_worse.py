"""What a swap promises: gains are kept, readings are judged by their own custom, on every path."""

import numpy as np
import pytest
import support
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight, filter_series
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core
STEPS, FILTERS = 120, (RobustKalmanFilter, KalmanFilter)


def problem(m, seed=0):
    """Position and velocity; m sensors of which the first two see the same."""
    rng = np.random.default_rng(seed)
    H = np.vstack([[1.0, 0.0], [1.0, 0.0], rng.normal(size=(max(m - 2, 0), 2))])[:m]
    return np.array([[1.0, 1.0], [0.0, 1.0]]), H, 0.01 * np.eye(2), np.eye(m)


def recording(m, seed=1):
    """A straight line with outliers, a gap, and a first sensor that goes wrong for good."""
    rng = np.random.default_rng(seed)
    F, H, _, _ = problem(m)
    x, zs = np.array([0.0, 0.1]), np.empty((STEPS, m))
    for k in range(STEPS):
        x = F @ x + 0.1 * rng.normal(size=2)
        zs[k] = H @ x + rng.normal(size=m) * np.where(rng.random(m) < 0.1, 30.0, 1.0)
    zs[40:43] = np.nan
    if m > 1:
        zs[60:, 0] += 25.0
    return zs


def built(m, factor=1.0, order=None, unit=None, **options):
    F, H, Q, R = problem(m)
    order, unit = np.arange(m) if order is None else order, np.ones(m) if unit is None else unit
    kf = RobustKalmanFilter(2, m, **options)
    kf.x, kf.F = np.zeros(2), F
    kf.H, kf.R = (unit[:, None] * H)[order], factor * (R * np.outer(unit, unit))[np.ix_(order, order)]
    kf.P, kf.Q = factor * 10.0 * np.eye(2), factor * Q
    return kf


def online(kf, zs):
    found = []
    for z in zs:
        kf.predict()
        kf.update(z)
        found.append((kf.x.copy(), kf.P.copy(), kf.weights.copy()))
    return [np.array(column) for column in zip(*found, strict=True)]


def as_series(kf, zs):
    found = filter_series(zs[None], kf.F, kf.H, kf.Q, kf.R, kf.x, kf.P, influence=kf.influence)
    return found.x[0], found.P[0], found.weights[0]


def as_recording(kf, zs):
    means, covariances, _, _ = kf.batch_filter(zs)
    return means, covariances, None


WAYS = [online, as_recording, as_series]


@pytest.mark.pairwise
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("factor", [1e-12, 1e-4, 100.0, 1e12])
def test_a_common_factor_of_P_Q_and_R_changes_nothing(path, way, m, factor):
    zs = recording(m)
    x, P, _ = way(built(m), zs)
    scaled_x, scaled_P, _ = way(built(m, factor), zs)
    assert_allclose(scaled_x, x, rtol=1e-8, atol=1e-8)
    assert_allclose(scaled_P, factor * P, rtol=1e-7)


@pytest.mark.pairwise
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("influence", [Huber(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_the_order_and_the_units_of_sensors_change_nothing(path, way, influence):
    m, zs = 4, recording(4)
    order, unit = np.array([2, 0, 3, 1]), np.array([1e-3, 1.0, 1e3, 1e6])
    x, P, weights = way(built(m, influence=influence), zs)
    other_x, other_P, other = way(built(m, 1.0, order, unit, influence=influence), (zs * unit)[:, order])
    assert_allclose(other_x, x, rtol=1e-7, atol=1e-7)
    assert_allclose(other_P, P, rtol=1e-6, atol=1e-9)
    if weights is not None:
        assert_allclose(other, weights[:, order], rtol=1e-6)


@pytest.mark.parametrize("wild", [1e3, 1e36, 1e150, 1e300])
def test_a_wild_value_leaves_the_weights_of_uncorrelated_sensors_at_1(path, wild):
    kf = RobustKalmanFilter(2, 2)
    kf.x, kf.H, kf.Q = np.zeros(2), np.eye(2), 0.01 * np.eye(2)
    rng = np.random.default_rng(0)
    for _ in range(30):
        kf.predict()
        kf.update(rng.normal(size=2))
    kf.predict()
    before = kf.x.copy()
    kf.update([wild, kf.x[1] + 0.1])
    assert kf.weights[1] == 1.0 and kf.weights[0] < 1e-2
    # A step of at most the threshold in units of this sensor's spread.
    assert abs(kf.x[0] - before[0]) <= 1.345 * kf.spread[0] * np.sqrt(kf.S[0, 0]) * (1 + 1e-9)


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("m", [2, 3, 4])
@pytest.mark.parametrize("fault", ["offset", "noisy"])
def test_one_bad_sensor_among_those_that_see_the_same_costs_little_in_any_units(path, m, fault):
    """Against the filter without it; the Kalman filter has 4 and more."""
    ratios = []
    for seed in range(5):
        rng = np.random.default_rng([seed, m])
        level = np.cumsum(0.1 * rng.normal(size=400))
        zs = level[:, None] + rng.normal(size=(400, m))
        zs[:, 0] += 10.0 if fault == "offset" else 30.0 * rng.normal(size=400)
        found, units = [], np.array([1.0, 1e-3, 1e3, 30.0][:m])
        for used, unit in ((zs * units, units), (zs[:, 1:], np.ones(m - 1))):
            kf = RobustKalmanFilter(1, used.shape[1])
            kf.x, kf.H, kf.Q, kf.P = np.zeros(1), unit[:, None], 0.01 * np.eye(1), 10.0 * np.eye(1)
            kf.R = np.diag(unit**2)
            found.append(np.sqrt(np.mean((kf.batch_filter(used)[0][50:, 0] - level[50:]) ** 2)))
        ratios.append(found[0] / found[1])
    assert np.median(ratios) < 1.6


def test_sensors_that_take_turns_are_told_apart_by_their_rows(path):
    """One is fifty times as noisy as the other; each is judged by its own custom."""
    rng = np.random.default_rng(3)
    rows, sigma = (np.array([[1.0, 0.0]]), np.array([[1.0, 1e-9]])), (5.0, 0.1)
    kf = RobustKalmanFilter(2, 1)
    kf.x, kf.F, kf.Q, kf.H = np.zeros(2), np.eye(2), 1e-6 * np.eye(2), np.array([[0.0, 1.0]])
    for k in range(400):
        kf.predict()
        kf.update(sigma[k % 2] * rng.normal(), H=rows[k % 2])
    spreads = [kf._prior(1, row).memory[0, 1] for row in rows]
    assert spreads[0] / spreads[1] == pytest.approx(50.0, rel=0.4)


def level_and_cycle(**options):
    """A level that wanders, and a slow daily cycle."""
    kf = RobustKalmanFilter(3, 1, **options)
    c, s = np.cos(2 * np.pi / 24), np.sin(2 * np.pi / 24)
    kf.F = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    kf.x, kf.H, kf.P = np.array([100.0, 0.0, 0.0]), np.array([[1.0, 1.0, 0.0]]), np.diag([25.0, 25.0, 25.0])
    kf.Q, kf.R = np.diag([0.06, 1e-8, 1e-8]), 0.25 * np.eye(1)
    return kf


def hours(steps, first, after, seed=4):
    """The cycle's truth, and readings that are 80 too low from `first` on, for a while."""
    rng = np.random.default_rng(seed)
    k = np.arange(steps)
    truth = 100.0 + np.cumsum(0.25 * rng.normal(size=steps)) + 5.0 * np.sin(2 * np.pi * k / 24)
    return truth, truth + 0.5 * rng.normal(size=steps) - 80.0 * ((k >= first) & (k < after))


def test_a_jump_spares_what_the_sensor_hardly_tells(path):
    """Four low readings are a jump of the level; the cycle, known for weeks, stays as certain as it was."""
    truth, zs = hours(504, 500, 504)
    kf = level_and_cycle()
    for k, z in enumerate(zs):
        kf.predict()
        if k == 503:
            cycle, level = kf.P[1:, 1:].copy(), kf.P[0, 0]
        kf.update(z)
    assert abs(kf.x[0] + kf.x[1] - truth[503] + 80.0) < 3.0
    assert_allclose(np.trace(kf.P[1:, 1:]), np.trace(cycle), rtol=0.2)
    assert kf.S[0, 0] > 100.0 * level


@pytest.mark.parametrize("length", [6, 12, 30])
def test_the_first_reading_that_undoes_a_jump_is_believed(path, length):
    truth, zs = hours(600, 500, 500 + length)
    kf = level_and_cycle()
    error = np.array([kf.predict() or kf.update(z) or (kf.H @ kf.x)[0] for z in zs]) - truth
    assert np.abs(error[503 : 500 + length] + 80.0).max() < 5.0
    assert np.abs(error[500 + length :]).max() < 3.0


def test_where_outliers_are_usual_one_reading_undoes_nothing(path):
    """A tenth of the readings is wild: the one that happens to lie where the level was before a jump is one of them."""
    rng = np.random.default_rng(5)
    zs = 100.0 + 0.5 * rng.normal(size=400) + np.where(np.arange(400) % 10 == 5, 40.0, 0.0)
    zs[300:] -= 80.0
    kf = level_and_cycle()
    support.through(kf, zs)
    before = kf.x[0]
    kf.predict()
    kf.update(100.0)
    assert abs(kf.x[0] - before) < 5.0


def test_sensors_that_are_equal_but_for_a_sign_may_stand_in_any_order(path):
    """Their customs are the same; whoever stands first must not win when both are clipped."""
    found, rng = [], np.random.default_rng(6)
    size = np.r_[rng.normal(size=20), 30.0]
    for order in ([0, 1], [1, 0]):
        kf = RobustKalmanFilter(1, 2)
        kf.x, kf.H = np.zeros(1), np.array([[1.0], [1.0]])
        for z in np.column_stack([size, -size]):
            kf.predict()
            kf.update(z[order])
        found.append(kf.x[0])
    assert found[0] == found[1] != 0.0


def coarse_recording(seed=3, step=2.0):
    """Position read in steps and speed; for 20 samples in 60 the position says the same."""
    rng = np.random.default_rng(seed)
    x, truth, zs = np.zeros(2), np.empty((STEPS, 2)), np.empty((STEPS, 2))
    for k in range(STEPS):
        x = truth[k] = np.array([[1.0, 1.0], [0.0, 1.0]]) @ x + np.array([0.05, 0.1]) * rng.normal()
        zs[k] = step * np.round((x[0] + rng.normal()) / step), x[1] + 0.3 * rng.normal()
    for k in (30, 90):
        zs[k : k + 20, 0] = zs[k, 0]
    return truth, zs


def with_speed(cls, unit=1.0):
    kf = cls(2, 2)
    kf.x, kf.F, kf.H = np.zeros(2), np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag([unit, 1.0])
    kf.P, kf.Q, kf.R = 10.0 * np.eye(2), np.outer([0.05, 0.1], [0.05, 0.1]), np.diag([unit**2, 0.09])
    return kf


def test_a_sensor_that_repeats_itself_while_others_move_on_is_not_believed(path):
    recordings = [coarse_recording(seed, step=1e-6) for seed in range(6)]
    ours, theirs = (
        np.mean([(with_speed(cls).batch_filter(zs)[0] - truth)[:, 0] ** 2 for truth, zs in recordings])
        for cls in FILTERS
    )
    assert ours < 0.7 * theirs


def level(step, jump, seed=0, steps=400):
    """A level that wanders slowly, read with noise in steps; it jumps in the middle."""
    rng = np.random.default_rng(seed)
    truth = 0.03 * rng.normal(size=(steps, 1)).cumsum(axis=0) + jump * (np.arange(steps)[:, None] >= steps // 2)
    return truth, step * np.round((truth + rng.normal(size=(steps, 1))) / step)


def square(cls, truth, zs):
    kf = cls(1, 1)
    kf.x, kf.F, kf.H = np.zeros(1), np.eye(1), np.eye(1)
    kf.P, kf.Q, kf.R = 10.0 * np.eye(1), 9e-4 * np.eye(1), np.eye(1)
    return np.mean((kf.batch_filter(zs)[0] - truth) ** 2)


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("step", [1.0, 2.0, 3.0, 5.0, 8.0])
def test_a_sensor_that_reads_in_steps_is_followed_as_the_kalman_filter_follows_it(path, step):
    # Most innovations are far smaller than a step: judged by their median alone, each step would be an outlier.
    ours, theirs = (np.mean([square(c, *level(step, 0.0, s)) for s in range(3)]) for c in FILTERS)
    assert ours < 1.13 * theirs
    ours, theirs = (np.mean([square(c, *level(step, 30.0, s)) for s in range(3)]) for c in FILTERS)
    assert ours <= theirs


def test_repeats_and_steps_are_learnt_alike_on_every_way(monkeypatch):
    support.needs_kernel()
    _, zs = coarse_recording()
    zs[50:52], zs[70, 0] = np.nan, 500.0
    found = [way(with_speed(RobustKalmanFilter), zs) for way in WAYS]
    support.without_kernel(monkeypatch)
    found += [way(with_speed(RobustKalmanFilter), zs) for way in WAYS]
    for x, P, _ in found[1:]:
        assert_allclose(np.reshape(x, (STEPS, 2)), found[0][0], rtol=1e-9, atol=1e-9)
        assert_allclose(P, found[0][1], rtol=1e-9)


@pytest.mark.parametrize("unit", [0.0254, 3.7, 1e6])
def test_in_other_units_a_step_is_the_same_step(path, unit):
    _, zs = coarse_recording()
    expected, _, _ = as_recording(with_speed(RobustKalmanFilter), zs)
    found, _, _ = as_recording(with_speed(RobustKalmanFilter, unit), zs * [unit, 1.0])
    assert_allclose(found, expected, rtol=1e-7, atol=1e-7)
