"""What filterpy and programs built on it do with a filter: banks, Saver, copies, and going on from an existing one."""

import copy
import pickle

import numpy as np
import pytest
import support
from benchmarks import box_tracking
from filterpy.common import Saver
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    IMMEstimator,
    KalmanFilter,
    MMAEFilterBank,
    UnscentedKalmanFilter,
)

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Huber,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    robust,
)
from robust_filterpy.filters import RobustCubatureKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

NDIMS = [1, 2]


def recording(n=40, dim_z=2, seed=2):
    return support.simulate(support.random_problem(51, 4, dim_z), n, seed, contamination=0.2)[0]


@pytest.mark.parametrize("ndim", NDIMS)
def test_saver(ndim):
    kf, zs = support.make(RobustKalmanFilter, support.random_problem(51, 4, 2), ndim), [*recording(), None]
    zs[5], zs[9] = [np.nan, zs[5][1]], [np.nan, np.nan]
    saver = Saver(kf)
    for z in zs:
        support.predict_and_update(kf, z)
        saver.save()
    saver.to_array()
    n, tail = len(zs), (1,) if ndim == 2 else ()
    shapes = {
        "x": (4, *tail), **dict.fromkeys(("y", "e", "weights", "clipped", "y_bounded"), (2, *tail)), "K": (4, 2),
        "T": (2, 2), "S": (2, 2), **dict.fromkeys(("log_likelihood", "likelihood", "mahalanobis"), ()),
    }  # fmt: skip
    for name, shape in shapes.items():
        assert getattr(saver, name).shape == (n, *shape), name
    step = np.einsum("kij,kj...->ki...", saver.K, saver.y_bounded)
    seen = np.arange(n - 1) != 9
    np.testing.assert_allclose((saver.x_post - saver.x_prior - step)[:-1][seen], 0.0, atol=1e-9)
    assert saver.clipped.any() and not saver.clipped.all()


def test_what_the_class_adds_is_small():
    """Saver copies __dict__ every epoch."""
    ours = support.make(RobustKalmanFilter, support.random_problem(51, 4, 2))
    theirs = support.make(KalmanFilter, support.random_problem(51, 4, 2))
    for kf in (ours, theirs):
        support.through(kf, recording(5))
    assert len(pickle.dumps(ours)) < 2 * len(pickle.dumps(theirs))


def bank(cls, ndim=2, **choices):
    """Two models of the same cart, one of them restless."""
    problems = (support.with_(support.cart(), Q=factor * support.cart().Q) for factor in (1.0, 25.0))
    return [support.make(cls, problem, ndim, **choices) for problem in problems]


TRANSITION = np.array([[0.97, 0.03], [0.03, 0.97]])


@pytest.mark.parametrize("ndim", NDIMS)
def test_banks_of_filters_with_an_infinite_threshold_are_filterpys(ndim):
    """The update of an MMAE passes z, R and H by position."""
    filters = [bank(RobustKalmanFilter, ndim, influence=Linear()), bank(KalmanFilter, ndim)]
    imms = [IMMEstimator(two, (0.5, 0.5), TRANSITION) for two in filters]
    zs = support.simulate(support.cart(), 60, seed=4)[0]
    support.assert_same_along(*imms, zs, names=("x", "P", "mu", "likelihood", "x_prior", "P_prior"), rtol=1e-9)
    filters = [bank(RobustKalmanFilter, ndim, influence=Linear()), bank(KalmanFilter, ndim)]
    mmaes = [MMAEFilterBank(two, np.array([0.5, 0.5]), dim_x=2, H=support.cart().H) for two in filters]

    def step(mmae, z):
        mmae.predict()
        mmae.update(np.reshape(z, (1, 1) if ndim == 2 else (1,)), R=np.array([[1.5]]))

    support.assert_same_along(*mmaes, zs, step=step, names=("x", "P", "p"), rtol=1e-9)


@pytest.mark.parametrize("factor", [1.0, 1e-4, 1e4])
@pytest.mark.parametrize("kind", [RobustKalmanFilter, AdaptiveKalmanFilter])
def test_a_tracker_of_boxes_loses_nobody_by_the_swap(kind, factor):
    """Set up as SORT does, x and P written in place, R a guess; MOTA as in `benchmarks/box_tracking.py`."""
    frames = box_tracking.drawn(box_tracking.SCENES["street"], seed=0, frames=150)
    theirs, ours = (
        box_tracking.judged(frames, box_tracking.tracked(lambda cls=cls: cls(7, 4), frames, 1, factor))[0]
        for cls in (KalmanFilter, kind)
    )
    assert theirs > 70.0 and ours > theirs - box_tracking.MOST_BELOW


# robust(kf): a filter that goes on from where an existing one of filterpy's is.


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
    ours = copy.deepcopy(robust(kf, influence=Huber(1.0)))
    # The functions of a filter of sigma points are this file's.
    ours = ours if hasattr(ours, "hx") else pickle.loads(pickle.dumps(ours))
    Saver(ours).save()
    # What the last step has left is there.
    for name in ("x", "P", "y", "S", "SI", "K", "x_prior", "P_prior", "x_post", "P_post", "z", "F", "H", "Q", "R"):
        np.testing.assert_array_equal(np.ravel(getattr(ours, name, 0)), np.ravel(getattr(kf, name, 0)), err_msg=name)
    assert ours.log_likelihood == pytest.approx(kf.log_likelihood)
    advance(ours, [1.2, 0.9, 1.1, 0.7, 1.3, 1e6])
    assert np.abs(ours.x).max() < 10.0 and ours.influence == Huber(1.0)
    support.assert_unchanged(before, kf)


@pytest.mark.parametrize("kf, match", [
    (RobustKalmanFilter(1, 1), "robust already"), (FixedLagSmoother(1, 1), "got FixedLagSmoother"),
    (None, "got NoneType"),
])  # fmt: skip
def test_what_it_cannot_convert_is_named(kf, match):
    with pytest.raises(TypeError, match=match):
        robust(kf)
    with pytest.raises(TypeError, match="influence: expected"):
        robust(KalmanFilter(1, 1), influence=3)
