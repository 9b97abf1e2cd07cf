"""robust(kf): a filter that goes on from where an existing one of filterpy's is."""

import copy
import pickle

import numpy as np
import pytest
import support
from filterpy.common import Saver
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    KalmanFilter,
    UnscentedKalmanFilter,
)

from robust_filterpy import Huber, RobustExtendedKalmanFilter, RobustKalmanFilter, RobustUnscentedKalmanFilter, robust
from robust_filterpy.filters import RobustCubatureKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core


class Logged(KalmanFilter):
    """A user's subclass that does something before filterpy."""

    def predict(self, *args, **kwargs):
        self.predictions = getattr(self, "predictions", 0) + 1
        super().predict(*args, **kwargs)


class Drifting(ExtendedKalmanFilter):
    """A user's model of the transition."""

    def predict_x(self, u=0):
        self.x = 0.9 * self.x + 1.0


def built(kind):
    x = np.array([1.0, 2.0])
    return support.of_matrices(kind, 1.0, np.eye(1, 2), 0.1, 3.0, 2.0, x)


def advance(kf, zs):
    for z in zs:
        kf.predict()
        if isinstance(kf, ExtendedKalmanFilter):
            kf.update(np.array([z]), lambda x: np.eye(1, 2), lambda x: x[:1])
        elif isinstance(kf, CubatureKalmanFilter):
            kf.update(np.array([[z]]))
        else:
            kf.update(np.array([z]))


KINDS = {
    KalmanFilter: RobustKalmanFilter, Logged: RobustKalmanFilter, ExtendedKalmanFilter: RobustExtendedKalmanFilter,
    Drifting: RobustExtendedKalmanFilter, UnscentedKalmanFilter: RobustUnscentedKalmanFilter,
    CubatureKalmanFilter: RobustCubatureKalmanFilter,
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("before", [[], [1.0, 0.5]], ids=["new", "running"])
def test_it_goes_on_as_filterpys_would_without_outliers(kind, before):
    kf = built(kind)
    advance(kf, before)
    ours = robust(kf, influence=Linear())
    assert isinstance(ours, KINDS[kind])
    theirs = copy.deepcopy(kf)
    for one in (ours, theirs):
        advance(one, [0.7, -0.2, 1.3])
    np.testing.assert_allclose(np.ravel(ours.x), np.ravel(theirs.x), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-9, atol=1e-12)
    assert getattr(ours, "predictions", None) == getattr(theirs, "predictions", None)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_an_outlier_no_longer_hurts_and_the_original_stays(kind):
    kf = built(kind)
    advance(kf, [1.0])
    before = support.snapshot(kf, [name for name, value in vars(kf).items() if isinstance(value, np.ndarray)])
    ours = robust(kf, influence=Huber(1.0))
    # What the last step has left is there.
    for name in ("x", "P", "y", "S", "SI", "K", "x_prior", "P_prior", "x_post", "P_post", "z", "F", "H", "Q", "R"):
        np.testing.assert_array_equal(np.ravel(getattr(ours, name, 0)), np.ravel(getattr(kf, name, 0)), err_msg=name)
    assert ours.log_likelihood == pytest.approx(kf.log_likelihood)
    advance(ours, [1.2, 0.9, 1.1, 0.7, 1.3, 1e6])
    assert np.abs(ours.x).max() < 10.0 and ours.influence == Huber(1.0)
    support.assert_unchanged(before, kf)


@pytest.mark.parametrize("kind", [KalmanFilter, Logged, Drifting], ids=lambda kind: kind.__name__)
def test_copies_pickles_and_savers_work(kind):
    ours = robust(built(kind))
    advance(ours, [1.0, 50.0])
    for other in (copy.deepcopy(ours), pickle.loads(pickle.dumps(ours))):
        assert type(other) is type(ours)
        advance(other, [2.0])
        np.testing.assert_array_equal(other.weights.shape, (1,))
    saver = Saver(ours)
    advance(ours, [2.0])
    saver.save()
    np.testing.assert_array_equal(other.x, ours.x)


@pytest.mark.parametrize(
    "kf, match",
    [
        (RobustKalmanFilter(1, 1), "robust already"), (FixedLagSmoother(1, 1), "got FixedLagSmoother"),
        (None, "got NoneType"),
    ],
)  # fmt: skip
def test_what_it_cannot_convert_is_named(kf, match):
    with pytest.raises(TypeError, match=match):
        robust(kf)
    with pytest.raises(TypeError, match="influence: expected"):
        robust(KalmanFilter(1, 1), influence=3)
