"""Lock-out and capture: what a run of outliers must not do, and a true jump must."""

import numpy as np
import pytest
from statsmodels.robust.norms import TrimmedMean
from support import make, of_matrices, random_problem, recovering, through, with_, without_kernel

from robust_filterpy import Huber, RobustKalmanFilter, TukeyBiweight
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core


def level(cls=recovering, **options):
    return of_matrices(cls, 1.0, [[1.0]], 0.01, 1.0, 0.1, np.zeros(1), **options)


def advance(kf, zs):
    return np.squeeze(through(kf, zs))


PLAIN = {"influence": TukeyBiweight(), "scaling": "innovation"}
CHOICES = [{"influence": psi} for psi in (TukeyBiweight(), Hampel(), TrimmedMean(3.0), Huber())]
CHOICES += [{"scaling": "bounded"}, {"information": "expected"}, {"information": "weight", "scaling": "bounded"}]


def recording(seed, jump=0.0, run=0, size=0.0, n=150, at=50):
    rng = np.random.default_rng(seed)
    x = 0.1 * np.cumsum(rng.normal(size=n))
    x[at:] += jump
    v = rng.normal(size=n)
    v[at : at + run] += size
    return x, x + v


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("options", CHOICES, ids=range(len(CHOICES)))
@pytest.mark.parametrize("jump", [6.0, -10.0, 30.0, 100.0, 1e6])
def test_every_true_jump_is_followed(options, jump):
    for seed in range(8):
        x, zs = recording(seed, jump)
        kf = level(**options)
        path = advance(kf, zs)
        assert np.abs(path - x)[-30:].mean() < max(1.0, 1e-12 * abs(jump)), (jump, seed)
        if abs(jump) >= 30:
            # The delay that is stated: patience and a few.
            assert kf.recoveries == 1
            assert np.abs(path - x)[50 + kf.patience + 10 :].max() < max(2.5, 1e-12 * abs(jump))


def test_without_recovery_a_redescending_psi_locks_out():
    x, zs = recording(0, 30.0)
    assert np.abs(advance(level(RobustKalmanFilter, **PLAIN), zs) - x)[-1] > 25


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("size", [4.0, -8.0, 30.0, 1e6])
@pytest.mark.parametrize("run", [1, 5, 10, 11])
def test_a_run_shorter_than_the_patience_does_not_capture(monkeypatch, run, size):
    # The kernel has no recovering filter; to the last bit only the definition equals itself.
    without_kernel(monkeypatch)
    peaks, plain = [], []
    for seed in range(4):
        x, zs = recording(seed, run=run, size=size)
        kf = level()
        peaks.append(np.abs(advance(kf, zs) - x)[50:].max())
        plain.append(np.abs(advance(level(RobustKalmanFilter, **PLAIN), zs) - x)[50:].max())
        assert kf.recoveries == 0
    assert np.mean(peaks) < 2.0
    # Until it recovers it is the same filter.
    np.testing.assert_array_equal(peaks, plain)


def test_scattered_outliers_and_what_is_too_far_never_insist():
    rng = np.random.default_rng(3)
    scattered = np.r_[rng.normal(size=20), rng.choice([-1, 1], 200) * rng.uniform(20, 1000, 200)]
    for zs in (scattered, *(np.r_[np.zeros(20), np.full(40, size)] for size in (1e10, 1e200, 1.7e308))):
        kf = level()
        advance(kf, zs)
        assert kf.recoveries == 0 and abs(kf.x[0]) < 1.5 and kf.P[0, 0] < 5.0


@pytest.mark.parametrize("patience", [2, 5, 20])
def test_patience_is_the_number_of_refused_measurements(patience):
    kf = level(patience=patience)
    advance(kf, [*np.zeros(30), *np.full(patience - 1, 40.0)])
    assert (kf.recoveries, kf.refused) == (0, patience - 1)
    advance(kf, [40.0])
    assert (kf.recoveries, kf.refused) == (1, 0)
    assert kf.P[0, 0] == pytest.approx(9 * 1600)
    advance(kf, [40.0])
    assert abs(kf.x[0] - 40.0) < 0.5


def test_a_vector_jump_and_missing_components():
    problem = with_(random_problem(4, 3, 2), F=np.eye(3), H=np.eye(2, 3), Q=0.01 * np.eye(3), R=np.eye(2))
    for grouping in ("component", "joint"):
        kf = make(recovering, problem, grouping=grouping)
        zs = np.random.default_rng(0).normal(size=(100, 2))
        zs[50:] += [0.0, 60.0]
        zs[55, 1], zs[60] = np.nan, np.nan
        through(kf, zs)
        assert abs(kf.x[1, 0] - 60.0) < 2 and abs(kf.x[0, 0]) < 2 and kf.recoveries >= 1


def test_a_long_recording_recovers_too():
    """However batch_filter goes through a long recording, it must watch every sample."""
    _, zs = recording(3, 50.0, n=3000, at=1500)
    online, batch = level(), level()
    np.testing.assert_allclose(batch.batch_filter(zs)[0][:, 0], advance(online, zs), rtol=1e-10, atol=1e-12)
    assert batch.recoveries == online.recoveries == 1


@pytest.mark.parametrize("weight", [1e-3, 1e-6, 0.0])
def test_what_the_sensor_barely_sees_stays_as_certain_as_it_was(weight):
    F = [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    kf, rng = of_matrices(recovering, F, [[1.0, 0.0, weight]], np.diag([0.01, 0.01, 0.0])), np.random.default_rng(10001)
    for k in range(3000):
        kf.predict()
        kf.update(100.0 * (k // 100 % 2) + rng.normal())
        assert np.linalg.eigvalsh(kf.P)[0] > -1e-9 and kf.P[2, 2] < 2.0, k
    assert kf.recoveries >= 25


@pytest.mark.parametrize("scaling", ["innovation", "unit", "bounded"])
def test_a_direction_that_inv_leaves_out_does_not_count(scaling):
    kf = recovering(2, 2, patience=3, scaling=scaling)
    kf.H, kf.P, kf.Q, kf.R, kf.inv = np.eye(2), np.diag([0.01, 0.0]), 0.0, np.diag([0.01, 0.0]), np.linalg.pinv
    with np.errstate(all="raise"):
        through(kf, ([0.0, 50.0], [0.0, 50.0], [0.0, 50.0], [5.0, 50.0]))
    assert (kf.refused, kf.recoveries) == (1, 0)


def test_noise_that_is_correlated_with_the_state_has_no_part_in_what_a_recovery_opens():
    """The noise of the refused readings is theirs: P grows along P H', not along P H' + M."""
    problem, grown = random_problem(4, 3, 2), []
    for M in (problem.M, 0.0 * problem.M):
        kf = make(recovering, with_(problem, M=M), patience=2)
        kf.R = problem.R + problem.H @ (problem.M - M) + (problem.M - M).T @ problem.H.T
        for z in ([900.0, -800.0], [901.0, -801.0]):
            kf.update_correlated(z)
        assert kf.recoveries == 1
        grown.append(kf.P)
    np.testing.assert_allclose(*grown, rtol=1e-9)
