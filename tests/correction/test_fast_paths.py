"""The form for one sensor, and a whole filter by it or by the kernel, say what the definition says.

`correct` is the definition, itself held to formulas from elsewhere in test_kalman_filter.py. A filter whose `inv` is
not numpy's own function takes that general path throughout, so that it is the oracle for a whole filter.
"""

from itertools import product

import numpy as np
import pytest
import support

from robust_filterpy import Hampel, Huber, Linear, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import Correction, SingularInnovationError, correct
from robust_filterpy.correction.options import GROUPINGS, INFORMATIONS, SCALINGS, Choices
from robust_filterpy.correction.scalar import correct_scalar

pytestmark = pytest.mark.core

INFLUENCES = (Linear(), Huber(), Huber(0.5), Hampel(1.0, 2.0, 4.0), TukeyBiweight(), StudentT())
FIELDS = ("x", "P", "y", "S", "inverse", "K", "T", "e", "psi", "psi_deriv", "y_bounded", "weights")


class Users(Huber):
    """A psi that has no form for single numbers."""

    def psi(self, e):
        return 0.5 * super().psi(e)

    def psi_deriv(self, e):
        return 0.5 * super().psi_deriv(e)


def problems(dim_z):
    """Problems of several sizes, small enough for every scaling to be legal."""
    return [support.mild(dim_x, dim_z, seed) for seed, dim_x in zip(range(3), (1, 4, 7), strict=True)]


def innovations(dim_z, seed):
    """Innovations from none to enormous, in one component or in all."""
    rng = np.random.default_rng(seed)
    sizes = product((0.0, 1.0, 1e3, 1e140), repeat=dim_z)
    return [rng.choice([-1.0, 1.0], dim_z) * rng.uniform(0.5, 1.5, dim_z) * size for size in sizes]


def assert_same_correction(short, general, y):
    """Compare every field; x and psi at the size of what moved them."""
    assert isinstance(short, Correction)
    assert general.SI is None or len(y) == 1
    for name in FIELDS:
        support.assert_close(getattr(short, name), getattr(general, name), 1e-11, f"{name} for y={y}")
    np.testing.assert_array_equal(short.clipped, general.clipped)


@pytest.mark.parametrize("influence", INFLUENCES, ids=repr)
@pytest.mark.parametrize("information", INFORMATIONS)
@pytest.mark.parametrize("scaling", SCALINGS)
def test_one_sensor_in_floats_equals_the_definition(scaling, information, influence):
    choices = Choices(influence, scaling, information)
    for seed, problem in enumerate(problems(1)):
        x = problem.x[:, 0]
        for M, y in product((None, problem.M), innovations(1, seed)):
            general = correct(x, problem.P, y, problem.H, problem.R, choices, M)
            for state in (x, problem.x):
                short = correct_scalar(state, problem.P, y.item(), problem.H, problem.R.item(), choices, M)
                assert short.x.shape == state.shape
                assert_same_correction(short.as_arrays(), general, y)


def test_psi_of_the_length_leaves_e_as_it_is_beside_a_sensor_outside_the_group():
    H = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    c = correct(np.zeros(2), np.eye(2), np.array([1.8, 1.8, 0.1]), H, np.eye(3), Choices(grouping="joint"))
    np.testing.assert_array_equal(c.e, c.T @ c.y)
    # Neither is far out by itself, but together they are.
    assert np.abs(c.e).max() < 1.345
    assert c.clipped.tolist() == [True, True, False]


@pytest.mark.parametrize("size", [1e99, 1e149, 1e299])
@pytest.mark.parametrize("unit", [1e-60, 1e-9, 1.0])
@pytest.mark.filterwarnings("error")
def test_a_joint_outlier_of_any_size_in_any_unit_moves_the_state_by_the_threshold(size, unit):
    kf = RobustKalmanFilter(2, 2, grouping="joint")
    kf.H, kf.P, kf.R = np.eye(2), unit**2 * np.eye(2), 3.0 * unit**2 * np.eye(2)
    kf.update(np.array([size, 0.0]))
    # x+ = P S^(-1/2) k
    np.testing.assert_allclose(kf.x.ravel(), [0.5 * unit * kf.influence.threshold, 0.0], rtol=1e-12)


