"""estimate_noise: scales come back whatever the share of outliers, and the likelihood is the noise-matched filter's."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.correction.mixture import ContaminatedScore
from robust_filterpy.filters.gaussian_sum import NoiseMatchedKalmanFilter
from robust_filterpy.noise._likelihood import log_likelihoods, of_filter
from robust_filterpy.noise.estimation import estimate_noise

F = np.array([[1.0, 1.0], [0.0, 0.95]])
Q, R = np.diag([0.1, 0.05]), 2.0


def recording(seed, contamination, steps=2000, outlier=10.0):
    rng = np.random.default_rng(seed)
    x, zs = np.zeros(2), np.zeros(steps)
    for k in range(steps):
        x = F @ x + np.sqrt(np.diag(Q)) * rng.standard_normal(2)
        zs[k] = x[0] + np.sqrt(R) * rng.standard_normal() * (outlier if rng.random() < contamination else 1.0)
    return zs


def guess(kind=RobustKalmanFilter, scale_R=30.0, scale_Q=0.02):
    kf = kind(2, 1)
    kf.F, kf.H = F, np.array([[1.0, 0.0]])
    kf.R, kf.Q = np.array([[R * scale_R]]), Q * scale_Q
    return kf


@pytest.mark.parametrize("contamination", [0.0, 0.1, 0.2])
def test_scales_come_back_within_ten_percent(contamination):
    found = [estimate_noise(guess(), recording(seed, contamination)) for seed in range(3)]
    assert np.mean([f.R[0, 0] for f in found]) / R == pytest.approx(1.0, abs=0.1)
    assert np.mean([f.Q[0, 0] for f in found]) / Q[0, 0] == pytest.approx(1.0, abs=0.1)
    assert np.mean([f.contamination for f in found]) == pytest.approx(contamination, abs=0.02)
    assert all(f.converged for f in found)


@pytest.mark.slow
@pytest.mark.parametrize("contamination", [0.0, 0.05, 0.1, 0.15, 0.2])
def test_scales_come_back_over_many_seeds(contamination):
    found = [estimate_noise(guess(), recording(100 + seed, contamination)) for seed in range(8)]
    assert np.median([f.R[0, 0] for f in found]) / R == pytest.approx(1.0, abs=0.1)
    assert np.median([f.Q[0, 0] for f in found]) / Q[0, 0] == pytest.approx(1.0, abs=0.1)


def test_a_normal_likelihood_overestimates_r_several_times():
    assert estimate_noise(guess(), recording(1, 0.1, 1000), contamination=0.0).R[0, 0] > 4.0 * R


def test_likelihood_is_that_of_the_noise_matched_filter():
    zs = recording(2, 0.1, 60)
    zs[7] = np.nan
    kf = guess(NoiseMatchedKalmanFilter)
    kf.measurement = ContaminatedScore(0.1, 10.0)
    total = 0.0
    for z in zs:
        kf.predict()
        kf.update(z)
        total += kf.log_likelihood
    data = of_filter(guess(), zs, None, None, None, None, None)
    zero = np.zeros((1, 1))
    ours = log_likelihoods(data, zero, np.zeros((1, 2)), np.array([0.1]), np.array([10.0]))
    assert ours[0] == pytest.approx(total, rel=1e-9)


def test_each_sensor_gets_its_own_factor_and_missing_ones_do_no_harm():
    rng = np.random.default_rng(3)
    level = np.cumsum(0.3 * rng.standard_normal(1500))
    zs = level[:, None] + np.array([1.0, 3.0]) * rng.standard_normal((1500, 2))
    zs[rng.random(zs.shape) < 0.1] = np.nan
    kf = RobustKalmanFilter(1, 2)
    kf.H = np.ones((2, 1))
    found = estimate_noise(kf, zs, R="each")
    assert found.R.diagonal() == pytest.approx([1.0, 9.0], rel=0.2)
    assert found.R[0, 1] == 0.0
    same = estimate_noise(kf, zs[:300], R=[0, -1], Q=False)
    assert same.R[1, 1] == 1.0
    assert same.Q == pytest.approx(kf.Q)


def test_the_filter_is_left_alone_until_apply():
    kf = guess()
    before = (kf.x.copy(), kf.P.copy(), kf.R.copy(), kf.Q.copy())
    found = estimate_noise(kf, recording(4, 0.1, 200))
    for was, now in zip(before, (kf.x, kf.P, kf.R, kf.Q), strict=True):
        np.testing.assert_array_equal(was, now)
    assert found.apply(kf) is kf
    np.testing.assert_array_equal(kf.R, found.R)


def test_filterpys_own_filter_will_do():
    found = estimate_noise(guess(KalmanFilter), recording(5, 0.1, 300))
    assert 0.5 < found.R[0, 0] / R < 2.0


def test_a_factor_that_the_data_do_not_determine_is_reported():
    kf = RobustKalmanFilter(1, 1)
    kf.H = np.eye(1)
    found = estimate_noise(kf, np.random.default_rng(0).standard_normal(400) + 5.0)
    assert found.Q[0, 0] < 1e-3


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (dict(R="all"), "R: expected one of"),
        (dict(R=[0, 1]), "R: expected True"),
        (dict(Q=[0, 2]), "Q: expected groups numbered"),
        (dict(contamination=1.0), "contamination"),
        (dict(scale_ratio=0.5), "scale_ratio"),
    ],
)
def test_bad_options(change, match):
    with pytest.raises(ValueError, match=match):
        estimate_noise(guess(), np.zeros(50), **change)


def test_bad_recordings_and_filters():
    with pytest.raises(ValueError, match="at least 10"):
        estimate_noise(guess(), np.zeros(5))
    with pytest.raises(ValueError, match="not missing, got 0 in 50"):
        estimate_noise(guess(), np.full(50, np.nan))
    with pytest.raises(TypeError, match="linear filter"):
        estimate_noise(object(), np.zeros(50))
    kf = ExtendedKalmanFilter(2, 1)
    kf.hx = None
    with pytest.raises(TypeError, match="linear filter"):
        estimate_noise(kf, np.zeros(50))
