"""Lock-out and capture: what a run of outliers must not do, and a true jump must."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from statsmodels.robust.norms import TrimmedMean
from support import of_matrices, recovering, through, without_kernel

from robust_filterpy import Huber, RobustKalmanFilter, TukeyBiweight
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core


def level(cls=recovering, **options):
    return of_matrices(cls, 1.0, [[1.0]], 0.01, 1.0, 0.1, np.zeros(1), **options)


def advance(kf, zs):
    return np.squeeze(through(kf, zs))


CHOICES = [{"influence": psi} for psi in (TukeyBiweight(), Hampel(), TrimmedMean(3.0), Huber())]
CHOICES += [{"information": "expected"}, {"information": "weight"}]


def recording(seed, jump=0.0, run=0, size=0.0, n=150, at=50):
    rng = np.random.default_rng(seed)
    x = 0.1 * np.cumsum(rng.normal(size=n))
    x[at:] += jump
    v = rng.normal(size=n)
    v[at : at + run] += size
    return x, x + v


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("options", CHOICES, ids=range(len(CHOICES)))
@pytest.mark.parametrize("R", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("jump", [6.0, -10.0, 30.0, 100.0, 1e3])
def test_every_true_jump_is_followed(options, R, jump):
    """Whatever R is, for which Q is in proportion here."""
    for seed in range(8):
        x, zs = recording(seed, jump)
        kf = level(**options)
        kf.Q, kf.R, kf.P = R * kf.Q, R * kf.R, R * kf.P
        path = advance(kf, zs)
        assert np.abs(path - x)[-30:].mean() < 1.0, (jump, seed)
        if abs(jump) >= 30:
            # The delay that is stated: patience and a few.
            assert np.abs(path - x)[50 + kf.patience + 10 :].max() < 2.5


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("size", [4.0, -8.0, 30.0, 1e6])
@pytest.mark.parametrize("run", [1, 5, 10, 11])
def test_a_run_shorter_than_the_patience_does_not_capture(run, size):
    peaks = []
    # An ordinary reading that is clipped makes a run of eleven one of twelve, of size 4 in 3 of 40 recordings.
    for seed in range(40):
        x, zs = recording(seed, run=run, size=size)
        peaks.append(np.abs(advance(level(), zs) - x)[50:].max())
    assert np.mean(peaks) < 2.0


def test_scattered_outliers_are_never_believed():
    rng = np.random.default_rng(3)
    zs = np.r_[rng.normal(size=20), rng.choice([-1, 1], 200) * rng.uniform(20, 1000, 200)]
    kf = level()
    path = advance(kf, zs)
    assert np.abs(path[20:40]).max() < 2.0


@pytest.mark.parametrize("by_kernel", [True, False])
@pytest.mark.parametrize("patience", [2, 5, 20])
def test_patience_is_the_number_of_refused_measurements(monkeypatch, patience, by_kernel):
    if not by_kernel:
        without_kernel(monkeypatch)
    zs = np.r_[np.zeros(100), np.full(patience, 40.0)] + np.random.default_rng(1).normal(size=100 + patience)
    kf = level(patience=patience)
    path = advance(kf, zs)
    assert np.abs(path[:-1]).max() < 2.0 and abs(path[-1] - 40.0) < 5.0


def averaging(cls, readings):
    """Estimates of a constant from readings of noise 1, Q = 0."""
    return advance(of_matrices(cls, 1.0, [[1.0]], 0.0, 1.0, 100.0, np.zeros(1)), readings)


def test_chance_is_no_jump_of_what_was_averaged_for_long():
    """Runs that chance clips on one side made the state forget: 1.17 of the Kalman filter's error, a quarter lost."""
    readings = np.random.default_rng(48).normal(size=(40, 2000))
    theirs, ours = (
        np.array([np.sqrt(np.mean(averaging(cls, z)[100:] ** 2)) for z in readings])
        for cls in (KalmanFilter, RobustKalmanFilter)
    )
    assert np.exp(np.log(ours / theirs).mean()) < 1.1
    assert (ours > 1.3 * theirs).sum() <= 6


@pytest.mark.parametrize("jump", [4.0, 6.0, 30.0])
def test_what_was_averaged_for_long_follows_a_true_jump(jump):
    for seed in range(10):
        readings = np.random.default_rng(seed).normal(size=2012)
        readings[2000:] += jump
        assert abs(averaging(RobustKalmanFilter, readings)[-1] - jump) < 2.0
