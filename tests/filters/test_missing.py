"""NaN in z means missing, per component; None means the whole sample."""

import numpy as np
import pytest
import support

from robust_filterpy import RobustExtendedKalmanFilter, RobustKalmanFilter, filter_series
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

NAN = np.nan
NDIMS = [1, 2]
SEEN = [0, 2]
CALLS = ["update", "update_correlated", "update_steadystate"]
PROBLEM = support.random_problem(41, 4, 3)
FEWER = support.with_(PROBLEM, H=PROBLEM.H[SEEN], R=PROBLEM.R[np.ix_(SEEN, SEEN)], M=PROBLEM.M[:, SEEN])


def robust(ndim=2, problem=PROBLEM, **choices):
    return support.make(RobustKalmanFilter, problem, ndim, **choices)


@pytest.mark.pairwise
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("method", ["update", "update_correlated"])
def test_a_missing_component_is_a_sensor_that_is_not_there(method, ndim, scaling, information, grouping):
    """What the filter shows of it is nothing: no innovation, no gain, a weight that is NaN; S is of all sensors."""
    choices = {"scaling": scaling, "information": information, "grouping": grouping}
    ours, theirs = robust(ndim, **choices), robust(ndim, FEWER, **choices)
    for kf, z in ((ours, [0.3, NAN, 50.0]), (theirs, [0.3, 50.0])):
        kf.predict()
        getattr(kf, method)(z)
    support.assert_same_state(ours, theirs, support.STATE)
    assert theirs.clipped.any()
    for name in ("log_likelihood", "mahalanobis"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-9), name
    for name, nothing in (("y", 0), ("e", 0), ("y_bounded", 0), ("weights", NAN), ("clipped", False)):
        full, part = np.ravel(getattr(ours, name)), np.ravel(getattr(theirs, name))
        np.testing.assert_allclose(full[SEEN], part, rtol=1e-9, err_msg=name)
        np.testing.assert_array_equal(full[1], nothing, err_msg=name)
    for name in ("T", "SI"):
        full = getattr(ours, name)
        support.assert_close(full[np.ix_(SEEN, SEEN)], getattr(theirs, name), what=name)
        assert not full[1].any() and not full[:, 1].any(), name
    support.assert_close(ours.K[:, SEEN], theirs.K, what="K")
    assert not ours.K[:, 1].any()
    support.assert_close(ours.x_post, ours.x_prior + ours.K @ ours.y_bounded, what="x_post")
    if method == "update":
        support.assert_close(ours.S, PROBLEM.H @ ours.P_prior @ PROBLEM.H.T + PROBLEM.R, what="S")


@pytest.mark.pairwise
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("method", CALLS)
@pytest.mark.parametrize("m, nothing", [
    *((1, form) for form in (NAN, [NAN], [[NAN]], np.array(NAN), np.float32(NAN), None)),
    *((3, form) for form in (None, [NAN] * 3, [[NAN]] * 3, np.full(3, NAN))),
])  # fmt: skip
def test_nothing_is_no_measurement_in_every_form(ndim, method, m, nothing):
    kf = robust(ndim, support.random_problem(41, 4, m))
    support.predict_and_update(kf, [0.1, 200.0, 0.3][-m:])
    kf.predict()
    before = support.snapshot(kf, ("x", "P", "K", "S", "SI", "T", "x_prior", "P_prior"))
    getattr(kf, method)(nothing)
    support.assert_unchanged(before, kf)
    np.testing.assert_array_equal(kf.x_post, kf.x)
    np.testing.assert_array_equal(kf.P_post, kf.P)
    for name in ("y", "e", "y_bounded", "clipped"):
        assert not np.any(getattr(kf, name)), name
    assert np.all(np.isnan(kf.weights)) and np.ravel(kf.z).tolist() == [None] * m
    assert (kf.log_likelihood, kf.likelihood, kf.mahalanobis) == (0, 1, 0)
    assert kf.log_likelihood_of(nothing) == 0


@pytest.mark.parametrize("ndim", NDIMS)
def test_steady_state_and_blocks_use_the_components_that_are_there(ndim):
    kf = robust(ndim, influence=Linear())
    support.predict_and_update(kf, [0.1, 0.2, 0.3])
    kf.predict_steadystate()
    x, gain = kf.x.copy(), kf.K.copy()
    kf.update_steadystate([0.5, NAN, 0.7])
    assert np.all(np.isfinite(kf.x)) and np.any(kf.x != x) and np.ravel(kf.y)[1] == 0
    # The gain is kept for the samples in which everything is there.
    kf.update_steadystate([0.5, 0.1, 0.7])
    np.testing.assert_array_equal(kf.K, gain)
    one, two = robust(ndim), robust(ndim)
    one.update_sequential(0, np.array([0.3, NAN]))
    two.update_sequential(0, 0.3)
    one.update_sequential(2, NAN)
    support.assert_same_state(one, two, ("x", "P"))


@pytest.mark.parametrize("m", [1, 2])
def test_missing_values_of_pandas_are_missing(path, m):
    """As NaN, in nullable columns, in rows of objects and for each call."""
    pd = pytest.importorskip("pandas")
    zs, _ = support.simulate(support.random_problem(6, 3, 2), 12, seed=6)
    zs[3, 0] = zs[5] = zs[8, 1] = np.nan
    table, p = pd.DataFrame(zs, columns=["a", "b"]).convert_dtypes(), support.random_problem(6, 3, m)
    assert table["a"].isna().sum() == 2 and str(table["a"].dtype) == "Float64"
    zs, rows = zs[:, :m], [[pd.NA if np.isnan(v) else v for v in row] for row in zs[:, :m]]
    expected = support.make(RobustKalmanFilter, p).batch_filter(zs)[0]
    for form in (table["a"], table[["a"]], rows) if m == 1 else (table, rows, table.to_numpy()):
        # Rows of objects go by the filter's own steps, which agree with the kernel to rounding.
        means = support.make(RobustKalmanFilter, p).batch_filter(form)[0]
        np.testing.assert_allclose(means, expected, rtol=1e-12)
    states = support.through(support.make(RobustKalmanFilter, p), rows)
    np.testing.assert_allclose(states, expected[:, :, 0], rtol=1e-10)
    ours, theirs = (filter_series([form], p.F, p.H, p.Q, p.R, p.x.ravel(), p.P) for form in (rows, zs))
    np.testing.assert_array_equal(ours.x, theirs.x)
    for cls, functions in ((RobustKalmanFilter, ()), (RobustExtendedKalmanFilter, (lambda x: p.H, p.H.dot))):
        kf, twin = (cls(3, m) for _ in range(2))
        kf.update(pd.NA if m == 1 else [pd.NA] * m, *functions)
        twin.update(None, *functions)
        np.testing.assert_array_equal(kf.x, twin.x)
        np.testing.assert_array_equal(kf.P, twin.P)
