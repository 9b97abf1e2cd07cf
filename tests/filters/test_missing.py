"""NaN in z means missing, per component; None means the whole sample."""

import numpy as np
import pytest
import support
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

NAN = np.nan
NDIMS = [1, 2]
SEEN = [0, 2]
CALLS = ["update", "update_correlated", "update_steadystate"]


def problem():
    return support.random_problem(41, 4, 3)


def robust(ndim=2, **choices):
    return support.make(RobustKalmanFilter, problem(), ndim, **choices)


def reduced(cls=KalmanFilter, ndim=2, **choices):
    """A filter that has the seen sensors only."""
    p = problem()
    return support.make(cls, support.with_(p, H=p.H[SEEN], R=p.R[np.ix_(SEEN, SEEN)], M=p.M[:, SEEN]), ndim, **choices)


@pytest.mark.pairwise
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("method", ["update", "update_correlated"])
def test_a_missing_component_is_a_sensor_that_is_not_there(method, ndim, scaling, information, grouping):
    choices = {"scaling": scaling, "information": information, "grouping": grouping}
    ours, theirs = robust(ndim, **choices), reduced(RobustKalmanFilter, ndim, **choices)
    for kf, z in ((ours, [0.3, NAN, 50.0]), (theirs, [0.3, 50.0])):
        kf.predict()
        getattr(kf, method)(z)
    support.assert_same_state(ours, theirs, support.STATE)
    assert ours.log_likelihood == pytest.approx(theirs.log_likelihood, rel=1e-10)


@pytest.mark.parametrize("ndim", NDIMS)
def test_what_the_filter_shows_of_a_missing_component(ndim):
    ours, theirs = robust(ndim), reduced(RobustKalmanFilter, ndim)
    for kf, z in ((ours, [0.3, NAN, 50.0]), (theirs, [0.3, 50.0])):
        kf.predict()
        kf.update(z)
    for name in ("y", "e", "y_bounded"):
        np.testing.assert_allclose(np.ravel(getattr(ours, name))[SEEN], np.ravel(getattr(theirs, name)), rtol=1e-9)
        assert np.ravel(getattr(ours, name))[1] == 0, name
    np.testing.assert_allclose(np.ravel(ours.weights)[SEEN], np.ravel(theirs.weights), rtol=1e-9)
    assert np.isnan(np.ravel(ours.weights)[1])
    np.testing.assert_array_equal(np.ravel(ours.clipped)[SEEN], np.ravel(theirs.clipped))
    assert theirs.clipped.any() and not np.ravel(ours.clipped)[1]
    for name in ("T", "SI"):
        full = getattr(ours, name)
        support.assert_close(full[np.ix_(SEEN, SEEN)], getattr(theirs, name), what=name)
        assert not full[1].any() and not full[:, 1].any(), name
    support.assert_close(ours.K[:, SEEN], theirs.K, what="K")
    assert not ours.K[:, 1].any()
    p = problem()
    support.assert_close(ours.S, p.H @ ours.P_prior @ p.H.T + p.R, what="S")
    support.assert_close(ours.x_post, ours.x_prior + ours.K @ ours.y_bounded, what="x_post")
    assert ours.mahalanobis == pytest.approx(theirs.mahalanobis, rel=1e-9)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("method", CALLS)
@pytest.mark.parametrize("z", [[NAN, NAN, NAN], [[NAN], [NAN], [NAN]], np.full(3, NAN)])
def test_all_missing_is_none(ndim, method, z):
    one, two = robust(ndim), robust(ndim)
    for kf, value in ((one, z), (two, None)):
        kf.predict()
        kf.update([0.1, 0.2, 0.3])
        kf.predict()
        getattr(kf, method)(value)
    support.assert_unchanged(support.snapshot(two, (*support.STATE, "y", "K", "S", "SI", *support.ROBUST)), one)
    assert one.log_likelihood == two.log_likelihood == 0


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("method", CALLS)
def test_update_with_none_is_no_measurement(ndim, method):
    kf = robust(ndim)
    kf.predict()
    kf.update([0.1, 200.0, 0.3])
    kf.predict()
    before = support.snapshot(kf, ("x", "P", "K", "S", "SI", "T", "x_prior", "P_prior"))
    getattr(kf, method)(None)
    support.assert_unchanged(before, kf)
    np.testing.assert_array_equal(kf.x_post, kf.x)
    np.testing.assert_array_equal(kf.P_post, kf.P)
    for name in ("y", "e", "y_bounded", "clipped"):
        assert not np.any(getattr(kf, name)), name
    assert np.all(np.isnan(kf.weights))
    assert np.ravel(kf.z).tolist() == [None] * 3
    assert kf.log_likelihood == 0
    assert kf.likelihood == 1
    assert kf.mahalanobis == 0


@pytest.mark.parametrize("z", [NAN, [NAN], [[NAN]], np.array(NAN), np.float32(NAN), None])
def test_a_missing_scalar(z):
    kf = support.make(RobustKalmanFilter, support.cart())
    kf.predict()
    x, P = kf.x.copy(), kf.P.copy()
    kf.update(z)
    np.testing.assert_array_equal(kf.x, x)
    np.testing.assert_array_equal(kf.P, P)


def test_log_likelihood_of_nothing_is_zero():
    kf = robust()
    kf.update([0.1, 0.2, 0.3])
    assert kf.log_likelihood_of(None) == 0
    assert kf.log_likelihood_of(np.full((3, 1), NAN)) == 0


@pytest.mark.parametrize("ndim", NDIMS)
def test_steady_state_uses_the_components_that_are_there(ndim):
    kf = robust(ndim, influence=Linear())
    kf.predict()
    kf.update([0.1, 0.2, 0.3])
    kf.predict_steadystate()
    x, gain = kf.x.copy(), kf.K.copy()
    kf.update_steadystate([0.5, NAN, 0.7])
    assert np.all(np.isfinite(kf.x))
    assert np.any(kf.x != x)
    assert np.ravel(kf.y)[1] == 0
    # The gain is kept for the samples in which everything is there.
    kf.update_steadystate([0.5, 0.1, 0.7])
    np.testing.assert_array_equal(kf.K, gain)


@pytest.mark.parametrize("ndim", NDIMS)
def test_sequential_with_a_missing_component(ndim):
    one, two = robust(ndim), robust(ndim)
    for kf in (one, two):
        kf.predict()
    one.update_sequential(0, np.array([0.3, NAN]))
    two.update_sequential(0, 0.3)
    support.assert_close(one.x, two.x)
    support.assert_close(one.P, two.P)
    before = support.snapshot(one, ("x", "P"))
    one.update_sequential(2, NAN)
    support.assert_unchanged(before, one)


def test_the_smoother_fills_gaps():
    zs = support.simulate(support.cart(), 60, seed=6, contamination=0.1)[0][:, 0]
    zs[20:30] = NAN
    kf = support.make(RobustKalmanFilter, support.cart())
    means, covariances, *_ = kf.batch_filter(zs)
    smoothed, smoothed_covariances, *_ = kf.rts_smoother(means, covariances)
    assert np.all(np.isfinite(smoothed))
    for before, after in zip(covariances, smoothed_covariances, strict=True):
        support.assert_positive_definite(after)
        assert np.linalg.eigvalsh(before - after).min() > -1e-12
    assert smoothed_covariances[25, 0, 0] < covariances[25, 0, 0] / 2
