"""What a swap promises: gains are kept on every path, readings judged by what is typical, little lost to filterpy.

Factors, units and orders cannot matter; recordings of a table are followed about as the Kalman filter follows them, or
much better; a jump opens what its sensor sees, and one reading undoes it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
import support
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose
from support import mover, of_matrices, through

from robust_filterpy import AdaptiveKalmanFilter, Huber, RobustKalmanFilter, StudentT, TukeyBiweight, filter_series
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core
STEPS, SPEED = 120, np.array([[1.0, 1.0], [0.0, 1.0]])


def levels(n, q, r):
    """A function that builds a filter of n levels, each with a sensor."""
    return lambda kind: of_matrices(kind, 1.0, np.eye(n), q, r, 10.0)


# What cannot matter.


def recording(m, seed=1):
    """A straight line with outliers, a gap, and a first sensor that goes wrong for good."""
    rng = np.random.default_rng(seed)
    x, zs, H = np.array([0.0, 0.1]), np.empty((STEPS, m)), sensors_of(m)
    for k in range(STEPS):
        x = SPEED @ x + 0.1 * rng.normal(size=2)
        zs[k] = H @ x + rng.normal(size=m) * np.where(rng.random(m) < 0.1, 30.0, 1.0)
    zs[40:43] = np.nan
    if m > 1:
        zs[60:, 0] += 25.0
    return zs


def sensors_of(m):
    """Of m sensors of position and speed the first two see the same."""
    rows = np.random.default_rng(0).normal(size=(max(m - 2, 0), 2))
    return np.vstack([[1.0, 0.0], [1.0, 0.0], rows])[:m]


def built(m, factor=1.0, order=slice(None), unit=1.0, **options):
    unit = unit * np.ones(m)
    return of_matrices(
        RobustKalmanFilter, SPEED, (unit[:, None] * sensors_of(m))[order], factor * 0.01,
        factor * np.diag(unit[order] ** 2), factor * 10.0, np.zeros(2), **options,
    )  # fmt: skip


def online(kf, zs, correct=None):
    path = []
    for z in zs:
        kf.predict()
        (correct or kf.update)(z)
        path.append((kf.x.copy(), kf.P.copy(), kf.weights.copy()))
    return [np.array(column) for column in zip(*path, strict=True)]


def correlated(kf, zs):
    return online(kf, zs, kf.update_correlated)


def one_by_one(kf, zs):
    parts = online(kf, zs[30:70], lambda z: [kf.update_sequential(i, number) for i, number in enumerate(z)])
    return *parts[:2], None


def steady(kf, zs):
    online(kf, zs[:20])
    path = []
    for z in zs[20:]:
        kf.predict_steadystate()
        kf.update_steadystate(z)
        path.append(kf.x.copy())
    return np.array(path), kf.P, None


def as_series(kf, zs):
    found = filter_series(zs[None], kf.F, kf.H, kf.Q, kf.R, np.ravel(kf.x), kf.P, influence=kf.influence)
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
@pytest.mark.parametrize("way", [*WAYS, correlated, steady, one_by_one])
@pytest.mark.parametrize("influence", [Huber(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
@pytest.mark.parametrize("unit", [[1e-3, 1.0, 1e3, 1e6], [1e-8, 3.7, 0.0254, 1e8]])
def test_the_order_and_the_units_of_sensors_change_nothing(path, way, influence, unit):
    zs, order, unit = recording(4), np.array([2, 0, 3, 1]), np.array(unit)
    # Sensors that are taken as they come have their own order.
    order = np.arange(4) if way is one_by_one else order
    x, P, weights = way(built(4, influence=influence), zs)
    other_x, other_P, other = way(built(4, 1.0, order, unit, influence=influence), (zs * unit)[:, order])
    assert_allclose(other_x, x, rtol=1e-7, atol=1e-7)
    assert_allclose(other_P, P, rtol=1e-6, atol=1e-9)
    if weights is not None:
        assert_allclose(other, weights[:, order], rtol=1e-6)


def test_sensors_that_are_equal_but_for_a_sign_may_stand_in_any_order(path):
    """What is typical of them is the same; whoever stands first must not win when both are clipped."""
    found, size = [], np.r_[np.random.default_rng(6).normal(size=20), 30.0]
    for signs in ([1.0, -1.0], [-1.0, 1.0]):
        kf = of_matrices(RobustKalmanFilter, 1.0, np.ones((2, 1)))
        through(kf, np.outer(size, signs))
        found.append(kf.x[0, 0])
    assert found[0] == found[1] != 0.0


def test_sensors_that_take_turns_are_told_apart_by_their_rows(path):
    """One is fifty times as noisy as the other; each is judged by what is typical of it."""
    rng, rows, sigma = np.random.default_rng(3), (np.array([[1.0, 0.0]]), np.array([[1.0, 1e-9]])), (5.0, 0.1)
    kf = of_matrices(RobustKalmanFilter, 1.0, [[0.0, 1.0]], 1e-6)
    for k in range(400):
        support.predict_and_update(kf, sigma[k % 2] * rng.normal(), H=rows[k % 2])
    spreads = [kf._prior(1, row).memory[0, 1] for row in rows]
    assert spreads[0] / spreads[1] == pytest.approx(50.0, rel=0.4)


# Position read in steps, and speed.


def coarse(g, step=2.0):
    """For 20 samples in 60 the position says the same."""
    x, truth, zs = np.zeros(2), np.empty((STEPS, 2)), np.empty((STEPS, 2))
    for k in range(STEPS):
        x = truth[k] = SPEED @ x + np.array([0.05, 0.1]) * g.normal()
        zs[k] = step * np.round((x[0] + g.normal()) / step), x[1] + 0.3 * g.normal()
    for k in (30, 90):
        zs[k : k + 20, 0] = zs[k, 0]
    return with_speed, truth[:, :1], zs


def with_speed(kind, unit=1.0):
    Q, R = np.outer([0.05, 0.1], [0.05, 0.1]), np.diag([unit**2, 0.09])
    return of_matrices(kind, SPEED, np.diag([unit, 1.0]), Q, R, 10.0)


def test_repeats_and_steps_are_learnt_alike_on_every_way_and_in_other_units(monkeypatch):
    support.needs_kernel()
    _, _, zs = coarse(np.random.default_rng(3))
    expected = as_recording(with_speed(RobustKalmanFilter), zs)[0]
    for unit in (0.0254, 3.7, 1e6):
        other = as_recording(with_speed(RobustKalmanFilter, unit), zs * [unit, 1.0])[0]
        assert_allclose(other, expected, rtol=1e-7, atol=1e-7)
    zs[50:52], zs[70, 0] = np.nan, 500.0
    found = [way(with_speed(RobustKalmanFilter), zs) for way in WAYS]
    support.without_kernel(monkeypatch)
    found += [way(with_speed(RobustKalmanFilter), zs) for way in WAYS]
    for x, P, _ in found[1:]:
        assert_allclose(np.reshape(x, (STEPS, 2)), found[0][0][..., 0], rtol=1e-9, atol=1e-9)
        assert_allclose(P, found[0][1], rtol=1e-9)


# What is left of the error of filterpy's filter, or added to it. Of a generator a drawing makes a function that builds
# a filter of any kind, the truth and the readings.


def bouncing(g):
    """A ball whose speed jumps, which no sensor sees, and Q is next to nothing."""
    dt = 1.0 / 30.0
    t, w = np.arange(60) * dt, np.array([dt * dt / 2.0, dt, 1.0])
    truth = 100.0 + 200.0 * t + 300.0 * t**2 - 1150.0 * np.maximum(t - 1.0, 0.0)
    F, P = np.array([[1.0, dt, dt * dt / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]), np.diag([10.0, 10.0, 1.0])
    zs = truth + 1.5 * g.normal(size=60)
    return lambda kind: of_matrices(kind, F, np.eye(1, 3), np.outer(w, w), 5.0, P), truth[:, None], zs


def box(g):
    """SORT's numbers: the ratio of the sides is known a thousand times better than R and Q say."""
    F = np.eye(7)
    F[[0, 1, 2], [4, 5, 6]] = 1.0
    speed = np.cumsum(0.3 * g.normal(size=(400, 2)), axis=0) + g.uniform(-8, 8, 2)
    truth = np.column_stack((500.0 + np.cumsum(speed, axis=0), np.tile([3000.0, 0.4], (400, 1))))
    zs = truth + g.normal(size=(400, 4)) * [2.0, 2.0, 150.0, 0.01]
    Q, R, P = np.diag([1.0, 1, 1, 1, 0.01, 0.01, 1e-4]), np.diag([1.0, 1, 10, 10]), np.diag([10.0] * 4 + [1e4] * 3)
    x = np.r_[zs[0], np.zeros(3)][:, None]
    return lambda kind: of_matrices(kind, F, np.eye(4, 7), Q, R, P, x), truth[:, :2], zs


