"""What filterpy and the trackers built on it do with a filter: banks, Saver, copies, kinematic_kf, slices."""

import inspect
import pickle

import numpy as np
import pytest
import support
from filterpy.common import Q_discrete_white_noise, Saver, kinematic_kf
from filterpy.kalman import IMMEstimator, KalmanFilter, MMAEFilterBank

from robust_filterpy import RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel, Linear

pytestmark = pytest.mark.core

NDIMS = [1, 2]


def travel(kf, zs):
    """Predict and update along zs."""
    for z in zs:
        kf.predict()
        kf.update(z)
    return kf


def recording(n=40, dim_z=2, seed=2):
    return support.simulate(support.random_problem(51, 4, dim_z), n, seed, contamination=0.2)[0]


CHOICES = [
    {},
    {"influence": Hampel(), "scaling": "bounded", "information": "weight"},
    {"influence": TukeyBiweight(), "information": "expected", "grouping": "joint"},
    {"influence": StudentT(), "grouping": "joint"},
]


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("gaps", [False, True])
def test_saver(ndim, gaps):
    kf = support.make(RobustKalmanFilter, support.random_problem(51, 4, 2), ndim)
    zs = recording()
    if gaps:
        zs[5, 0] = zs[9] = np.nan
    saver = Saver(kf)
    travel(kf, zs[:1])
    for z in zs:
        travel(kf, [z])
        saver.save()
    if gaps:
        kf.predict()
        kf.update(None)
        saver.save()
    saver.to_array()
    n = len(zs) + gaps
    tail = (1,) if ndim == 2 else ()
    assert len(saver) == n
    assert saver.x.shape == (n, 4, *tail)
    for name in ("y", "e", "weights", "clipped", "y_bounded"):
        assert getattr(saver, name).shape == (n, 2, *tail), name
    assert saver.T.shape == saver.S.shape == (n, 2, 2)
    assert saver.K.shape == (n, 4, 2)
    assert saver.log_likelihood.shape == saver.likelihood.shape == saver.mahalanobis.shape == (n,)
    step = np.einsum("kij,kj...->ki...", saver.K, saver.y_bounded)
    np.testing.assert_allclose(saver.x_post, saver.x_prior + step, atol=1e-9)
    assert saver.clipped.any() and not saver.clipped.all()


def test_what_the_class_adds_is_small():
    """Saver copies __dict__ every epoch."""
    ours = support.make(RobustKalmanFilter, support.random_problem(51, 4, 2))
    theirs = support.make(KalmanFilter, support.random_problem(51, 4, 2))
    for kf in (ours, theirs):
        travel(kf, recording(5))
    assert len(pickle.dumps(ours)) < 2 * len(pickle.dumps(theirs))


def bank(cls, ndim=2, **choices):
    """Two models of the same cart, one of them restless."""
    filters = []
    for factor in (1.0, 25.0):
        problem = support.cart()
        filters.append(support.make(cls, support.with_(problem, Q=factor * problem.Q), ndim, **choices))
    return filters


TRANSITION = np.array([[0.97, 0.03], [0.03, 0.97]])


def test_imm_with_an_infinite_threshold_is_filterpys():
    banks = [
        IMMEstimator(filters, (0.5, 0.5), TRANSITION)
        for filters in (bank(RobustKalmanFilter, influence=Linear()), bank(KalmanFilter))
    ]
    for z in support.simulate(support.cart(), 60, seed=4)[0]:
        for imm in banks:
            imm.predict()
            imm.update(z)
        for name in ("x", "P", "mu", "likelihood", "x_prior", "P_prior"):
            support.assert_close(getattr(banks[0], name), getattr(banks[1], name), 1e-9, name)


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("choices", CHOICES, ids=str)
def test_imm_survives_outliers_and_gaps(ndim, choices):
    imm = IMMEstimator(bank(RobustKalmanFilter, ndim, **choices), (0.5, 0.5), TRANSITION)
    zs = support.simulate(support.cart(), 60, seed=4)[0]
    zs[20], zs[30] = 1e6, np.nan
    for z in zs:
        imm.predict()
        imm.update(z)
        assert np.all(np.isfinite(imm.x)) and np.all(np.isfinite(imm.mu))
        support.assert_positive_definite(imm.P)
    assert abs(np.ravel(imm.x)[0] - zs[-1, 0]) < 10


def test_imm_forgets_nothing_at_a_missing_sample():
    imm = IMMEstimator(bank(RobustKalmanFilter), (0.5, 0.5), TRANSITION)
    for z in support.simulate(support.cart(), 30, seed=4)[0]:
        imm.predict()
        imm.update(z)
    imm.predict()
    mu = imm.cbar.copy()
    imm.update(None)
    np.testing.assert_allclose(imm.mu, mu, rtol=1e-12)


