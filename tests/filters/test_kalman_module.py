"""robust_filterpy.kalman: every name of filterpy.kalman, and with Linear() its numbers."""

import importlib
import inspect
import math
import pkgutil
from pathlib import Path
from types import ModuleType

import filterpy.common
import filterpy.kalman as theirs
import numpy as np
import pytest
import support

import robust_filterpy.kalman as ours
from robust_filterpy import Contaminated, Huber, RobustKalmanFilter, common, filter_series
from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core
OURS = {
    "CubatureKalmanFilter", "EnsembleKalmanFilter", "ExtendedKalmanFilter", "FixedLagSmoother", "KalmanFilter",
    "UnscentedKalmanFilter", "batch_filter", "rts_smoother", "update",
}  # fmt: skip
MODULES = {info.name for info in pkgutil.iter_modules(theirs.__path__)} - {"tests"}
COMMON = {info.name for info in pkgutil.iter_modules(filterpy.common.__path__)} - {"tests"}


def test_every_name_is_there_and_ours_are_ours():
    names = [name for name in dir(theirs) if not name.startswith("_")]
    for name in names:
        is_ours = name in OURS or (isinstance(getattr(theirs, name), ModuleType) and name in MODULES)
        assert (getattr(ours, name) is getattr(theirs, name)) == (not is_ours), name
    assert set(names) == set(ours.__all__) and set(names) >= OURS
    assert {name for name in dir(filterpy.common) if not name.startswith("_")} == set(common.__all__)
    for name in OURS:
        assert getattr(ours, name).__module__.startswith("robust_filterpy.")


@pytest.mark.parametrize(
    "room, module",
    [(room, name) for room, names in (("kalman", MODULES), ("common", COMMON)) for name in sorted(names)],
)
def test_every_module_is_there_and_gives_ours(room, module):
    """Also as ``from robust_filterpy.kalman import kalman_filter``, which gave filterpy's module."""
    own = importlib.import_module(f"robust_filterpy.{room}.{module}")
    other = importlib.import_module(f"filterpy.{room}.{module}")
    around = importlib.import_module(f"robust_filterpy.{room}")
    assert getattr(around, module) is (own if module not in OURS | {"unscented_transform"} else getattr(own, module))
    defined = [name for name, thing in vars(other).items() if getattr(thing, "__module__", "") == other.__name__]
    assert defined
    for name in defined:
        assert getattr(own, name) is getattr(around, name), name
        assert getattr(own, name).__module__.startswith("robust_") == (name in OURS | {"kinematic_kf"}), name


@pytest.mark.parametrize("order_by_dim", [True, False])
@pytest.mark.parametrize("dim, order", [(1, 0), (1, 2), (2, 1), (3, 3)])
def test_kinematic_kf_sees_the_position_of_each_dimension(dim, order, order_by_dim):
    """H follows from what it is to measure: filterpy 2.0.0's is that of the sum of positions."""
    dt = 0.3
    kf = common.kinematic_kf(dim, order, dt, order_by_dim=order_by_dim)
    assert type(kf) is RobustKalmanFilter and kf.dim_z == dim
    derivatives = np.random.default_rng(0).normal(size=(dim, order + 1))
    at = derivatives @ [dt**k / math.factorial(k) for k in range(order + 1)]
    x = derivatives.ravel() if order_by_dim else derivatives.T.ravel()
    np.testing.assert_allclose(kf.H @ x, derivatives[:, 0])
    np.testing.assert_allclose(kf.H @ kf.F @ x, at)
    given = theirs.KalmanFilter(dim * (order + 1), dim)
    assert common.kinematic_kf(dim, order, dt, dim, order_by_dim, given) is given
    np.testing.assert_array_equal(given.H, kf.H)
    assert common.kinematic_kf(1, 1, dim_z=2).H.tolist() == [[1.0, 0.0], [1.0, 0.0]]


