"""Without a finite threshold the filter is filterpy's, on every path and for every attribute.

Where filterpy 1.4.5 lacks a method or an argument of 2.0.0, the comparison is with the definition.
"""

import filterpy.kalman
import numpy as np
import pytest
import scipy.stats
import support
from filterpy.common import Saver, inv_diagonal
from filterpy.kalman import KalmanFilter

from robust_filterpy import Huber, Linear, RobustKalmanFilter

pytestmark = pytest.mark.core

INFINITE = [Linear(), Huber(np.inf)]
NDIMS = [1, 2]
FILTERPY_2 = hasattr(KalmanFilter, "update_sequential")
ATTRIBUTES = (*support.STATE, "y", "K", "S", "SI")


def pair(problem, ndim=2, influence=INFINITE[0], **choices):
    """A robust filter without threshold and filterpy's, loaded alike."""
    robust = support.make(RobustKalmanFilter, problem, ndim, influence=influence, **choices)
    return robust, support.make(KalmanFilter, problem, ndim)


def column(kf, z):
    """Shape a measurement like the filter's x, which is the form that filterpy wants beside H."""
    return np.reshape(z, (-1, 1)) if kf.x.ndim == 2 else np.ravel(z)


def gaussian_log_likelihood(kf):
    """The definition, from what the filter shows."""
    return scipy.stats.multivariate_normal(cov=kf.S).logpdf(np.ravel(kf.y))


@pytest.mark.parametrize(
    "dims, influence, ndim",
    [
        ((1, 1), Linear(), 2),
        ((2, 1), Huber(np.inf), 1),
        ((3, 2), Linear(), 1),
        ((4, 4), Huber(np.inf), 2),
        ((7, 4), Linear(), 2),
        ((20, 5), Huber(np.inf), 2),
    ],
)
def test_equals_kalman_for_infinite_threshold_over_10000_steps(dims, influence, ndim):
    problem = support.random_problem(sum(dims), *dims)
    robust, plain = pair(problem, ndim, influence)
    zs, _ = support.simulate(problem, 10_000, seed=1, contamination=0.05)
    for k, z in enumerate(zs):
        for kf in (robust, plain):
            kf.predict()
            kf.update(z)
        # Every step for the state, now and then for what filterpy computes slowly.
        assert np.abs(robust.x - plain.x).max() <= 1e-10 * np.abs(plain.x).max()
        if k % 100 == 0:
            support.assert_same_state(robust, plain, ATTRIBUTES)
            assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-10)
    support.assert_same_state(robust, plain, ATTRIBUTES)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("influence", INFINITE, ids=repr)
def test_equals_kalman_whatever_the_information_and_the_grouping(ndim, information, grouping, influence):
    problem = support.random_problem(5, 4, 3)
    robust, plain = pair(problem, ndim, influence, information=information, grouping=grouping)
    for z in support.simulate(problem, 50, seed=2, contamination=0.2)[0]:
        for kf in (robust, plain):
            kf.predict()
            kf.update(z)
        support.assert_same_state(robust, plain)


def test_bounded_scaling_equals_kalman_where_s_is_not_below_one():
    problem = support.random_problem(5, 4, 3)
    problem = support.with_(problem, R=problem.R + np.eye(3))
    robust, plain = pair(problem, scaling="bounded")
    for z in support.simulate(problem, 50, seed=2)[0]:
        for kf in (robust, plain):
            kf.predict()
            kf.update(z)
        support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("dims", [(1, 1), (4, 2), (7, 4), (20, 5)])
