"""Gaps, long steps, fill values, jumps: what the default and the adaptive filter do with recordings of other people."""

from itertools import product

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose
from support import mover, of_matrices, predict_and_update, states, through, white

from robust_filterpy import AdaptiveKalmanFilter, RobustKalmanFilter
from robust_filterpy.filters import StuckSensorWarning

pytestmark = pytest.mark.usefixtures("path")
BOTH = pytest.mark.parametrize("kind", [RobustKalmanFilter, AdaptiveKalmanFilter])
stuck = pytest.mark.filterwarnings("ignore::robust_filterpy.filters.StuckSensorWarning")


def step(kf, z):
    predict_and_update(kf, z)
    return kf.x[0, 0]


def settled(R=1.0, seed=0, steps=60):
    """The default and the Kalman filter after the same ordinary readings, and the Kalman filter's state in both."""
    rng, pair = np.random.default_rng(seed), [mover(kind, R) for kind in (RobustKalmanFilter, KalmanFilter)]
    zs = np.cumsum(0.03 * rng.normal(size=steps)) + rng.normal(size=steps)
    for kf in pair:
        through(kf, zs)
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
    for size in (0.5, 1000):
        ours, theirs = settled(R)
        for kf in (ours, theirs):
            event(kf, size)
        z = theirs.x[0, 0] + 3.0 * np.sqrt((theirs.H @ theirs.P @ theirs.H.T + theirs.R)[0, 0])
        before = theirs.x[0, 0]
        ours.update(z)
        theirs.update(z)
        missed.append(abs(ours.x[0, 0] - theirs.x[0, 0]) / abs(theirs.x[0, 0] - before))
    assert missed[1] < 1e-12 and (R > 1.0 or missed[0] > 0.05)


@pytest.mark.pairwise
@BOTH
@pytest.mark.parametrize("length", [1, 4, 7, 8, 30, 700])
@pytest.mark.parametrize("value", [-9999.0, 0.0, 65535.0, 1e30])
def test_a_run_of_fill_values_is_missing_and_is_said_once(kind, value, length, recwarn):
    rng = np.random.default_rng(2)
    x = 20.0 + np.cumsum(0.05 * rng.normal(size=960))
    zs = np.round(x + 0.1 * rng.normal(size=960), 2)
    zs[200 : 200 + length] = value
    gaps = zs.copy()
    gaps[200 : 200 + length] = np.nan
    ours, theirs, missing = (
        np.abs(through(mover(kind, 0.01, q=1e-4, P=100.0, x=20.0), readings)[200:, 0] - x[200:])
        for kind, readings in ((kind, zs), (KalmanFilter, zs), (kind, gaps))
    )
    # Nothing foresees a gap of hundreds.
    assert ours.max() < max(0.1 * theirs.max(), 1.05 * missing.max()) and ours[-60:].max() < 0.5
    assert sum(w.category is StuckSensorWarning for w in recwarn) == (length > 1)


@stuck
@BOTH
@pytest.mark.parametrize("coarse", [0.01, 0.5, 1.0])
def test_a_sensor_at_rest_that_truly_steps_is_followed(kind, coarse):
    zs = np.round(np.where(np.arange(600) < 550, 20.0, 35.0) / coarse) * coarse
    zs[:300] += np.round(0.3 * np.random.default_rng(3).normal(size=300) / coarse) * coarse
    assert np.abs(through(mover(kind, 0.04, q=1e-4, x=20.0), zs)[570:, 0] - 35.0).max() < 1.0


@BOTH
def test_a_step_of_what_is_measured_leaves_the_speed(kind):
    """filterpy's is off by 7.3."""
    for seed in range(4):
        kf, noise = mover(kind, 0.09, h=0.1, q=1.0), 0.05 * np.random.default_rng(seed).normal(size=400)
        path = through(kf, 0.7 * np.arange(400) + 5.0 * (np.arange(400) >= 200) + noise)
        worst = np.abs(path[190:, 1] - 7.0).max()
        assert worst < (0.5 if kind is RobustKalmanFilter else 1.0) and abs(path[-1, 0] - 284.3) < 0.15


def test_what_a_jump_opens_does_not_depend_on_the_order_of_the_sensors():
    H, rng = np.array([[1.0, 0.2], [0.3, 1.0]]), np.random.default_rng(7)
    pair, noise = [mover(RobustKalmanFilter) for _ in range(2)], rng.normal(size=(70, 2))
    for kf, order in zip(pair, ([0, 1], [1, 0]), strict=True):
        kf.dim_z, kf.H, kf.R = 2, H[order], np.eye(2)
        for k, y in enumerate(noise):
            step(kf, (y + (300.0 if k >= 60 else 0.0))[order])
            if k == 63:
                assert kf.S[0, 0] > 1e3
    assert_allclose(pair[0].x, pair[1].x, rtol=1e-9)
    assert_allclose(pair[0].P, pair[1].P, rtol=1e-9)