def ramp(slope):
    """A model without a slope is always behind: large innovations, small changes, and the sensor is not to blame.

    Of ramps of five deviations a step and more this does not hold: there it is chance.
    """

    def drawn(g):
        truth = slope * np.arange(300.0)[:, None]
        return levels(1, 0.01, 1.0), truth, truth + g.normal(size=(300, 1))

    return drawn


def repeats(step, sigma, drift, rests):
    """Noise that is in between the steps is not seen; r fell by decades with each dozen equal readings."""

    def drawn(g):
        moves = np.where(np.arange(400)[:, None] < rests, 0.0, drift * g.normal(size=(400, 2)))
        truth = np.cumsum(moves, axis=0) + 0.3
        zs = truth + sigma * g.normal(size=(400, 2))
        zs[:rests] = 0.0
        zs = step * np.round(zs / step) if step else zs
        return levels(2, drift**2, sigma**2 + step**2 / 12.0), truth, zs

    return drawn


def in_steps(step, jump):
    """A level that wanders slowly, and jumps in the middle; most innovations are far smaller than a step."""

    def drawn(g):
        truth = 0.03 * g.normal(size=(400, 1)).cumsum(axis=0) + jump * (np.arange(400)[:, None] >= 200)
        return levels(1, 9e-4, 1.0), truth, step * np.round((truth + g.normal(size=(400, 1))) / step)

    return drawn