def test_update_with_per_call_matrices(ndim, dims):
    rng = np.random.default_rng(3)
    problem = support.random_problem(4, *dims, dim_u=2)
    robust, plain = pair(problem, ndim)
    for z in support.simulate(problem, 60, seed=4)[0]:
        u = rng.normal(size=(2, 1) if ndim == 2 else 2)
        F, B = support.stable(rng, dims[0]), rng.normal(size=(dims[0], 2))
        Q, R = support.spd(rng, dims[0], 0.1), support.spd(rng, dims[1])
        H = rng.normal(size=(dims[1], dims[0]))
        for kf in (robust, plain):
            kf.predict(u, B=B, F=F, Q=Q)
            kf.update(column(kf, z), R=R, H=H)
        support.assert_same_state(robust, plain)
        np.testing.assert_array_equal(np.ravel(robust.z), z)


@pytest.mark.parametrize("ndim", NDIMS)
def test_scalar_r_and_q_per_call(ndim):
    problem = support.random_problem(4, 3, 2)
    robust, plain = pair(problem, ndim)
    for z in support.simulate(problem, 20, seed=4)[0]:
        for kf in (robust, plain):
            kf.predict(Q=0.3)
            kf.update(z, R=0.7)
        support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
def test_control_input(ndim):
    problem = support.random_problem(6, 4, 2, dim_u=3)
    robust, plain = pair(problem, ndim)
    rng = np.random.default_rng(1)
    for z in support.simulate(problem, 20, seed=4)[0]:
        u = rng.normal(size=(3, 1) if ndim == 2 else 3)
        for kf in (robust, plain):
            kf.predict(u)
            kf.update(z)
            kf.predict()
        support.assert_same_state(robust, plain)


def test_scalar_control_without_b_is_ignored():
    robust, plain = pair(support.cart())
    for kf in (robust, plain):
        kf.predict(0)
        kf.update(1.0)
    support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("dims", [(1, 1), (4, 2), (20, 5)])
def test_update_correlated(ndim, dims):
    problem = support.random_problem(8, *dims)
    robust, plain = pair(problem, ndim)
    rng = np.random.default_rng(0)
    for k, z in enumerate(support.simulate(problem, 60, seed=4)[0]):
        R = None if k % 2 else support.spd(rng, dims[1]) + problem.R
        for kf in (robust, plain):
            kf.predict()
            kf.update_correlated(z, R=R)
        support.assert_same_state(robust, plain, rtol=1e-9)
        assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-9)


def test_m_is_not_used_by_update():
    problem = support.random_problem(8, 4, 2)
    robust, plain = pair(problem)
    for kf in (robust, plain):
        kf.predict()
        kf.update([1.0, 2.0])
    support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
def test_default_m_is_no_correlation(ndim):
    problem = support.random_problem(8, 4, 2)
    robust, plain = pair(problem, ndim)
    robust.M = RobustKalmanFilter(4, 2).M
    for kf in (robust, plain):
        kf.predict()
    robust.update_correlated([1.0, 2.0])
    plain.update([1.0, 2.0])
    support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("blocks", [[(0, 1), (1, 1), (2, 1)], [(0, 2), (2, 1)], [(0, 3)], [(1, 2), (0, 1)]])
def test_update_sequential_equals_updates_with_one_block_after_another(ndim, blocks):
    problem = support.random_problem(8, 4, 3)
    robust, plain = pair(problem, ndim)
    for z in support.simulate(problem, 20, seed=4)[0]:
        robust.predict()
        plain.predict()
        x, P = plain.x[..., 0] if ndim == 2 else plain.x, plain.P
        for start, length in blocks:
            rows = slice(start, start + length)
            robust.update_sequential(start, z[rows] if length > 1 else z[start])
            H, R = problem.H[rows], problem.R[rows, rows]
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            y = z[rows] - H @ x
            x, P = x + K @ y, P - K @ H @ P
            support.assert_close(np.ravel(robust.y)[rows], y, what="y")
            support.assert_close(robust.K[:, rows], K, what="K")
            np.testing.assert_array_equal(np.ravel(robust.z)[rows].astype(float), z[rows])
        plain.x, plain.P = x.reshape(plain.x.shape), P
        support.assert_close(robust.x, plain.x, what="x")
        support.assert_close(robust.P, plain.P, what="P")
        support.assert_close(robust.x_post, plain.x, what="x_post")
        support.assert_close(robust.P_post, plain.P, what="P_post")


