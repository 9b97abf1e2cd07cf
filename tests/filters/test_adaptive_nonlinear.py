"""Nonlinear filters that learn their noise: on a linear model the linear one's numbers, on a radar what it promises."""

import copy
import pickle

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import MerweScaledSigmaPoints
from support import FILTERPY_2, load, polar, polar_jacobian, random_problem, simulate, wrapped

from robust_filterpy import Huber, Learnt, RobustKalmanFilter
from robust_filterpy.filters import RobustCubatureKalmanFilter, RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter

DT = 0.1
F = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
Q = np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
R = np.diag([0.25, 1e-4])
START = np.array([30.0, -2.0, 20.0, 1.0])
CLASSES = [RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter, RobustCubatureKalmanFilter]


def made(cls, n, m, fx, hx, **options):
    """Return a filter of any of the kinds, by default one that learns its noise."""
    options.setdefault("noise", "learnt")
    if issubclass(cls, RobustExtendedKalmanFilter):
        return cls(n, m, **options)
    if issubclass(cls, RobustUnscentedKalmanFilter):
        return cls(n, m, DT, hx, fx, MerweScaledSigmaPoints(n, 0.5, 2.0, 3.0 - n), **options)
    return cls(n, m, DT, hx, fx, **options)


def radar(cls, factor=1.0, **options):
    kf = made(cls, 4, 2, lambda x, dt: F @ x, polar, **options)
    kf.residual_z = wrapped
    kf.x, kf.P, kf.Q, kf.R = START.copy(), np.diag([4.0, 1.0, 4.0, 1.0]), Q.copy(), factor * R
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.F = F.copy()
    return kf


def returns(steps, seed, contamination=0.0):
    rng = np.random.default_rng(seed)
    x, truth, zs = START.copy(), np.empty((steps, 4)), np.empty((steps, 2))
    for k in range(steps):
        # Back to where it came from, so that the radar always sees it well.
        x = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=4) - 0.02 * DT * np.array([0, x[0] - 30.0, 0, x[2] - 20.0])
        truth[k] = x
        zs[k] = polar(x) + np.sqrt(np.diag(R)) * rng.normal(size=2) * np.where(rng.random(2) < contamination, 20.0, 1.0)
    return truth, zs


def step(kf, z):
    kf.predict()
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.update(z, polar_jacobian, polar, residual=wrapped)
    else:
        kf.update(z)


def error(kf, truth, zs, late=250):
    found = []
    for z in zs:
        step(kf, z)
        found.append(np.ravel(kf.x)[[0, 2]].copy())
    return np.sqrt(np.mean(np.square(found - truth[:, [0, 2]])[late:]))


@pytest.mark.skipif(not FILTERPY_2, reason="filterpy 1.4.5 corrects by sigma points without Q")
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("cls, dims", [(cls, (1, 1)) for cls in CLASSES] + [(cls, (3, 2)) for cls in CLASSES[:2]])
def test_on_a_linear_model_they_are_the_linear_filter(cls, dims, grouping):
    problem = random_problem(7, *dims)
    zs, _ = simulate(problem, 60, seed=7, contamination=0.2)
    zs[5, 0] = zs[9] = np.nan
    linear = load(RobustKalmanFilter(*dims, noise="learnt", grouping=grouping), problem)
    kf = made(cls, *dims, lambda x, dt: problem.F @ x, lambda x: problem.H @ x, grouping=grouping)
    kf.x, kf.P, kf.Q, kf.R = np.ravel(problem.x).astype(float), problem.P.copy(), problem.Q.copy(), problem.R.copy()
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.F = problem.F.copy()
    # filterpy's cubature filter corrects by the sigma points from before Q was added.
    if cls is RobustCubatureKalmanFilter:
        kf.Q = np.zeros_like(problem.Q)
        linear.Q = np.zeros_like(problem.Q)
    for z in zs:
        linear.predict(), kf.predict()
        linear.update(z)
        if isinstance(kf, RobustExtendedKalmanFilter):
            kf.update(z, lambda x: problem.H, lambda x: problem.H @ x)
        else:
            kf.update(z)
        for name in ("x", "P", "learnt", "log_likelihood", "weights", "S", "outlier_probability"):
            ours, theirs = getattr(kf, name), getattr(linear, name)
            if name == "learnt" and grouping != "joint":
                # What a nonlinear filter takes for readings are innovations.
                ours, theirs = ours[:, :-2], theirs[:, :-2]
            np.testing.assert_allclose(np.ravel(ours), np.ravel(theirs), rtol=1e-6, atol=1e-9, err_msg=name)


def test_sensors_that_fail_together_count_once_among_the_outliers_of_a_nonlinear_filter_too():
    problem = random_problem(7, 3, 3)
    linear = load(RobustKalmanFilter(3, 3, noise="learnt", grouping=((0, 1),)), problem)
    kf = RobustExtendedKalmanFilter(3, 3, noise="learnt", grouping=((0, 1),))
    kf.x, kf.P, kf.Q, kf.R = np.ravel(problem.x).astype(float), problem.P.copy(), problem.Q.copy(), problem.R.copy()
    kf.F, probable = problem.F.copy(), 0
    for z in simulate(problem, 40, seed=7, contamination=0.2)[0]:
        linear.predict(), kf.predict()
        linear.update(z)
        kf.update(z, lambda x: problem.H, lambda x: problem.H @ x)
        assert kf.outlier_probability == pytest.approx(linear.outlier_probability, rel=1e-6, abs=1e-9)
        probable += 0.01 < kf.outlier_probability < 0.99
    assert probable > 3