@pytest.mark.parametrize("ndim", NDIMS)
def test_mmae(ndim):
    """Its update passes z, R and H by position."""
    H = support.cart().H
    banks = [
        MMAEFilterBank(filters, np.array([0.5, 0.5]), dim_x=2, H=H)
        for filters in (bank(RobustKalmanFilter, ndim, influence=Linear()), bank(KalmanFilter, ndim))
    ]
    for z in support.simulate(support.cart(), 40, seed=4)[0]:
        for mmae in banks:
            mmae.predict()
            mmae.update(np.reshape(z, (1, 1) if ndim == 2 else (1,)), R=np.array([[1.5]]))
        for name in ("x", "P", "p"):
            support.assert_close(getattr(banks[0], name), getattr(banks[1], name), 1e-9, name)


@pytest.mark.skipif(
    "kf" not in inspect.signature(kinematic_kf).parameters, reason="filterpy 1.4.5 builds the filter itself"
)
@pytest.mark.parametrize("order_by_dim", [True, False])
def test_kinematic_kf_fills_the_filter_in_place(order_by_dim):
    kf = RobustKalmanFilter(dim_x=6, dim_z=1)
    assert kinematic_kf(3, 1, dt=0.1, order_by_dim=order_by_dim, kf=kf) is kf
    plain = kinematic_kf(3, 1, dt=0.1, order_by_dim=order_by_dim)
    np.testing.assert_array_equal(kf.F, plain.F)
    np.testing.assert_array_equal(kf.H, plain.H)
    for z in (0.1, 0.2, 1e6, 0.4):
        kf.predict()
        kf.update(z)
    assert np.abs(kf.x).max() < 10


def box_tracker(cls):
    """A SORT-like tracker of boxes: 7 states, 4 measured, everything written into slices."""
    kf = cls(dim_x=7, dim_z=4)
    kf.F = np.eye(7)
    kf.F[:3, 4:] = np.eye(3)
    kf.H = np.eye(4, 7)
    kf.R[2:, 2:] *= 10.0
    kf.P[4:, 4:] *= 1000.0
    kf.P *= 10.0
    kf.Q[-1, -1] *= 0.01
    kf.Q[4:, 4:] *= 0.01
    kf.x[:4] = np.array([[10.0], [20.0], [400.0], [1.5]])
    return kf


def test_a_tracker_that_writes_into_slices():
    ours, theirs = box_tracker(RobustKalmanFilter), box_tracker(KalmanFilter)
    ours.influence = Linear()
    rng = np.random.default_rng(2)
    for k in range(30):
        z = np.array([[10.0 + k], [20.0], [400.0 + 2 * k], [1.5]]) + rng.normal(size=(4, 1))
        for kf in (ours, theirs):
            if kf.x[6] + kf.x[2] <= 0:
                kf.x[6] *= 0.0
            kf.predict()
            kf.update(None if k == 12 else z)
            kf.x[5] = 0.0
        support.assert_same_state(ours, theirs, ("x", "P", "x_prior", "P_prior", "K"))


def test_a_tracker_with_points_that_come_and_go():
    """As in norfair: H with zero rows for unseen points and R made anew for every call."""
    points, n = 3, 6
    filters = []
    for cls, choices in ((RobustKalmanFilter, {"influence": Linear()}), (KalmanFilter, {})):
        kf = cls(dim_x=2 * n, dim_z=n, **choices)
        kf.F[:n, n:] = np.eye(n)
        kf.H = np.eye(n, 2 * n)
        kf.R *= 4.0
        kf.Q *= 0.1
        filters.append(kf)
    rng = np.random.default_rng(0)
    for _ in range(30):
        seen = np.repeat(rng.random(points) < 0.6, 2)
        z = rng.normal(size=(n, 1))
        for kf in filters:
            kf.predict()
            kf.update(z, None, np.diag(seen.astype(float)) @ kf.H)
        support.assert_same_state(*filters, ("x", "P", "K", "S"))


def test_a_program_that_changes_the_class_only():
    """The README's promise, on filterpy's usual first example."""

    def track(cls):
        f = cls(dim_x=2, dim_z=1)
        f.x = np.array([2.0, 0.0])
        f.F = np.array([[1.0, 1.0], [0.0, 1.0]])
        f.H = np.array([[1.0, 0.0]])
        f.P *= 1000.0
        f.R = 5
        f.Q = Q_discrete_white_noise(dim=2, dt=0.1, var=0.13)
        rng = np.random.default_rng(4)
        for t in range(200):
            f.predict()
            f.update(t + rng.normal() * 2 + (500.0 if t % 25 == 24 else 0.0))
        return f.x

    assert abs(track(RobustKalmanFilter)[0] - 199) < 4
    assert abs(track(KalmanFilter)[0] - 199) > 20