@pytest.mark.skipif(not FILTERPY_2, reason="filterpy 1.4.5 has no update_sequential")
def test_update_sequential_equals_filterpys():
    problem = support.random_problem(8, 4, 3)
    robust, plain = pair(problem)
    rng = np.random.default_rng(0)
    for z in support.simulate(problem, 20, seed=4)[0]:
        H, R = rng.normal(size=(1, 4)), support.spd(rng, 2)
        for kf in (robust, plain):
            kf.predict()
            kf.update_sequential(0, z[:2].copy(), R_i=R)
            kf.update_sequential(2, float(z[2]), R_i=0.4, H_i=H)
        support.assert_same_state(robust, plain, (*support.STATE, "y", "K"))
        np.testing.assert_array_equal(robust.z.astype(float), plain.z.astype(float))


@pytest.mark.parametrize("ndim", NDIMS)
def test_steady_state(ndim):
    problem = support.random_problem(9, 4, 2, dim_u=1)
    robust, plain = pair(problem, ndim)
    zs = support.simulate(problem, 100, seed=4)[0]
    u = np.ones((1, 1) if ndim == 2 else 1)
    for k, z in enumerate(zs):
        for kf in (robust, plain):
            if k < 60:
                kf.predict(u)
                kf.update(z)
            else:
                kf.predict_steadystate(u)
                kf.update_steadystate(z)
        support.assert_same_state(robust, plain)


def test_steady_state_with_a_gain_from_elsewhere():
    problem = support.random_problem(9, 4, 2)
    donor = pair(problem)[1]
    for z in support.simulate(problem, 60, seed=4)[0]:
        donor.predict()
        donor.update(z)
    robust, plain = pair(problem)
    for kf in (robust, plain):
        kf.K, kf.P = donor.K.copy(), donor.P.copy()
        for z in support.simulate(problem, 30, seed=5)[0]:
            kf.predict_steadystate()
            kf.update_steadystate(z)
    support.assert_same_state(robust, plain, (*support.STATE, "y", "K"))


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("alpha", [1.0, 1.02, 1.5])
def test_fading_memory(ndim, alpha):
    problem = support.random_problem(9, 3, 2)
    robust, plain = pair(problem, ndim)
    for kf in (robust, plain):
        kf.alpha = alpha
        assert kf.alpha == pytest.approx(alpha)
        for z in support.simulate(problem, 20, seed=4)[0]:
            kf.predict()
            kf.update(z)
    support.assert_same_state(robust, plain)


@pytest.mark.parametrize("method", ["update", "update_correlated", "update_steadystate"])
@pytest.mark.parametrize("ndim", NDIMS)
def test_update_with_none(method, ndim):
    robust, plain = pair(support.random_problem(9, 3, 2), ndim)
    for kf in (robust, plain):
        kf.predict()
        kf.update([1.0, 2.0])
        kf.predict()
        getattr(kf, method)(None)
    support.assert_same_state(robust, plain, (*support.STATE, "K", "S", "SI"))
    np.testing.assert_array_equal(np.ravel(robust.y), [0.0, 0.0])
    assert np.ravel(robust.z).tolist() == [None, None]


@pytest.mark.parametrize(
    "z",
    [[1.0, 2.0], (1, 2), [[1.0], [2.0]], [[1.0, 2.0]], np.array([1, 2]), np.array([[1.0], [2.0]])],
    ids=["list", "tuple", "column-list", "row", "int-array", "column"],
)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("method", ["update", "update_correlated", "update_steadystate", "get_update"])
def test_forms_of_a_vector_measurement(z, ndim, method):
    robust, plain = pair(support.random_problem(9, 3, 2), ndim)
    for kf in (robust, plain):
        kf.update([0.5, 0.6])
    returned = [getattr(kf, method)(z) for kf in (robust, plain)]
    support.assert_same_state(robust, plain)
    assert robust.z.shape == plain.z.shape
    if method == "get_update":
        support.assert_close(returned[0][0], returned[1][0])
        support.assert_close(returned[0][1], returned[1][1])