@pytest.mark.parametrize("cls", CLASSES)
def test_a_wrong_r_costs_little_and_outliers_less_than_by_huber_told_all(cls):
    for seed in range(2):
        truth, zs = returns(600, seed, contamination=0.1)
        right = error(radar(cls), truth, zs)
        assert right < error(radar(cls, noise=None), truth, zs)
        for factor in (0.01, 100.0):
            kf = radar(cls, factor)
            assert error(kf, truth, zs) < 1.15 * right
            assert np.all((0.5 < kf.R_learnt.diagonal() / R.diagonal()) & (kf.R_learnt.diagonal() / R.diagonal() < 2.0))


@pytest.mark.parametrize("cls", CLASSES)
@pytest.mark.parametrize("jump", [5.0, 50.0])
def test_after_a_jump_of_the_state_they_come_back(cls, jump):
    truth, zs = returns(400, 7, contamination=0.1)
    moved = truth[250:] + [jump, 0.0, -jump / 4.0, 0.0]
    truth, zs = np.vstack((truth[:250], moved)), np.vstack((zs[:250], [polar(x) for x in moved]))
    assert error(radar(cls), truth, zs, late=340) < 1.0


def test_what_curvature_adds_to_the_innovation_is_no_noise():
    """A squared state that is hardly known: S is fifty times R at most steps."""
    rng = np.random.default_rng(10003)
    kf = made(RobustUnscentedKalmanFilter, 1, 1, lambda x, dt: 0.5 * x, lambda x: x**2)
    kf.Q, kf.R = np.eye(1), 0.04 * np.eye(1)
    x, excess = 0.0, []
    for _ in range(1500):
        x = 0.5 * x + rng.normal()
        kf.predict()
        kf.update(np.array([x**2 + 0.2 * rng.normal()]))
        excess.append(kf.S[0, 0] / 0.04)
    assert np.median(excess) > 30.0
    assert kf.R_learnt[0, 0] < 30.0 * 0.04


@pytest.mark.parametrize("cls", CLASSES)
def test_a_refused_measurement_teaches_nothing(cls):
    kf = radar(cls)
    step(kf, polar(START))
    before = {name: copy.deepcopy(value) for name, value in kf.__dict__.items() if not callable(value)}
    with pytest.raises(ValueError):
        step_without_prediction(kf, np.array([np.inf, 0.0]))
    for name, value in before.items():
        np.testing.assert_equal(getattr(kf, name), value) if isinstance(value, (np.ndarray, float)) else None
    with pytest.raises(AttributeError, match="noise="):
        kf.influence = Huber()
    with pytest.raises(ValueError, match="measurement_scales"):
        radar(cls, noise=Learnt((2.0, 3.0)))


def step_without_prediction(kf, z):
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.update(z, polar_jacobian, polar, residual=wrapped)
    else:
        kf.update(z)


def test_a_missing_measurement_teaches_nothing_and_a_pickled_filter_goes_on():
    truth, zs = returns(80, 5, contamination=0.1)
    kf = radar(RobustExtendedKalmanFilter)
    error(kf, truth[:40], zs[:40], 0)
    before = kf.learnt
    for z in (None, np.array([np.nan, np.nan])):
        step(kf, z)
        np.testing.assert_array_equal(kf.learnt, before)
        assert kf.outlier_probability == 0.0
    twin = pickle.loads(pickle.dumps(kf))
    error(kf, truth[40:], zs[40:], 0), error(twin, truth[40:], zs[40:], 0)
    np.testing.assert_array_equal(twin.x, kf.x)
    np.testing.assert_array_equal(twin.learnt, kf.learnt)


@pytest.mark.parametrize("cls", CLASSES)
def test_batch_filter_is_the_loop_and_all_of_it_or_nothing(cls):
    _, zs = returns(30, 6, contamination=0.1)
    zs[4, 1], rows = np.nan, list(zs)
    rows[7] = None
    loop, batch = radar(cls), radar(cls)
    found = []
    for z in rows:
        step(loop, z)
        found.append(np.ravel(loop.x).copy())
    functions = (polar_jacobian, polar) if issubclass(cls, RobustExtendedKalmanFilter) else ()
    last = {"residual": wrapped} if functions else {}
    saver = Saver(batch)
    means, covariances = batch.batch_filter(rows, *functions, saver=saver, **last)
    np.testing.assert_array_equal(means, found)
    np.testing.assert_array_equal(covariances[-1], loop.P)
    assert len(saver.x) == 30
    x, P = batch.x.copy(), batch.P.copy()
    with pytest.raises(ValueError, match="step 5: z: expected finite"):
        batch.batch_filter([*rows[:5], np.array([np.inf, 0.0])], *functions, **last)
    np.testing.assert_array_equal(batch.x, x)
    np.testing.assert_array_equal(batch.P, P)
    with pytest.raises(ValueError, match="Rs: expected an entry for each of the 30"):
        batch.batch_filter(rows, *functions, Rs=[R] * 3, **last)
    with pytest.raises(TypeError, match="zs: expected a sequence"):
        batch.batch_filter(3.0, *functions, **last)