@BOTH
@pytest.mark.parametrize("q, wild", [*product((1.0, 10.0, 100.0, 1e4), (0.0, 30.0)), (1e11, 0.0)])
def test_readings_that_say_more_than_the_state_are_followed_and_their_outliers_are_not(kind, q, wild):
    """A sensor that is exact for how the point moves: H P H' is 3 to 3e10 times R, all of it as it is given."""
    F, root, ratios = white(1.0, 0.0)[0], np.sqrt(q) * np.array([0.5, 1.0]), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = states(F, np.outer(rng.normal(size=300), root), np.zeros(2))[:, 0]
        zs = truth + rng.normal(size=300) + (rng.random(300) < 0.05) * wild * max(root[1], 1.0) * rng.normal(size=300)
        both = (of_matrices(cls, F, [[1.0, 0.0]], np.outer(root, root), 1.0, 10.0) for cls in (kind, KalmanFilter))
        ours, theirs = (np.linalg.norm((through(kf, zs)[:, 0] - truth)[50:]) for kf in both)
        ratios.append(ours / theirs)
    assert np.exp(np.mean(np.log(ratios))) < (0.3 if wild else 1.06)


def test_a_long_step_among_the_first_is_not_what_is_usual():
    pair = [mover(kind, 25.0, q=0.1) for kind in (RobustKalmanFilter, KalmanFilter)]
    for h, z in ((1.0, 2.0), (1.0, -1.5), (20.0, 17.0), (20.0, -28.0)):
        for kf in pair:
            F, Q = white(h, 0.1)
            kf.predict(F=F, Q=Q)
            kf.update(z)
    assert_allclose(pair[0].x[0], pair[1].x[0], atol=1.0)


def test_where_the_growth_of_P_varies_an_outlier_beyond_all_such_readings_is_clipped():
    rng, kf = np.random.default_rng(0), mover(RobustKalmanFilter)
    for k in range(401):
        kf.predict()
        # One prior in five is much less certain than usual, as where F is linearized at each estimate.
        kf.P[0, 0] += 100.0 if k % 5 == 0 else 0.0
        kf.update(rng.normal() if k < 400 else 50.0)
    assert abs(kf.x[0, 0]) < 15.0


def after_jumps(sizes, seed=0, every=60):
    """The default after jumps of some sizes, and where the position is then."""
    rng, kf, level = np.random.default_rng(seed), mover(RobustKalmanFilter), 0.0
    for size in (*sizes, 0.0):
        through(kf, level + rng.normal(size=every))
        level += size
    return kf, level


def test_where_jumps_are_usual_the_first_reading_of_one_is_believed():
    """The first takes four; an outlier far beyond jumps is bounded as ever, one as far as they go is undone at once."""
    for jumps, believed in (((), False), ((30.0, 30.0, 30.0), True)):
        kf, level = after_jumps(jumps)
        assert (abs(step(kf, level + 28.0) - level - 28.0) < 3.0) == believed
        speed = kf.x[1, 0]
        assert abs(step(kf, level) - level) < 3.0 and abs(kf.x[1, 0] - speed) < 0.2
    for far in (300.0, 1e4, 1e300):
        kf, level = after_jumps((30.0, -30.0, 30.0, -30.0))
        assert abs(step(kf, level + far) - level) < 3.0


def test_where_runs_come_to_nothing_jumps_need_as_many_readings_as_ever():
    rng, kf, k = np.random.default_rng(2), mover(RobustKalmanFilter), np.arange(400)
    through(kf, rng.normal(size=400) + 30.0 * ((k > 200) & (k % 10 == 5)) + 30.0 * ((k >= 100) & (k < 140)))
    assert abs(step(kf, 30.0)) < 5.0 and abs(step(kf, 30.0)) < 5.0


HARDLY, TWICE = ((1.0, 0.0, 1e-3),), ((1.0, 0.0), (1.0, 0.0))


def test_a_state_that_its_sensor_hardly_sees_keeps_a_bounded_covariance_through_many_jumps():
    rng, kf = np.random.default_rng(0), mover(AdaptiveKalmanFilter, H=HARDLY, P=1.0)
    widest = []
    for jump in range(10):
        through(kf, 100.0 * (jump % 2) + rng.normal(size=60))
        widest.append(kf.P.max())
        assert np.linalg.eigvalsh(kf.P).min() > 0.0
    # A reading of 100 in a millionth of the variance, by a third.
    assert max(widest) < 1.2e9