@pytest.mark.parametrize("z", [3, 3.5, np.float64(3.5), np.array(3.5), [3], (3,), [[3]], np.array([[3]])])
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("method", ["update", "update_correlated", "update_steadystate"])
def test_forms_of_a_scalar_measurement(z, ndim, method):
    robust, plain = pair(support.cart(), ndim)
    for kf in (robust, plain):
        kf.update(0.5)
        getattr(kf, method)(z)
    support.assert_same_state(robust, plain)
    assert robust.z.shape == plain.z.shape


@pytest.mark.parametrize("ndim", NDIMS)
def test_integer_arrays(ndim):
    integers = {
        "x": np.array([[1], [2]]) if ndim == 2 else np.array([1, 2]),
        "P": 50 * np.eye(2, dtype=int),
        "F": np.array([[1, 1], [0, 1]]),
        "H": np.array([[1, 0]]),
        "Q": np.eye(2, dtype=int),
        "R": np.array([[5]]),
    }
    robust, plain = RobustKalmanFilter(2, 1, influence=Linear()), KalmanFilter(2, 1)
    for kf in (robust, plain):
        for name, value in integers.items():
            setattr(kf, name, value.copy())
        kf.update(4)
        for z in range(5):
            kf.predict()
            kf.update(z)
    support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
def test_scalars_as_attributes(ndim):
    """R and P as 5, Q as a number that filterpy adds to every entry."""
    robust, plain = pair(support.cart(), ndim)
    for kf in (robust, plain):
        kf.R, kf.Q, kf.P = 5, 0.0001, 7.0
        for z in range(5):
            kf.predict()
            kf.update(z)
        kf.R = 2.5
        kf.update(3.0)
    support.assert_same_state(robust, plain)


def test_scalar_p_without_a_prediction_is_a_multiple_of_the_identity():
    robust, plain = pair(support.cart())
    robust.P, plain.P = 7.0, 7.0 * np.eye(2)
    for kf in (robust, plain):
        kf.update(3.0)
    support.assert_same_state(robust, plain, ("x", "P", "K", "S"))


@pytest.mark.parametrize("ndim", NDIMS)
def test_zero_rows_in_h(ndim):
    robust, plain = pair(support.random_problem(9, 4, 3), ndim)
    for kf in (robust, plain):
        kf.H[1] = 0.0
        kf.predict()
        kf.update([1.0, 2.0, 3.0])
    support.assert_same_state(robust, plain)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("dim_z", [1, 2, 4])
def test_dim_z_rewritten_between_calls(ndim, dim_z):
    robust, plain = pair(support.random_problem(9, 4, 3), ndim)
    other = support.random_problem(10, 4, dim_z)
    for kf in (robust, plain):
        kf.predict()
        kf.update([1.0, 2.0, 3.0])
        kf.dim_z, kf.H, kf.R = dim_z, other.H.copy(), other.R.copy()
        kf.predict()
        kf.update(np.arange(dim_z) + 1.0)
    support.assert_same_state(robust, plain)
    assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-10)
    for name in ("e", "weights", "clipped", "y_bounded"):
        assert getattr(robust, name).shape == robust.y.shape


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


@pytest.mark.parametrize("ndim", NDIMS)
def test_get_update_and_get_prediction(ndim):
    problem = support.random_problem(11, 4, 2, dim_u=1)
    robust, plain = pair(problem, ndim)
    u = np.ones((1, 1) if ndim == 2 else 1)
    for kf in (robust, plain):
        kf.predict(u)
        kf.update([1.0, 2.0])
    support.assert_close(robust.get_prediction(u)[0], plain.get_prediction(u)[0])
    support.assert_close(robust.get_prediction(u)[1], plain.get_prediction(u)[1])
    for z in ([1.0, -1.0], None):
        for ours, theirs in zip(robust.get_update(z), plain.get_update(z), strict=True):
            support.assert_close(ours, theirs)


