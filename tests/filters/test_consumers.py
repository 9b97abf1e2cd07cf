"""What filterpy and the trackers built on it do with a filter: banks, Saver, copies, kinematic_kf, slices."""

import pickle

import numpy as np
import pytest
import support
from filterpy.common import Q_discrete_white_noise, Saver
from filterpy.kalman import IMMEstimator, KalmanFilter, MMAEFilterBank

from robust_filterpy import RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel, Linear

pytestmark = pytest.mark.core

NDIMS = [1, 2]


def recording(n=40, dim_z=2, seed=2):
    return support.simulate(support.random_problem(51, 4, dim_z), n, seed, contamination=0.2)[0]


CHOICES = [
    {},
    {"influence": Hampel(), "scaling": "bounded", "information": "weight"},
    {"influence": TukeyBiweight(), "information": "expected", "grouping": "joint"},
    {"influence": StudentT(), "grouping": "joint"},
]


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
    support.through(imm, support.simulate(support.cart(), 30, seed=4)[0])
    imm.predict()
    mu = imm.cbar.copy()
    imm.update(None)
    np.testing.assert_allclose(imm.mu, mu, rtol=1e-12)


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
