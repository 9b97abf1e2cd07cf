"""Without a finite threshold the filter is filterpy's, on every path and for every attribute.

Where filterpy 1.4.5 lacks a method or an argument of 2.0.0, the comparison is with the definition.
"""

import numpy as np
import pytest
import scipy.stats
import support
from filterpy.kalman import KalmanFilter

from robust_filterpy import Huber, RobustKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

INFINITE = [Linear(), Huber(np.inf)]
NDIMS = [1, 2]
ATTRIBUTES = (*support.STATE, "y", "K", "S", "SI")


def pair(problem, ndim=2, influence=INFINITE[0], **choices):
    """A robust filter without threshold and filterpy's, loaded alike."""
    robust = support.make(RobustKalmanFilter, problem, ndim, influence=influence, **choices)
    return robust, support.make(KalmanFilter, problem, ndim)


def gaussian_log_likelihood(kf):
    """The definition, from what the filter shows."""
    return scipy.stats.multivariate_normal(cov=kf.S).logpdf(np.ravel(kf.y))


@pytest.mark.parametrize("dims, influence, ndim", [
    pytest.param((1, 1), Linear(), 2, marks=pytest.mark.nightly),
    pytest.param((2, 1), Huber(np.inf), 1, marks=pytest.mark.nightly),
    ((3, 2), Linear(), 1),
    pytest.param((4, 4), Huber(np.inf), 2, marks=pytest.mark.nightly),
    ((7, 4), Linear(), 2),
    pytest.param((20, 5), Huber(np.inf), 2, marks=pytest.mark.nightly),
])  # fmt: skip
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


@pytest.mark.pairwise
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("influence", INFINITE, ids=repr)
def test_equals_kalman_whatever_the_information_and_the_grouping(ndim, information, grouping, influence):
    problem = support.random_problem(5, 4, 3)
    robust, plain = pair(problem, ndim, influence, information=information, grouping=grouping)
    support.assert_same_along(robust, plain, support.simulate(problem, 50, seed=2, contamination=0.2)[0])


def test_bounded_scaling_equals_kalman_where_s_is_not_below_one():
    problem = support.random_problem(5, 4, 3)
    problem = support.with_(problem, R=problem.R + np.eye(3))
    robust, plain = pair(problem, scaling="bounded")
    support.assert_same_along(robust, plain, support.simulate(problem, 50, seed=2)[0])


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
            kf.update(support.column(kf, z), R=R, H=H)
        support.assert_same_state(robust, plain)
        np.testing.assert_array_equal(np.ravel(robust.z), z)


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


@pytest.mark.skipif(not support.FILTERPY_2, reason="filterpy 1.4.5 has no update_sequential")
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
@pytest.mark.parametrize("blocks", [[1, 1, 1], [2, 1], [1, 2]])
def test_blocks_of_independent_sensors_are_one_update(ndim, blocks):
    """And by the chain rule their log-likelihoods add up to that of the whole measurement."""
    problem = support.with_(support.random_problem(8, 4, 3), R=np.diag([0.5, 1.0, 2.0]))
    robust, plain = pair(problem, ndim)
    for z in support.simulate(problem, 20, seed=4)[0]:
        for kf in (robust, plain):
            kf.predict()
        start = 0
        for length in blocks:
            robust.update_sequential(start, z[start : start + length])
            start += length
        plain.update(z)
        support.assert_same_state(robust, plain, support.STATE)
        assert robust.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-9)
        assert robust.mahalanobis == pytest.approx(np.sqrt(np.ravel(plain.y) @ plain.SI @ np.ravel(plain.y)), rel=1e-9)
        np.testing.assert_array_equal(np.ravel(robust.z).astype(float), z)


@pytest.mark.parametrize("ndim", NDIMS)
def test_steady_state(ndim):
    problem = support.random_problem(9, 4, 2, dim_u=1)
    robust, plain = pair(problem, ndim)
    u = np.ones((1, 1) if ndim == 2 else 1)

    def step(kf, k_and_z):
        kind = "" if k_and_z[0] < 60 else "_steadystate"
        getattr(kf, f"predict{kind}")(u)
        getattr(kf, f"update{kind}")(k_and_z[1])

    support.assert_same_along(robust, plain, enumerate(support.simulate(problem, 100, seed=4)[0]), step)


def test_steady_state_with_a_gain_from_elsewhere():
    problem = support.random_problem(9, 4, 2)
    donor = pair(problem)[1]
    support.through(donor, support.simulate(problem, 60, seed=4)[0])
    robust, plain = pair(problem)
    for kf in (robust, plain):
        kf.K, kf.P = donor.K.copy(), donor.P.copy()

    def step(kf, z):
        kf.predict_steadystate()
        kf.update_steadystate(z)

    zs = support.simulate(problem, 30, seed=5)[0]
    support.assert_same_along(robust, plain, zs, step, (*support.STATE, "y", "K"))


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("alpha", [1.0, 1.02, 1.5])
def test_fading_memory(ndim, alpha):
    problem = support.random_problem(9, 3, 2)
    robust, plain = pair(problem, ndim)
    for kf in (robust, plain):
        kf.alpha = alpha
        assert kf.alpha == pytest.approx(alpha)
    support.assert_same_along(robust, plain, support.simulate(problem, 20, seed=4)[0])


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
    z = support.column(plain, [1.0, 2.0])
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