@pytest.mark.parametrize("ndim", NDIMS)
def test_get_prediction_with_per_call_matrices_is_what_predict_does(ndim):
    problem, other = support.random_problem(11, 4, 2, dim_u=1), support.random_problem(12, 4, 2, dim_u=1)
    robust, plain = pair(problem, ndim)
    u = np.ones((1, 1) if ndim == 2 else 1)
    for arguments in ({}, {"u": u}, {"u": u, "B": other.B}, {"F": other.F}, {"Q": other.Q}, {"Q": 0.25}):
        x, P = robust.get_prediction(**arguments)
        support.load(plain, problem, ndim).predict(**arguments)
        support.assert_close(x, plain.x)
        support.assert_close(P, plain.P)


@pytest.mark.parametrize("ndim", NDIMS)
def test_residual_measurement_and_likelihoods(ndim):
    robust, plain = pair(support.random_problem(11, 4, 2), ndim)
    z = column(plain, [1.0, 2.0])
    for kf in (robust, plain):
        kf.predict()
        kf.update(z)
    support.assert_close(robust.residual_of(z), plain.residual_of(z))
    support.assert_close(robust.measurement_of_state(plain.x), plain.measurement_of_state(plain.x))
    assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-10)
    assert robust.log_likelihood == pytest.approx(gaussian_log_likelihood(plain), rel=1e-10)
    assert robust.likelihood == pytest.approx(plain.likelihood, rel=1e-10)
    y = np.ravel(plain.y)
    assert robust.mahalanobis == pytest.approx(np.sqrt(y @ plain.SI @ y), rel=1e-10)
    expected = scipy.stats.multivariate_normal(np.ravel(plain.H @ plain.x), plain.S).logpdf(np.ravel(z))
    assert robust.log_likelihood_of(z) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("inverse", [np.linalg.pinv, inv_diagonal], ids=["pinv", "inv_diagonal"])
def test_another_inverse(inverse):
    problem = support.random_problem(13, 3, 2)
    problem = support.with_(problem, P=np.eye(3), Q=np.eye(3), F=0.9 * np.eye(3), H=np.eye(2, 3), R=np.diag([1.0, 2.0]))
    robust, plain = pair(problem)
    for kf in (robust, plain):
        kf.inv = inverse
        for z in support.simulate(problem, 10, seed=1)[0]:
            kf.predict()
            kf.update(z)
    support.assert_same_state(robust, plain)


def batches(ndim):
    """The ways to call batch_filter, as keyword arguments made from (problem, n, rng)."""
    u = (1, 1) if ndim == 2 else (1,)
    return {
        "plain": lambda p, n, rng: {},
        "update_first": lambda p, n, rng: {"update_first": True},
        "control": lambda p, n, rng: {"us": list(rng.normal(size=(n, *u)))},
        "lists": lambda p, n, rng: {
            "Fs": [support.stable(rng, 4) for _ in range(n)],
            "Qs": [support.spd(rng, 4) for _ in range(n)],
            "Hs": [rng.normal(size=(2, 4)) for _ in range(n)],
            "Rs": [support.spd(rng, 2) for _ in range(n)],
            "Bs": [rng.normal(size=(4, 1)) for _ in range(n)],
            "us": list(rng.normal(size=(n, *u))),
        },
    }


