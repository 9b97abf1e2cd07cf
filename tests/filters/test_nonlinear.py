"""The nonlinear filters: filterpy's for an infinite threshold, and what every robust filter promises."""

import copy

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)
from support import FILTERPY_2, polar, polar_jacobian, random_problem, simulate, with_, wrapped

from robust_filterpy import Huber, RobustKalmanFilter, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.filters import RobustCubatureKalmanFilter, RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core
DT = 0.1
F = np.array([[1, DT, 0, 0], [0, 1, 0, 0], [0, 0, 1, DT], [0, 0, 0, 1.0]])
Q = np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
R = np.diag([0.25, 1e-4])
START = np.array([30.0, -2.0, 20.0, 1.0])
EVERY = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "S", "SI", "K", "log_likelihood", "mahalanobis")


def radar(n, seed, contamination=0.0):
    """A target in the plane and its radar returns, shape (n, 2)."""
    rng = np.random.default_rng(seed)
    x, truth, z = START.copy(), np.empty((n, 4)), np.empty((n, 2))
    for k in range(n):
        x = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=4)
        truth[k] = x
        z[k] = polar(x) + np.sqrt(np.diag(R)) * rng.normal(size=2)
        if rng.random() < contamination:
            z[k] += np.sqrt(np.diag(R)) * rng.normal(size=2) * 20
    return truth, z


def prepare(kf, ndim=1):
    kf.x = START.copy() if ndim == 1 else START[:, None].copy()
    kf.P, kf.Q, kf.R = np.diag([4.0, 1.0, 4.0, 1.0]), Q.copy(), R.copy()
    if hasattr(kf, "F"):
        kf.F = F.copy()
    return kf


def ekf(cls=RobustExtendedKalmanFilter, ndim=1, **choices):
    return prepare(cls(4, 2, **choices), ndim)


def ukf(cls=RobustUnscentedKalmanFilter, points=None, **choices):
    points = points or MerweScaledSigmaPoints(4, 0.5, 2.0, -1.0)
    return prepare(cls(4, 2, DT, polar, lambda x, dt: F @ x, points, residual_z=wrapped, **choices))


def ckf(cls=RobustCubatureKalmanFilter, **choices):
    return prepare(cls(4, 2, DT, polar, lambda x, dt: F @ x, residual_z=wrapped, **choices))


def correct(kf, z, **call):
    """Update any of the three."""
    if isinstance(kf, ExtendedKalmanFilter):
        kf.update(z, polar_jacobian, polar, residual=wrapped, **call)
    else:
        kf.update(z, **call)


def run(kf, zs):
    xs = []
    for z in zs:
        kf.predict()
        correct(kf, z)
        xs.append(np.ravel(kf.x).copy())
    return np.array(xs)


def state(kf):
    """Everything a filter holds, arrays by value."""
    slots = {name: getattr(kf, name) for name in ("_last", "_y", "_S", "_SI")}
    return copy.deepcopy({**kf.__dict__, **slots})


def assert_same_state(before, after):
    assert before.keys() == after.keys()
    for name, value in before.items():
        if name in {"hx", "fx", "points_fn", "_choices"} or callable(value):
            continue
        np.testing.assert_equal(after[name], value, err_msg=name)


MAKERS = [pytest.param(f, id=f.__name__) for f in (ekf, ukf, ckf)]
PLAIN = {ekf: ExtendedKalmanFilter, ukf: UnscentedKalmanFilter, ckf: CubatureKalmanFilter}


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("scaling", ["innovation"])
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("influence", [Linear(), Huber(np.inf)], ids=repr)
def test_equals_filterpy_for_infinite_threshold(maker, scaling, information, influence):
    ours = maker(influence=influence, scaling=scaling, information=information)
    theirs = maker(PLAIN[maker])
    for z in radar(60, 1)[1]:
        ours.predict(), theirs.predict()
        if maker is ckf:
            correct(ours, z), correct(theirs, z[:, None])
        else:
            correct(ours, z), correct(theirs, z)
        for name in EVERY:
            if name == "mahalanobis" and maker is ckf:
                continue  # filterpy's multiplies a column from the wrong side there
            a, b = getattr(ours, name), getattr(theirs, name, None)
            if b is None or (name in {"SI", "mahalanobis"} and not np.any(b)):
                continue  # 1.4.5's extended filter leaves SI at 0
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10 * max(1.0, np.abs(b).max()), err_msg=name)
            assert np.shape(a) == np.shape(b), name