@pytest.mark.parametrize("ndim", [1, 2])
def test_update_is_filterpys_and_the_filters(ndim):
    problem = support.random_problem(1, 3, 2)
    x = problem.x if ndim == 2 else problem.x[:, 0]
    z = np.array([[1.0], [2.0]]) if ndim == 2 else np.array([1.0, 2.0])
    given = x, problem.P, z, problem.R, problem.H
    expected = theirs.update(*given, return_all=True)
    found = ours.update(*given, return_all=True, influence=Linear())
    for one, other in zip(found[:5], expected[:5], strict=True):
        assert one.shape == np.shape(other)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    # filterpy's function takes the likelihood of z at the corrected state; its filter, and ours, at the predicted one.
    kf = support.make(theirs.KalmanFilter, problem, ndim)
    kf.update(z)
    assert found[5] == pytest.approx(kf.log_likelihood, rel=1e-9)
    for options in ({"influence": Huber(1.0), "grouping": "joint"}, {"noise": Contaminated(0.1, 8.0)}):
        kf = support.make(RobustKalmanFilter, problem, ndim, **options)
        kf.update(1e3 * z)
        x_, P = ours.update(x, problem.P, 1e3 * z, problem.R, problem.H, **options)
        np.testing.assert_allclose(x_, kf.x, rtol=1e-12)
        np.testing.assert_allclose(P, kf.P, rtol=1e-12)


def test_functions_show_every_option_of_a_filter():
    options = [name for name in inspect.signature(RobustKalmanFilter).parameters if not name.startswith("dim")]
    for function in (ours.update, ours.batch_filter, filter_series):
        assert set(options) <= set(inspect.signature(function).parameters)


def test_numbers_stay_numbers():
    x, P = ours.update(1.0, 2.0, 3.0, 1.0, influence=Linear())
    assert (type(x), x, P) == (float, pytest.approx(1.0 + 4.0 / 3.0), pytest.approx(2.0 / 3.0))
    assert ours.update(1.0, 2.0, None, 1.0) == (1.0, 2.0)
    # No call is the first of a filter, whose first reading may say that the start is wrong.
    assert abs(ours.update(0.0, 1.0, 100.0, 1.0, noise="learnt")[0]) < 1.0
    assert ours.update(1.0, 2.0, None, 1.0, return_all=True)[2:] == (None,) * 4


