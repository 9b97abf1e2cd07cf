"""What the program around a filter does: numpy told to raise, missing values of pandas, whole tables of them."""

import numpy as np
import pytest
import support
from support import recovering, told, two_sided

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Huber,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    StudentT,
    TukeyBiweight,
    filter_series,
)
from robust_filterpy.influence import Hampel, Linear

SIZES = [1e-300, 1e-160, 1.0, 1e20, 1e160, 1e300]
READ = ("x", "P", "log_likelihood", "likelihood", "mahalanobis", "y_bounded", "weights")

pytestmark = pytest.mark.usefixtures("path")


@pytest.fixture
def raising():
    """Tell numpy to raise whatever it can."""
    with np.errstate(all="raise"):
        yield


def run(kf, zs):
    """Return what a user reads after every step."""
    found = []
    for z in zs:
        kf.predict()
        kf.update(z)
        found.append([np.copy(getattr(kf, name)) for name in READ])
    return found


@pytest.mark.pairwise
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("influence", [Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_numpy_told_to_raise_changes_no_number(influence, information, size):
    for dims in ((2, 1), (3, 2), (4, 3)):
        problem, zs = support.random_problem(5, *dims), np.outer([1.0, -1.0, 0.0], np.full(dims[1], size))
        for scaling, grouping in (("innovation", "component"), ("innovation", "joint"), ("bounded", "component")):
            options = {"influence": influence, "information": information, "scaling": scaling, "grouping": grouping}
            quiet = run(support.make(RobustKalmanFilter, problem, **options), zs)
            with np.errstate(all="raise"):
                loud = run(support.make(RobustKalmanFilter, problem, **options), zs)
            for ours, theirs in zip(loud, quiet, strict=True):
                for one, other in zip(ours, theirs, strict=True):
                    np.testing.assert_array_equal(one, other)


@pytest.mark.pairwise
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("cls", [recovering, told, two_sided, AdaptiveKalmanFilter])
def test_nor_does_it_stop_another_filter_or_a_series(raising, cls, size):
    problem = support.random_problem(5, 3, 2)
    zs = np.array([[size] * 2] * 14 + [[-size] * 2, [0.0, 0.0]])
    run(support.make(cls, problem), zs)
    support.make(RobustKalmanFilter, problem).batch_filter(zs)
    p = problem
    filter_series(np.tile(zs, (2, 1, 1)), p.F, p.H, p.Q, p.R, p.x.ravel(), p.P)


def test_a_prediction_that_overflows_is_refused_in_the_usual_words(raising):
    kf = support.make(RobustKalmanFilter, support.random_problem(5, 3, 2))
    kf.F = 1e200 * np.eye(3)
    before = support.snapshot(kf)
    with pytest.raises(ValueError, match="finite P"):
        kf.predict()
    support.assert_unchanged(before, kf)


@pytest.mark.parametrize("m", [1, 2])
def test_missing_values_of_pandas_are_missing(m):
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
        found = support.make(RobustKalmanFilter, p).batch_filter(form)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    path = support.through(support.make(RobustKalmanFilter, p), rows)
    np.testing.assert_allclose(path, expected[:, :, 0], rtol=1e-10)
    ours, theirs = (filter_series([form], p.F, p.H, p.Q, p.R, p.x.ravel(), p.P) for form in (rows, zs))
    np.testing.assert_array_equal(ours.x, theirs.x)
    for cls, functions in ((RobustKalmanFilter, ()), (RobustExtendedKalmanFilter, (lambda x: p.H, p.H.dot))):
        kf, twin = (cls(3, m) for _ in range(2))
        kf.update(pd.NA if m == 1 else [pd.NA] * m, *functions)
        twin.update(None, *functions)
        np.testing.assert_array_equal(kf.x, twin.x)
        np.testing.assert_array_equal(kf.P, twin.P)