def test_what_was_refused_on_the_way_to_a_jump_is_an_outlier_in_no_class_any_more():
    for seed in range(3):
        zs = np.where(np.arange(420) >= 400, 30.0, 0.0) + np.random.default_rng(seed).normal(size=420)
        kf = mover(AdaptiveKalmanFilter)
        noises = [(through(kf, part), kf.noise_learnt)[1] for part in np.split(zs, [400, 403])]
        share = [float(noise.contamination[0]) for noise in noises]
        assert share[1] > share[0] + 0.01 and abs(share[2] - share[0]) < 0.002
        assert noises[2].scale_ratio[0] < 7.0


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("top", [20.0, 140.0, 290.0])
@pytest.mark.parametrize("H", [[[1.0], [1.0]], [[1.0, 0.0], [0.0, 1.0]]])
def test_no_recording_is_lost_to_outliers_of_any_size(H, top):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        kf, zs = AdaptiveKalmanFilter(len(H[0]), 2), rng.normal(size=(300, 2))
        kf.H, kf.Q = np.array(H), 0.01 * kf.Q
        wild = rng.choice([-1.0, 1.0], size=zs.shape) * 10.0 ** rng.uniform(0.0, top, size=zs.shape)
        kf.batch_filter(np.where(rng.random(zs.shape) < 0.4, wild, zs))
        assert np.linalg.eigvalsh(kf.P).min() > 0.0


def wrong_by(c, unit=1.0, sensors=1, passed=False, at_first=()):
    """P, Q and R with one wrong factor: the errors of 400 steps, in the first unit, and the filter."""
    rng, x, (F, Q) = np.random.default_rng(3), np.zeros(2), white(1.0, 1e-3)
    kf = mover(AdaptiveKalmanFilter, c * unit**2, H=TWICE[:sensors], q=c * unit**2 * 1e-3, P=c * unit**2 * 10.0)
    kf.x[0], errors = 0.5 * unit, []
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
    right, wrong = (np.sqrt(np.mean(wrong_by(factor, **options)[0][150:] ** 2)) for factor in (1.0, c))
    assert wrong < 1.05 * right


@pytest.mark.parametrize("c", [1e-8, 1e8])
def test_what_is_learned_of_r_and_q_has_the_factor_in_it(c):
    (_, one), (_, other) = wrong_by(1.0), wrong_by(c)
    assert_allclose(other.R_learnt, one.R_learnt, rtol=0.3)
    assert 0.1 < c * other.process_scale[0] / one.process_scale[0] < 10.0


def test_no_reading_moves_the_estimate_beyond_bounds_while_the_factor_is_looked_for():
    errors, _ = wrong_by(1e-6, at_first=(0.3, -0.2, 0.4, 1e300))
    assert np.isfinite(errors).all() and np.abs(errors[4:]).max() < 20.0


@pytest.mark.parametrize("off, speed, P", [
    (500.0, 1.0, (1e3, 1e3)), (500.0, 1.0, (1.0, 1.0)), (1e6, 1.0, (1e3, 1e3)), (60.0, 1.0, (1.0, 1.0)),
    (300.0, 15.0, (9.0, 9.0)), (300.0, 15.0, (9.0, 1e3)),
])  # fmt: skip
def test_a_program_that_starts_at_zero_far_from_its_first_reading_is_followed_at_once(off, speed, P):
    """Programs begin with x = 0 and a P that does not say how far that may be: nothing is an outlier yet."""
    truth = off + speed * np.arange(12.0)
    zs = truth + np.random.default_rng(1).normal(size=12)
    errors = []
    for kind in (KalmanFilter, AdaptiveKalmanFilter):
        kf = mover(kind, 1.0)
        kf.P = np.diag(P)
        errors.append(np.abs([step(kf, z) for z in zs] - truth))
    # One reading cannot tell what of it is speed.
    assert abs(kf.x[1, 0] - speed) < 3.0
    assert errors[1].max() < 4.0 and errors[1].max() < 1.5 * errors[0].max() + 1.0


def test_a_first_reading_that_was_wild_is_left_with_the_next_ones():
    zs = np.random.default_rng(2).normal(size=12)
    zs[0] = 1e6
    kf = mover(AdaptiveKalmanFilter, 1.0)
    assert np.abs([step(kf, z) for z in zs][2:]).max() < 4.0


@pytest.mark.parametrize("q", [0.1, 10.0])
def test_a_vehicle_that_stops_and_goes_is_no_series_of_outliers(q, path):
    """Learned as runs of outliers, which they are not, its starts cost 2.0 and 2.4 of filterpy's error."""
    errors = []
    for seed in range(3):
        rng, k = np.random.default_rng(seed), np.arange(600)
        x = np.cumsum(np.where(k % 60 < 30, rng.uniform(5.0, 15.0, 10)[k // 60], 0.0))
        filters = [mover(kind, 4.0, h=1.0, q=q) for kind in (KalmanFilter, AdaptiveKalmanFilter)]
        zs = x + 2.0 * rng.normal(size=600)
        errors.append([np.sqrt(np.mean((through(kf, zs)[:, 0] - x) ** 2)) for kf in filters])
    ratio = np.exp(np.log(errors).mean(axis=0) @ [-1.0, 1.0])
    assert ratio < 1.7, ratio