@pytest.mark.parametrize("update_first", [False, True])
def test_batch_filter_and_rts_smoother_are_filterpys(update_first):
    problem, rng = support.random_problem(3, 2, 1, 1), np.random.default_rng(1)
    zs, _ = support.simulate(problem, 12, 2)
    Fs, Qs, *lists = ([a] * 12 for a in (problem.F, problem.Q, problem.H, problem.R))
    us, Bs = list(rng.normal(size=(12, 1, 1))), [problem.B] * 12
    arguments = (problem.x, problem.P, list(zs[:, :, None]), Fs, Qs, *lists, Bs, us, update_first)
    found, expected = ours.batch_filter(*arguments, influence=Linear()), theirs.batch_filter(*arguments)
    smoothed = (module.rts_smoother(*expected[:2], Fs, Qs) for module in (ours, theirs))
    for one, other in (*zip(found, expected, strict=True), *zip(*smoothed, strict=True)):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    assert ours.batch_filter(*arguments)[0].shape == (12, 2, 1)
    # The matrix that leads to a step, as a filter's smoother takes it; filterpy's function takes the one before.
    Fs = [support.stable(rng, 2) for _ in range(12)]
    kf = support.make(theirs.KalmanFilter, problem)
    one, other = ours.rts_smoother(*expected[:2], Fs, Qs), kf.rts_smoother(*expected[:2], Fs=Fs, Qs=Qs)
    np.testing.assert_allclose(one[0], other[0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("call, match", [
    (lambda: ours.update(np.zeros(2), np.eye(2), [1.0, 2.0], 1.0, np.eye(1, 2)), "z: expected 1"),
    (lambda: ours.rts_smoother(np.zeros(4), np.ones((4, 1, 1)), np.eye(1), np.eye(1)), "Xs: expected shape"),
    (lambda: ours.update(np.zeros(2), np.eye(3), 1.0, 1.0, np.eye(1, 2)), "P: expected shape"),
    (lambda: ours.update(0.0, 1.0, np.inf, 1.0), "z: expected a finite"),
    (lambda: ours.update(0.0, 1.0, 1.0, 1.0, influence="x"), "influence"),
    (lambda: ours.update(0.0, 1.0, 1.0, 1.0, noise="learnt", process="scales"), "process: expected 'given'"),
    (lambda: ours.batch_filter(np.zeros(2), np.eye(2), [1.0], [np.eye(2)], [np.eye(2)], [], [1.0]), "Hs: expected"),
    *((lambda given=given: common.kinematic_kf(*given), match) for given, match in (
        ((0, 1), "dim"), ((2, -1), "order"), ((3, 1, 1.0, 2), "dim_z"), ((2, 1, 1.0, 0), "dim_z"),
    )),
    (lambda: common.kinematic_kf(3, 1, kf=RobustKalmanFilter(6, 1)), "kf: expected dim_x=6 and dim_z=3"),
    (lambda: ensemble(ours, N=1), "N: expected"),
])  # fmt: skip
def test_bad_input_is_refused_by_name(call, match):
    with pytest.raises((TypeError, ValueError), match=match):
        call()


def ensemble(module, N=20, **choices):
    kf = module.EnsembleKalmanFilter(
        np.array([0.0, 1.0]), np.eye(2), 1, 0.1, N, lambda x: x[:1], lambda x, dt: x + [dt * x[1], 0.0], **choices
    )
    kf.Q = 0.1 * np.eye(2)
    return kf


def test_the_ensemble_filter_is_filterpys_with_the_same_random_numbers():
    np.random.seed(3)  # noqa: NPY002
    one = ensemble(theirs)
    other = ensemble(ours, influence=Linear(), rng=np.random.RandomState(3))
    for z in (1.0, 2.0, None, 3.0):
        for kf in (one, other):
            kf.predict()
            kf.update(None if z is None else np.array([z]))
        support.assert_same_state(other, one, (*support.STATE, "sigmas", "K", "S", "SI"), 1e-9)


@pytest.mark.parametrize(
    "choices", [{}, {"information": "weight", "grouping": "joint"}, {"information": "expected"}], ids=str
)
def test_members_of_a_robust_ensemble_spread_as_P_says(choices):
    """Mean and covariance of many members, also where an outlier was clipped; 5 standard errors."""
    size = 100_000
    kf = RobustEnsembleKalmanFilter(
        np.zeros(2), np.eye(2), 2, 1.0, size, lambda x: x + [0.0, 0.5 * x[0]], lambda x, dt: x,
        rng=np.random.default_rng(0), **choices,
    )  # fmt: skip
    support.predict_and_update(kf, [4.0, 0.3])
    error = 5.0 * np.sqrt(2.0 / size) * np.abs(kf.P).max()
    np.testing.assert_allclose(np.cov(kf.sigmas.T), kf.P, atol=error)
    np.testing.assert_allclose(kf.sigmas.mean(axis=0), kf.x, atol=1e-10)


def test_an_outlier_does_not_carry_the_ensemble_away():
    kf = ensemble(ours, N=200, rng=np.random.default_rng(1))
    support.through(kf, np.array([[0.1], [0.2], [1e6], [0.4], [np.nan], [0.6]]))
    assert abs(kf.x[0] - 0.6) < 1.5
    for bad in (np.inf, [1.0, 2.0]):
        before = kf.sigmas.copy()
        with pytest.raises(ValueError, match="z: expected"):
            kf.update(bad)
        np.testing.assert_array_equal(kf.sigmas, before)


def test_the_page_on_filterpy_says_what_becomes_of_each_name():
    page = (Path(__file__).parents[2] / "docs" / "filterpy.md").read_text(encoding="utf-8")
    table = page.partition("## Every name")[2].partition("## What it does")[0]
    things = [*vars(theirs).items(), *vars(filterpy.common).items()]
    names = {name for name, thing in things if str(getattr(thing, "__module__", "")).startswith("filterpy.")}
    missing = {name for name in names | MODULES | COMMON if f"`{name}`" not in table}
    assert len(names) > 25 and not missing, missing