def driven(seen, sensors=1):
    """A position whose speed white noise moves, and what the sensors make of it and of their noise."""

    def drawn(g):
        F, Q = support.white(1.0, 1e-2)
        x = support.states(F, np.vstack([np.zeros(2), g.multivariate_normal(np.zeros(2), Q, 399)]))
        zs = seen(x[:, :1], g.normal(size=(400, sensors)))
        return lambda kind: mover(kind, H=[[1.0, 0.0]] * sensors, q=1e-2), x[:, :1], zs

    return drawn


def held(truth, noise):
    return (truth + noise)[np.arange(400) // 5 * 5]


def colored(memory):
    def seen(truth, noise):
        for k in range(1, 400):
            noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
        return truth + noise

    return seen


def gone_off(g):
    """One of two sensors is 8 off from the hundredth reading on."""
    x = np.cumsum(np.cumsum(np.sqrt(1e-3) * g.normal(size=600)))[:, None]
    zs = x + g.normal(size=(600, 2)) + np.outer(np.arange(600) >= 100, [0.0, 8.0])
    return lambda kind: mover(kind, H=((1.0, 0.0), (1.0, 0.0))), x, zs


def jumping(size, every, share=0.0):
    def drawn(g):
        x = np.cumsum(np.cumsum(np.sqrt(1e-3) * g.normal(size=1000)))
        x += np.cumsum(np.where(np.arange(1000) % every == 0, size * g.choice([-1.0, 1.0], 1000), 0.0))
        zs = x + np.where(g.random(1000) < share, 10.0, 1.0) * g.normal(size=1000)
        return lambda kind: mover(kind, x=x[0]), x[:, None], zs

    return drawn


class Row(NamedTuple):
    """A filter's mean square error over the Kalman filter's is less than `most`, after so many steps."""

    kind: type
    draw: Callable
    most: float
    seeds: range
    after: int = 0
    #: Of each recording, not of all of them together.
    each: bool = False


FOLLOWED = {
    "a ball that bounces": Row(AdaptiveKalmanFilter, bouncing, 4.0, range(60), 5),
    # With one scale of Q for all of the state it was 50 and more.
    "a box whose shape hardly moves": Row(AdaptiveKalmanFilter, box, 1.5, range(5), 20, each=True),
    **{f"a level on a slope of {slope}": Row(AdaptiveKalmanFilter, ramp(slope), 0.4, range(8), 50, each=True)
       for slope in (0.5, 1.0, 2.0)},
    "coarse steps": Row(AdaptiveKalmanFilter, repeats(1.0, 0.3, 0.02, 0), 1.3, range(4)),
    "coarse steps of a state that moves": Row(AdaptiveKalmanFilter, repeats(1.0, 0.2, 0.1, 0), 1.3, range(4)),
    "a sensor that reads 0 at rest": Row(AdaptiveKalmanFilter, repeats(0.0, 1.0, 0.2, 150), 1.6, range(4)),
    **{f"read in steps of {step}": Row(RobustKalmanFilter, in_steps(step, 0.0), 1.13, range(3))
       for step in (1.0, 2.0, 3.0, 5.0, 8.0)},
    **{f"read in steps of {step}, with a jump": Row(RobustKalmanFilter, in_steps(step, 30.0), 1.0 + 1e-12, range(3))
       for step in (1.0, 2.0, 3.0, 5.0, 8.0)},
    "a sensor that repeats itself while others move": Row(RobustKalmanFilter, lambda g: coarse(g, 1e-6), 0.7, range(6)),
    "the last reading is held": Row(RobustKalmanFilter, driven(held), 1.21, range(20, 26), 50),
    "the last reading is held, adaptive": Row(AdaptiveKalmanFilter, driven(held), 1.44, range(20, 26), 50),
    "colored noise of two": Row(RobustKalmanFilter, driven(colored(0.9), 2), 1.254, range(20, 26), 50),
    "colored noise of four": Row(RobustKalmanFilter, driven(colored(0.98), 4), 1.488, range(20, 26), 50),
    "one of two sensors has gone off": Row(AdaptiveKalmanFilter, gone_off, 0.0289, range(4, 7)),
    # How many readings a jump needs is learnt.
    "jumps": Row(AdaptiveKalmanFilter, jumping(30.0, 200), 0.9025, range(10, 16)),
    "jumps and outliers": Row(AdaptiveKalmanFilter, jumping(30.0, 200, 0.05), 1.1025, range(10, 16)),
    "small jumps": Row(AdaptiveKalmanFilter, jumping(8.0, 100), 0.81, range(10, 16)),
}  # fmt: skip


def squares(kind, row):
    """The mean square of the error in each recording."""
    errors = []
    for seed in row.seeds:
        build, truth, zs = row.draw(np.random.default_rng(seed))
        errors.append(np.mean((through(build(kind), zs)[:, : truth.shape[1]] - truth)[row.after :] ** 2))
    return np.array(errors)


@pytest.mark.parametrize("name", FOLLOWED)
def test_it_follows_almost_as_the_kalman_filter_or_much_better(path, name):
    row = FOLLOWED[name]
    ours, theirs = squares(row.kind, row), squares(KalmanFilter, row)
    assert (ours < row.most * theirs).all() if row.each else ours.sum() < row.most * theirs.sum()


@pytest.mark.parametrize("length, far", [(1, 300.0), (1, 1e300), (3, 1e4)])
def test_after_jumps_no_outlier_that_is_farther_than_they_went_is_believed(length, far):
    build, x, zs = jumping(30.0, 200)(np.random.default_rng(3))
    zs[950 : 950 + length] += far
    assert np.abs(through(build(AdaptiveKalmanFilter), zs)[900:, :1] - x[900:]).max() < 10.0


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("m", [2, 3, 4])
@pytest.mark.parametrize("fault", ["offset", "noisy"])
def test_one_bad_sensor_among_those_that_see_the_same_costs_little_in_any_units(path, m, fault):
    """Against the filter without it; the Kalman filter has 4 and more."""
    ratios, units = [], np.array([1.0, 1e-3, 1e3, 30.0][:m])
    for seed in range(5):
        rng = np.random.default_rng([seed, m])
        truth = np.cumsum(0.1 * rng.normal(size=400))
        zs = truth[:, None] + rng.normal(size=(400, m))
        zs[:, 0] += 10.0 if fault == "offset" else 30.0 * rng.normal(size=400)
        with_it, without = (
            of_matrices(RobustKalmanFilter, 1.0, unit[:, None], 0.01, np.diag(unit**2), 10.0)
            for unit in (units, np.ones(m - 1))
        )
        paths = with_it.batch_filter(zs * units)[0], without.batch_filter(zs[:, 1:])[0]
        errors = [np.mean((path[50:, 0, 0] - truth[50:]) ** 2) for path in paths]
        ratios.append(np.sqrt(errors[0] / errors[1]))
    assert np.median(ratios) < 1.6


# A level that wanders, and a slow daily cycle.


def level_and_cycle():
    c, s = np.cos(2 * np.pi / 24), np.sin(2 * np.pi / 24)
    F, Q = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]), np.diag([0.06, 1e-8, 1e-8])
    return of_matrices(RobustKalmanFilter, F, [[1.0, 1.0, 0.0]], Q, 0.25, 25.0, [[100.0], [0.0], [0.0]])