@pytest.mark.parametrize("points", [MerweScaledSigmaPoints(4, 0.1, 2.0, -1.0), JulierSigmaPoints(4, 0.5)])
def test_unscented_equals_filterpy_for_every_kind_of_points(points):
    ours, theirs = ukf(points=points, influence=Linear()), ukf(UnscentedKalmanFilter, points=points)
    for z in radar(50, 2)[1]:
        ours.predict(), theirs.predict()
        ours.update(z), theirs.update(z)
    np.testing.assert_allclose(ours.x, theirs.x, rtol=1e-9)
    np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("ndim", [1, 2])
def test_extended_equals_the_linear_filter_on_a_linear_problem(ndim):
    problem = random_problem(3, 4, 2)
    zs, _ = simulate(problem, 100, 3, contamination=0.2)
    linear, extended = RobustKalmanFilter(4, 2), RobustExtendedKalmanFilter(4, 2)
    for kf in (linear, extended):
        kf.x = problem.x.copy() if ndim == 2 else problem.x[:, 0].copy()
        kf.P, kf.F, kf.Q, kf.R = problem.P, problem.F, problem.Q, problem.R
    linear.H = problem.H
    for z in zs:
        linear.predict(), extended.predict()
        linear.update(z)
        extended.update(z, lambda x: problem.H, lambda x: problem.H @ x)
        for name in ("x", "P", "y", "S", "K", "e", "weights", "clipped", "T", "y_bounded", "log_likelihood", "z"):
            np.testing.assert_allclose(getattr(extended, name), getattr(linear, name), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
def test_unscented_equals_the_linear_filter_on_a_linear_problem(scaling, information, grouping):
    problem = random_problem(5, 3, 2)
    zs, _ = simulate(problem, 60, 5, contamination=0.2)
    zs[7, 0], zs[20:22, 1], zs[30] = np.nan, np.nan, np.nan
    # A sensor that sees nothing of the state must not take part in the joint length.
    problem = with_(problem, H=np.vstack([problem.H, np.zeros(3)]), R=np.diag([0.4, 0.5, 0.6]))
    zs = np.column_stack([zs, np.tile([0.0, 50.0], 30)])
    choices = {"scaling": scaling, "information": information, "grouping": grouping}
    linear = RobustKalmanFilter(3, 3, **choices)
    points = MerweScaledSigmaPoints(3, 0.5, 2.0, 0.0)
    sigma = RobustUnscentedKalmanFilter(
        3, 3, 1.0, lambda x: problem.H @ x, lambda x, dt: problem.F @ x, points, **choices
    )
    for kf in (linear, sigma):
        kf.x, kf.P, kf.Q, kf.R = problem.x[:, 0].copy(), problem.P, problem.Q, problem.R
    linear.F, linear.H = problem.F, problem.H
    for z in zs:
        linear.predict(), sigma.predict()
        if not FILTERPY_2:
            sigma.sigmas_f = points.sigma_points(sigma.x, sigma.P)
        linear.update(z), sigma.update(z)
        for name in ("x", "P", "y", "S", "K", "e", "weights", "T", "y_bounded", "log_likelihood"):
            np.testing.assert_allclose(getattr(sigma, name), getattr(linear, name), rtol=1e-7, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("maker", MAKERS)
def test_outliers_do_not_hurt(maker):
    errors = {"robust": [], "plain": []}
    for seed in range(4):
        truth, zs = radar(100, seed, contamination=0.15)
        for name, kf in (("robust", maker()), ("plain", maker(PLAIN[maker]))):
            path = run(kf, zs if name == "robust" or maker is not ckf else zs[:, :, None])
            errors[name].append(np.mean((path - truth)[:, [0, 2]] ** 2))
    assert np.mean(errors["robust"]) < 0.3 * np.mean(errors["plain"])


@pytest.mark.parametrize("maker", MAKERS)
def test_a_refused_measurement_or_noise_changes_nothing(maker):
    kf, z = maker(), radar(1, 0)[1][0]
    run(kf, radar(5, 0)[1])
    before = state(kf)
    for bad in ([1.0, 2.0, 3.0], 1.0, [np.inf, 0.0], "ab"):
        with pytest.raises((ValueError, TypeError), match="z: expected"):
            correct(kf, bad)
        assert_same_state(before, state(kf))
    for bad in (np.eye(3), -1.0, np.array([[1.0, 2.0], [2.0, 1.0]]), "a"):
        with pytest.raises((ValueError, TypeError), match="R: expected"):
            correct(kf, z, R=bad)
        assert_same_state(before, state(kf))


def test_a_model_that_fails_changes_nothing():
    extended, unscented, cubature = ekf(), ukf(), ckf()
    for kf in (extended, unscented, cubature):
        run(kf, radar(5, 0)[1])
    z = radar(1, 0)[1][0]
    cases = [
        (extended, ValueError, lambda: extended.update(z, lambda x: np.eye(2), polar)),
        (extended, ValueError, lambda: extended.update(z, polar_jacobian, lambda x: np.ones(3))),
        (extended, ValueError, lambda: extended.update(z, polar_jacobian, lambda x: polar(x) * np.nan)),
        (extended, ValueError, lambda: extended.update(z, polar_jacobian, polar, residual=lambda a, b: a[:1])),
        (extended, ValueError, lambda: extended.predict_update(z, polar_jacobian, lambda x: np.ones(3))),
        (unscented, ValueError, lambda: unscented.update(z, hx=lambda x: x * np.nan)),
        (unscented, ValueError, lambda: unscented.predict(fx=lambda x, dt: x * np.nan)),
        (unscented, ZeroDivisionError, lambda: unscented.predict(fx=lambda x, dt: 1 // 0)),
        (unscented, ValueError, lambda: unscented.batch_filter([z, z, z[:1]])),
        (cubature, ValueError, lambda: cubature.update(z[:1])),
    ]
    for kf, error, call in cases:
        before = state(kf)
        with pytest.raises(error):
            call()
        assert_same_state(before, state(kf))
    extended.F = np.eye(4) * np.nan
    before = state(extended)
    with pytest.raises(ValueError, match="predict"):
        extended.predict()
    assert_same_state(before, state(extended))


@pytest.mark.parametrize("maker", [ekf, ukf])
def test_unit_scaling_that_would_make_P_indefinite_is_refused(maker):
    kf = maker(scaling="unit")
    kf.P *= 1e4
    kf.predict()
    before = state(kf)
    with pytest.raises(NotPositiveDefiniteError, match="bounded"):
        correct(kf, polar(START))
    assert_same_state(before, state(kf))


@pytest.mark.parametrize("maker", MAKERS)
def test_saver_and_repr(maker):
    kf = maker()
    kf.predict()
    saver = Saver(kf)
    for z in radar(5, 0)[1]:
        kf.predict()
        correct(kf, z)
        saver.save()
    saver.to_array()
    assert saver.weights.shape[:2] == (5, 2) and saver.x.shape[:2] == (5, 4)
    text = repr(kf)
    assert text.startswith(type(kf).__name__) and "influence = Huber" in text.replace("\n", " ")


def test_every_choice_can_be_changed_later():
    kf = ukf()
    kf.influence, kf.information, kf.grouping, kf.scaling = TukeyBiweight(), "weight", "joint", "bounded"
    run(kf, radar(5, 0)[1])
    with pytest.raises(ValueError, match="scaling"):
        kf.scaling = "none"
    for cls in (RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter):
        with pytest.raises(TypeError, match="influence"):
            (ekf if cls is RobustExtendedKalmanFilter else ukf)(influence=3.0)


def test_extended_predict_update_predicts_then_corrects():
    zs = radar(30, 8, contamination=0.1)[1]
    ours, theirs = ekf(influence=Linear()), ekf(ExtendedKalmanFilter)
    for z in zs:
        ours.predict_update(z, polar_jacobian, polar)
        theirs.predict_update(z, polar_jacobian, polar)
        for name in ("x", "P", "y", "S", "K"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-9, atol=1e-12)
    x, P = ours.x.copy(), ours.P.copy()
    ours.predict_update(None, polar_jacobian, polar)
    np.testing.assert_allclose(ours.x, F @ x)
    np.testing.assert_allclose(ours.P, F @ P @ F.T + Q)


def test_extended_takes_one_range_like_filterpys_own_test():
    """A climbing aircraft seen by a range-only radar, a scalar R for each call, hx a plain number."""
    rng = np.random.default_rng(0)
    kf = RobustExtendedKalmanFilter(3, 1)
    kf.F = np.eye(3) + 0.05 * np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]])
    kf.x, kf.Q = np.array([-10.0, 90.0, 1100.0]), 0.001 * np.diag([0, 1, 1])
    kf.P *= 50
    position, saver = 0.0, Saver(kf)
    for k in range(400):
        position += 0.05 * 100
        z = np.hypot(position, 1000.0) * (1 + 0.05 * rng.normal()) + (500.0 if k % 10 == 9 else 0.0)
        at = np.hypot(kf.x[0], kf.x[2])
        kf.update(
            np.array([z]), lambda x: np.array([[x[0], 0, x[2]]]) / np.hypot(x[0], x[2]), lambda x: np.hypot(x[0], x[2]),
            R=at * 2.5,
        )  # fmt: skip
        assert kf.mahalanobis == pytest.approx(abs(kf.e[0]))
        kf.predict()
        saver.save()
    saver.to_array()
    assert abs(kf.x[0] - position) < 150 and abs(kf.x[1] - 100) < 15


@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.parametrize("shape", [(2,), (2, 1), (1, 2)])
def test_rows_and_columns_mean_the_same(ndim, shape):
    z = radar(1, 0)[1][0] + [3.0, 0.1]
    kf = ekf(ndim=ndim)
    kf.update(z.reshape(shape), polar_jacobian, polar, residual=wrapped)
    reference = ekf()
    reference.update(z, polar_jacobian, polar, residual=wrapped)
    np.testing.assert_allclose(kf.x.ravel(), reference.x)
    assert kf.x.shape == ((4,) if ndim == 1 else (4, 1))


@pytest.mark.parametrize("maker", MAKERS)
def test_arguments_reach_the_measurement_function(maker):
    z = np.array([3.0, 4.0])
    kf = maker(influence=Linear())
    kf.residual_z = np.subtract
    kf.predict()
    if maker is ekf:
        kf.update(z, lambda x, a: a * np.eye(2, 4), lambda x, a, b: a * np.ravel(x)[:2] + b, args=2.0, hx_args=(2.0, 1))
    elif maker is ukf:
        kf.update(z, hx=lambda x, a, b: a * x[:2] + b, a=2.0, b=1)
    else:
        kf.hx = lambda x, a, b: a * x[:2] + b
        kf.update(z, hx_args=(2.0, 1))
    np.testing.assert_allclose(np.ravel(kf.y), z - 2.0 * np.ravel(kf.x_prior)[:2] - 1)


def test_unscented_batch_equals_the_loop():
    zs = radar(20, 9, contamination=0.2)[1]
    listed = [*zs[:5], None, *zs[6:]]
    loop, batch = ukf(), ukf()
    path = run(loop, listed)
    saver = Saver(batch)
    means, covariances = batch.batch_filter(listed, Rs=[R] * 20, dts=DT, saver=saver)
    np.testing.assert_array_equal(means, path)
    np.testing.assert_array_equal(covariances[-1], loop.P)
    assert len(saver) == 20
    smooth, _, _ = batch.rts_smoother(means, covariances)
    assert smooth.shape == means.shape
    with pytest.raises(ValueError, match="Rs"):
        batch.batch_filter(listed, Rs=[R] * 3)


def test_unscented_moves_the_state_by_state_add():
    kf = ukf(state_add=lambda x, dx: x + dx + [100.0, 0, 0, 0])
    plain = ukf()
    for one in (kf, plain):
        one.predict()
        one.update(polar(START))
    np.testing.assert_allclose(kf.x, plain.x + np.array([100.0, 0, 0, 0]))


@pytest.mark.parametrize("maker", MAKERS)
def test_P_stays_positive_definite(maker):
    kf = maker()
    rng = np.random.default_rng(0)
    for z in radar(300, 3)[1]:
        kf.predict()
        bad = rng.random(2) < 0.4
        correct(kf, np.where(bad, rng.choice([-1, 1], 2) * 10.0 ** rng.uniform(0, 200, 2), z))
        assert np.linalg.eigvalsh(kf.P)[0] > 0 and np.abs(kf.P - kf.P.T).max() <= 1e-12 * np.abs(kf.P).max()
    assert np.isfinite(kf.x).all()


@pytest.mark.parametrize("u", [np.array([0.3, -0.7]), np.zeros(2), [[0.3], [-0.7]]], ids=str)
def test_an_extended_filter_with_several_inputs_is_moved_by_all_of_them(u):
    problem = random_problem(8, 3, 1, dim_u=2)
    kf = RobustExtendedKalmanFilter(3, 1, 2)
    kf.x, kf.P, kf.Q, kf.F, kf.B = np.ravel(problem.x), problem.P, problem.Q, problem.F, problem.B
    kf.predict(u)
    np.testing.assert_allclose(kf.x, problem.F @ np.ravel(problem.x) + problem.B @ np.ravel(u), rtol=1e-12)
    np.testing.assert_allclose(kf.P, problem.F @ problem.P @ problem.F.T + problem.Q, rtol=1e-12)
