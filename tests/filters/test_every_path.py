"""Every method that corrects the state is robust: none falls back to the plain gain."""

import numpy as np
import pytest
import support

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.influence import Hampel, Linear

pytestmark = pytest.mark.core

K = 1.345
FORMULAS = support.HuberFormulas(K)
SCALINGS = ["innovation", "bounded", "unit"]
NDIMS = [1, 2]


def robust(problem=None, ndim=2, **choices):
    """A robust filter for the problem, or for one of four states and two sensors."""
    return support.make(RobustKalmanFilter, problem or support.random_problem(21, 4, 2), ndim, **choices)


PATHS = {
    "update": lambda kf, z: kf.update(z),
    "update with R and H": lambda kf, z: kf.update(np.reshape(z, kf.y.shape), R=kf.R + np.eye(2), H=kf.H + 0.1),
    "update_correlated": lambda kf, z: kf.update_correlated(z),
    "update_sequential": lambda kf, z: kf.update_sequential(0, np.array(z)),
    "update_steadystate": lambda kf, z: kf.update_steadystate(z),
    "batch_filter": lambda kf, z: kf.batch_filter([np.reshape(z, kf.y.shape)]),
    "batch_filter update_first": lambda kf, z: kf.batch_filter([np.reshape(z, kf.y.shape)], update_first=True),
}


@pytest.mark.pairwise
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("influence", [Huber(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_every_path_bounds_the_correction(path, ndim, influence):
    """Once clipped, a larger outlier moves the state no further."""
    problem = support.random_problem(26, 4, 2)
    states = []
    for size in (1e6, 1e12, 1e300):
        kf = robust(problem, ndim, influence=influence)
        kf.update([0.1, 0.2])
        PATHS[path](kf, [size, -size])
        states.append((np.ravel(kf.x), kf.P))
        support.assert_positive_definite(kf.P)
    for x, P in states[1:]:
        np.testing.assert_allclose(x, states[0][0], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(P, states[0][1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("ndim", NDIMS)
def test_get_update_is_update_and_changes_nothing(ndim):
    problem = support.random_problem(26, 4, 2)
    kf = robust(problem, ndim)
    kf.update([0.1, 0.2])
    for z in ([0.3, 0.1], [1e6, 0.1], [np.nan, 5.0], [np.nan, np.nan], None):
        before = support.snapshot(kf)
        likelihood = kf.log_likelihood
        x, P = kf.get_update(z)
        kf.get_prediction()
        kf.residual_of([1.0, 2.0])
        kf.log_likelihood_of(np.reshape([1.0, 2.0], kf.y.shape))
        support.assert_unchanged(before, kf)
        assert kf.log_likelihood == likelihood
        kf.update(z)
        support.assert_close(x, kf.x)
        support.assert_close(P, kf.P)


def test_what_get_update_and_get_prediction_return_can_be_written_to():
    kf = robust()
    before = support.snapshot(kf)
    for x, P in (kf.get_update([1.0, 2.0]), kf.get_update(None), kf.get_prediction()):
        x[:], P[:] = 77.0, 77.0
    support.assert_unchanged(before, kf)


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("ndim", NDIMS)
def test_update_correlated_is_the_correction_with_m(scaling, ndim):
    problem = support.mild()
    kf = robust(problem, ndim, scaling=scaling)
    z = [0.1, -20.0]
    reference = support.reference_correction(
        problem.x, problem.P, z, problem.H, problem.R, FORMULAS, scaling=scaling, M=problem.M
    )
    kf.update_correlated(z)
    support.assert_corrected(kf, reference)


@pytest.mark.parametrize("ndim", NDIMS)
def test_update_sequential_is_one_correction_for_each_block(ndim):
    problem = support.random_problem(27, 4, 3)
    kf, x, P = robust(problem, ndim), problem.x, problem.P
    for rows, z in ((slice(0, 2), np.array([0.3, 80.0])), (slice(2, 3), np.array([-60.0]))):
        reference = support.reference_correction(x, P, z, problem.H[rows], problem.R[rows, rows], FORMULAS)
        kf.update_sequential(rows.start, z)
        x, P = reference.x, reference.P
        support.assert_close(np.ravel(kf.x), x, 1e-9, "x")
        support.assert_close(kf.P, P, 1e-9, "P")
        for name in ("y", "e", "weights"):
            support.assert_close(np.ravel(getattr(kf, name))[rows], getattr(reference, name), 1e-9, name)
        support.assert_close(kf.K[:, rows], reference.K, 1e-9, "K")
    assert kf.x.shape == ((4, 1) if ndim == 2 else (4,))


@pytest.mark.parametrize("ndim", NDIMS)
def test_steady_state_is_not_spoilt_by_the_outlier_before(ndim):
    problem = support.random_problem(28, 4, 2)
    calm, upset = robust(problem, ndim), robust(problem, ndim)
    zs = support.simulate(problem, 60, seed=1)[0]
    for kf in (calm, upset):
        support.through(kf, zs)
        kf.predict()
    x, P = calm.x.copy(), calm.P.copy()
    calm.update(zs[0])
    upset.update([1e9, -1e9])
    support.assert_close(upset.K, calm.K)
    for kf in (calm, upset):
        kf.x, kf.P = x.copy(), P.copy()
        kf.predict_steadystate()
        kf.update_steadystate([0.4, 90.0])
        support.assert_close(kf.x_post, kf.x_prior + kf.K @ kf.y_bounded)
        e = np.ravel(kf.T @ kf.y)
        support.assert_close(np.ravel(kf.T @ kf.y_bounded), np.clip(e, -K, K), 1e-9)
        np.testing.assert_array_equal(np.ravel(kf.clipped), np.abs(e) > K)
    support.assert_close(calm.x, upset.x)


def test_unit_scaling_refuses_to_make_p_indefinite():
    kf = robust(support.with_(support.cart(), P=10 * np.eye(2)), scaling="unit")
    before = support.snapshot(kf)
    assert issubclass(NotPositiveDefiniteError, np.linalg.LinAlgError)
    for call in (kf.update, kf.get_update, kf.update_correlated, lambda z: kf.update_sequential(0, z)):
        with pytest.raises(NotPositiveDefiniteError, match="H P H'"):
            call(0.5)
        support.assert_unchanged(before, kf)
    kf.scaling = "bounded"
    kf.update(0.5)
    support.assert_positive_definite(kf.P)


def test_linear_has_no_bound():
    """The other side of the coin, so that the bounds above can fail."""
    kf = robust(influence=Linear())
    kf.update([1e9, -1e9])
    assert np.abs(kf.x).max() > 1e6
    assert not kf.clipped.any()