def hours(steps, first, after):
    """The cycle's truth, and readings that are 80 too low from `first` on, for a while."""
    rng, k = np.random.default_rng(4), np.arange(steps)
    truth = 100.0 + np.cumsum(0.25 * rng.normal(size=steps)) + 5.0 * np.sin(2 * np.pi * k / 24)
    return truth, truth + 0.5 * rng.normal(size=steps) - 80.0 * ((k >= first) & (k < after))


def test_a_jump_spares_what_the_sensor_hardly_tells(path):
    """Four low readings are a jump of the level; the cycle, known for weeks, stays as certain as it was."""
    (truth, zs), kf = hours(504, 500, 504), level_and_cycle()
    through(kf, zs[:503])
    kf.predict()
    cycle, level = np.trace(kf.P[1:, 1:]), kf.P[0, 0]
    kf.update(zs[503])
    assert abs(kf.x[0] + kf.x[1] - truth[503] + 80.0) < 3.0
    assert_allclose(np.trace(kf.P[1:, 1:]), cycle, rtol=0.2)
    assert kf.S[0, 0] > 100.0 * level


@pytest.mark.parametrize("length", [6, 12, 30])
def test_the_first_reading_that_undoes_a_jump_is_believed(path, length):
    truth, zs = hours(600, 500, 500 + length)
    error = through(level_and_cycle(), zs)[:, :2].sum(axis=1) - truth
    assert np.abs(error[503 : 500 + length] + 80.0).max() < 5.0
    assert np.abs(error[500 + length :]).max() < 3.0


def test_where_outliers_are_usual_one_reading_undoes_nothing(path):
    """A tenth of the readings is wild: the one that happens to lie where the level was before a jump is one of them."""
    zs = 100.0 + 0.5 * np.random.default_rng(5).normal(size=400) + np.where(np.arange(400) % 10 == 5, 40.0, 0.0)
    zs[300:] -= 80.0
    kf = level_and_cycle()
    before = through(kf, zs)[-1, 0]
    assert abs(through(kf, [100.0])[-1, 0] - before) < 5.0
