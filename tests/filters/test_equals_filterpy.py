"""Without a finite threshold the filter is filterpy's: on every path, in every form of an argument, in all it shows.

Where filterpy 1.4.5 lacks a method or an argument of 2.0.0, the comparison is with the definition.
"""

from functools import partial

import numpy as np
import pytest
import support
from filterpy.kalman import KalmanFilter
from support import column

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter
from robust_filterpy.correction import Scales
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

NDIMS = [1, 2]
SHOWN = (*support.STATE, "y", "K", "S", "SI")
needs_2 = pytest.mark.skipif(not support.FILTERPY_2, reason="filterpy 1.4.5 has no update_sequential")


def pair(problem, ndim=2, influence=Linear(), **choices):
    """A robust filter without threshold and filterpy's, loaded alike."""
    robust = support.make(RobustKalmanFilter, problem, ndim, influence=influence, **choices)
    return robust, support.make(KalmanFilter, problem, ndim)


def steady(kf, z, k, u):
    kind = "" if k < 40 else "_steadystate"
    getattr(kf, f"predict{kind}")(u)
    getattr(kf, f"update{kind}")(z)


def steady_with_a_gain_from_elsewhere(kf, z, k, u):
    if k == 0:
        kf.K, kf.S, kf.SI = 0.1 * kf.H.T, np.eye(len(z)), np.eye(len(z))
    kf.predict_steadystate(u)
    kf.update_steadystate(z)


def another_height(kf, k):
    """dim_z is written anew between two calls."""
    other = support.random_problem(10, len(kf.x), 1 + k % 4)
    kf.dim_z, kf.H, kf.R = 1 + k % 4, other.H.copy(), other.R.copy()
    support.predict_and_update(kf, np.arange(kf.dim_z) + 1.0)


def one_input(kf, o, k):
    """Inputs for one step, of the filter's kind of column."""
    return column(kf, o.B[0] + k)


# What is done to both filters at each step: with z, the number of the step and the matrices of another problem.
def inv_of_the_users(S):
    return np.linalg.solve(S, np.eye(len(S)))


PROGRAMS = {
    "matrices of a call": lambda kf, z, k, o: (
        kf.predict(one_input(kf, o, k), B=o.B, F=o.F, Q=o.Q), kf.update(column(kf, z), R=o.R, H=o.H)
    ),
    "numbers of a call": lambda kf, z, k, o: (kf.predict(Q=0.3), kf.update(z, R=0.7)),
    "inputs": lambda kf, z, k, o: (kf.predict(one_input(kf, o, k)), kf.update(z)),
    "no B": lambda kf, z, k, o: (setattr(kf, "B", None), kf.predict(0), kf.update(z)),
    "correlated": lambda kf, z, k, o: (kf.predict(), kf.update_correlated(z, R=None if k % 2 else o.R + kf.R)),
    "steady state": lambda kf, z, k, o: steady(kf, z, k, one_input(kf, o, k)),
    "steady state, a gain from elsewhere": lambda kf, z, k, o: (
        steady_with_a_gain_from_elsewhere(kf, z, k, one_input(kf, o, k))
    ),
    "fading": lambda kf, z, k, o: (setattr(kf, "alpha", 1.0 + 0.02 * (k % 26)), kf.predict(), kf.update(z)),
    "a row of zeros": lambda kf, z, k, o: (kf.H[:1].fill(0.0), kf.predict(), kf.update(z)),
    "another dim_z": lambda kf, z, k, o: another_height(kf, k),
    "inverse of the user's": lambda kf, z, k, o: (setattr(kf, "inv", inv_of_the_users), kf.predict(), kf.update(z)),
    "pinv": lambda kf, z, k, o: (setattr(kf, "inv", np.linalg.pinv), kf.predict(), kf.update(z)),
}  # fmt: skip


