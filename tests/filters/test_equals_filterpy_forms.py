"""Without a finite threshold the filter takes what filterpy takes: scalars, lists, columns, integers, other sizes."""

import numpy as np
import pytest
import support
from filterpy.common import inv_diagonal
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

NDIMS = [1, 2]


def pair(problem, ndim=2, **choices):
    """A robust filter without threshold and filterpy's, loaded alike."""
    robust = support.make(RobustKalmanFilter, problem, ndim, influence=Linear(), **choices)
    return robust, support.make(KalmanFilter, problem, ndim)


@pytest.mark.parametrize("ndim", NDIMS)
def test_scalar_r_and_q_per_call(ndim):
    problem = support.random_problem(4, 3, 2)
    robust, plain = pair(problem, ndim)
    zs = support.simulate(problem, 20, seed=4)[0]
    support.assert_same_along(robust, plain, zs, lambda kf, z: (kf.predict(Q=0.3), kf.update(z, R=0.7)))


def test_scalar_control_without_b_is_ignored():
    robust, plain = pair(support.cart())
    for kf in (robust, plain):
        kf.predict(0)
        kf.update(1.0)
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


@pytest.mark.pairwise
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


@pytest.mark.pairwise
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
    support.assert_same_along(robust, plain, range(5))


@pytest.mark.parametrize("ndim", NDIMS)
def test_scalars_as_attributes(ndim):
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
    # Its batch_filter passes it to each prediction, where it means times I.
    for ours, theirs in zip(robust.batch_filter([1.0, 2.0]), plain.batch_filter([1.0, 2.0]), strict=True):
        np.testing.assert_allclose(np.reshape(ours, np.shape(theirs)), theirs, rtol=1e-9)


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
    robust.update(support.column(robust, z), R=other.R, H=other.H)
    plain.update(z)
    support.assert_same_state(robust, plain, ("x", "P", "x_post", "P_post", "y", "K", "S", "SI"))


@pytest.mark.parametrize("inverse", [np.linalg.pinv, inv_diagonal], ids=["pinv", "inv_diagonal"])
def test_another_inverse(inverse):
    problem = support.random_problem(13, 3, 2)
    problem = support.with_(problem, P=np.eye(3), Q=np.eye(3), F=0.9 * np.eye(3), H=np.eye(2, 3), R=np.diag([1.0, 2.0]))
    robust, plain = pair(problem)
    robust.inv = plain.inv = inverse
    support.assert_same_along(robust, plain, support.simulate(problem, 10, seed=1)[0])


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
