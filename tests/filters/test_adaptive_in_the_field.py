"""What happens to sensors in the field, under `AdaptiveKalmanFilter`, beside filterpy on the same readings."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from support import through, without_kernel

from robust_filterpy import AdaptiveKalmanFilter
from robust_filterpy.filters import StuckSensorWarning


def moving(kind, H=((1.0, 0.0),), q=1e-3, r=1.0, P=10.0, x=0.0):
    """Return a filter of a position that moves at a speed."""
    H = np.array(H)
    kf = kind(H.shape[1], len(H))
    kf.F = np.eye(H.shape[1]) + np.eye(H.shape[1], k=1) * (H.shape[1] == 2)
    kf.Q = q * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]) if H.shape[1] == 2 else np.diag([1e-3, 1e-3, 1e-6])
    kf.H, kf.R, kf.P = H, r * np.eye(len(H)), P * np.eye(H.shape[1])
    kf.x[0] = x
    return kf


@pytest.mark.parametrize("length", [1, 4, 7, 8, 30, 700])
@pytest.mark.parametrize("value", [-9999.0, 0.0, 65535.0, 1e30])
def test_a_run_of_fill_values_is_missing_and_is_said_once(value, length, recwarn):
    rng = np.random.default_rng(2)
    x = 20.0 + np.cumsum(0.05 * rng.normal(size=960))
    zs = np.round(x + 0.1 * rng.normal(size=960), 2)
    zs[200 : 200 + length] = value
    gaps = zs.copy()
    gaps[200 : 200 + length] = np.nan
    ours, theirs, missing = (
        np.abs(through(moving(kind, q=1e-4, r=0.01, P=100.0, x=20.0), readings)[200:, 0] - x[200:])
        for kind, readings in ((AdaptiveKalmanFilter, zs), (KalmanFilter, zs), (AdaptiveKalmanFilter, gaps))
    )
    # Nothing foresees a gap of hundreds.
    assert ours.max() < max(0.1 * theirs.max(), 1.05 * missing.max()) and ours[-60:].max() < 0.5
    assert sum(w.category is StuckSensorWarning for w in recwarn) == (length > 1)


def test_a_sensor_at_rest_that_truly_steps_is_followed():
    for step in (0.01, 0.5, 1.0):
        zs = np.round(np.where(np.arange(300) < 250, 20.0, 35.0) / step) * step
        assert np.abs(through(moving(AdaptiveKalmanFilter, r=0.04, x=20.0), zs)[260:, 0] - 35.0).max() < 1.0


def test_a_state_that_its_sensor_hardly_sees_keeps_a_bounded_covariance_through_many_jumps():
    rng, kf = np.random.default_rng(0), moving(AdaptiveKalmanFilter, [[1.0, 0.0, 1e-3]], P=1.0)
    widest = []
    for jump in range(10):
        through(kf, 100.0 * (jump % 2) + rng.normal(size=60))
        widest.append(kf.P.max())
        assert np.linalg.eigvalsh(kf.P).min() > 0.0
    # A reading of 100 in a millionth of the variance, by a third.
    assert max(widest) < 1.2e9


def test_of_two_sensors_the_one_that_has_gone_off_is_left():
    errors = np.zeros(2)
    for seed in range(4, 7):
        rng = np.random.default_rng(seed)
        x = np.cumsum(np.cumsum(np.sqrt(1e-3) * rng.normal(size=600)))
        zs = x[:, None] + rng.normal(size=(600, 2)) + np.outer(np.arange(600) >= 100, [0.0, 8.0])
        for i, kind in enumerate((AdaptiveKalmanFilter, KalmanFilter)):
            errors[i] += np.square(through(moving(kind, [[1.0, 0.0], [1.0, 0.0]]), zs)[:, 0] - x).sum()
    assert np.sqrt(errors[0] / errors[1]) < 0.17


def test_a_position_that_steps_is_not_taken_for_speed():
    for seed in range(4):
        kf = moving(AdaptiveKalmanFilter, r=0.09)
        kf.F[0, 1], kf.Q = 0.1, np.array([[1e-3 / 3, 5e-3], [5e-3, 0.1]])
        noise = 0.05 * np.random.default_rng(seed).normal(size=400)
        found = through(kf, 0.7 * np.arange(400) + 5.0 * (np.arange(400) >= 200) + noise)
        # filterpy's is off by 7.3.
        assert np.abs(found[190:, 1] - 7.0).max() < 1.0 and abs(found[-1, 0] - 284.3) < 0.1


def jumping(seed, size, every, share=0.0):
    rng = np.random.default_rng(seed)
    x = np.cumsum(np.cumsum(np.sqrt(1e-3) * rng.normal(size=1000)))
    x += np.cumsum(np.where(np.arange(1000) % every == 0, size * rng.choice([-1.0, 1.0], 1000), 0.0))
    return x, x + np.where(rng.random(1000) < share, 10.0, 1.0) * rng.normal(size=1000)


@pytest.mark.parametrize(
    "size, every, share, limit", [(30.0, 200, 0.0, 0.95), (30.0, 200, 0.05, 1.05), (8.0, 100, 0.0, 0.9)]
)
def test_how_many_readings_a_jump_needs_is_learnt(size, every, share, limit):
    cases = [jumping(seed, size, every, share) for seed in range(10, 16)]
    ours, theirs = (
        [np.square(through(moving(kind, x=x[0]), zs)[:, 0] - x).mean() for x, zs in cases]
        for kind in (AdaptiveKalmanFilter, KalmanFilter)
    )
    assert np.sqrt(np.mean(ours) / np.mean(theirs)) < limit


@pytest.mark.parametrize("length, far", [(1, 300.0), (1, 1e300), (3, 1e4)])
def test_after_jumps_no_outlier_that_is_farther_than_they_went_is_believed(length, far):
    x, zs = jumping(3, 30.0, 200)
    zs[950 : 950 + length] += far
    assert np.abs(through(moving(AdaptiveKalmanFilter, x=x[0]), zs)[900:, 0] - x[900:]).max() < 10.0


def test_the_definition_says_the_same_of_them(monkeypatch):
    rng = np.random.default_rng(0)
    hardly = 100.0 * (np.arange(150) // 50 % 2) + rng.normal(size=150)
    biased = rng.normal(size=(170, 2)) + np.outer(np.arange(170) >= 60, [0.0, 8.0])
    fills = np.where(np.arange(120) // 20 == 3, -9999.0, np.round(rng.normal(size=120), 1))
    cases = (((1.0, 0.0, 1e-3),), hardly), (((1.0, 0.0), (1.0, 0.0)), biased), (((1.0, 0.0),), fills)
    cases = (*cases, (((1.0, 0.0),), jumping(10, 30.0, 60)[1][:300]))
    expected = [through(moving(AdaptiveKalmanFilter, H), zs) for H, zs in cases]
    without_kernel(monkeypatch)
    for (H, zs), found in zip(cases, expected, strict=True):
        np.testing.assert_allclose(through(moving(AdaptiveKalmanFilter, H), zs), found, rtol=1e-9, atol=1e-9)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("top", [20.0, 140.0, 290.0])
@pytest.mark.parametrize("H", [[[1.0], [1.0]], [[1.0, 0.0], [0.0, 1.0]]])
def test_no_recording_is_lost_to_outliers_of_any_size(H, top):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        kf, zs = AdaptiveKalmanFilter(len(H[0]), 2), rng.normal(size=(300, 2))
        kf.H, kf.Q = np.array(H), 0.01 * kf.Q
        wild = rng.choice([-1.0, 1.0], size=zs.shape) * 10.0 ** rng.uniform(0.0, top, size=zs.shape)
        kf.batch_filter(np.where(rng.random(zs.shape) < 0.4, wild, zs))
        assert np.linalg.eigvalsh(kf.P).min() > 0.0


def test_what_was_refused_on_the_way_to_a_jump_is_an_outlier_in_no_class_any_more():
    for seed in range(3):
        zs = np.where(np.arange(420) >= 400, 30.0, 0.0) + np.random.default_rng(seed).normal(size=420)
        kf = moving(AdaptiveKalmanFilter)
        noises = [(through(kf, part), kf.noise_learnt)[1] for part in np.split(zs, [400, 403])]
        share = [float(noise.contamination[0]) for noise in noises]
        assert share[1] > share[0] + 0.01 and abs(share[2] - share[0]) < 0.002
        assert noises[2].scale_ratio[0] < 7.0