def batch_by_definition(kf, zs, us=None, update_first=False, **lists):
    """The loop that batch_filter stands for; filterpy 1.4.5's refuses None beside columns."""
    out = ([], [], [], [])
    for k, z in enumerate(zs):
        one = {name[0]: values[k] for name, values in lists.items()}
        for step in ("update", "predict") if update_first else ("predict", "update"):
            if step == "predict":
                kf.predict(None if us is None else us[k], **{n: v for n, v in one.items() if n in "FQB"})
            else:
                kf.update(z, **{n: v for n, v in one.items() if n in "HR"})
            for series, value in zip(out[2:] if step == "predict" else out[:2], (kf.x, kf.P), strict=True):
                series.append(value.copy())
    return tuple(map(np.array, out))


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("case", ["plain", "update_first", "control", "lists"])
@pytest.mark.parametrize("missing", [False, True])
def test_batch_filter_and_smoother(ndim, case, missing):
    problem, n = support.random_problem(14, 4, 2, dim_u=1), 40
    arguments = batches(ndim)[case](problem, n, np.random.default_rng(0))
    robust, plain = pair(problem, ndim)
    if "us" not in arguments:
        # Without B, so that filterpy's default us=0 multiplies nothing.
        robust.B = plain.B = None
    zs = [column(plain, z) for z in support.simulate(problem, n, seed=3)[0]]
    if missing:
        zs[3] = zs[20] = zs[21] = None
    ours = robust.batch_filter(zs, **arguments)
    theirs = plain.batch_filter(zs, **arguments) if FILTERPY_2 else batch_by_definition(plain, zs, **arguments)
    assert len(ours) == 4
    for a, b in zip(ours, theirs, strict=True):
        support.assert_close(a, b)
    support.assert_same_state(robust, plain, (*support.STATE, "K", "S", "SI"))

    matrices = {name: arguments.get(name) for name in ("Fs", "Qs")}
    smoothed = robust.rts_smoother(*ours[:2], **matrices), plain.rts_smoother(*theirs[:2], **matrices)
    for a, b in zip(*smoothed, strict=True):
        support.assert_close(a, b, rtol=1e-9)


def test_batch_filter_of_an_array_and_of_scalars():
    robust, plain = pair(support.cart())
    zs = support.simulate(support.cart(), 30, seed=3)[0]
    for form in (zs, zs[:, 0], list(zs[:, 0]), zs[:, :, None]):
        for kf in (robust, plain):
            support.load(kf, support.cart())
        for a, b in zip(robust.batch_filter(form), plain.batch_filter(form), strict=True):
            support.assert_close(a, b)


def test_batch_filter_with_saver():
    robust, plain = pair(support.cart(), ndim=1)
    zs = support.simulate(support.cart(), 30, seed=3)[0]
    saver = Saver(robust)
    means, covariances, *_ = robust.batch_filter(zs, saver=saver)
    saver.to_array()
    support.assert_close(saver.x, means)
    support.assert_close(saver.P, covariances)
    support.assert_close(means, plain.batch_filter(zs)[0])


def test_the_smoother_is_the_procedural_one():
    """filterpy also has it as a function, with the indices one step apart."""
    robust = pair(support.cart())[0]
    means, covariances, *_ = robust.batch_filter(support.simulate(support.cart(), 30, seed=3)[0])
    n, kf = len(means), support.cart()
    ours = robust.rts_smoother(means, covariances)
    theirs = filterpy.kalman.rts_smoother(means, covariances, [kf.F] * n, [kf.Q] * n)
    for a, b in zip(ours[:2], theirs[:2], strict=True):
        support.assert_close(a, b)


def test_default_construction_and_dimension_check():
    robust, plain = RobustKalmanFilter(3, 2, 1), KalmanFilter(3, 2, 1)
    assert isinstance(robust, KalmanFilter)
    for name in (*support.STATE, "F", "H", "Q", "R", "y", "K", "S", "SI"):
        np.testing.assert_array_equal(getattr(robust, name), getattr(plain, name), err_msg=name)
    assert robust.B is None and robust.alpha == 1.0 and robust.inv is np.linalg.inv
    assert (robust.dim_x, robust.dim_z, robust.dim_u) == (3, 2, 1)
    assert robust.log_likelihood == plain.log_likelihood
    assert robust.likelihood == plain.likelihood
    robust.test_matrix_dimensions()