def measurements(dim_z):
    """Ordinary samples, outliers of every size, missing components and missing samples."""
    rng = np.random.default_rng(3)
    zs = rng.normal(size=(30, dim_z)) * np.where(rng.random((30, dim_z)) < 0.3, 100.0, 1.0)
    zs[rng.random((30, dim_z)) < 0.15] = np.nan
    zs[8], zs[18], zs[24] = np.nan, 1e250, -1e300
    return list(zs)


@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.parametrize("grouping", GROUPINGS)
@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("dim_z", [1, 2, 3])
def test_a_filter_equals_one_that_takes_the_general_path(dim_z, scaling, grouping, ndim):
    problem = support.mild(4, dim_z)
    if dim_z > 1:
        problem.H[0] = 0.0
    for information, influence, method in product(
        INFORMATIONS, (Huber(), Hampel(1.0, 2.0, 4.0)), ("update", "update_correlated")
    ):
        choices = dict(scaling=scaling, grouping=grouping, information=information, influence=influence)
        kf, oracle = (support.make(RobustKalmanFilter, problem, ndim, **choices) for _ in range(2))
        oracle.inv = lambda S: np.linalg.inv(S)
        for k, z in enumerate(measurements(dim_z)):
            if k == 15 and dim_z > 1:
                for f in (kf, oracle):
                    f.H = support.mild(4, dim_z).H
            for f in (kf, oracle):
                f.predict()
                getattr(f, method)(z)
            for name in ("x", "P", "K", "S", "T", "e", "y", "y_bounded"):
                support.assert_close(getattr(kf, name), getattr(oracle, name), 1e-9, f"{name} at sample {k}")
            np.testing.assert_array_equal(np.isnan(kf.weights), np.isnan(oracle.weights))
            assert kf.log_likelihood == pytest.approx(oracle.log_likelihood, rel=1e-9)


@pytest.mark.parametrize("dim_z", [1, 2, 4])
def test_the_gain_is_there_whenever_it_is_asked_for(dim_z):
    problem = support.random_problem(2, 4, dim_z)
    asked, later = (support.make(RobustKalmanFilter, problem) for _ in range(2))
    for z in support.simulate(problem, 20, 1, 0.3)[0]:
        for kf in (asked, later):
            kf.predict()
            kf.update(z)
        gain = asked.K
        assert gain.shape == (4, dim_z)
    for kf in (asked, later):
        kf.predict()
        kf.update(None)
    np.testing.assert_array_equal(asked.K, gain)
    np.testing.assert_array_equal(later.K, gain)


@pytest.mark.parametrize("grouping", GROUPINGS)
@pytest.mark.parametrize("noise", [1e-3, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("H", [[[1.0, 0.0], [1.0, 1e-3]], [[1.0, 0.0], [1.0, 1e-3], [0.5, 1e-2]]])
def test_sensors_that_see_almost_the_same_keep_p_positive_definite(H, noise, grouping):
    H = np.array(H)
    P, R = 4.0 * np.eye(2), noise * np.eye(len(H))
    for y in innovations(len(H), 5):
        c = correct(np.zeros(2), P, y, H, R, Choices(grouping=grouping))
        support.assert_positive_definite(c.P, size=np.abs(P).max())


@pytest.mark.parametrize("grouping", GROUPINGS)
@pytest.mark.parametrize("m", [2, 3])
def test_sensors_that_see_the_same_without_noise_are_refused(m, grouping):
    for noise in (0.0, 1e-20, 1e-16):
        with pytest.raises(SingularInnovationError, match="singular"):
            correct(np.zeros(1), np.eye(1), np.ones(m), np.ones((m, 1)), noise * np.eye(m), Choices(grouping=grouping))