@pytest.mark.pairwise
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("dims", [(1, 1), (4, 2), (7, 4), pytest.param((20, 5), marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_of_calls_gives_what_filterpy_gives(name, dims, ndim):
    problem = support.random_problem(4, *dims, dim_u=2)
    filters = robust, plain = pair(problem, ndim)
    for k, z in enumerate(support.simulate(problem, 60, seed=4)[0]):
        other = support.random_problem(1000 + k, *dims, dim_u=2)
        for kf in filters:
            PROGRAMS[name](kf, z, k, other)
        support.assert_same_state(robust, plain, SHOWN, rtol=1e-9)
        assert robust.z.shape == plain.z.shape and robust.weights.shape == robust.y.shape
        if "steady" not in name:
            assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-9)


NONE = Contaminated(0.0)
WITHOUT = [
    *({"influence": psi, "scaling": scaling, "grouping": grouping} for psi in (Linear(), Huber(np.inf))
      for scaling, grouping in (
        ("innovation", "component"), ("innovation", "joint"), ("learnt", "component"), ("learnt", "joint"),
        ("bounded", "component"),
    )),
    *({"noise": NONE, "process": process, "grouping": "joint"} for process in (
        NONE, Scales([1.0], jump=0.0), Scales([1.0, 1.0], dwell=5, jump=0.0),
    )),
]  # fmt: skip


@pytest.mark.pairwise
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("options", WITHOUT, ids=range(len(WITHOUT)))
def test_no_choice_matters_without_a_threshold_or_outliers(ndim, information, options):
    problem = support.random_problem(5, 4, 3)
    # S is not below one, where the bounded scaling of a sensor is the innovation's.
    problem = support.with_(problem, R=problem.R + np.eye(3))
    if "noise" in options:
        # Of a given noise an outlier is that far off that it cannot be.
        robust, contamination = support.load(RobustKalmanFilter(4, 3, **options), problem, ndim), 0.0
    else:
        robust, contamination = support.make(RobustKalmanFilter, problem, ndim, information=information, **options), 0.2
    plain, zs = support.make(KalmanFilter, problem, ndim), support.simulate(problem, 50, 2, contamination)[0]
    support.assert_same_along(robust, plain, zs, rtol=1e-8)
    assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-8)
    if support.FILTERPY_2:
        support.assert_same_along(robust, plain, zs, step=predict_and_correlate, rtol=1e-8)


def predict_and_correlate(kf, z):
    kf.predict()
    kf.update_correlated(z)


@needs_2
@pytest.mark.parametrize("blocks", [[(0, 1), (1, 1), (2, 1)], [(0, 2), (2, 1)], [(0, 3)], [(1, 2), (0, 1)]])
def test_update_sequential_is_filterpys(blocks):
    problem = support.random_problem(8, 4, 3)
    robust, plain = pair(problem)
    for k, z in enumerate(support.simulate(problem, 20, seed=4)[0]):
        for kf in (robust, plain):
            kf.predict()
            for start, length in blocks:
                other = support.random_problem(100 + k, 4, length)
                of_call = {"R_i": other.R, "H_i": other.H} if k % 2 else {}
                kf.update_sequential(start, z[start : start + length].copy() if length > 1 else z[start], **of_call)
        support.assert_same_state(robust, plain, support.STATE)
        # What is shown is that of the last block.
        for name in "zyK":
            ours, theirs = (np.atleast_2d(np.asarray(getattr(kf, name), dtype=float).T).T for kf in (robust, plain))
            ours, theirs = (ours.T, theirs.T) if name == "K" else (ours, theirs)
            np.testing.assert_allclose(ours[start : start + length], theirs[start : start + length], rtol=1e-9)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("blocks", [[1, 1, 1], [2, 1], [1, 2]])
def test_blocks_of_independent_sensors_are_one_update(ndim, blocks):
    """And by the chain rule their log-likelihoods add up to that of the whole measurement."""
    problem = support.with_(support.random_problem(8, 4, 3), R=np.diag([0.5, 1.0, 2.0]))
    robust, plain = pair(problem, ndim)
    for z in support.simulate(problem, 20, seed=4)[0]:
        robust.predict(), plain.predict()
        total = 0.0
        for start, length in zip(np.cumsum([0, *blocks]), blocks, strict=False):
            robust.update_sequential(int(start), z[start : start + length])
            total += robust.log_likelihood
        plain.update(z)
        support.assert_same_state(robust, plain, support.STATE)
        assert total == pytest.approx(plain.log_likelihood, rel=1e-9)


@pytest.mark.parametrize("ndim", NDIMS)
def test_what_can_be_asked_without_a_step(ndim):
    problem, other = support.random_problem(11, 4, 2, dim_u=1), support.random_problem(12, 4, 2, dim_u=1)
    robust, plain = pair(problem, ndim)
    u, z = np.ones((1, 1) if ndim == 2 else 1), column(plain, [1.0, 2.0])
    for arguments in ({}, {"u": u}, {"u": u, "B": other.B}, {"F": other.F}, {"Q": other.Q}, {"Q": 0.25}):
        x, P = robust.get_prediction(**arguments)
        support.load(plain, problem, ndim).predict(**arguments)
        support.assert_close(x, plain.x)
        support.assert_close(P, plain.P)
    support.load(plain, problem, ndim)
    for kf in (robust, plain):
        support.predict_and_update(kf, z)
    support.assert_close(robust.residual_of(z), plain.residual_of(z))
    support.assert_close(robust.measurement_of_state(plain.x), plain.measurement_of_state(plain.x))


ONE = [3, 3.5, np.float64(3.5), np.array(3.5), [3], (3,), [[3]], np.array([[3]])]
TWO = [[1.0, 2.0], (1, 2), [[1.0], [2.0]], [[1.0, 2.0]], np.array([1, 2]), np.array([[1.0], [2.0]])]


@pytest.mark.pairwise
@pytest.mark.parametrize("z", ONE + TWO, ids=range(len(ONE + TWO)))
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("method", ["update", "update_correlated", "update_steadystate", "get_update"])
def test_forms_of_a_measurement(z, ndim, method):
    robust, plain = filters = pair(support.random_problem(9, 3, np.size(z)), ndim)
    for kf in filters:
        kf.update([0.5, 0.6][: np.size(z)])
    returned = [getattr(kf, method)(z) for kf in filters]
    support.assert_same_state(robust, plain)
    assert robust.z.shape == plain.z.shape
    for ours, theirs in zip(*returned, strict=True) if method == "get_update" else ():
        support.assert_close(ours, theirs)


@pytest.mark.parametrize("ndim", NDIMS)
def test_numbers_as_attributes(ndim):
    """R, P and Q as numbers: predict adds Q to every entry of P, as filterpy does, and says so."""
    robust, plain = pair(support.cart(), ndim)
    for kf in (robust, plain):
        kf.R, kf.Q, kf.P = 5, 0.0001, 7.0
    with pytest.warns(UserWarning, match=r"Q: expected a matrix, got the number 0.0001, which is added to every entry"):
        support.assert_same_along(robust, plain, range(5))
    for kf in (robust, plain):
        kf.R = 2.5
        kf.update(3.0)
    support.assert_same_state(robust, plain)
    # Without a prediction a number as P is a multiple of the identity.
    robust.P, plain.P = 7.0, 7.0 * np.eye(2)
    for kf in (robust, plain):
        kf.update(3.0)
    support.assert_same_state(robust, plain, ("x", "P", "K", "S"))


@pytest.mark.filterwarnings("ignore:Q. expected a matrix")
@pytest.mark.parametrize("Q", [0.25, 1, np.float32(0.25), np.float64(0.25), np.int64(1), np.array(0.25)], ids=repr)
def test_a_number_as_q_is_what_it_is_in_filterpy(Q):
    """Its batch_filter passes it to each prediction, where it means times I."""
    zs, results = [1.0, 2.0, None, 3.0], []
    for kind in (KalmanFilter, partial(RobustKalmanFilter, influence=Linear())):
        steps, whole = (support.load(kind(2, 1), support.cart()) for _ in range(2))
        steps.Q = whole.Q = Q
        support.through(steps, zs)
        results.append((steps.P, *whole.batch_filter(zs)))
    for theirs, ours in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("height", [1, 4])
def test_h_of_another_height_for_one_call(ndim, height):
    """filterpy 1.4.5 cannot; the definition is a filter of that dim_z."""
    problem, other = support.random_problem(9, 4, 3), support.random_problem(10, 4, height)
    robust = pair(problem, ndim)[0]
    plain = support.make(KalmanFilter, support.with_(problem, H=other.H, R=other.R, M=other.M), ndim)
    z = np.arange(height) + 1.0
    robust.update(column(robust, z), R=other.R, H=other.H)
    plain.update(z)
    support.assert_same_state(robust, plain, ("x", "P", "x_post", "P_post", "y", "K", "S", "SI"))
